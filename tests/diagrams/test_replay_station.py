"""A recorded run, explored once more."""

import collections

import numpy as np
import pytest
from mcap.reader import make_reader

from benchmarks.timelines import read_timeline
from tests.diagrams.rooms import lasting, room
from tfg_drake.diagrams.methods import FindMethod
from tfg_drake.diagrams.missions import run
from tfg_drake.diagrams.recorded_station import ReplayRobot
from tfg_drake.diagrams.station import MakeTurtlebotStation
from tfg_drake.storage.port_recording import read_recording
from tfg_drake.systems.port_player import PortPlayer

EXACT = ("map.npz", "stages.jsonl", "trajectory.tum", "scenario.yaml")


def said(run):
    """The messages of a run's ports in order, and their times; chunks of the file end where the mission was kept."""
    with (run.folder / "ports.mcap").open("rb") as file:
        found = make_reader(file, validate_crcs=True).iter_messages()
        return [(channel.topic, one.log_time, one.data) for _, channel, one in found if channel.topic != "display.map"]


def names(system):
    inputs = {system.get_input_port(i).get_name() for i in range(system.num_input_ports())}
    return inputs, {system.get_output_port(i).get_name() for i in range(system.num_output_ports())}


def test_its_ports_are_those_of_any_station(finished):
    inputs, outputs = names(PortPlayer(read_recording(finished.folder)))
    simulated_inputs, simulated_outputs = names(MakeTurtlebotStation(room()))
    assert inputs == {name for name in simulated_inputs if not name.startswith("truth.")} | {"base.enable"}
    others = {"base.enabled", "operator.goal", "operator.pose"}
    assert outputs == {name for name in simulated_outputs if not name.startswith("truth.")} | others


def test_the_same_explorer_comes_to_the_same_map(finished, tmp_path):
    robot = ReplayRobot(read_recording(finished.folder))
    again = run.run_mission(room(), name="room", out_dir=tmp_path, robot=robot)
    for name in ("outcome", "reason", "sim_time_s", "landmark_rmse_m", "surface_coverage", "map_bytes"):
        assert again.summary[name] == finished.summary[name]
    assert finished.summary["outcome"] == "complete"
    assert finished.summary["stages"] > 1
    assert again.summary["position_error_m"]["mean"] is again.summary["online_pose_anees"] is None
    for name in EXACT:
        assert (again.folder / name).read_bytes() == (finished.folder / name).read_bytes(), name
    assert said(again) == said(finished)
    assert {one.told["wheels"] for one in read_timeline(again.folder) if one.layer == "world"} == {False}


def test_foxglove_shows_poses_scans_map_and_path(finished):
    with (finished.folder / "ports.mcap").open("rb") as file:
        found = [
            (schema.name, channel.topic) for schema, channel, _ in make_reader(file, validate_crcs=True).iter_messages()
        ]
    counts = collections.Counter(found)
    seconds = finished.summary["sim_time_s"]
    assert counts["foxglove.FrameTransform", "display.pose"] > 10 * seconds
    assert counts["foxglove.LaserScan", "scan.ranges"] > 9 * seconds
    assert counts["foxglove.SceneUpdate", "display.map"] > 0.5 * finished.summary["stages"]
    assert counts["foxglove.SceneUpdate", "display.path"] > 1


def test_trajectory_tools_find_the_error_of_the_summary(finished):
    """By evo's definition of the absolute trajectory error, poses paired by their stamps, nothing aligned."""
    estimated, true = (np.loadtxt(finished.folder / name) for name in ("trajectory.tum", "truth.tum"))
    _, rows, true_rows = np.intersect1d(estimated[:, 0], true[:, 0], return_indices=True)
    assert len(rows) == len(estimated)
    error = np.linalg.norm(estimated[rows, 1:4] - true[true_rows, 1:4], axis=1)
    told = finished.summary["position_error_m"]
    assert error.mean() == pytest.approx(told["mean"], abs=1e-6)
    assert error.max() == pytest.approx(told["max"], abs=1e-6)


@pytest.mark.slow
def test_a_run_that_was_ended_ends_there_again(tmp_path):
    one = run.run_mission(room(), name="room", out_dir=tmp_path / "one", max_time=8.5)
    robot = ReplayRobot(read_recording(one.folder))
    two = run.run_mission(room(), name="room", out_dir=tmp_path / "two", robot=robot)
    assert (two.summary["outcome"], two.summary["reason"]) == ("time_limit", "the recording has ended")
    assert two.summary["sim_time_s"] == 8.5
    for name in EXACT:
        assert (two.folder / name).read_bytes() == (one.folder / name).read_bytes(), name
    assert said(two) == said(one)


@pytest.mark.slow
def test_another_method_on_it_ends_with_the_recording(finished, tmp_path):
    robot = ReplayRobot(read_recording(finished.folder))
    summary = run.run_mission(room(), out_dir=tmp_path, robot=robot, method=FindMethod("grid-nearest")).summary
    assert summary["sim_time_s"] <= robot.end_time
    assert summary["outcome"] != "fault"


def test_a_run_need_not_be_recorded(finished, tmp_path):
    (tmp_path / "ports.mcap").write_text("an earlier run's")
    result = run.run_mission(room(), name="room", out_dir=tmp_path, record=False)
    assert not (tmp_path / "ports.mcap").exists()
    for name in ("map.npz", "stages.jsonl", "trajectory.tum", "truth.tum"):
        assert (tmp_path / name).read_bytes() == (finished.folder / name).read_bytes(), name
    assert lasting(result.summary) == lasting(finished.summary)
