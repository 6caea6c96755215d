"""A mission in Meshcat: what is there, when it was there in a recording, and that it is nobody else's business."""

import base64
import itertools
import logging
import re
import time

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.geometry import Meshcat, MeshcatParams
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.multibody.tree import SpatialInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import ConstantValueSource, ConstantVectorSource

import tfg_drake
from tests.systems.web_page import WebPage
from tfg_drake.diagrams.commands.explore import open_meshcat
from tfg_drake.geometry.se2 import compose, pose_at
from tfg_drake.messages import (
    WALLS_BELOW,
    GoalChoice,
    LaserScan,
    MapEstimate,
    MissionStatus,
    Observation,
    Path,
    PoseEstimate,
    Roadmap,
    TfgMap,
    replace,
)
from tfg_drake.pictures import tables
from tfg_drake.pictures.layers import LOOKS
from tfg_drake.pictures.plates import legend_plate, words_plate
from tfg_drake.simulation.people import People, places_at
from tfg_drake.systems.ports import PERIOD, MessageState
from tfg_drake.systems.visualizer import TfgVisualizer
from tfg_drake.world.world import World


@pytest.fixture(scope="module")
def meshcat():
    return Meshcat(MeshcatParams(host="localhost"))


def make_world():
    walls = np.array([[0.0, 0.0, 8.0, 0.0], [8.0, 0.0, 8.0, 5.0]])
    return World(
        walls=walls,
        tag_ids=np.array([3]),
        p_WT=np.array([[4.0, 0.0]]),
        tag_facing=np.array([np.pi / 2]),
        start=np.array([2.0, 2.0, 0.5]),
    )


def make_map(n=2, stage=1):
    observation = Observation(
        ids=np.zeros(0, dtype=int),
        stamps=np.zeros(0),
        X_AB=np.zeros((0, 3)),
    )
    return MapEstimate(
        stage=stage,
        stamp=1.0,
        ids=np.arange(n),
        p_ML=np.arange(2.0 * n).reshape(n, 2),
        anchor=np.zeros((n, 2)),
        reach=np.zeros((n, 2)),
        X_MD=np.zeros(3),
        local=np.arange(n),
        covariance=0.01 * np.eye(2 * n + 3),
        landmark_covariance=np.tile(0.01 * np.eye(2), (n, 1, 1)),
        X_MA=np.zeros((stage, 3)),
        observation=observation,
        entropy=-1.0,
    )


def make_messages(f=2):
    """One of each; f frontiers, surfaces, candidates and path points, 0 for the empty messages of the beginning."""
    points = np.arange(2.0 * f).reshape(f, 2)
    tfg = TfgMap(
        stage=1,
        segments=np.hstack([points, points + 1.0]),
        segment_kind=np.arange(f) % 3,
        segment_ids=np.full((f, 2), -1),
        facing=np.zeros((f, 2)),
        frontiers=points,
        frontier_length=np.ones(f),
        frontier_normal=np.zeros((f, 2)),
        star_offsets=np.zeros(1, dtype=int),
        star_vertices=np.zeros((0, 2)),
        star_centers=np.zeros((0, 2)),
    )
    roadmap = Roadmap(
        stage=1,
        points=points,
        edges=np.array([[0, 1]] if f else np.zeros((0, 2), dtype=int)),
        reachable=np.ones(f, dtype=bool),
        enterable=np.ones(f, dtype=bool),
        entry=np.arange(f),
        travel_time=np.ones(f),
        travel_length=np.ones(f),
    )
    goal = GoalChoice(
        stage=1,
        node=0 if f else -1,
        p_MG=np.zeros(2),
        candidates=np.arange(f),
        exploitation=np.ones(f),
        exploration=np.ones(f),
        pose_price=np.zeros(f),
        gain=np.ones(f),
        value=np.ones(f),
        verdict="goal" if f else "complete",
        reason="",
    )
    pose = PoseEstimate(
        stamp=1.0,
        X_MB=np.array([1.0, 0.0, 0.1]),
        covariance=1e-4 * np.eye(3),
        speed=np.zeros(2),
        stage=1,
        new_ids=np.zeros(0, dtype=int),
        p_MU=np.zeros((0, 2)),
    )
    ranges = np.array([1.0, np.inf, 2.0]) if f else np.full(3, np.inf)
    scan = LaserScan(stamp=1.0, angles=np.array([-1.0, 0.0, 1.0]), ranges=ranges, range_max=10.0, sigma=0.01)
    return {
        "map": make_map(f),
        "tfg": tfg,
        "roadmap": roadmap,
        "goal": goal,
        "path": Path(id=1, stage=1, points=points),
        "pose": pose,
        "scan": scan,
        "mission": MissionStatus(phase="follow", stage=1, since=0.0),
    }


