"""What a mission looks like, recorded: each message once, and nothing is changed by it."""

import collections

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource

from benchmarks.timelines import read_timeline
from tests.systems.test_visualizer import GrowingMap, make_map, make_messages
from tests.walls import known_at_their_ends, walls_between
from tfg_drake.messages import WALLS_BELOW, GridMap, replace
from tfg_drake.simulation.disturbance import Pushes, with_push
from tfg_drake.simulation.people import People
from tfg_drake.storage.timeline import FILE_NAME, TimelineWriter
from tfg_drake.systems.timeline_recorder import TimelineRecorder


@pytest.fixture
def writer(tmp_path):
    with TimelineWriter(tmp_path / FILE_NAME) as writer:
        yield writer


def make_diagram(writer, messages, truth=True):
    builder = DiagramBuilder()
    recorder = builder.AddNamedSystem("recorder", TimelineRecorder(writer))
    for name, message in messages.items():
        source = builder.AddSystem(ConstantValueSource(Value[object](message)))
        builder.Connect(source.get_output_port(), recorder.GetInputPort(name))
    if truth:
        pose = builder.AddSystem(ConstantVectorSource([3.0, 2.0, 0.5, 0.0, 0.0]))
        enabled = builder.AddSystem(ConstantVectorSource([1.0]))
        builder.Connect(pose.get_output_port(), recorder.GetInputPort("truth"))
        builder.Connect(enabled.get_output_port(), recorder.GetInputPort("enabled"))
    return builder.Build()


def recorded(writer, tmp_path):
    writer.flush()
    return read_timeline(tmp_path)


def test_what_does_not_change_is_written_once_and_what_moves_again_and_again(writer, tmp_path):
    Simulator(make_diagram(writer, make_messages())).AdvanceTo(1.0)
    records = recorded(writer, tmp_path)
    counts = collections.Counter(record.layer for record in records)
    once = [
        "map",
        "tfg",
        "frontiers",
        "nodes",
        "roadmap",
        "goal",
        "gains",
        "path",
        "mission",
        "enabled",
        "scan",
    ]
    assert {name: counts[name] for name in once} == dict.fromkeys(once, 1)
    assert counts["pose"] == counts["truth"] == 9
    truth = [record for record in records if record.layer == "truth"]
    np.testing.assert_allclose(truth[0].arrays["pose"], [3.0, 2.0, 0.5])
    told = {record.layer: record.told for record in records}
    assert told["enabled"]["enabled"] is True
    assert told["mission"]["phase"] == "follow"
    assert told["gains"]["explained"][0]["chosen"]
    assert told["goal"]["most"] == 1.0


def test_the_tour_is_recorded_with_the_goal(writer, tmp_path):
    messages = make_messages(3)
    goal = replace(messages["goal"], value=np.array([-9.0, -np.inf, -2.0]), node=2, tour=np.array([2, 0]))
    roadmap = replace(messages["roadmap"], ids=np.arange(3))
    Simulator(make_diagram(writer, messages | {"goal": goal, "roadmap": roadmap})).AdvanceTo(0.1)
    layers = {record.layer: record for record in recorded(writer, tmp_path)}
    np.testing.assert_allclose(layers["goal"].arrays["tour"], roadmap.points[[2, 0]])
    assert layers["goal"].arrays["done"].tolist() == [2.0, 9.0]
    assert [row["at"] for row in layers["gains"].told["explained"]] == [[4.0, 5.0], [2.0, 3.0]]


def test_tags_that_are_seen_and_not_mapped_are_recorded_as_they_change(writer, tmp_path):
    pose = replace(make_messages()["pose"], new_ids=np.array([4, 9]), p_MU=np.array([[1.0, 2.0], [3.0, 4.0]]))
    Simulator(make_diagram(writer, {"pose": pose})).AdvanceTo(2.0)
    (sighted,) = [record for record in recorded(writer, tmp_path) if record.layer == "sighted"]
    assert sighted.arrays["ids"].tolist() == [4, 9]
    np.testing.assert_allclose(sighted.arrays["points"], pose.p_MU)


@pytest.mark.parametrize("places", [-1, 0, 3])
def test_in_how_many_places_of_its_map_the_robot_may_be_is_recorded_once(writer, tmp_path, places):
    pose = replace(make_messages()["pose"], places=places)
    Simulator(make_diagram(writer, {"pose": pose})).AdvanceTo(1.0)
    assert [one.told["places"] for one in recorded(writer, tmp_path) if one.layer == "places"] == [places]


def test_before_there_is_a_scan_none_is_recorded(writer, tmp_path):
    messages = make_messages()
    Simulator(make_diagram(writer, messages | {"scan": replace(messages["scan"], stamp=-np.inf)})).AdvanceTo(0.5)
    assert "scan" not in {record.layer for record in recorded(writer, tmp_path)}


def test_a_push_is_recorded(writer, tmp_path):
    Simulator(make_diagram(writer, {"pushes": with_push(Pushes(), 2.5)})).AdvanceTo(1.0)
    (record,) = [record for record in recorded(writer, tmp_path) if record.layer == "pushes"]
    (push,) = record.told["pushes"]
    assert (push["time"], push["left"], push["turn"]) == (2.5, 0.5, np.pi / 6)


