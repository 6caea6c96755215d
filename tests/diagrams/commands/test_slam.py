"""tfg-drake slam from the command line."""

import gzip
import json
import sys

import numpy as np
import pytest

from tfg_drake.datasets.mrclam import COMMAND_LATENCY
from tfg_drake.io.extras import pip_install


@pytest.fixture
def mrclam(tmp_path):
    """A drive round a circle of 2 m with four landmarks, two of them named as each other in the truth."""
    folder = tmp_path / "Small"
    folder.mkdir()
    ids = [6, 7, 8, 9, 10]
    p_WL = np.array([[3.0, 0.0], [0.0, 3.0], [-3.0, 0.5], [0.0, -3.0], [1.0, 1.0]])
    named = p_WL[[1, 0, 2, 3, 4]]
    folder.joinpath("Barcodes.dat").write_text("".join(f"{i} {i + 50}\n" for i in [1, *ids]))
    folder.joinpath("Landmark_Groundtruth.dat").write_text(
        "".join(f"{i} {x} {y} 0 0\n" for i, (x, y) in zip(ids, named, strict=True))
    )
    odometry, measurements, truth = [], [], []
    for k in range(240):
        t, angle = 0.25 * k, 0.025 * k
        x, y, heading = 2.0 * np.sin(angle), -2.0 * np.cos(angle), angle
        odometry.append(f"{t - COMMAND_LATENCY} {1.05 * 0.2} {1.09 * 0.1}\n")
        truth.append(f"{t} {x} {y} {heading}\n")
        for i, p in zip(ids, p_WL, strict=True):
            d = p - (x, y)
            bearing = (np.arctan2(d[1], d[0]) - heading + np.pi) % (2 * np.pi) - np.pi
            measurements.append(f"{t} {i + 50} {np.hypot(*d)} {bearing}\n")
    for name, lines in (("Odometry", odometry), ("Measurement", measurements), ("Groundtruth", truth)):
        folder.joinpath(f"Robot1_{name}.dat").write_text("".join(lines))
    return folder


def test_what_was_mended_of_a_recording_is_said_once(call, tmp_path, mrclam):
    file = mrclam / "Robot1_Measurement.dat"
    rows = file.read_text().splitlines()
    file.write_text("\n".join([*rows[100:], *rows[:100], "59.75 56"]))
    code, printed, complaint = call("slam", str(mrclam), "--out", str(tmp_path / "run"))
    assert (code, complaint) == (0, "")
    mended = "Robot1_Measurement.dat: the last row cut off, left out; 100 rows out of order, sorted"
    assert printed.count(mended) == 1
    assert mended in (tmp_path / "run" / "log.txt").read_text()


