"""A mission that was cut short, gone on with."""

import dataclasses
import json
import math
import shutil
import time
from functools import partial

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import FirstOrderLowPassFilter

import tfg_drake
from benchmarks.timelines import read_timeline
from tests.diagrams.rooms import room as divided_room
from tests.storage.test_checkpoint import TOLD
from tfg_drake.diagrams.explorer import MakeTfgExplorer
from tfg_drake.diagrams.methods import METHODS, FindMethod
from tfg_drake.diagrams.missions import run
from tfg_drake.diagrams.missions.mission import Mission, MissionRequest
from tfg_drake.diagrams.missions.resume import cut_short
from tfg_drake.diagrams.recorded_station import ReplayRobot
from tfg_drake.diagrams.robots import SIMULATED
from tfg_drake.diagrams.scenario import ApplySettings, ApplyWorldFile, LoadScenario, MakeWorld
from tfg_drake.diagrams.station import MakeTurtlebotStation
from tfg_drake.geometry.se2 import compose, pose_at
from tfg_drake.messages import FloatArray, replace
from tfg_drake.mission.manual_drive import Pressed, drive_csv
from tfg_drake.simulation.differential_drive import TIME
from tfg_drake.storage import port_recording, timeline
from tfg_drake.storage.checkpoint import CheckpointError, read_checkpoint, write_checkpoint
from tfg_drake.storage.port_recording import read_recording
from tfg_drake.systems.differential_drive_plant import DifferentialDrivePlant

# People and changes, too: the whole world goes on.
ROOMS = """
seed: 3
world:
  start: [2, 1.5, 0.3]
  walls: [[0, 0, 9, 0], [9, 0, 9, 4], [9, 4, 0, 4], [0, 4, 0, 0], [3, 2.2, 3, 4], [6, 0, 6, 2.6]]
explorer: {first_look: 2, first_turns: 1}
reality:
  people: 1
  changes: [{time: 9, walls: [[4, 1, 4.4, 1]]}]
disturbances: [{time: 11, duration: 0.5, ahead: 0.1, turn: 0.1}]
"""
CUT, END = 12.0, 18.0
# What a machine takes differs from run to run.
COSTS = ("wall_time_s", "cpu_time_s", "real_time_factor", "peak_rss_bytes", "stage_ms")


def scenario():
    return ApplyWorldFile(LoadScenario(data=ROOMS), tag_spacing=1.0)


def same(summary):
    return {key: value for key, value in summary.items() if key not in COSTS and not key.endswith("cpu_s")}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return run.run_mission(scenario(), name="rooms", max_time=END, out_dir=tmp_path_factory.mktemp("whole"))


@pytest.fixture(scope="module")
def half(tmp_path_factory):
    return run.run_mission(scenario(), name="rooms", max_time=CUT, out_dir=tmp_path_factory.mktemp("half"))


def gone_on(folder, out, end=END):
    return run.run_mission(cut_short(folder, out).request, max_time=end)


@pytest.fixture(scope="module")
def after(half, tmp_path_factory):
    return gone_on(half.folder, tmp_path_factory.mktemp("after") / "after")


def test_a_resumed_mission_ends_as_if_it_had_not_been_cut(whole, after):
    assert after.summary["resumed_at_s"] == [CUT]
    assert same(after.summary) == {**same(whole.summary), "resumed_at_s": [CUT]}
    for name in ("stages.jsonl", "trajectory.tum", "truth.tum"):
        assert (after.folder / name).read_bytes() == (whole.folder / name).read_bytes()
    one, two = (tfg_drake.load_run(result.folder) for result in (whole, after))
    np.testing.assert_array_equal(one.map.p_ML, two.map.p_ML)
    for port, times in one.recording.log_times.items():
        np.testing.assert_array_equal(times, two.recording.log_times[port])
    before, now = (
        [record.time for record in read_timeline(r.folder) if record.layer == "pose"] for r in (whole, after)
    )
    assert sorted(set(now)) == sorted(set(before))


