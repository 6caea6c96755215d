"""A mission from Python: the front door, parts of one's own, and what a user is told."""

import dataclasses
import json
import logging
import time

import numpy as np
import pytest
import threadpoolctl
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, EventStatus, LeafSystem
from pydrake.systems.primitives import ConstantVectorSource

import tfg_drake
from benchmarks.timelines import read_timeline
from examples.estimator import MakeTruthEstimator
from tests.diagrams.rooms import QUICK_LOOK, ROOM, lasting, room, tagged
from tfg_drake import kernels
from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams import compile_kernels
from tfg_drake.diagrams.explorer import MakeTfgExplorer
from tfg_drake.diagrams.methods import MethodError
from tfg_drake.diagrams.mission_diagram import ConnectStation
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld, Scenario, ScenarioError
from tfg_drake.diagrams.station import MakeTurtlebotStation
from tfg_drake.io.yaml_text import dump_yaml
from tfg_drake.mapfile.saved_map import load_map, restored_estimate
from tfg_drake.messages import replace
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.systems.differential_drive_plant import DifferentialDrivePlant
from tfg_drake.systems.info_gain_goal_selector import InfoGainGoalSelector
from tfg_drake.systems.ports import declare_message_output
from tfg_drake.systems.prm_planner import PrmPlanner
from tfg_drake.systems.pure_pursuit_follower import PurePursuitFollower
from tfg_drake.systems.slam_estimator import SlamEstimator

LISTED = "must be one of gain_per_time, argmax, tour, nearest_frontier, random"


def bare():
    return tagged(ROOM + QUICK_LOOK)


def test_a_kept_run_is_that_of_the_command_line_to_the_bit(call, tmp_path):
    file = tmp_path / "room.yaml"
    file.write_text(ROOM + QUICK_LOOK)
    code, _, _ = call("explore", file, "--tag-spacing", 1, "--seed", 5, "--headless", "--out", tmp_path / "one")
    assert code == 0
    two = tfg_drake.explore(file, tag_spacing=1.0, seed=5, out=tmp_path / "two")
    assert (two.folder, two.outcome) == (tmp_path / "two", "complete")
    assert lasting(json.loads((tmp_path / "one" / "summary.json").read_text())) == lasting(two.summary)
    for name in ("stages.jsonl", "map.npz", "trajectory.tum", "truth.tum", "scenario.yaml"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), name
    assert (tmp_path / "two" / "mission.html").stat().st_size > 100_000
    assert two.map.stage == two.summary["stages"]
    with pytest.raises(RuntimeError, match="the run is over"):
        two.advance(1.0)


def test_in_steps_it_is_the_same_mission(tmp_path):
    whole = tfg_drake.explore(bare(), out=tmp_path / "run")
    steps = tfg_drake.explore(bare(), until=7.3)
    assert (steps.folder, steps.summary) == (None, None)
    assert steps.advance(11.9).advance().outcome == whole.outcome
    assert steps.stages == whole.stages


def test_the_stages_of_a_mission_that_goes_on_from_anothers_context_begin_there():
    quick = ["explorer.first_look=0"]
    whole = tfg_drake.explore("house", settings=quick, until=12.0)
    before = whole.stages[-1]["stage"]
    fork = tfg_drake.explore("house", settings=quick, until=0.0)
    fork.context.SetTimeStateAndParametersFrom(whole.context)
    fork.simulator.Initialize()
    fork.advance(8.0)
    whole.advance(8.0)
    stages = [row["stage"] for row in fork.stages]
    assert before > 1
    assert len(stages) > 1
    assert stages == list(range(before, whole.stages[-1]["stage"] + 1))


def test_what_it_says_is_of_now_also_when_the_simulator_was_advanced():
    house = tfg_drake.explore(bare(), until=0.0)
    assert (house.map, house.status.stage) == (None, 0)
    house.simulator.AdvanceTo(8.0)
    assert house.status.stage == house.map.stage == house.tfg.stage == house.look("map").stage > 0
    assert f"{house.status.stage} stages" in repr(house)


