"""CARMEN's and the MinesRover's laser logs: written here, and the real ones where they are at hand."""

import bz2
import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.laser_log import METRES_PER_COUNT, SCANNER_AHEAD, SCANS_LATE, load_breezyslam, load_carmen
from tfg_drake.datasets.recording import DatasetError
from tfg_drake.hardware.recordings import load_dataset

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
EXACT = OdometryConfig(0.0, 0.0, 0.0, 0.0, 0.0)
SPAN = "say what it spans, rad, by --set hardware.scanner.field_of_view=RAD"
HALF = "1.0 2.0 25.0 81.91 " + "3.0 " * 176


def flaser(x, y, theta, stamp, ranges=HALF, of_body=None):
    ox, oy, otheta = (x, y, theta) if of_body is None else of_body
    return f"FLASER {len(ranges.split())} {ranges} {x} {y} {theta} {ox} {oy} {otheta} {stamp} host {stamp}\n"


def odom(x, y, theta, stamp):
    return f"ODOM {x} {y} {theta} 0 0 0 {stamp} host {stamp}\n"


def robot_laser(pose, body, stamp, first=-2.0, step=0.5, ranges=(1.0, 2.0, 9.0, 3.0), greatest=8.0):
    of_rays = (
        f"0 {first} {step * len(ranges)} {step} {greatest} 0.01 0 {len(ranges)} {' '.join(map(str, ranges))} 2 7 7"
    )
    poses = " ".join(map(str, [*pose, *body]))
    return f"ROBOTLASER1 {of_rays} {poses} 0.1 0.2 0 0 0 {stamp} host {stamp}\n"


def rover(time, left, right):
    return " ".join(map(str, [time, 0, left, right, *[0] * 20, *[0] * 100, *[1500] * 582, 0])) + "\n"


def test_a_carmen_log_is_read_plain_and_packed(tmp_path):
    text = "# comment\nPARAM a b\n" + flaser(1, 2, 0.5, 10.0) + "ODOM 1 2\n" + flaser(1.5, 2, 0.7, 11.0)
    (tmp_path / "a.log").write_text(text)
    (tmp_path / "a.log.gz").write_bytes(gzip.compress(text.encode()))
    (tmp_path / "a.clf.bz2").write_bytes(bz2.compress(text.encode()))
    for name in ("a.log", "a.log.gz", "a.clf.bz2"):
        log = load_dataset(tmp_path / name, noise=1e-9)
        assert log.name == "a"
        np.testing.assert_allclose(log.scans[0].angles[:4], np.radians([-90, -89, -88, -86]))
        np.testing.assert_array_equal(log.scans[0].ranges[:4], [1.0, 2.0, math.inf, 3.0])
        assert [one.stamp for one in log.odometry] == [one.stamp for one in log.scans] == [10.0, 11.0]
        np.testing.assert_array_equal(log.truth.X_WB, [[1, 2, 0.5], [1.5, 2, 0.7]])
        c, s = math.cos(0.5), math.sin(0.5)
        np.testing.assert_allclose(log.odometry[1].X_OB, [0.5 * c, -0.5 * s, 0.2], atol=2e-3)
        assert log.notes == ()
    (tmp_path / "a.clf.bz2").write_bytes(bz2.compress(text.encode())[:-20])
    with pytest.raises(DatasetError, match=r"a.clf.bz2: not a whole bzip2 file; copy it again"):
        load_dataset(tmp_path / "a.clf.bz2")