def make_diagram(meshcat, messages, world=None):
    builder = DiagramBuilder()
    visualizer = TfgVisualizer(meshcat, world, np.array([2.0, 2.0, 0.5]))
    builder.AddNamedSystem("visualizer", visualizer)
    for name, message in messages.items():
        source = builder.AddSystem(ConstantValueSource(Value[object](message)))
        builder.Connect(source.get_output_port(), visualizer.GetInputPort(name))
    if messages:
        truth = builder.AddSystem(ConstantVectorSource([3.0, 2.0, 0.5, 0.0, 0.0]))
        builder.Connect(truth.get_output_port(), visualizer.GetInputPort("truth"))
    return builder.Build()


def is_visible(meshcat, path):
    """Meshcat has it as msgpack has booleans."""
    return {b"\xc3": True, b"\xc2": False}[meshcat._GetPackedProperty(f"/tfg/{path}", "visible")[-1:]]


def drawn(meshcat, path):
    """The OBJ file and materials that stand there."""
    return meshcat._GetPackedObject(f"/tfg/{path}")


def told(meshcat, words):
    """Whether these stand beside the building."""
    return base64.b64encode(words_plate(words)) in drawn(meshcat, "words/1")


STAGE_PATHS = [*(f"map/{layer}/1" for layer in ("map", "tfg", "frontiers", "gains")), "map/driving/path/1"]


def test_draws_everything_that_is_there(meshcat):
    Simulator(make_diagram(meshcat, make_messages(), make_world())).AdvanceTo(1.0)
    for path in [*STAGE_PATHS, "map/driving/goal/1", "map/scan/1", "map/robot", "truth", "world/walls", "world/floor"]:
        assert drawn(meshcat, path), path
    assert b"usemtl edge" in drawn(meshcat, "map/tfg/1")
    assert b"usemtl landmark_3sigma" in drawn(meshcat, "map/map/1")


def test_a_tour_has_numbers_a_way_a_trail_and_words(meshcat):
    messages = make_messages()
    choice = replace(messages["goal"], tour=messages["goal"].candidates[:2])
    choice = replace(choice, value=np.full(len(choice.candidates), -12.0))
    Simulator(make_diagram(meshcat, messages | {"goal": choice}, make_world())).AdvanceTo(1.0)
    tour = drawn(meshcat, "map/tour/1")
    assert all(name in tour for name in (b"usemtl stop", b"usemtl number"))
    assert b"usemtl robot_3sigma" in drawn(meshcat, "map/uncertainty/1")
    assert told(meshcat, "1 s, stage 1, follow, goal (2.0, 2.0) m, tour of 2 in 12 s, most gain 1 nats")
    assert b"usemtl plate" in drawn(meshcat, "legend/1")
    assert not any(base64.b64encode(legend_plate(names)[0]) in drawn(meshcat, "legend/1") for names in ((), LOOKS))
    assert is_visible(meshcat, "map/gains")


def test_places_to_go_to_are_gone_when_the_mission_is_over(meshcat):
    over = MissionStatus(phase="done", stage=1, since=0.0, outcome="complete", reason="nothing is open")
    Simulator(make_diagram(meshcat, make_messages() | {"mission": over}, make_world())).AdvanceTo(0.5)
    assert [is_visible(meshcat, f"map/{name}") for name in ("gains", "tour")] == [False, False]
    assert told(meshcat, "0 s, stage 1, complete")