@pytest.mark.parametrize(("landmarks", "drawn"), [("both", True), ("walls", False)])
def test_a_robot_that_maps_no_tags_has_no_camera_on_its_page(landmarks, drawn, tmp_path):
    tfg_drake.explore(bare(), settings=[f"explorer.landmarks={landmarks}"], out=tmp_path / "run", until=0.1)
    (world,) = [one for one in read_timeline(tmp_path / "run") if one.layer == "world"]
    assert (world.told["camera"] is not None) == drawn


def test_a_plant_begins_where_the_world_says():
    world = MakeWorld(bare().world)
    elsewhere = dataclasses.replace(world, start=np.array([0.1, 0.0, 0.0]) + world.start)
    with pytest.raises(ValueError, match=r"^truth.pose begins at \(.*\), not at world.start \(.*\), m and rad: "):
        tfg_drake.explore(bare(), plant=lambda scenario: DifferentialDrivePlant(elsewhere, scenario.robot), until=0.0)


def test_a_page_is_served_meanwhile(tmp_path, capsys):
    tfg_drake.explore(bare(), page=True, out=tmp_path / "run", until=1.0)
    assert "page: http://localhost:" in capsys.readouterr().out


@pytest.mark.parametrize("role", ["goal_selector", "estimator", "planner", "follower", "plant", "station"])
def test_an_instance_is_no_factory(role, tmp_path):
    system = ConstantVectorSource([0.0])
    line = f"{role}: must be a function that makes one, not a ConstantVectorSource: write lambda scenario: ..."
    with pytest.raises(TypeError) as caught:
        tfg_drake.explore(bare(), out=tmp_path / "run", **{role: system})
    assert str(caught.value) == line
    assert not (tmp_path / "run").exists()
    with pytest.raises(TypeError, match=f"{role}: its function must return a Drake System, not int"):
        tfg_drake.explore(bare(), **{role: lambda _scenario: 3})
    with pytest.raises(
        TypeError, match=rf"^{role}: is called with the scenario and nothing else: .*; write lambda scenario: \.\.\.$"
    ):
        tfg_drake.explore(bare(), **{role: SlamEstimator})


@pytest.mark.parametrize(
    ("role", "made", "line"),
    [
        (
            "estimator",
            lambda _: ConstantVectorSource([0.0]),
            "estimator ConstantVectorSource: lacks the output port pose, a message PoseEstimate; it has y0; "
            "MakePoseEstimator makes an estimator of a pose alone",
        ),
        (
            "goal_selector",
            lambda _: ConstantVectorSource([0.0]),
            "goal_selector ConstantVectorSource: lacks the output port goal, a message GoalChoice; it has y0",
        ),
        (
            "plant",
            lambda _: ConstantVectorSource([0.0]),
            "plant ConstantVectorSource: lacks the output port pose, a vector of size 5; it has y0",
        ),
        (
            "station",
            lambda _: ConstantVectorSource([0.0]),
            "station: lacks the output ports base.odometry, tags.detections, scan.ranges, base.hazards, base.enabled; "
            "see MakeTurtlebotStation",
        ),
        (
            "follower",
            lambda _: PoseAsVelocity(),
            "follower PoseAsVelocity: its output port velocity_commanded must carry a vector of size 2, not a vector "
            "of size 3",
        ),
    ],
)
def test_a_part_without_a_port_is_told_by_its_name_when_it_is_built(role, made, line):
    with pytest.raises(TypeError) as caught:
        tfg_drake.explore(bare(), until=0.0, **{role: made})
    assert str(caught.value) == line


def test_a_part_with_another_message_is_told_before_it_drives():
    with pytest.raises(TypeError) as caught:
        tfg_drake.explore(bare(), until=0.0, goal_selector=lambda _: NumberAsGoal())
    assert str(caught.value) == "goal_selector.goal must hold GoalChoice, not int"


class NumberAsGoal(LeafSystem):
    """A goal selector that says a number."""

    def __init__(self):
        super().__init__()
        declare_message_output(self, "goal", lambda _context: 3, {self.nothing_ticket()})


