"""CARMEN's and the MinesRover's laser logs: written here, and the real ones where they are at hand."""

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.laser_log import METRES_PER_COUNT, SCANNER_AHEAD, SCANS_LATE, load_breezyslam, load_carmen
from tfg_drake.datasets.recording import DatasetError

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
EXACT = OdometryConfig(0.0, 0.0, 0.0, 0.0, 0.0)


def flaser(x, y, theta, stamp, ranges="1.0 2.0 25.0 81.91"):
    return f"FLASER 4 {ranges} {x} {y} {theta} {x} {y} {theta} {stamp} host {stamp}\n"


def rover(time, left, right):
    return " ".join(map(str, [time, 0, left, right, *[0] * 20, *[0] * 100, *[1500] * 582, 0])) + "\n"


def test_a_carmen_log_is_read_plain_and_gzipped(tmp_path):
    text = "# comment\nPARAM a b\n" + flaser(1, 2, 0.5, 10.0) + "ODOM 1 2\n" + flaser(1.5, 2, 0.7, 10.0)
    (tmp_path / "a.log").write_text(text)
    (tmp_path / "a.log.gz").write_bytes(gzip.compress(text.encode()))
    for name in ("a.log", "a.log.gz"):
        log = load_carmen(tmp_path / name, EXACT, seed=0)
        assert log.name == "a"
        np.testing.assert_allclose(log.scans[0].angles, [-math.pi / 2, -math.pi / 4, 0.0])
        np.testing.assert_array_equal(log.scans[0].ranges, [1.0, 2.0, math.inf])
        # Stamps that stand still are moved on.
        assert log.scans[1].stamp == pytest.approx(10.001)
        assert [one.stamp for one in log.odometry] == [one.stamp for one in log.scans]
        np.testing.assert_array_equal(log.truth.X_WB, [[1, 2, 0.5], [1.5, 2, 0.7]])
        c, s = math.cos(0.5), math.sin(0.5)
        np.testing.assert_allclose(log.odometry[1].X_OB, [0.5 * c, -0.5 * s, 0.2], atol=1e-12)


def test_odometry_errors_are_the_seeds(tmp_path):
    (tmp_path / "a.log").write_text("".join(flaser(k, 0, 0, k) for k in range(20)))
    runs = [load_carmen(tmp_path / "a.log", OdometryConfig(), seed).odometry[-1].X_OB for seed in (0, 0, 1)]
    np.testing.assert_array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("hello\n", "a.log: fewer than two FLASER lines in it; is it a CARMEN log?"),
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
        ("1 2 3\n", ", line 1: 706 columns expected, 3 found; mend it"),
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


@pytest.mark.skipif(not (DATA / "breezyslam").is_dir(), reason="the rover's log is not at hand")
def test_the_real_rover_log():
    log = load_breezyslam(DATA / "breezyslam" / "exp1.dat.gz")
    assert len(log.scans) == 754
    assert len(log.odometry) == 756
    assert 5.0 < np.hypot(*np.diff([one.X_OB[:2] for one in log.odometry], axis=0).T).sum() < 50.0
