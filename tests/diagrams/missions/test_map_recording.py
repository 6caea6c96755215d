"""A laser recording mapped by a mission without wheels, against the true way through a simulated room."""

import dataclasses
import functools
import json
import math
import threading

import numpy as np
import pytest

import tfg_drake
from benchmarks.timelines import read_timeline
from tfg_drake.config import OdometryConfig, ScanConfig
from tfg_drake.datasets.evaluation import hits, relative_error, truth_at, wall_thickness
from tfg_drake.datasets.laser_log import EXACT_SCANNER
from tfg_drake.datasets.recording import GroundTruth, Recording
from tfg_drake.diagrams.methods import MethodError
from tfg_drake.diagrams.missions import slam as slam_module
from tfg_drake.diagrams.missions.slam import map_recording
from tfg_drake.diagrams.recorded_station import MakeRecordedStation
from tfg_drake.geometry import se2
from tfg_drake.messages import Odometry, replace
from tfg_drake.notes import Note, take_note
from tfg_drake.simulation.laser_scanner import ray_angles, scan
from tfg_drake.storage.run import load_run

CORNERS = np.array([[-5.0, -4.0], [5.0, -4.0], [5.0, 4.0], [1.0, 4.0], [1.0, 2.5], [-5.0, 2.5]])
WALLS = np.hstack([CORNERS, np.roll(CORNERS, -1, axis=0)])
SCANNER = ScanConfig(field_of_view=math.pi)
# The recording's clock began long before it.
BEGAN = 1000.0


@pytest.fixture(scope="module")
def room():
    """A round and a half of a room by bad odometry."""
    rng, angles = np.random.default_rng(1), ray_angles(SCANNER)
    turn = np.linspace(0.0, 3.0 * math.pi, 120)
    X_WB = np.column_stack([2.0 * np.sin(turn), -0.5 - 2.0 * np.cos(turn), se2.wrap_angle(turn)])
    steps = se2.between(X_WB[:-1], X_WB[1:]) * [1.01, 1.0, 1.02] + rng.normal(size=(119, 3)) * [0.005, 0.0, 0.005]
    X_OB = [np.zeros(3)]
    for step in steps:
        X_OB.append(se2.compose(X_OB[-1], step))
    at = BEGAN + 0.5 * np.arange(120)
    scans = [scan(WALLS, X, t, angles, rng.normal(size=len(angles)), SCANNER) for t, X in zip(at, X_WB, strict=True)]
    return Recording(
        name="room",
        odometry=tuple(Odometry(t, X, np.zeros(2)) for t, X in zip(at, X_OB, strict=True)),
        detections=(),
        model=OdometryConfig(),
        truth=GroundTruth(at, X_WB, np.zeros(0, dtype=np.int64), np.zeros((0, 2))),
        scans=tuple(scans),
        scanner=EXACT_SCANNER,
        notes=(Note("jump", 3.0, "odometry jumps by 6.1 m"),),
    )


@pytest.fixture(scope="module")
def mapped(room, tmp_path_factory):
    said = []
    result = map_recording(room, room.name, tmp_path_factory.mktemp("room") / "run", say=said.append)
    *shares, solving, last = said
    assert shares[0] < "online  10 %" < "online  90 %" < shares[-1] <= "online 100 %"
    assert solving.endswith("complete: solving the whole map, writing the run's files")
    assert last == "solving all poses, measuring and drawing the map"
    return result


def poses(file):
    table = np.loadtxt(file)
    return table[:, 0], np.column_stack([table[:, 1:3], 2.0 * np.arctan2(table[:, 6], table[:, 7])])


def test_walls_map_a_room(room, mapped):
    summary, folder = mapped.summary, mapped.folder
    assert (summary["outcome"], summary["method"], summary["scans"]) == ("complete", "walls", 120)
    assert summary["relative_translation_m"]["mean"] < 0.02
    assert summary["relative_rotation_rad"]["mean"] < 5e-3
    assert summary["robot_rmse_m"] < 0.02
    assert summary["wall_thickness_m"] < 0.03
    assert len(CORNERS) <= summary["walls_mapped"] <= len(CORNERS) + 4
    assert summary["notes"] == [{"kind": "jump", "time_s": 3.0, "text": "odometry jumps by 6.1 m"}]
    assert json.loads((folder / "summary.json").read_text()) == summary
    stamps, X_MB = poses(folder / "trajectory.tum")
    np.testing.assert_allclose(stamps, [one.stamp for one in room.scans], atol=1e-6)
    assert relative_error(truth_at(room.truth, stamps), X_MB)[0]["mean"] < 0.02
    assert wall_thickness(hits(room.scans, X_MB)) < 0.03