@pytest.mark.parametrize(("count", "last"), [(180, 89.0), (181, 90.0), (360, 89.5), (361, 90.0), (721, 90.0)])
def test_half_circles_are_known_by_their_number_of_rays(tmp_path, count, last):
    (tmp_path / "a.log").write_text("".join(flaser(k, 0, 0, k, "2.0 " * count) for k in range(2)))
    angles = load_carmen(tmp_path / "a.log", EXACT, 0).scans[0].angles
    np.testing.assert_allclose(np.degrees(angles[[0, count // 2, -1]]), [-90.0, 0.0, last], atol=1e-9)


def test_other_scanners_need_what_they_span(tmp_path):
    (tmp_path / "a.log").write_text("".join(flaser(k, 0, 0, k, "1.0 2.0 3.0") for k in range(2)))
    with pytest.raises(DatasetError) as error:
        load_dataset(tmp_path / "a.log")
    assert str(error.value) == (
        f"{tmp_path}/a.log: scans of 3 rays, and only 180, 181, 360, 361, 720, 721 are half a circle; "
        "say what it spans, rad, by --set hardware.scanner.field_of_view=RAD"
    )
    log = load_dataset(tmp_path / "a.log", scanner={"field_of_view": 4.0})
    np.testing.assert_allclose(log.scans[0].angles, [-2.0, 0.0, 2.0])
    for said, ranges in (({"clockwise": True}, [3.0, 2.0, 1.0]), ({"clockwise": True, "flip": True}, [1.0, 2.0, 3.0])):
        log = load_dataset(tmp_path / "a.log", scanner={"field_of_view": 4.0, **said})
        np.testing.assert_array_equal(log.scans[0].ranges, ranges)
    # It looks back: its left is the robot's right.
    log = load_dataset(tmp_path / "a.log", scanner={"field_of_view": 4.0, "yaw": math.pi, "clock_offset": 0.1})
    np.testing.assert_allclose(log.scans[0].angles, [2.0 - math.pi, math.pi - 2.0, math.pi])
    np.testing.assert_array_equal(log.scans[0].ranges, [3.0, 1.0, 2.0])
    assert log.scans[1].stamp == 0.9
    with pytest.raises(
        DatasetError, match=r"--set hardware.scanner.pitch: .* is a recording, of its scanner say x, y,"
    ):
        load_dataset(tmp_path / "a.log", scanner={"pitch": 0.1})
    with pytest.raises(DatasetError, match=r"--set hardware.scanner.yaw: .* has no laser scanner; leave it out"):
        load_dataset(tmp_path, scanner={"yaw": 1.0})


def drive(count=40):
    """Poses of a body that turns while it drives, and their stamps, a second apart."""
    k = np.arange(count)
    return np.column_stack([0.3 * k, 0.1 * k, 0.05 * k]), 100.0 + k


def ahead(pose, by):
    return pose[0] + by * math.cos(pose[2]), pose[1] + by * math.sin(pose[2]), pose[2]


def test_a_raw_log_has_the_wheels_way_and_the_scanner_where_it_says(tmp_path):
    poses, stamps = drive()
    lines = []
    for pose, stamp in zip(poses, stamps, strict=True):
        # The scanner's poses are rounded, as those of logs are, and between two lines of odometry.
        lines += [odom(*(pose - 0.5 * (poses[1] - poses[0])), stamp - 0.5)]
        lines += [flaser(*np.round(ahead(pose, 0.25), 6), stamp, of_body=np.round(pose, 6))]
    (tmp_path / "a.log").write_text("".join([*lines, odom(*poses[-1], stamps[-1] + 0.5)]))
    log = load_dataset(tmp_path / "a.log")
    assert log.truth is None
    np.testing.assert_allclose([one.X_OB for one in log.odometry], poses, atol=1e-6)
    np.testing.assert_allclose(log.odometry[5].V_B, [math.hypot(0.3, 0.1), 0.05], atol=0.02)
    assert not any(one.at_rest for one in log.odometry[1:])
    np.testing.assert_allclose([one.stamp for one in log.scans], stamps)
    np.testing.assert_allclose(log.scan_arrivals, stamps)
    assert log.X_BS[0] == pytest.approx(0.25, abs=1e-5)
    assert log.scanner.mount_deviation == pytest.approx(0.02)
    with pytest.raises(
        DatasetError, match=r"--seed 1: .* has odometry of its own, only corrected CARMEN logs have not"
    ):
        load_dataset(tmp_path / "a.log", seed=1)


def test_a_log_whose_poses_slam_corrected_is_none_of_its_wheels(tmp_path):
    poses, stamps = drive()
    rng = np.random.default_rng(0)
    # As GMapping writes them: odometry goes on from each corrected pose.
    lines = [
        line
        for pose, stamp in zip(poses + rng.normal(0.0, 0.05, poses.shape), stamps, strict=True)
        for line in (odom(*(pose + np.array([0.03, 0.02, 0.01])), stamp), flaser(*pose, stamp), odom(*pose, 0))
    ]
    (tmp_path / "a.log").write_text("".join(lines))
    assert load_dataset(tmp_path / "a.log").truth is not None
    # Corrected poses beside those of the wheels: they do not stay together.
    lines = [
        odom(*pose, stamp) + flaser(*(1.02 * pose), stamp, of_body=pose)
        for pose, stamp in zip(poses, stamps, strict=True)
    ]
    (tmp_path / "a.log").write_text("".join(lines))
    log = load_dataset(tmp_path / "a.log")
    np.testing.assert_allclose(log.truth.X_WB, 1.02 * poses)


def test_robotlaser_lines_say_their_own_angles(tmp_path):
    poses, stamps = drive()
    lines = [robot_laser(ahead(pose, 0.1), pose, stamp) for pose, stamp in zip(poses, stamps, strict=True)]
    (tmp_path / "a.log").write_text("".join(lines))
    log = load_dataset(tmp_path / "a.log")
    # 9 m is beyond its range: no return.
    np.testing.assert_allclose(log.scans[0].angles, [-2.0, -1.5, -0.5])
    np.testing.assert_array_equal(log.scans[0].ranges, [1.0, 2.0, 3.0])
    assert log.scans[0].range_max == 8.0
    assert log.truth.X_WB[3] == pytest.approx(ahead(poses[3], 0.1))
    # With the wheels' own lines beside them they are the wheels'.
    beside = [odom(*pose, stamp) + line for pose, stamp, line in zip(poses, stamps, lines, strict=True)]
    (tmp_path / "a.log").write_text("".join(beside))
    log = load_dataset(tmp_path / "a.log")
    assert log.truth is None
    np.testing.assert_allclose([one.X_OB for one in log.odometry], poses)
    # Of two kinds the fuller is read.
    (tmp_path / "a.log").write_text("".join([*lines, flaser(0, 0, 0, 200.0), flaser(0, 0, 0, 201.0)]))
    assert len(load_dataset(tmp_path / "a.log").scans) == 40


def test_rawlaser_lines_take_the_wheels_way_between_two_lines_of_odometry(tmp_path):
    poses, stamps = drive()
    lines = [odom(*pose, stamp) for pose, stamp in zip(poses, stamps, strict=True)]
    raw = [f"RAWLASER1 0 -1.0 2.0 1.0 8.0 0.01 0 3 1 2 3 0 {stamp} host {stamp}\n" for stamp in stamps[:-1] + 0.25]
    (tmp_path / "a.log").write_text("".join(np.ravel(list(zip(lines, raw, strict=False)))) + lines[-1])
    log = load_dataset(tmp_path / "a.log")
    assert log.truth is None
    quarter = np.array([0.075, 0.025, 0.0125])
    np.testing.assert_allclose([one.X_OB for one in log.odometry], poses[:-1] + quarter, atol=1e-9)
    np.testing.assert_allclose(log.scans[0].angles, [-1.0, 0.0, 1.0])
    (tmp_path / "a.log").write_text("".join(raw))
    with pytest.raises(DatasetError, match=r"a.log: scans without poses and no ODOM lines; record odometry, too"):
        load_dataset(tmp_path / "a.log")


@pytest.mark.parametrize("cut", [lambda k: 0.0, lambda k: float(int(0.01 * k)), lambda k: 1e-3 * k])
def test_stamps_that_cannot_be_true_become_time_by_motion(tmp_path, cut):
    poses, _ = drive()
    (tmp_path / "a.log").write_text("".join(flaser(*pose, cut(k)) for k, pose in enumerate(poses)))
    log = load_dataset(tmp_path / "a.log")
    step = math.hypot(0.3, 0.1) / 0.4 + 0.05
    expected = step * np.arange(40)
    np.testing.assert_allclose([one.stamp for one in log.scans], expected)
    np.testing.assert_allclose(log.truth.stamps, expected)
    np.testing.assert_allclose(log.told_stamps, np.column_stack([[cut(k) for k in range(40)], expected]))
    (note,) = log.notes
    assert (note.kind, note.time_s) == ("stamps", pytest.approx(step if cut(2) == cut(0) else 0.0, abs=2 * step))
    assert note.text == (
        "39 of 40 stamps cannot be true: they stand still, run back, or leave no time for the way or hours; "
        "none is believed; time is by motion instead, 0.4 m/s and 0.6 rad/s"
    )


def test_a_gap_of_years_and_a_stamp_that_runs_back_are_mended_alone(tmp_path):
    poses, stamps = drive(200)
    told = stamps.copy()
    told[100:] += 4e9
    told[50] = told[49] - 0.3
    (tmp_path / "a.log").write_text("".join(flaser(*pose, stamp) for pose, stamp in zip(poses, told, strict=True)))
    log = load_dataset(tmp_path / "a.log")
    step = math.hypot(0.3, 0.1) / 0.4 + 0.05
    times = np.array([one.stamp for one in log.scans])
    np.testing.assert_allclose(np.delete(times[:100], 50), np.delete(stamps[:100], 50))
    assert times[50] == pytest.approx(stamps[49] + step)
    np.testing.assert_allclose(np.diff(times[99:]), [step, *[1.0] * 99], atol=1e-5)
    assert log.notes[0].text.startswith("2 of 200 stamps cannot be true")
    assert " the others are believed; " in log.notes[0].text


def test_odometry_errors_are_the_seeds(tmp_path):
    (tmp_path / "a.log").write_text("".join(flaser(k, 0, 0, 9 * k) for k in range(20)))
    runs = [load_carmen(tmp_path / "a.log", OdometryConfig(), seed).odometry[-1].X_OB for seed in (0, 0, 1)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("hello\n", "a.log: fewer than two scans in it (FLASER, ROBOTLASER1, RAWLASER1); is it a CARMEN log?"),
        ("ROBOTLASER1 0 1 2\n", "a.log, line 1: not a whole ROBOTLASER1 line; copy the file again"),
        ("FLASER 4 1.0\n", "a.log, line 1: not a whole FLASER line; copy the file again"),
        ("FLASER\n", "a.log, line 1: not a whole FLASER line; copy the file again"),
        (flaser(0, 0, 0, "x"), "a.log, line 1: 'x' is not a finite number below 1e+19; mend the line"),
        (flaser(0, 0, 0, 1, "1 2 nan 3"), "a.log, line 1: 'nan' is not a finite number below 1e+19; mend the line"),
    ],
)
def test_complaints_about_carmen_logs(tmp_path, text, complaint):
    (tmp_path / "a.log").write_text(text)
    with pytest.raises(DatasetError) as error:
        load_carmen(tmp_path / "a.log", EXACT, 0)
    assert str(error.value) == f"{tmp_path}/{complaint}"


def test_a_rover_log(tmp_path):
    (tmp_path / "r.dat").write_text(rover(1_000_000, 0, 0) + rover(2_000_000, 1000, 1000) + rover(3_000_000, 900, 1100))
    log = load_breezyslam(tmp_path / "r.dat")
    # The scans are told late: the first is of a time before the wheels' first counts.
    assert [one.stamp for one in log.scans] == [1.0 - SCANS_LATE, 2.0 - SCANS_LATE]
    assert [one.stamp for one in log.odometry] == [0.0, 1.0, 2.0]
    # As seen from amid the wheels.
    ahead = np.argmin(np.abs(log.scans[0].angles))
    assert log.scans[0].ranges[ahead] == pytest.approx(1.5 + SCANNER_AHEAD, abs=1e-4)
    assert -log.scans[0].angles[0] < log.scans[0].angles[-1] < math.radians(100)
    np.testing.assert_allclose(log.odometry[1].X_OB, [1000 * METRES_PER_COUNT, 0.0, 0.0], atol=1e-12)
    # It turns in place, round the middle of its axle; the scanner is before that.
    turn = 0.5 * 200 * METRES_PER_COUNT / 0.165
    np.testing.assert_allclose(log.odometry[2].X_OB - log.odometry[1].X_OB, [0.0, 0.0, turn], atol=1e-12)
    assert log.truth is None


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("1 2 3\n", f", line 1: 706 columns expected, 24 and 682 rays, 3 found; mend it, or of another scanner {SPAN}"),
        (
            rover(2, 0, 0).replace("1500 0", "1500 " * 400),
            f", line 1: 706 columns expected, 24 and 682 rays, 1105 found; mend it, or of another scanner {SPAN}",
        ),
        (rover("x", 0, 0), ", line 1: 'x' is not a finite number below 1e+19; mend the line"),
        (rover(2, 0, 0) + rover(2, 1, 0), ": two different scans at 2 us; leave one of them out"),
        ("", ": fewer than two scans in it; copy it again"),
    ],
)
def test_complaints_about_rover_logs(tmp_path, text, complaint):
    (tmp_path / "r.dat").write_text(text)
    with pytest.raises(DatasetError) as error:
        load_breezyslam(tmp_path / "r.dat")
    assert str(error.value) == f"{tmp_path}/r.dat{complaint}"


@pytest.mark.skipif(not (DATA / "carmen").is_dir(), reason="the CARMEN logs are not at hand")
@pytest.mark.parametrize(("name", "scans"), [("intel", 910), ("aces", 440)])
def test_the_real_carmen_logs(name, scans):
    log = load_carmen(DATA / "carmen" / f"{name}-corrected.log.gz", OdometryConfig(), 0)
    assert len(log.scans) == len(log.odometry) == scans
    assert (np.diff([one.stamp for one in log.scans]) > 0.0).all()


def test_a_rover_log_of_another_scanner(tmp_path):
    text = "".join(
        " ".join(map(str, [k * 10**6, 0, k, k, *[0] * 20, 1000, 2000, 3000, 0, 30000])) + "\n" for k in range(3)
    )
    (tmp_path / "r.dat.bz2").write_bytes(bz2.compress(text.encode()))
    log = load_dataset(tmp_path / "r.dat.bz2", scanner={"field_of_view": 4.0, "x": 0.3})
    assert [one.stamp for one in log.scans] == [0.0, 1.0, 2.0]
    x, y = (log.scans[0].ranges * one(log.scans[0].angles) for one in (np.cos, np.sin))
    np.testing.assert_allclose(np.arctan2(y, x - 0.3)[:3], [-2.0, -1.0, 0.0])  # The last met nothing.
    np.testing.assert_allclose(np.hypot(x - 0.3, y)[:3], [1.0, 2.0, 3.0])
    assert log.scans[0].ranges[3] == math.inf
    assert log.X_BS[0] == 0.3
    assert not log.mount_known


RECORDINGS = DATA / "recordings"


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings are not at hand")
@pytest.mark.parametrize(("name", "degrees"), [("hokuyo240", 240.0), ("hokuyo270", 270.0)])
def test_a_recording_of_a_wider_scanner_sees_what_the_good_one_saw(name, degrees):
    path = RECORDINGS / "I-carmen-fov" / f"{name}.log.gz"
    with pytest.raises(DatasetError, match="are half a circle; say what it spans"):
        load_dataset(path)
    log = load_dataset(path, scanner={"field_of_view": math.radians(degrees)})
    good = load_dataset(RECORDINGS / "0-good" / "good.log.gz")
    assert len(log.scans) == len(good.scans)
    for one, other in zip(log.scans[::40], good.scans[::40], strict=True):
        at = other.angles
        assert np.median(np.abs(np.interp(at, one.angles, one.ranges) - other.ranges)) < 0.05


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the recordings are not at hand")
def test_a_rover_log_of_a_wider_scanner_sees_what_the_good_one_saw():
    path = RECORDINGS / "J-breezy-1081" / "utm1081.dat.gz"
    with pytest.raises(DatasetError, match="706 columns expected, 24 and 682 rays, 1105 found"):
        load_dataset(path)
    log = load_dataset(path, scanner={"field_of_view": math.radians(270.0), "x": SCANNER_AHEAD})
    good = load_dataset(RECORDINGS / "0-good" / "good.dat.gz")
    for one, other in zip(log.scans[1::40], good.scans[::40], strict=True):
        assert np.median(np.abs(np.interp(other.angles, one.angles, one.ranges) - other.ranges)) < 0.1


@pytest.mark.skipif(not (DATA / "radish").is_dir(), reason="the raw logs are not at hand")
@pytest.mark.parametrize(
    ("name", "scans", "ahead"), [pytest.param("aces", 7374, 0.0, marks=pytest.mark.slow), ("fr079", 4934, -0.04)]
)
def test_the_real_raw_logs(name, scans, ahead):
    log = load_dataset(DATA / "radish" / f"{name}.clf.bz2")
    assert log.truth is None
    assert len(log.scans) == scans
    assert log.notes == ()
    assert log.X_BS[0] == pytest.approx(ahead, abs=1e-4)


@pytest.mark.skipif(not (DATA / "breezyslam").is_dir(), reason="the rover's log is not at hand")
def test_the_real_rover_log():
    log = load_breezyslam(DATA / "breezyslam" / "exp1.dat.gz")
    assert len(log.scans) == 754
    assert len(log.odometry) == 756
    assert 5.0 < np.hypot(*np.diff([one.X_OB[:2] for one in log.odometry], axis=0).T).sum() < 50.0
