import gc
import json
import math
import os
import shutil
import signal
import threading

import numpy as np
import pytest
from pydrake.geometry import Meshcat, MeshcatParams

import tfg_drake
from benchmarks.timelines import read_timeline
from tests.diagrams.rooms import lasting, room
from tfg_drake.cockpit.clock import Clock
from tfg_drake.config import DisturbanceConfig
from tfg_drake.diagrams import mission_diagram
from tfg_drake.diagrams.interruption import NAMES
from tfg_drake.diagrams.methods import FindMethod, Method
from tfg_drake.diagrams.missions import run
from tfg_drake.diagrams.missions.mission import Mission, MissionRequest
from tfg_drake.diagrams.missions.mission_runner import MissionRunner
from tfg_drake.diagrams.missions.resume import cut_short
from tfg_drake.diagrams.missions.run_folder import make_run_folder
from tfg_drake.diagrams.scenario import DumpScenario, LoadScenario
from tfg_drake.grid.saved_grid import load_grid
from tfg_drake.mapfile.saved_map import load_map
from tfg_drake.messages import is_tag, replace
from tfg_drake.mission.sequence import NOT_ENABLED, PAUSED
from tfg_drake.planning.mission_end import IN_VAIN, REASONS
from tfg_drake.slam.gtsam_solver import map_graph
from tfg_drake.slam.shared import CAMERA_YAW, RANGE_SCALE, SWEEP
from tfg_drake.storage.port_recording import read_recording
from tfg_drake.storage.trajectory import read_tum

_FIELDS = """schema version commit scenario world seed method outcome reason sim_time_s resumed_at_s notes wall_time_s
cpu_time_s real_time_factor distance_m stages landmarks_present landmarks_reachable landmarks_mapped
landmarks_doubtful landmarks_extra walls_mapped landmark_rmse_m landmark_error_max_m landmark_rmse_aligned_m
least_known changes landmark_entropy_nats landmark_anees landmark_nees pose_anees online_pose_anees position_error_m
position_error_moving_m heading_error_rad surface_coverage surface_coverage_5cm surface_phantom_m area_coverage
area_seen_s explored_s open_edges openings undiscovered contacts contacts_received min_clearance_m map_variables
map_bytes calibration estimator_cpu_s planner_cpu_s simulator_cpu_s peak_rss_bytes stage_ms"""
FIELDS = _FIELDS.split()


def test_a_small_room_is_explored_to_its_end(finished):
    summary = finished.summary
    assert summary["outcome"] == "complete"
    assert summary["landmarks_mapped"] == summary["landmarks_reachable"] == summary["landmarks_present"] > 10
    assert summary["landmark_rmse_m"] < 0.1
    assert summary["contacts"] == 0
    assert summary["area_coverage"] > 0.99
    assert 0.0 < summary["explored_s"] <= summary["sim_time_s"]
    assert all(edge["why"] in (*REASONS, IN_VAIN) and edge["length_m"] > 0.0 for edge in summary["open_edges"])
    # Nobody is sent to look after sensors that are well.
    assert "the base stands" not in (finished.folder / "log.txt").read_text()


def test_the_summary_has_every_field_in_order(finished):
    written = json.loads((finished.folder / "summary.json").read_text())
    assert written == finished.summary
    assert list(written) == FIELDS
    for name in ("position_error_m", "position_error_moving_m", "heading_error_rad"):
        assert list(written[name]) == ["mean", "std", "max", "final"]
    assert list(written["map_variables"]) == ["landmarks", "poses", "calibration"]
    assert list(written["stage_ms"]) == ["median", "p99", "max"]


def test_parameters_are_in_the_summary_by_their_names(finished):
    known = load_map(finished.folder / "map.npz").graph.shared
    for place, name in (
        (CAMERA_YAW, "camera_yaw_rad"),
        (RANGE_SCALE, "range_scale"),
        (SWEEP, "scanner_sweep_s_per_rad"),
    ):
        told = finished.summary["calibration"][name]
        assert (told["value"], told["deviation"]) == pytest.approx((known.mean[place], known.sigma[place]))