def test_what_came_before_is_no_delay_of_a_mission_that_goes_on(half, tmp_path, caplog):
    mission = Mission(cut_short(half.folder, tmp_path / "on").request)
    mission.begin()
    mission.simulator.set_target_realtime_rate(1.0)
    mission.simulator.set_monitor(lambda _root: time.sleep(0.035))
    mission.advance(CUT + 0.5)
    mission.observe()
    assert "real time is missed" not in caplog.text


@pytest.mark.slow
def test_a_resumed_run_replays(after, tmp_path):
    robot = ReplayRobot(read_recording(after.folder))
    again = run.run_mission(scenario(), robot=robot, name="rooms", max_time=END, out_dir=tmp_path / "again")
    assert again.summary["landmark_rmse_m"] == after.summary["landmark_rmse_m"]


def test_a_killed_run_goes_on_from_its_last_checkpoint(whole, half, tmp_path):
    # As a kill leaves it: more of stages, recording and timeline than the checkpoint knows, no summary.
    killed = shutil.copytree(whole.folder, tmp_path / "killed")
    (killed / "summary.json").unlink()
    shutil.copy(half.folder / "checkpoint.bin", killed)
    with (killed / "timeline.tfg").open("ab") as file:
        file.write(b"\1\0")
    cut = tfg_drake.load_run(killed)
    assert cut.summary["outcome"] == "cut_short"
    assert cut.stamps[-1] == pytest.approx(CUT, abs=0.2)
    after = gone_on(killed, None)
    assert same(after.summary) == {**same(whole.summary), "resumed_at_s": [CUT]}
    assert (after.folder / "stages.jsonl").read_bytes() == (whole.folder / "stages.jsonl").read_bytes()


@pytest.mark.slow
def test_from_python_a_run_goes_on_where_it_is(half, tmp_path):
    copy = shutil.copytree(half.folder, tmp_path / "copy")
    mission = tfg_drake.explore(resume=copy, until=CUT + 2.0)
    assert mission.folder == copy
    assert mission.time == CUT + 2.0
    assert mission.summary["resumed_at_s"] == [CUT]
    assert tfg_drake.explore(resume=copy, until=CUT + 4.0).summary["resumed_at_s"] == [CUT, CUT + 2.0]


def test_what_cannot_be_gone_on_with_is_told(half, tmp_path):
    with pytest.raises(CheckpointError, match="holds no mission to go on with"):
        cut_short(tmp_path)
    (tmp_path / "summary.json").write_text(json.dumps({}))
    with pytest.raises(CheckpointError, match=r"has ended.*--map"):
        cut_short(tmp_path)


def test_a_replay_is_not_gone_on_with(half, tmp_path):
    robot = dataclasses.replace(ReplayRobot(read_recording(half.folder)))
    run.run_mission(scenario(), robot=robot, name="rooms", max_time=5.0, out_dir=tmp_path)
    assert not (tmp_path / "checkpoint.bin").exists()


def test_a_real_robot_that_was_carried_finds_itself_first(half):
    elsewhere = scenario()
    elsewhere.world.start = [1.0, 3.0, 2.0]
    robot = dataclasses.replace(SIMULATED, name="kobuki", world_known=False, real=True, enabled=True)
    mission = Mission(MissionRequest(elsewhere, robot=robot, before=read_checkpoint(half.folder)[1]))
    mission.begin()
    assert (mission.time, mission.status.phase) == (CUT, "observe")
    station = mission.simulator.get_system().GetSubsystemByName("station")
    plant = station.GetSubsystemByName("differential_drive_plant")
    # It stands in for a robot that has a clock of its own: the plant's begins with the mission's.
    of_plant = plant.GetMyMutableContextFromRoot(mission.simulator.get_mutable_context())
    of_plant.get_mutable_discrete_state_vector().SetAtIndex(TIME, CUT)
    stages = len(mission.stages)
    mission.advance(CUT + 12.0)
    assert CUT <= mission.placed_since < CUT + 8.0
    assert len(mission.stages) > stages
    truth = station.GetOutputPort("truth.pose").Eval(station.GetMyContextFromRoot(mission.simulator.get_context()))
    X_WB = compose(np.array(scenario().world.start), pose_at(mission.pose, mission.time))
    np.testing.assert_allclose(X_WB[:2], truth[:2], atol=0.05)