def test_a_recording_is_run_judged_and_kept(call, tmp_path, mrclam):
    out = tmp_path / "run"
    code, printed, complaint = call("slam", str(mrclam), "--out", str(out), "--json")
    assert (code, complaint) == (0, "")
    summary = json.loads((out / "summary.json").read_text())
    assert json.loads(printed.splitlines()[-1]) == summary
    assert summary["method"] == "online+batch"
    assert summary["robot_rmse_m"] < 1e-4
    assert summary["online_rmse_m"] < 1e-2
    assert summary["landmarks_mapped"] == 5
    assert summary["landmarks_misfit"] == [6, 7]
    assert summary["landmark_rmse_m"] > 1.0
    assert summary["landmark_rmse_without_misfits_m"] < 1e-4
    assert summary["measurements_used"] == 5 * 240
    assert summary["measurements_rejected"] == 0
    assert summary["final_error"] < 1e-3
    note = "landmarks 6 and 7 lie 4.2 m from the given truth: each where the other should be"
    assert summary["notes"] == [{"kind": "truth", "time_s": None, "text": note}]
    assert note in printed
    assert f"CPU time      {summary['cpu_time_s']:.1f} s, with loading and files\n" in printed
    assert (out / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert len((out / "trajectory.tum").read_text().splitlines()) >= 240
    assert len((out / "online.tum").read_text().splitlines()) == 239  # no odometry beyond the last frame


def test_a_graph_is_solved(call, tmp_path):
    path = tmp_path / "two.g2o"
    path.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 0 1 2 0 0 1 0 0 1 0 1\n")
    code, printed, complaint = call("slam", str(path), "--out", str(tmp_path / "run"), "--json")
    assert (code, complaint) == (0, "")
    summary = json.loads(printed.splitlines()[-1])
    assert summary["method"] == "batch"
    assert summary["final_error"] == pytest.approx(0.25)
    assert summary["measurements_used"] == 2
    assert summary["robot_rmse_m"] is summary["online_rmse_m"] is summary["landmark_rmse_m"] is None
    assert "RMSE" not in printed.split("{")[0]
    assert "VERTEX_SE2 1 1.5" in (tmp_path / "run" / "solved.g2o").read_text()


def test_a_loose_graph_is_named(call, tmp_path):
    path = tmp_path / "loose.g2o"
    path.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 2 3 1 0 0 1 0 0 1 0 1\n")
    code, _, complaint = call("slam", str(path), "--out", str(tmp_path / "run"))
    mend = "add an edge, or FIX a pose of its part"
    expected = f"tfg-drake: {path}: nothing ties vertex 2 to vertex 0; {mend}\n"
    assert (code, complaint) == (2, expected)


def test_what_is_no_data_set_is_named(call, tmp_path, mrclam):
    out = ["--out", str(tmp_path / "run")]
    text = tmp_path / "notes.txt"
    text.write_text("")
    empty = tmp_path / "empty"
    empty.mkdir()
    graph = tmp_path / "a.g2o"
    graph.write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
    video = "of a video give --calibration and --tag-size"
    bag = "a ROS bag (its folder, .mcap, .db3, .bag)"
    kinds = f"a .g2o file, a laser log (.log, .clf, .dat), {bag}, an MR.CLAM or TagSLAM folder"
    for arguments, expected in [
        ([str(tmp_path / "none")], f"{tmp_path / 'none'}: no such file or folder; name a data set"),
        ([str(text)], f"{text}: not a data set; name {kinds}, or {video}"),
        (
            [str(empty)],
            f"{empty}: holds neither Barcodes.dat (MR.CLAM) nor tag_corners.csv (TagSLAM) nor files of a ROS bag;"
            f" name a folder with one of them, or {video}",
        ),
        ([str(mrclam), "--robot", "9"], "--robot 9: MR.CLAM has robots 1 to 5"),
        (
            [str(mrclam), "--robot", "2"],
            f"{mrclam / 'Robot2_Odometry.dat'}: no such file, nor with .gz; put it there",
        ),
        ([str(graph), "--robot", "1"], f"--robot 1: {graph} has one robot only; leave --robot out"),
    ]:
        code, _, complaint = call("slam", *arguments, *out)
        assert (code, complaint) == (2, f"tfg-drake: {expected}\n")


def test_ctrl_c_ends_it(mrclam, tmp_path):
    from tfg_drake.diagrams.missions.slam import run_slam

    def interrupted(_text):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_slam(mrclam, tmp_path / "run", interrupted)
    assert not (tmp_path / "run" / "summary.json").exists()


@pytest.fixture
def carmen(tmp_path):
    """A scanner that goes round a square room of 8 m, as CARMEN logs it."""
    lines = []
    bearings = (np.arange(180) / 180 - 0.5) * np.pi
    for k in range(60):
        heading = 0.1 * k
        x, y = 2.0 * np.sin(heading), -2.0 * np.cos(heading)
        c, s = np.cos(heading + bearings), np.sin(heading + bearings)
        with np.errstate(divide="ignore"):
            ranges = np.minimum((4.0 - np.sign(c) * x) / np.abs(c), (4.0 - np.sign(s) * y) / np.abs(s))
        pose = f"{x} {y} {heading}"
        lines.append(f"FLASER 180 {' '.join(f'{r:.3f}' for r in ranges)} {pose} {pose} {0.5 * k} host {0.5 * k}\n")
    path = tmp_path / "room.log"
    path.write_text("".join(lines))
    return path


@pytest.mark.parametrize("method", ["walls", "grid"])
def test_a_laser_log_is_mapped_judged_and_kept(call, tmp_path, carmen, method):
    out = tmp_path / "run"
    arguments = ["--seed", "2", "--odometry-noise", "0.5", "--method", method, "--json", "--out", str(out)]
    told = tmp_path / "room.relations.gz"
    told.write_bytes(gzip.compress(b"5.0 10.0 0 0 0 0 0 0\n"))
    code, printed, complaint = call("slam", str(carmen), *arguments, "--relations", str(told))
    assert (code, complaint) == (0, "")
    summary = json.loads((out / "summary.json").read_text())
    assert json.loads(printed.splitlines()[-1]) == summary
    assert (summary["method"], summary["outcome"], summary["scans"]) == (method, "complete", 60)
    assert summary["relative_translation_m"]["mean"] < 0.05
    assert summary["relative_rotation_rad"]["mean"] < 0.02
    assert summary["robot_rmse_m"] < 0.05
    assert summary["wall_thickness_m"] < 0.05
    assert "between two scans, mean" in printed
    assert f"{summary['wall_thickness_m']:.3f} m thick: mean spread of scan points about a line\n" in printed
    spent = f"{summary['cpu_time_s']:.0f} s of CPU in {summary['wall_time_s']:.0f} s"
    assert f"online        {spent}, without loading, the last solve and files\n" in printed
    assert f"1 checked by hand, off by {summary['relations']['translation_m']['mean']:.4f} ± 0.0000 m" in printed
    assert (out / "figure.png").read_bytes().startswith(b"\x89PNG")
    assert len((out / "trajectory.tum").read_text().splitlines()) == 60
    assert (out / "map.npz").exists() == (method == "walls")
    assert (out / "grid.npz").exists() == (method == "grid")
    assert (summary["walls_mapped"] is None) == (method == "grid")
    if method == "walls":
        assert 4 <= summary["walls_mapped"] <= 6
        code, printed, complaint = call("map", "info", str(out))
        assert (code, complaint) == (0, "")
        assert f"landmarks    {summary['walls_mapped']} walls" in printed


def test_options_of_laser_logs_go_with_these(call, tmp_path, mrclam, carmen):
    own = f"{mrclam} has odometry of its own, only corrected CARMEN logs have not; leave it out"
    blind = tmp_path / "blind.log"
    blind.write_text("".join(f"FLASER 180 {'81.9 ' * 180}{k} 0 0 {k} 0 0 {k} host {k}\n" for k in range(3)))
    methods = "name walls or grid for a laser recording, and nothing for other data sets"
    for arguments, expected in [
        ([str(mrclam), "--seed", "1"], f"--seed 1: {own}"),
        ([str(mrclam), "--odometry-noise", "2"], f"--odometry-noise 2: {own}"),
        ([str(mrclam), "--method", "grid"], f"--method grid: {methods}"),
        ([str(mrclam), "--page"], "--page: is for laser recordings; leave it out"),
        ([str(mrclam), "--set", "scan.range=5"], "--set scan.range=5: is for laser recordings; leave it out"),
        ([str(carmen), "--method", "tags"], f"--method tags: {methods}"),
        ([str(blind)], f"{blind}: no scan in it met anything; copy it again"),
        ([str(carmen), "--seed", "-1"], "--seed -1: must be between 0 and 2147483647"),
        ([str(carmen), "--odometry-noise", "0"], "--odometry-noise 0: must be greater than 0"),
    ]:
        code, _, complaint = call("slam", *arguments, "--out", str(tmp_path / "run"))
        assert (code, complaint) == (2, f"tfg-drake: {expected}\n")


@pytest.mark.parametrize(
    ("package", "extra", "arguments"),
    [
        ("rosbags", "bag", ["a.mcap"]),
        ("robotpy_apriltag", "camera", ["a.mp4", "--calibration", "c.yaml", "--tag-size", "1"]),
    ],
)
def test_a_missing_package_is_named_before_all_else(call, monkeypatch, package, extra, arguments):
    for name in (package, "tfg_drake.diagrams.missions.slam"):
        monkeypatch.setitem(sys.modules, name, None)
    complaint = f"tfg-drake: {package} is not installed; get it with {pip_install(extra)}\n"
    assert call("slam", *arguments) == (2, "", complaint)