def test_a_run_leaves_no_garbage_and_the_collector_as_it_was(tmp_path, monkeypatch):
    """A figure goes round in circles and holds megabytes, which nobody may come to collect for many missions."""
    monkeypatch.setattr(run, "MissionRunner", _fail)
    # What other tests have left.
    gc.collect()
    before = gc.isenabled(), gc.get_threshold()
    with pytest.raises(Failure):
        run.run_mission(room(), max_time=1.0, out_dir=tmp_path)
    monkeypatch.undo()
    gc.disable()
    try:
        run.run_mission(room(), max_time=1.0, out_dir=tmp_path)
        assert not [one for one in gc.get_objects() if type(one).__name__ == "Figure"]
    finally:
        gc.enable()
    assert (gc.isenabled(), gc.get_threshold(), gc.get_freeze_count()) == (*before, 0)


class Failure(Exception):
    """What goes wrong."""


def _fail(*_arguments):
    raise Failure


def test_stages_are_written_line_by_line(finished):
    written = (finished.folder / "stages.jsonl").read_text().splitlines()
    lines = [json.loads(line, parse_constant=pytest.fail) for line in written]
    assert lines == finished.stages
    assert [line["stage"] for line in lines] == list(range(1, finished.summary["stages"] + 1))
    first = lines[0]
    np.testing.assert_allclose(first["goal"], [2.0, 1.5, 0.3], atol=1e-9)
    assert first["predicted_gain"] is None
    # Everything is new: from the prior of 10 m an axis to the entropy that is left.
    prior = first["landmarks"] * math.log(2.0 * math.pi * math.e * 10.0**2)
    assert first["realised_gain"] == pytest.approx(prior - first["entropy_nats"])
    # Tags and walls.
    ids = load_map(finished.folder / "map.npz").graph.ids
    assert np.count_nonzero(~is_tag(ids)) > 3
    assert lines[-1]["landmarks"] == len(ids)
    # A glance on the way is no goal that anything was predicted of.
    goals = [line for line in lines[1:] if line["predicted_gain"] is not None]
    assert goals
    for line in goals:
        assert line["predicted_gain"] == pytest.approx(line["exploitation"] + line["exploration"])
    # The map is solved once more at the end.
    assert lines[-1]["entropy_nats"] == pytest.approx(finished.summary["landmark_entropy_nats"], abs=0.02)


def test_the_folder_is_whole(finished):
    names = "figure.png log.txt map.npz mission.html ports.mcap scenario.yaml stages.jsonl summary.json timeline.tfg"
    names += " trajectory.tum truth.tum"
    assert sorted(path.name for path in finished.folder.iterdir()) == names.split()
    assert (finished.folder / "figure.png").read_bytes().startswith(b"\x89PNG")
    saved = load_map(finished.folder / "map.npz")
    assert finished.summary["walls_mapped"] > 0
    assert sum(finished.summary["map_variables"].values()) == map_graph(saved.graph)[1].dim()
    assert LoadScenario(finished.folder / "scenario.yaml") == room()


def test_the_trajectories_share_a_frame_and_end_together(finished):
    stamps, X_WB = read_tum(finished.folder / "trajectory.tum")
    true_stamps, X_WB_true = read_tum(finished.folder / "truth.tum")
    np.testing.assert_allclose(X_WB[0, :2], [2.0, 1.5], atol=1e-6)
    # The camera's yaw was not known then.
    assert X_WB[0, 2] == pytest.approx(0.3, abs=0.02)
    assert true_stamps[-1] <= finished.summary["sim_time_s"] <= true_stamps[-1] + 0.1
    truth = X_WB_true[np.searchsorted(true_stamps, stamps)]
    error = np.linalg.norm(X_WB[:, :2] - truth[:, :2], axis=1)
    assert error.mean() == pytest.approx(finished.summary["position_error_m"]["mean"], abs=1e-6)
    first = next(row for row, X in enumerate(truth) if math.dist(X[:2], truth[0, :2]) > 0.1)
    moving = finished.summary["position_error_moving_m"]
    assert 0 < first < len(error) - 100
    assert moving["mean"] == pytest.approx(error[first:].mean(), abs=1e-6)
    assert moving["mean"] > finished.summary["position_error_m"]["mean"]
    assert error.max() < 0.2
    assert 0.1 < finished.summary["online_pose_anees"] < 10.0