class PoseAsVelocity(LeafSystem):
    """A follower with a vector of another size."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("velocity_commanded", 3, lambda context, output: None)


def test_tags_are_placed_or_left_out():
    assert tfg_drake.explore("corridor", until=0.0).scenario.world.tags
    assert not tfg_drake.explore("corridor", tag_spacing=None, until=0.0).scenario.world.tags
    with pytest.raises(TypeError, match="tag_spacing 'none': must be metres, or None for no tags"):
        tfg_drake.explore("corridor", tag_spacing="none")


def test_what_does_not_go_together_is_told():
    with pytest.raises(MethodError, match="grid-nearest: has parts of its own; with planner= leave method out"):
        tfg_drake.explore(bare(), method="grid-nearest", planner=lambda _: None)
    with pytest.raises(TypeError, match="plant: is for the usual station"):
        tfg_drake.explore(bare(), plant=lambda _: None, station=lambda _: None)
    with pytest.raises(ValueError, match="until -3: must be 0 or more"):
        tfg_drake.explore(bare(), until=-3.0)


@pytest.mark.parametrize(
    ("section", "key", "value", "complaint"),
    [
        ("explorer", "goal", "bst", f"scenario: explorer.goal: {LISTED}, is bst"),
        ("robot", "radius", -0.2, "scenario: robot.radius: must be greater than 0, is -0.2"),
        ("tags", "range", "far", "scenario: tags.range: expected a number, found text ('far')"),
    ],
)
def test_a_scenario_changed_in_python_is_checked_like_a_file(section, key, value, complaint):
    scenario = bare()
    setattr(getattr(scenario, section), key, value)
    for use in (lambda: tfg_drake.explore(scenario), lambda: MakeTfgExplorer(scenario)):
        with pytest.raises(ScenarioError) as caught:
            use()
        assert str(caught.value) == complaint


def test_what_is_no_field_of_a_scenario_is_told():
    scenario = bare()
    scenario.explorer.stop_gian = 7.0
    with pytest.raises(ScenarioError, match=r"^scenario: explorer\.stop_gian: unknown key; did you mean stop_gain\?$"):
        tfg_drake.explore(scenario)
    scenario = bare()
    scenario.robot = {"max_speed": 0.3}
    with pytest.raises(ScenarioError, match=r"^scenario: \{'max_speed': 0\.3\} is a dict; give a section as its class"):
        tfg_drake.explore(scenario)


def test_a_scenario_that_is_read_is_not_written_over(tmp_path):
    mine = tmp_path / "scenario.yaml"
    mine.write_text(ROOM + QUICK_LOOK)
    with pytest.raises(BadInput, match=r"its scenario\.yaml, which is read, would be written over"):
        tfg_drake.explore(mine, out=tmp_path)
    assert mine.read_text() == ROOM + QUICK_LOOK


def test_a_scenario_from_yaml_is_changed_and_written_back(tmp_path):
    scenario = LoadScenario("house")
    scenario.explorer.stop_gain, scenario.seed = 7.0, 11
    (tmp_path / "mine.yaml").write_text(dump_yaml(dataclasses.asdict(scenario)))
    assert LoadScenario(tmp_path / "mine.yaml") == scenario
    layered = LoadScenario("house", data="{seed: 11, explorer: {stop_gain: 7}}")
    assert layered == scenario


def test_the_truth_is_an_estimator(tmp_path):
    run = tfg_drake.explore(bare(), estimator=MakeTruthEstimator, out=tmp_path / "run")
    summary = run.summary
    assert summary["outcome"] == "complete"
    assert summary["position_error_m"]["max"] < 1e-9
    assert summary["landmarks_mapped"] == summary["landmarks_reachable"] == len(run.map.ids)
    assert summary["surface_coverage"] > 0.9
    assert (run.folder / "mission.html").exists()
    # What the file says of an estimator without a graph is its map.
    saved = load_map(run.folder)
    np.testing.assert_allclose(restored_estimate(saved).p_ML, run.map.p_ML, atol=1e-9)
    np.testing.assert_allclose(restored_estimate(saved).covariance, run.map.covariance, atol=1e-9)
    assert saved.stage == saved.tfg.stage == summary["stages"]


def MakeByHand(scenario, **parts):
    """Station and explorer, as a user puts them together: simulator and explorer."""
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("my robot", MakeTurtlebotStation(scenario))
    explorer = builder.AddNamedSystem("my explorer", MakeTfgExplorer(scenario, **parts))
    ConnectStation(builder, station, explorer)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    diagram.SetRandomContext(simulator.get_mutable_context(), RandomGenerator(scenario.seed))
    return simulator, explorer


def test_the_truth_is_an_estimator_by_hand():
    simulator, explorer = MakeByHand(bare(), estimator=MakeTruthEstimator)
    simulator.AdvanceTo(8.0)
    estimate = explorer.GetOutputPort("map").Eval(explorer.GetMyContextFromRoot(simulator.get_context()))
    assert estimate.stage >= 1
    assert explorer.HasInputPort("truth.pose")


def test_a_diagram_by_hand_keeps_blas_to_one_thread_and_is_that_of_explore():
    with threadpoolctl.threadpool_limits(limits=2):
        simulator, explorer = MakeByHand(bare())
        assert {one["num_threads"] for one in threadpoolctl.threadpool_info() if one["user_api"] == "blas"} == {1}
    simulator.AdvanceTo(8.0)
    estimate = explorer.GetOutputPort("map").Eval(explorer.GetMyContextFromRoot(simulator.get_context()))
    other = tfg_drake.explore(bare(), until=8.0).look("map")
    assert (estimate.stage, estimate.entropy) == (other.stage, other.entropy)


def test_planner_selector_follower_and_plant_of_ones_own():
    made = []

    def noted(name, system):
        made.append(name)
        return system

    def MakePlanner(scenario):
        parts = scenario.robot, scenario.tags, scenario.odometry, scenario.explorer, scenario.planner
        return noted("planner", PrmPlanner(PlanningParameters(*parts, scenario.seed + 1)))

    def MakeSelector(scenario):
        parts = scenario.robot, scenario.tags, scenario.odometry, scenario.explorer
        return noted("goal_selector", InfoGainGoalSelector(PlanningParameters(*parts)))

    def MakeFollower(scenario):
        slow = dataclasses.replace(scenario.robot, max_speed=0.1)
        return noted("follower", PurePursuitFollower(slow, scenario.explorer, None))

    def MakePlant(scenario):
        return noted("plant", DifferentialDrivePlant(MakeWorld(scenario.world), scenario.robot))

    parts = {"planner": MakePlanner, "goal_selector": MakeSelector, "follower": MakeFollower, "plant": MakePlant}
    mission = tfg_drake.explore(room(), until=14.0, **parts)
    assert sorted(made) == sorted(parts)
    stamps, X_WB = mission.X_WB_true
    speed = np.hypot(*np.diff(X_WB[:, :2], axis=0).T) / np.diff(stamps)
    assert 0.05 < speed.max() < 0.11


class Lost(InfoGainGoalSelector):
    """Chooses a node that is not there."""

    def _Choose(self, *arguments):
        return replace(super()._Choose(*arguments), node=10**6)


def test_a_goal_that_is_no_node_is_told_at_once(tmp_path):
    def MakeLost(scenario):
        return Lost(PlanningParameters(scenario.robot, scenario.tags, scenario.odometry, scenario.explorer))

    with pytest.raises(ValueError, match="goal of stage 1: there is no node 1000000; choose one of the roadmap's"):
        tfg_drake.explore(room(), goal_selector=MakeLost)
    with pytest.raises(ValueError, match="there is no node 1000000"):
        tfg_drake.explore(room(), goal_selector=MakeLost, out=tmp_path / "run")
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["outcome"] == "fault"


def MakeModestStation(scenario, truth=("truth.pose",)):
    """A station that knows of the truth its pose alone, or nothing."""
    builder = DiagramBuilder()
    inner = builder.AddNamedSystem("inner", MakeTurtlebotStation(scenario))
    builder.ExportInput(inner.GetInputPort("base.velocity_commanded"), "base.velocity_commanded")
    for name in ("base.odometry", "base.hazards", "base.enabled", "tags.detections", "scan.ranges", *truth):
        builder.ExportOutput(inner.GetOutputPort(name), name)
    return builder.Build()


def test_a_station_needs_no_truth_but_its_pose(tmp_path):
    run = tfg_drake.explore(bare(), station=MakeModestStation, out=tmp_path / "run")
    assert run.outcome == "complete"
    assert run.summary["contacts"] is None
    assert run.summary["position_error_m"]["max"] < 0.1


def test_of_a_station_without_truth_the_world_is_not_known(tmp_path):
    run = tfg_drake.explore(bare(), station=lambda of: MakeModestStation(of, ()), until=8.0, out=tmp_path / "run")
    assert run.summary["surface_coverage"] is None
    assert run.summary["position_error_m"]["max"] is None


def test_what_belongs_to_the_run_is_refused_when_it_is_resumed(tmp_path):
    tfg_drake.explore(bare(), until=6.0, out=tmp_path / "run")
    with pytest.raises(BadInput, match="seed=, settings=: of the run that is resumed"):
        tfg_drake.explore(resume=tmp_path / "run", seed=4, settings=["explorer.stop_gain=9"])
    assert tfg_drake.explore(resume=tmp_path / "run", until=7.0).time == 7.0


@pytest.mark.parametrize("by", ["diagram", "explorer"])
def test_a_monitor_stops_at_so_many_tags(by):
    mission = tfg_drake.explore(bare(), until=0.0)

    def enough(root):
        estimate = mission.explorer.GetOutputPort("map").Eval(mission.explorer.GetMyContextFromRoot(root))
        if len(estimate.ids) >= 10:
            return EventStatus.ReachedTermination(getattr(mission, by), "ten tags")
        return EventStatus.DidNothing()

    mission.simulator.set_monitor(enough)
    mission.advance()
    assert mission.outcome == ""
    assert len(mission.look("map").ids) >= 10


def test_kernels_that_are_compiled_are_told_on_standard_error(monkeypatch, capsys):
    compiled = iter([False, False])

    class Compiling:
        word, ended = "compiling kernels, about 40 s left", False

        def close(self):
            pass

    def wait(_seconds):
        Compiling.ended = True

    monkeypatch.setattr(kernels, "are_compiled", lambda: next(compiled))
    monkeypatch.setattr(compile_kernels, "WarmUp", Compiling)
    monkeypatch.setattr(compile_kernels.time, "sleep", wait)
    compile_kernels.make_kernels_ready.__wrapped__()
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("compiling kernels, once per installation, into ")
    monkeypatch.setattr(kernels, "are_compiled", lambda: True)
    compile_kernels.make_kernels_ready.__wrapped__()
    assert capsys.readouterr() == ("", "")


def test_real_time_that_is_missed_is_told_once(caplog):
    mission = tfg_drake.explore(bare(), until=0.0, realtime_rate=1e4)
    with caplog.at_level(logging.WARNING, "tfg_drake.pace"):
        mission.advance(0.5)
        # Nobody can simulate that fast, but a second is not missed yet.
        assert not caplog.text
        time.sleep(1.2)  # What a user does between two steps is no delay.
        mission.advance(0.5)
        assert not caplog.text
        mission.simulator.set_monitor(lambda _root: time.sleep(0.05))
        mission.advance(3.0)
    assert caplog.text.count("real time is missed, by ") == 1


def test_as_fast_as_possible_misses_nothing(caplog):
    tfg_drake.explore(Scenario(world=bare().world), until=0.5)
    assert "real time is missed" not in caplog.text


def test_time_does_not_run_backwards():
    with pytest.raises(ValueError, match=r"^until -3: must be 0 or more$"):
        tfg_drake.explore("house", until=-3)
    house = tfg_drake.explore("house", until=0.0)
    with pytest.raises(ValueError, match=r"^-3 s: must be 0 or more; time does not run backwards$"):
        house.advance(-3)
    assert house.time == 0.0


def test_what_the_method_fixes_is_in_the_scenario_and_not_to_be_set():
    mission = tfg_drake.explore(bare(), method="paper", until=0.0)
    assert (mission.scenario.explorer.gain, mission.scenario.explorer.landmarks) == ("paper", "tags")
    with pytest.raises(MethodError, match=r"^paper: fixes explorer.gain=paper; leave explorer.gain=exact out, or take"):
        tfg_drake.explore(bare(), method="paper", settings=["explorer.gain=exact"], until=0.0)