def test_it_leaves_what_any_run_leaves(mapped):
    run = load_run(mapped.folder)
    assert run.map.tfg.stage == run.map.stage == mapped.summary["stages"] > 10
    for name in ("map.npz", "timeline.tfg", "mission.html", "figure.png", "ports.mcap", "online.tum"):
        assert (mapped.folder / name).stat().st_size > 0


def test_its_page_has_neither_a_camera_nor_wheels(mapped):
    (world,) = [one for one in read_timeline(mapped.folder) if one.layer == "world"]
    assert (world.told["camera"], world.told["wheels"]) == (None, False)


@pytest.mark.parametrize("ending", [".geojson", ".dxf", ".svg", ".yaml", ".g2o"])
def test_its_map_is_exported(call, mapped, tmp_path, ending):
    code, _, complaint = call("map", "export", str(mapped.folder), str(tmp_path / f"room{ending}"))
    assert (code, complaint) == (0, "")
    assert (tmp_path / f"room{ending}").stat().st_size > 100


def test_explore_maps_a_station_that_is_a_recording(room):
    make = functools.partial(MakeRecordedStation, recording=room)
    run = tfg_drake.explore(station=make, until=30.0)
    assert not run.outcome
    assert 2 <= run.tfg.stage == run.map.stage
    assert run.advance().outcome == "complete"
    assert run.station.HasOutputPort("scan.ranges")
    with pytest.raises(MethodError, match="without planner"):
        tfg_drake.explore(station=make, planner=lambda _: None)


@pytest.fixture
def undrawn(monkeypatch):
    """Nothing that takes long is drawn or measured at the end."""
    monkeypatch.setattr(slam_module, "draw_laser_map", lambda *_: None)
    monkeypatch.setattr(slam_module, "wall_thickness", lambda _: math.nan)


def broken(room, at, jump):
    """The recording with odometry that jumps at a message and says so: it goes on by its velocity before."""
    X_OB = [one.X_OB for one in room.odometry]
    step = se2.between(X_OB[at - 2], X_OB[at - 1]) if jump is None else jump
    guess = se2.compose(X_OB[at - 1], step)
    odometry = [
        replace(one, X_OB=se2.compose(guess, se2.between(X_OB[at], one.X_OB)), breaks=1) if k >= at else one
        for k, one in enumerate(room.odometry)
    ]
    return dataclasses.replace(room, odometry=tuple(odometry))


@pytest.mark.parametrize("jump", [pytest.param(None, marks=pytest.mark.slow), np.array([0.4, 0.15, 0.3])])
def test_a_way_that_is_unknown_costs_nothing_among_known_walls(room, tmp_path, jump):
    summary = map_recording(broken(room, 100, jump), room.name, tmp_path / "run", record=False).summary
    assert summary["robot_rmse_m"] < 0.03
    assert summary["wall_thickness_m"] < 0.03


@pytest.mark.usefixtures("undrawn")
def test_a_jump_that_is_believed_bends_the_map(room, tmp_path):
    told = broken(room, 100, np.array([1.2, 0.9, 0.8]))
    told = dataclasses.replace(told, odometry=tuple(replace(one, breaks=0) for one in told.odometry))
    assert map_recording(told, room.name, tmp_path / "run", record=False).summary["robot_rmse_m"] > 0.05


@pytest.mark.usefixtures("undrawn")
def test_a_note_of_the_mapping_has_the_time_of_the_recording(room, tmp_path):
    event = threading.Event()

    def say(_text):
        take_note("walls", 5.0, "bent")
        take_note("sensor", None, "wrong all the time")
        event.set()

    summary = map_recording(room, room.name, tmp_path / "run", say=say, interrupted=event, record=False).summary
    assert [note["time_s"] for note in summary["notes"]] == [3.0, BEGAN + 5.0, None]


@pytest.mark.usefixtures("undrawn")
def test_a_recording_that_is_interrupted_keeps_what_there_is(room, tmp_path):
    event = threading.Event()

    def say(text):
        assert not event.is_set()
        if text > "online  30 %":
            event.set()

    result = map_recording(room, room.name, tmp_path / "run", say=say, interrupted=event)
    assert result.summary["outcome"] == "interrupted"
    assert "interrupted" in dict(slam_module.table_rows(result.summary))["outcome"]
    assert 2 <= load_run(result.folder).map.stage < 15
    assert len((result.folder / "trajectory.tum").read_text().splitlines()) == len(room.scans)