class Ending(LeafSystem):
    """A mission that is over at 1 s, and ends the simulation a period later, as a sequencer does."""

    def __init__(self, status):
        super().__init__()
        self._status, self._over = MessageState(self, status), replace(status, phase="done", outcome="budget")
        self.DeclareStateOutputPort("mission", self._status.index)
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Update(self, context, state):
        if self._status(context).outcome:
            return EventStatus.ReachedTermination(self, "over")
        return self._status.set(state, self._over) if context.get_time() >= 1.0 else EventStatus.DidNothing()


def test_the_end_of_a_mission_is_told(meshcat):
    builder = DiagramBuilder()
    mission = builder.AddSystem(Ending(make_messages()["mission"]))
    visualizer = builder.AddSystem(TfgVisualizer(meshcat))
    builder.Connect(mission.get_output_port(), visualizer.GetInputPort("mission"))
    source = builder.AddSystem(ConstantValueSource(Value[object](make_messages()["pose"])))
    builder.Connect(source.get_output_port(), visualizer.GetInputPort("pose"))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(2.0)
    assert simulator.get_context().get_time() < 1.1
    assert told(meshcat, "1 s, stage 1, budget")


class Way(LeafSystem):
    """A pose that goes ahead by a metre a second."""

    def __init__(self, pose):
        super().__init__()
        at = lambda context, value: value.set_value(  # noqa: E731
            replace(pose, stamp=context.get_time(), X_MB=np.array([context.get_time(), 0.0, 0.0]))
        )
        self.DeclareAbstractOutputPort("pose", lambda: Value[object](pose), at)


def test_the_trail_grows_by_pieces_that_hang_together(meshcat):
    builder = DiagramBuilder()
    way, visualizer = builder.AddSystem(Way(make_messages()["pose"])), builder.AddSystem(TfgVisualizer(meshcat))
    builder.Connect(way.get_output_port(), visualizer.GetInputPort("pose"))
    Simulator(builder.Build()).AdvanceTo(10.0)
    reach = []
    for piece in range(3):
        text = drawn(meshcat, f"map/trail/{piece}/1")
        x = [float(found) for found in re.findall(rb"v (-?[0-9.]+) -?[0-9.]+ 0\.03", text)]
        reach.append((min(x), max(x)))
    assert reach[0][0] < 0.1
    assert all(one[1] >= after[0] for one, after in itertools.pairwise(reach))
    assert reach[-1][1] > 9.5


def test_draws_walls_that_are_landmarks(meshcat):
    ids, reach = np.append(WALLS_BELOW - 1, [0, 1]), np.array([[-1.0, 2.0], [0, 0], [0, 0]])
    with_walls = replace(make_map(3), ids=ids, reach=reach)
    Simulator(make_diagram(meshcat, make_messages() | {"landmarks": with_walls}, make_world())).AdvanceTo(0.5)
    assert b"usemtl wall_landmark_3sigma" in drawn(meshcat, "map/wall_landmarks/1")


def make_people(p_WP):
    none, nobody = np.zeros(len(p_WP)), np.zeros(len(p_WP), dtype=bool)
    ways = (np.zeros((0, 2)),) * len(p_WP)
    return People(0.0, p_WP, np.zeros_like(p_WP), none, none, none, nobody, nobody, ways)


def test_draws_who_walks_about(meshcat):
    people = make_people(np.array([[1.0, 2.0], [3.0, 4.0]]))
    Simulator(make_diagram(meshcat, {"people": people}, make_world())).AdvanceTo(0.5)
    assert meshcat.HasPath("/tfg/people/1")
    assert not meshcat.HasPath("/tfg/people/2")
    assert np.array([3.0, 4.0]).astype(">f8").tobytes()[:8] in meshcat._GetPackedTransform("/tfg/people/1")
    Simulator(make_diagram(meshcat, make_messages(), make_world())).AdvanceTo(0.5)
    assert not meshcat.HasPath("/tfg/people")


def test_another_simulation_begins_anew_and_empty_messages_leave_nothing_behind(meshcat):
    Simulator(make_diagram(meshcat, make_messages(), make_world())).AdvanceTo(0.5)
    diagram = make_diagram(meshcat, make_messages(f=0), make_world())
    for _ in range(2):
        Simulator(diagram).AdvanceTo(0.5)
        for path in STAGE_PATHS:
            assert not drawn(meshcat, path), path