def test_the_time_limit_ends_a_mission(tmp_path):
    seen = []
    result = run.run_mission(room(), max_time=8.5, out_dir=tmp_path, on_progress=seen.append)
    assert (result.summary["outcome"], result.summary["sim_time_s"]) == ("time_limit", 8.5)
    assert result.summary["reason"] == "the time limit of 8.5 s was reached"
    assert [progress.time for progress in seen] == [*np.arange(1.0, 9.0), 8.5, 8.5]
    assert [progress.outcome for progress in seen] == [*[""] * 9, "time_limit"]
    assert seen[-1].landmarks == f"{result.summary['landmarks_mapped']} tags"
    assert result.summary["landmarks_mapped"] > 0
    assert 10.0 < seen[-1].area < 24.1


def test_before_the_first_stage_there_is_no_map_but_a_summary(tmp_path):
    summary = run.run_mission(room(), max_time=1.0, out_dir=tmp_path).summary
    assert list(summary) == FIELDS
    assert summary["stages"] == summary["landmarks_mapped"] == summary["map_bytes"] == 0
    assert summary["landmark_rmse_m"] is summary["landmark_entropy_nats"] is summary["pose_anees"] is None
    assert summary["area_coverage"] == 0.0
    assert not (tmp_path / "map.npz").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("number", "name"), NAMES.items())
def test_a_signal_leaves_a_usable_result(tmp_path, number, name):
    def interrupt(progress):
        if progress.time == 8.0 and not progress.outcome:
            os.kill(os.getpid(), number)

    before = signal.getsignal(number)
    result = run.run_mission(room(), out_dir=tmp_path, on_progress=interrupt)
    assert (result.summary["outcome"], result.summary["reason"]) == ("interrupted", f"interrupted by {name} at 8 s")
    assert load_map(tmp_path / "map.npz").stage == 1
    assert signal.getsignal(number) == before


def test_a_second_ctrl_c_aborts(tmp_path, monkeypatch):
    def interrupt(_progress):
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("tfg_drake.diagrams.interruption.TOGETHER", 0.0)
    with pytest.raises(KeyboardInterrupt):
        run.run_mission(room(), out_dir=tmp_path, on_progress=interrupt)


@pytest.mark.parametrize(
    ("error", "time", "told", "stages"),
    [(ValueError("no way\nmore"), 8.0, "8.06", 1), (SystemExit("no way\nmore"), 1.0, "1.06", 0)],
)
def test_an_error_inside_is_a_fault_and_its_traceback_is_in_the_log(tmp_path, monkeypatch, error, time, told, stages):
    class Failing(mission_diagram.PoseVector):
        def _CalcVector(self, context, output):
            if context.get_time() > time:
                raise error
            super()._CalcVector(context, output)

    monkeypatch.setattr(mission_diagram, "PoseVector", Failing)
    summary = run.run_mission(room(), out_dir=tmp_path).summary
    assert summary["outcome"] == "fault"
    assert summary["reason"] == f"{type(error).__name__} at {told} s: no way"
    assert summary["stages"] == stages
    assert list(summary) == FIELDS
    assert "Traceback (most recent call last)" in (tmp_path / "log.txt").read_text()


def test_an_error_while_the_diagram_is_built_is_a_fault_too(tmp_path):
    def fail(_scenario):
        raise ValueError("\nno way\nmore")

    method = Method("failing", fail)
    summary = run.run_mission(room(), method=method, out_dir=tmp_path).summary
    assert (summary["outcome"], summary["reason"]) == ("fault", "ValueError at 0.00 s: no way")
    assert list(summary) == FIELDS
    # Of the truth nothing is known.
    names = "figure.png log.txt mission.html ports.mcap scenario.yaml stages.jsonl summary.json timeline.tfg"
    names += " trajectory.tum"
    assert sorted(path.name for path in tmp_path.iterdir()) == names.split()
    assert "Traceback (most recent call last)" in (tmp_path / "log.txt").read_text()


def test_a_caller_may_end_a_mission(tmp_path):
    stop = threading.Event()
    stop.set()
    summary = run.run_mission(room(), out_dir=tmp_path, interrupted=stop).summary
    assert (summary["outcome"], summary["reason"]) == ("interrupted", "interrupted at 0 s")