# The missions above are of tfg.
METHODS_TRIED = ("grid-nearest", "random", "scripted", "manual")
OTHERS = tuple(pytest.param(name, marks=pytest.mark.slow) for name in ("tfg", "paper", "weighted"))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*METHODS_TRIED, *OTHERS])
def test_every_method_goes_on_to_the_bit(name, tmp_path):
    rooms = ApplySettings(scenario(), ["drive=[[4, 1], [4.5, 3]]"])
    method = METHODS[name]
    if name == "manual":
        (tmp_path / "keys.csv").write_text(
            drive_csv((Pressed(2.5, "forward"), Pressed(6.0, "left"), Pressed(9.0, "forward")))
        )
        method = FindMethod(str(tmp_path / "keys.csv"))
    whole = Mission(MissionRequest(rooms, method))
    whole.begin()
    whole.advance(8.0)
    write_checkpoint(tmp_path / "checkpoint.bin", TOLD, whole.state())
    whole.advance(11.0)
    after = Mission(MissionRequest(rooms, method, before=read_checkpoint(tmp_path)[1]))
    after.begin()
    assert after.time == 8.0
    after.advance(11.0)
    for poses in (Mission.estimated_poses, Mission.true_poses):
        for one, two in zip(poses(whole), poses(after), strict=True):
            np.testing.assert_array_equal(one, two)
    assert after.stages == whole.stages


def MakeLaggingPlant(scenario):
    """A plant with continuous state."""
    builder = DiagramBuilder()
    motors = builder.AddNamedSystem("motors", FirstOrderLowPassFilter(0.3, 2))
    base = builder.AddNamedSystem("base", DifferentialDrivePlant(MakeWorld(scenario.world), scenario.robot))
    builder.Connect(motors.get_output_port(), base.GetInputPort("velocity_commanded"))
    builder.ExportInput(motors.get_input_port(), "velocity_commanded")
    for name in ("pose", "hazards"):
        builder.ExportOutput(base.GetOutputPort(name), name)
    return builder.Build()


def test_continuous_state_goes_on_to_the_bit_with_fixed_steps(tmp_path):
    robot = dataclasses.replace(SIMULATED, MakeStation=partial(MakeTurtlebotStation, plant=MakeLaggingPlant))

    def begun(**before):
        mission = Mission(MissionRequest(divided_room(), robot=robot, **before))
        mission.begin()
        mission.simulator.get_mutable_integrator().set_fixed_step_mode(True)
        return mission

    def speeds(mission):
        return mission.simulator.get_context().get_continuous_state_vector().CopyToVector()

    whole = begun()
    whole.advance(4.0)
    assert speeds(whole)[1] > 0.1
    write_checkpoint(tmp_path / "checkpoint.bin", TOLD, whole.state())
    after = begun(before=read_checkpoint(tmp_path)[1])
    np.testing.assert_array_equal(speeds(after), speeds(whole))
    for mission in (whole, after):
        mission.advance(5.0)
    np.testing.assert_array_equal(after.true_poses()[1], whole.true_poses()[1])


@pytest.fixture(scope="module")
def parts(half):
    """Annotations and values of a checkpoint's parts."""
    mission = Mission(MissionRequest(scenario(), before=read_checkpoint(half.folder)[1]))
    mission.begin()
    return mission.state()


@pytest.fixture
def state(parts):
    """These parts, to be changed."""
    return dict(parts)