def test_works_with_nothing_connected(meshcat):
    diagram = make_diagram(meshcat, {})
    Simulator(diagram).AdvanceTo(0.5)
    diagram.ForcedPublish(diagram.CreateDefaultContext())
    assert drawn(meshcat, "map/robot")
    assert not is_visible(meshcat, "truth")


def test_before_there_is_anything_the_true_robot_stands_at_the_start(meshcat):
    TfgVisualizer(meshcat, make_world())
    assert is_visible(meshcat, "truth")
    start = np.array([np.cos(0.5), np.sin(0.5), 0.0, 0.0, -np.sin(0.5), np.cos(0.5), 0, 0, 0, 0, 1, 0, 2.0, 2.0, 0, 1])
    assert start.astype(">f8").tobytes()[:8] in meshcat._GetPackedTransform("/tfg/truth")


@pytest.mark.parametrize(
    ("phase", "moving", "shown"),
    [("follow", True, True), ("glance", True, True), ("map", True, True), ("map", False, False)],
)
def test_the_path_is_shown_as_long_as_the_robot_drives(meshcat, phase, moving, shown):
    mission = MissionStatus(phase=phase, stage=1, since=0.0, moving=moving)
    Simulator(make_diagram(meshcat, make_messages() | {"mission": mission})).AdvanceTo(0.5)
    assert is_visible(meshcat, "map/driving") is shown


class GrowingMap(LeafSystem):
    """A map that gains a landmark at 0.3 s."""

    def __init__(self, first, second):
        super().__init__()
        state = self.DeclareAbstractState(Value[object](first))
        self.DeclarePeriodicUnrestrictedUpdateEvent(
            10.0, 0.3, lambda _c, s: s.get_mutable_abstract_state(0).set_value(second)
        )
        self.DeclareStateOutputPort("map", state)


def growing(meshcat):
    """A diagram that draws a growing map."""
    builder = DiagramBuilder()
    source = builder.AddSystem(GrowingMap(make_map(1, 1), make_map(2, 2)))
    visualizer = builder.AddSystem(TfgVisualizer(meshcat))
    builder.Connect(source.get_output_port(), visualizer.GetInputPort("map"))
    return builder.Build()


def test_without_a_recording_a_map_that_grows_keeps_its_path():
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    simulator = Simulator(growing(meshcat))
    simulator.AdvanceTo(0.25)
    before = drawn(meshcat, "map/map/1")
    simulator.AdvanceTo(1.0)
    assert len(drawn(meshcat, "map/map/1")) > len(before)
    assert not meshcat.HasPath("/tfg/map/map/2")


def test_in_a_recording_it_has_a_path_a_version_until_there_is_another():
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    simulator = Simulator(growing(meshcat))
    simulator.AdvanceTo(0.25)
    meshcat.StartRecording()
    simulator.AdvanceTo(0.75)
    meshcat.StopRecording()
    assert [is_visible(meshcat, f"map/map/{k}") for k in (1, 2)] == [False, True]
    scene = simulator.get_system().GetSystems()[1]._scene
    for count in (3, 4):  # The third is written over.
        estimate = make_map(count, count)
        scene.write_rows("map", float(count), tables.landmarks(estimate))
    assert [is_visible(meshcat, f"map/map/{k}") for k in (1, 2, 3)] == [False, False, True]
    assert not meshcat.HasPath("/tfg/map/map/4")
    meshcat.StartRecording()
    scene.write_rows("map", 5.0, tables.landmarks(make_map(2, 2)))
    assert [meshcat.HasPath(f"/tfg/map/map/{k}") for k in (1, 2, 3, 4)] == [False, False, True, True]