@pytest.mark.parametrize(("reason", "phase"), [(NOT_ENABLED, "waits"), (PAUSED, "paused")])
def test_who_has_not_enabled_the_robot_is_told_that_it_waits(reason, phase):
    told = []
    mission = Mission(MissionRequest(room(), on_progress=told.append))
    mission.begin()
    mission.status = replace(mission.status, phase="paused", reason=reason)
    MissionRunner(mission, threading.Event())._tell()
    assert [progress.phase for progress in told] == [phase]


def test_default_folders_do_not_collide(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run.time, "strftime", lambda _format: "20260101-120000")
    folders = [make_run_folder(None, "paper-4").name for _ in range(2)]
    assert folders == ["20260101-120000-paper-4", "20260101-120000-paper-4-2"]


def test_the_mission_may_run_outside_the_main_thread(tmp_path):
    results = []
    worker = threading.Thread(target=lambda: results.append(run.run_mission(room(), max_time=1.0, out_dir=tmp_path)))
    worker.start()
    worker.join()
    assert results[0].summary["outcome"] == "time_limit"


def test_a_grid_mission_has_a_grid_and_no_landmarks(tmp_path):
    summary = run.run_mission(room(), method=FindMethod("grid-nearest"), name="room", out_dir=tmp_path).summary
    assert (summary["method"], summary["outcome"], summary["contacts"]) == ("grid-nearest", "complete", 0)
    assert list(summary) == FIELDS
    assert summary["landmarks_mapped"] is None
    assert summary["landmark_rmse_m"] is summary["pose_anees"] is summary["online_pose_anees"] is None
    assert list(summary["map_variables"]) == ["cells"]
    assert summary["area_coverage"] > 0.99
    assert 0.9 < summary["surface_coverage_5cm"] <= summary["surface_coverage"]
    assert summary["position_error_moving_m"]["max"] == summary["position_error_m"]["max"] < 0.1
    grid = load_grid(tmp_path / "grid.npz")
    assert grid.probability.size == summary["map_variables"]["cells"]
    assert not (tmp_path / "map.npz").exists()
    again = run.run_mission(room(), method=FindMethod("grid-nearest"), name="room", out_dir=tmp_path / "again").summary
    assert lasting(again) == lasting(summary)


@pytest.mark.parametrize("name", ["weighted", pytest.param("random", marks=pytest.mark.slow)])
def test_other_methods_end_a_mission_too(name, tmp_path):
    summary = run.run_mission(room(), method=FindMethod(name), name="room", max_time=30.0, out_dir=tmp_path).summary
    assert summary["outcome"] in ("complete", "time_limit")
    assert summary["contacts"] == 0
    assert summary["area_coverage"] > 0.99


def test_a_scripted_drive_maps_what_it_passes(tmp_path):
    scenario = room()
    scenario.drive = [[2.6, 1.7]]
    summary = run.run_mission(scenario, method=FindMethod("scripted"), name="room", out_dir=tmp_path).summary
    assert summary["stages"] == 2
    assert summary["outcome"] in ("complete", "stuck")
    assert summary["landmarks_mapped"] > 10
    assert summary["position_error_m"]["max"] < 0.1


class Restless:
    """A page that holds the clock again and again, lets it go and changes its speed, and asks for nothing else."""

    class Clock(Clock):
        looks = 0

        @property
        def version(self):
            self.looks += 1
            return self.looks // 20

        @version.setter
        def version(self, _):
            pass

        @property
        def held(self):
            self.looks += 1
            return self.looks % 20 < 2

        @held.setter
        def held(self, _):
            pass

    def __init__(self):
        self.clock, self.watched, self.followed, self.word, self.stages = self.Clock(), True, [], "", []
        self.follow, self.at_stage, self.requests = self.followed.append, self.stages.append, lambda: []
        self.sends = False