def test_with_nothing_connected_there_is_nothing_to_write(writer, tmp_path):
    diagram = make_diagram(writer, {}, truth=False)
    Simulator(diagram).AdvanceTo(0.5)
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    assert recorded(writer, tmp_path) == []


def test_empty_messages_of_the_beginning(writer, tmp_path):
    Simulator(make_diagram(writer, make_messages(f=0))).AdvanceTo(0.25)
    layers = {record.layer: record for record in recorded(writer, tmp_path)}
    assert layers["goal"].arrays["points"].shape == layers["goal"].arrays["tour"].shape == (0, 2)
    assert layers["map"].arrays["points"].shape == (0, 2)


def test_a_map_is_written_when_it_grows_and_not_while_there_is_no_view(writer, tmp_path):
    def times(first, second):
        builder = DiagramBuilder()
        source = builder.AddSystem(GrowingMap(first, second))
        recorder = builder.AddSystem(TimelineRecorder(writer))
        builder.Connect(source.get_output_port(), recorder.GetInputPort("map"))
        Simulator(builder.Build()).AdvanceTo(1.0)
        return [(record.time, record.told["stage"]) for record in recorded(writer, tmp_path)]

    assert times(make_map(1, 1), make_map(2, 2)) == [(0.0, 1), (0.5, 2)]
    writer.close()
    writer.__init__(tmp_path / FILE_NAME)
    assert times(make_map(0, 0), make_map(0, 0)) == [(0.0, 0)]


def test_walls_that_are_landmarks_are_written_with_the_map(writer, tmp_path):
    def estimates(x):
        """At two stages, tags alone and with walls at some x."""
        estimate = make_map(2, 1)
        ids, none = WALLS_BELOW - len(x) + np.arange(len(x)), np.zeros((len(estimate.ids), 2))
        walls, anchor, reach = walls_between([[[at, -1.0], [at, 1.0]] for at in x])
        with_walls = replace(
            estimate,
            ids=np.append(ids, estimate.ids),
            p_ML=np.vstack([walls, estimate.p_ML]),
            anchor=np.vstack([anchor, none]),
            reach=np.vstack([reach, none]),
            landmark_covariance=np.concatenate([known_at_their_ends(reach, 0.3), estimate.landmark_covariance]),
        )
        return estimate, with_walls

    first, second = estimates([0.0]), estimates([0.0, 91.0])
    builder = DiagramBuilder()
    recorder = builder.AddSystem(TimelineRecorder(writer))
    for k, name in enumerate(("map", "landmarks")):
        source = builder.AddSystem(GrowingMap(first[k], replace(second[k], stage=2)))
        builder.Connect(source.get_output_port(), recorder.GetInputPort(name))
    Simulator(builder.Build()).AdvanceTo(0.6)
    walls = [record for record in recorded(writer, tmp_path) if record.layer == "wall_landmarks"]
    assert [record.time for record in walls] == [0.0, 0.5]
    np.testing.assert_allclose(walls[0].arrays["segments"], [[0.0, -1.0, 0.0, 1.0]], atol=1e-9)
    segments = walls[1].arrays["segments"]
    np.testing.assert_allclose(segments, [[0.0, -1.0, 0.0, 1.0], [91.0, -1.0, 91.0, 1.0]], atol=1e-9)
    np.testing.assert_allclose(walls[1].arrays["deviation"], 0.3)


def test_a_forced_publish_writes_what_was_held_back(writer, tmp_path):
    big = replace(make_messages()["roadmap"], points=np.zeros((20000, 2)))
    builder = DiagramBuilder()
    source = builder.AddSystem(GrowingMap(big, replace(big, stage=2)))
    recorder = builder.AddSystem(TimelineRecorder(writer))
    builder.Connect(source.get_output_port(), recorder.GetInputPort("roadmap"))
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(1.0)
    assert [record.layer for record in recorded(writer, tmp_path)] == ["nodes", "roadmap"]
    diagram.ForcedPublish(simulator.get_context())
    assert [record.layer for record in recorded(writer, tmp_path)] == ["nodes", "roadmap"] * 2


def test_a_grid_and_people(writer, tmp_path):
    probability = np.full((4, 5), 0.5, dtype=np.float32)
    probability[1, :3], probability[2, 1] = 0.0, 1.0
    grid = GridMap(stage=2, stamp=1.0, resolution=0.1, origin=np.zeros(2), probability=probability)
    none, nobody = np.zeros(2), np.zeros(2, dtype=bool)
    p_WP = np.array([[1.0, 2.0], [3.0, 4.0]])
    people = People(0.0, p_WP, np.zeros((2, 2)), none, none, none, nobody, nobody, (np.zeros((0, 2)),) * 2)
    Simulator(make_diagram(writer, {"grid": grid, "people": people})).AdvanceTo(0.1)
    layers = {record.layer: record for record in recorded(writer, tmp_path)}
    np.testing.assert_allclose(layers["grid"].arrays["free"], [[0.05, 0.15, 0.25, 0.15]], atol=1e-3)
    np.testing.assert_allclose(layers["grid"].arrays["occupied"], [[0.15, 0.25, 0.15, 0.25]], atol=1e-3)
    np.testing.assert_allclose(layers["people"].arrays["points"], p_WP)