def test_a_lost_picture_is_told_once_and_ends_nothing(caplog):
    level = logging.getLogger("drake").level
    meshcat = open_meshcat()  # Its server's last words do not wait for Python's lock.
    logging.getLogger("drake").setLevel(level)
    simulator = Simulator(make_diagram(meshcat, make_messages()))
    simulator.AdvanceTo(0.5)
    page = WebPage(meshcat.port())  # which stays until the end
    page.send(b"\xc1")  # malformed
    end = time.monotonic() + 30.0
    while not (told := [one.getMessage() for one in caplog.records if one.name == "tfg_drake.visualizer"]):
        assert time.monotonic() < end
        simulator.AdvanceTo(simulator.get_context().get_time() + 0.25)
    simulator.AdvanceTo(simulator.get_context().get_time() + 1.0)
    reason = "Meshcat's internal websocket thread exited unexpectedly"
    assert told == [f"the picture in Meshcat is lost: {reason}; the mission goes on"]
    assert len([one for one in caplog.records if one.name == "tfg_drake.visualizer"]) == 1


def test_the_users_meshcat_and_loggers_are_left_alone(meshcat):
    level = logging.getLogger("drake").level
    meshcat.SetProperty("/Background", "visible", True)
    properties = [("/Background", "visible"), ("/Grid", "visible"), ("/Axes", "visible")]
    properties.append(("/Lights/AmbientLight/<object>", "intensity"))
    before = [meshcat._GetPackedProperty(*one) for one in properties]
    Simulator(make_diagram(meshcat, make_messages(), make_world())).AdvanceTo(0.5)
    assert [meshcat._GetPackedProperty(*one) for one in properties] == before
    assert logging.getLogger("drake").level == level


def test_a_plant_of_the_users_moves_in_the_same_meshcat(meshcat):
    from pydrake.geometry import Box, MeshcatVisualizer
    from pydrake.math import RigidTransform

    builder = DiagramBuilder()
    plant, scene_graph = AddMultibodyPlantSceneGraph(builder, 0.01)
    ball = plant.AddRigidBody("ball", SpatialInertia.SolidCubeWithDensity(1000.0, 0.1))
    plant.RegisterVisualGeometry(ball, RigidTransform(), Box(0.1, 0.1, 0.1), "ball", [1.0, 0.0, 0.0, 1.0])
    plant.Finalize()
    MeshcatVisualizer.AddToBuilder(builder, scene_graph, meshcat)
    builder.AddSystem(TfgVisualizer(meshcat, make_world()))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.1)
    before = meshcat._GetPackedTransform("/drake/visualizer/ball")
    simulator.AdvanceTo(0.5)
    assert before
    assert meshcat._GetPackedTransform("/drake/visualizer/ball") != before
    assert drawn(meshcat, "world/walls")


def test_redraws_a_stage_once_and_only_when_it_changes(meshcat, monkeypatch):
    diagram = growing(meshcat)
    scene = diagram.GetSystems()[1]._scene
    shown = []
    monkeypatch.setattr(scene, "write_rows", lambda layer, time, table, **told: shown.append(told["stage"]))
    Simulator(diagram).AdvanceTo(1.0)
    assert shown == [1, 2]
    # What is drawn belongs to the simulation: a new one begins anew.
    Simulator(diagram).AdvanceTo(0.2)
    assert shown == [1, 2, 1]


QUICK_LOOK = ["explorer.first_look=2", "explorer.first_turns=1"]


def test_a_mission_is_the_same_with_and_without_it(meshcat):
    def driven(**shown):
        mission = tfg_drake.explore("house", until=14.0, settings=QUICK_LOOK, **shown)
        return mission.look("truth.pose"), mission.map.p_ML, mission.stages

    for with_it, without in zip(driven(meshcat=meshcat), driven(), strict=True):
        np.testing.assert_array_equal(with_it, without)