@pytest.mark.parametrize(
    ("name", "hint", "value"),
    [
        ("time", float, 1e9),
        ("time", float, math.nan),
        ("time", float, -1.0),
        ("time", str, "soon"),
        ("logs", list[FloatArray], []),
        ("stages", list[str], ["first"]),
        ("resumed", float, 1.0),
        ("/explorer/follower", tuple[FloatArray, FloatArray], (np.zeros(1), np.zeros(99))),
        ("/explorer/slam_estimator", tuple[float, float], (0.0, 0.0)),
        ("/explorer/mission_sequencer", tuple[float], (1.0,)),
    ],
)
def test_what_cannot_be_restored_is_one_line_and_nothing_is_lost(half, state, tmp_path, name, hint, value):
    cut = shutil.copytree(half.folder, tmp_path / "cut")
    standing = read_checkpoint(half.folder)[1]
    for part, kind in (("ports", port_recording.Standing), ("timeline", timeline.Standing)):
        state[part] = kind, standing.take(part, kind)
    told = read_checkpoint(half.folder)[0]
    write_checkpoint(cut / "checkpoint.bin", told, state)
    assert cut_short(cut).request.before.take("time", float) == CUT
    write_checkpoint(cut / "checkpoint.bin", told, {**state, name: (hint, value)})
    before = {file.name: file.read_bytes() for file in cut.iterdir()}
    with pytest.raises(CheckpointError, match=r"^[^\n]*is damaged[^\n]*--map$"):
        gone_on(cut, None)
    assert cut_short(cut).request.name == "rooms"
    for kept in ("checkpoint.bin", "scenario.yaml", "summary.json", "map.npz", "trajectory.tum", "stages.jsonl"):
        assert (cut / kept).read_bytes() == before[kept]
    assert len(read_recording(cut).messages["base.odometry"]) > 16 * (CUT - 1.0)


def test_a_map_whose_indices_are_out_of_bounds_is_no_state(half, state, tmp_path):
    hint, (builder,) = state["/explorer/tfg_builder"]
    graph = builder.graph
    wrong = replace(graph, star_offsets=graph.star_offsets + 10**9)
    state["/explorer/tfg_builder"] = hint, (replace(builder, graph=wrong),)
    write_checkpoint(tmp_path / "checkpoint.bin", TOLD, state)
    mission = Mission(MissionRequest(scenario(), before=read_checkpoint(tmp_path)[1]))
    with pytest.raises(CheckpointError, match="is damaged"):
        mission.begin()


class Remembering(LeafSystem):
    """A part of somebody's own whose state is anything."""

    def __init__(self):
        super().__init__()
        self.DeclareAbstractState(AbstractValue.Make({"seen": []}))


def test_a_part_whose_state_cannot_be_kept_does_not_stop_the_mission(tmp_path, caplog):
    def MakeExplorer(rooms):
        explorer, builder = MakeTfgExplorer(rooms), DiagramBuilder()
        builder.AddSystem(explorer)
        builder.AddNamedSystem("mine", Remembering())
        for i in range(explorer.num_input_ports()):
            builder.ExportInput(explorer.get_input_port(i), explorer.get_input_port(i).get_name())
        for i in range(explorer.num_output_ports()):
            builder.ExportOutput(explorer.get_output_port(i), explorer.get_output_port(i).get_name())
        return builder.Build()

    method = dataclasses.replace(METHODS["scripted"], name="mine", MakeExplorer=MakeExplorer)
    done = run.run_mission(scenario(), method=method, name="rooms", max_time=3.0, out_dir=tmp_path)
    assert (done.summary["outcome"], done.summary["sim_time_s"]) == ("time_limit", 3.0)
    assert "/explorer/mine: dict cannot be kept" in done.unwritten["checkpoint.bin"]
    assert caplog.text.count("could not be gone on with") == 1
    assert not (tmp_path / "checkpoint.bin").exists()


def test_a_mission_that_fails_at_once_has_a_report(tmp_path, monkeypatch):
    monkeypatch.setattr(Mission, "observe", lambda self: 1 / 0)
    done = run.run_mission(scenario(), name="rooms", max_time=3.0, out_dir=tmp_path)
    assert (done.summary["outcome"], done.summary["distance_m"]) == ("fault", 0.0)


def test_a_link_in_the_place_of_a_file_is_not_written_through(half, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("mine\n")
    for name in ("log.txt", "timeline.tfg"):
        cut = shutil.copytree(half.folder, tmp_path / name)
        request = cut_short(cut).request
        (cut / name).unlink()
        (cut / name).symlink_to(elsewhere)
        with pytest.raises(OSError, match="symbolic links"):
            run.run_mission(request, max_time=END)
    assert elsewhere.read_text() == "mine\n"