def test_who_only_looks_on_and_holds_the_clock_changes_nothing(finished, tmp_path, monkeypatch):
    page = Restless()
    result = run.run_mission(room(), name="room", out_dir=tmp_path, cockpit=page)
    assert page.clock.looks > 150
    assert page.followed == [tmp_path / "timeline.tfg"]
    assert page.stages[-1] == finished.summary["stages"]
    assert lasting(result.summary) == lasting(finished.summary)
    for name in ("stages.jsonl", "trajectory.tum", "truth.tum", "map.npz"):
        assert (tmp_path / name).read_bytes() == (finished.folder / name).read_bytes(), name
    ports = [read_recording(folder) for folder in (tmp_path, finished.folder)]
    for name in ports[0].messages:
        assert len(ports[0].messages[name]) == len(ports[1].messages[name])
        assert np.array_equal(ports[0].log_times[name], ports[1].log_times[name])


def test_what_a_run_looked_like_is_in_its_folder(finished):
    records = read_timeline(finished.folder)
    layers = {record.layer for record in records}
    assert {"world", "map", "tfg", "free", "roadmap", "gains", "path", "pose", "truth", "scan", "end"} <= layers
    stages = [record.told["stage"] for record in records if record.layer == "map"]
    assert stages == list(range(finished.summary["stages"] + 1))
    last = [record for record in records if record.layer == "mission"][-1]
    assert last.told["outcome"] == "complete"
    assert records[-1].layer == "end"
    assert records[-1].told["landmarks_mapped"] == finished.summary["landmarks_mapped"]
    page = (finished.folder / "mission.html").read_text()
    assert "room, seed 3" in page
    # A tour's first stop is the goal, and each is done with later than the one before it.
    tours = [record.arrays for record in records if record.layer == "goal" and len(record.arrays["tour"])]
    assert max(len(one["tour"]) for one in tours) > 1
    for one in tours:
        np.testing.assert_allclose(one["tour"][0], one["points"][0])
        assert np.all(np.diff(one["done"], prepend=0.0) > 0.0)


def test_who_pushes_the_robot_into_a_wall_has_made_the_contact(tmp_path):
    """The scenario's push and somebody's, in the first look; both are in what the page shows."""
    scenario, page = room(), Restless()
    scenario.disturbances = [DisturbanceConfig(time=1.0, duration=0.5, ahead=6.0)]
    asked = iter([[]] * 40 + [["push"]])
    page.requests = lambda: next(asked, [])
    summary = run.run_mission(scenario, max_time=5.0, out_dir=tmp_path, cockpit=page).summary
    assert (summary["contacts"], summary["contacts_received"]) == (0, 1)
    told = {record.layer: record.told for record in read_timeline(tmp_path)}
    assert [push["ahead"] for push in told["world"]["pushes"]] == [6.0]
    assert [push["left"] for push in told["pushes"]["pushes"]] == [0.5]
    assert told["end"]["contacts_received"] == 1


@pytest.mark.parametrize("name", ["grid-nearest", "scripted"])
def test_a_method_without_every_port_is_shown_too(name, tmp_path):
    meshcat = Meshcat(MeshcatParams(host="localhost"))
    scenario = room()
    scenario.drive = [[4.0, 1.5]]
    arguments = {"method": FindMethod(name), "meshcat": meshcat, "max_time": 2.0, "out_dir": tmp_path}
    assert run.run_mission(scenario, **arguments).summary["outcome"] == "time_limit"


def test_the_scenario_of_a_run_has_what_its_method_fixed(tmp_path):
    result = run.run_mission(room(), method=FindMethod("tfg-argmax"), out_dir=tmp_path / "run", max_time=12.0)
    kept = LoadScenario(tmp_path / "run" / "scenario.yaml")
    assert (kept.explorer.goal, kept.explorer.glance_period) == ("argmax", 0.0)
    assert next(iter(read_timeline(result.folder))).told["rule"] == "argmax"
    # As runs had it when it was what had been asked for.
    shutil.copytree(result.folder, tmp_path / "before")
    (tmp_path / "before" / "scenario.yaml").write_text(DumpScenario(room()))
    for folder in (result.folder, tmp_path / "before"):
        assert tfg_drake.load_run(folder).stages == result.stages
        tfg_drake.fork(folder, len(result.stages))  # Refused where it comes out otherwise.
    whole = run.run_mission(room(), method=FindMethod("tfg-argmax"), out_dir=tmp_path / "whole", max_time=16.0)
    after = run.run_mission(cut_short(result.folder).request, method=FindMethod("tfg-argmax"), max_time=16.0)
    assert (after.stages, len(after.stages) > len(result.stages)) == (whole.stages, True)