# What a page shows: where robot, truth and people are in W, and the vertices of visible landmarks in M and of the path.
SHOWN = """viewer.animator.pause(); viewer.animator.seek(arguments[0]);
viewer.scene.updateMatrixWorld(true);
const T = MeshCat.THREE, at = (...path) => viewer.scene_tree.find(["tfg", ...path]).object;
// The page's own axes have y up.
const place = (object) => { const e = object.matrixWorld.elements; return [e[12], -e[14]]; };
const vertices = (root, material) => {
  const found = [];
  root.traverseVisible((part) => {
    const materials = [part.material ?? []].flat(), k = materials.findIndex((one) => one.name === material);
    if (k < 0) return;
    const groups = part.geometry.groups.length ? part.geometry.groups : [{ materialIndex: 0, start: 0, count: 1e9 }];
    const points = part.geometry.attributes.position.array;
    for (const group of groups.filter((one) => one.materialIndex === k))
      for (let i = group.start; i < group.start + group.count && 3 * i < points.length; i++)
        found.push([points[3 * i], points[3 * i + 1]]);
  });
  return found;
};
const drives = at("map", "driving").visible;
return { robot: place(at("map", "robot")), truth: place(at("truth")), people: place(at("people", "0")),
         landmarks: vertices(at("map", "map"), "landmark"),
         path: drives ? vertices(at("map", "driving"), "path") : [] };
"""
CORNERS = 30  # of the top of a landmark: ten triangles


LONG_LOOK = ["reality.people=1", "explorer.first_look=20", "explorer.first_turns=3"]


@pytest.mark.slow
def test_a_published_recording_plays_the_mission(driver, tmp_path):
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    mission = tfg_drake.explore("house", meshcat=meshcat, until=0.0, settings=LONG_LOOK)
    meshcat.StartRecording()
    moments = []

    def in_sight():
        return mission.status.drives, mission.look("path").id, mission.look("map").stage

    for soon in (20.0, 40.0, 42.0, 50.0, 55.0, 61.0):
        mission.advance(soon - mission.time)
        before, there = None, in_sight()
        while there != before:  # It is recorded eight times a second.
            mission.advance(0.2)
            before, there = there, in_sight()
        now = mission.time
        pose, people = mission.look("pose"), mission.look("truth.people")
        moments.append(
            {
                "time": now,
                "robot": compose(mission.X_WM, pose_at(pose, now))[:2],
                "truth": mission.look("truth.pose")[:2],
                "people": places_at(people, now)[0],
                "landmarks": mission.map.p_ML if mission.map is not None else np.zeros((0, 2)),
                "path": mission.look("path").points if mission.status.drives else np.zeros((0, 2)),
            }
        )
    assert not len(moments[0]["landmarks"])
    assert len({len(one["landmarks"]) for one in moments}) > 2
    assert {len(one["path"]) > 0 for one in moments} == {True, False}
    mission.advance(0.2)  # Between two recorded poses the robot is between them.
    meshcat.StopRecording()
    meshcat.PublishRecording()
    page = tmp_path / "mission.html"
    page.write_text(meshcat.StaticHtml())

    driver.get(page.as_uri())
    end = time.monotonic() + 60.0
    while not driver.execute_script("return viewer.animator.duration > 0"):
        assert time.monotonic() < end
        time.sleep(0.1)
    shown = driver.execute_script(SHOWN, 0.0)  # Nobody has pressed play: it shows the end.
    np.testing.assert_allclose(shown["robot"], moments[-1]["robot"], atol=0.1)
    assert len(shown["landmarks"]) >= CORNERS * max(len(one["landmarks"]) for one in moments)
    driver.execute_script("viewer.animator.play()")
    for one in [*moments, moments[1]]:
        shown = driver.execute_script(SHOWN, one["time"])
        for name in ("robot", "truth", "people"):
            np.testing.assert_allclose(shown[name], one[name], atol=0.03, err_msg=f"{name} at {one['time']} s")
        corners = np.array(shown["landmarks"]).reshape(-1, CORNERS, 2)
        assert len(corners) == len(one["landmarks"])
        if len(corners):
            nearest = np.linalg.norm(corners.mean(axis=1)[:, None] - one["landmarks"], axis=2).min(axis=0)
            assert nearest.max() < 0.1
        path = np.array(shown["path"]).reshape(-1, 2)
        assert (len(path) > 0) == (len(one["path"]) > 0)
        if len(path):
            np.testing.assert_allclose(path.min(axis=0), one["path"].min(axis=0), atol=0.1)
            np.testing.assert_allclose(path.max(axis=0), one["path"].max(axis=0), atol=0.1)
