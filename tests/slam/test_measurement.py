"""Errors and Jacobians of a sighting of a tag and of a look at a wall, against geometry and differences."""

from dataclasses import replace

import numpy as np
import pytest

from tests.slam.test_localizer_kernels import AHEAD, lines_from
from tests.slam.test_scan_lines import ANGLES, CONFIG
from tfg_drake.geometry import se2
from tfg_drake.simulation.laser_scanner import scan
from tfg_drake.slam.measurement import COLUMNS, ERROR, linearise_tag, linearise_wall, look_of
from tfg_drake.slam.scan_lines import scan_lines

# The wall AHEAD: the angle of its normal, and its distance from CENTRE.
CENTRE = np.array([1.0, 0.5])
WALL = np.array([0.0, 3.0])


def tag_rows(X_FB, mount, twist, p_FL, *, offset=0.0, seen=(0.0, 0.0)):
    rows = np.full((2, COLUMNS), np.nan)
    linearise_tag(rows, X_FB, mount, offset, twist, *seen, p_FL)
    return rows


def wall_rows(X_FB, mount, twist, line, wall):
    rows, look = np.full((2, COLUMNS), np.nan), np.empty(7)
    look_of(line, look)
    linearise_wall(rows, X_FB, mount, twist, look, wall, CENTRE)
    return rows


def assert_derivatives(rows, x):
    """rows: of x, pose, mount, landmark and twist; Jacobians are the differences of the error, which is wrapped."""
    columns = np.delete(rows(x), ERROR, axis=1)
    assert columns.shape == (2, len(x))
    for i, column in enumerate(columns.T):
        step = 1e-6 * np.eye(len(x))[i]
        apart = rows(x + step)[:, ERROR] - rows(x - step)[:, ERROR]
        apart[0] = se2.wrap_angle(apart[0])
        np.testing.assert_allclose(column, apart / 2e-6, atol=2e-6)


@pytest.mark.parametrize("seed", range(20))
def test_derivatives_of_a_sighting_are_those_of_differences(seed):
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.normal(0.0, 3.0, 3), rng.normal(0.0, 0.1, 5), rng.normal(0.0, 5.0, 2), rng.normal(size=2)])
    assert_derivatives(lambda x: tag_rows(x[:3], x[3:8], x[10:], x[8:10], offset=0.05), x)


@pytest.mark.parametrize("seed", range(20))
def test_a_tag_is_seen_where_it_is(seed):
    """By a camera that was elsewhere when the frame was taken, and measures too long."""
    rng = np.random.default_rng(seed)
    X_FB, p_FL, twist = rng.normal(0.0, 2.0, 3), rng.normal(0.0, 5.0, 2), np.array([0.4, 0.0])
    yaw, ahead, left, clock, scale = mount = rng.normal(0.0, 0.1, 5)
    offset = 0.03
    X_FC = se2.compose(X_FB, np.array([ahead - (clock - offset) * twist[0], left, yaw]))
    x, y = se2.transform(se2.inverse(X_FC), p_FL)
    seen = np.arctan2(y, x), (1.0 + scale) * np.hypot(x, y)
    error = tag_rows(X_FB, mount, twist, p_FL, offset=offset, seen=seen)[:, ERROR]
    np.testing.assert_allclose(error, 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_derivatives_of_a_look_are_those_of_differences(seed):
    rng = np.random.default_rng(seed)
    line = lines_from(np.array([0.5, -0.2, 0.4]), AHEAD)[0]
    line[7:] += rng.normal(0.0, 0.3, 4)
    x = np.concatenate([rng.normal(0.0, 2.0, 3), rng.normal(0.0, 0.1, 5), rng.normal(0.0, 2.0, 2), rng.normal(size=2)])
    assert_derivatives(lambda x: wall_rows(x[:3], x[3:8], x[10:], line, x[8:10]), x)


def test_a_line_without_error_is_on_its_wall():
    X_FB, mount = np.array([0.5, -0.2, 0.4]), np.array([0.1, 0.2, -0.1, 0.0, 0.0])
    for line in lines_from(se2.compose(X_FB, mount[[1, 2, 0]]), AHEAD):
        np.testing.assert_allclose(wall_rows(X_FB, mount, np.zeros(2), line, WALL)[:, ERROR], 0.0, atol=1e-6)


@pytest.mark.parametrize("twist", [(0.0, 0.5), (0.4, 0.0)], ids=["turning", "driving"])
@pytest.mark.parametrize(
    ("heading", "angles"),
    [(0.3, ANGLES)]
    + [(heading, np.linspace(-np.pi, np.pi, 720)) for heading in (3.0, -2.9)]
    + [(-2.9, np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False))],
    ids=["ahead", "behind to the left", "behind to the right", "over the cut"],
)
def test_a_sweep_is_known(heading, angles, twist):
    """Rays taken later are from another place where the robot moves."""
    swept, X_DB, twist = np.zeros(5), np.array([0.0, 0.0, heading]), np.array(twist)
    swept[4] = 0.005
    ranges = np.empty(len(angles))
    for i, angle in enumerate(angles):
        ago = swept[4] * angle
        then = X_DB - ago * np.array([twist[0] * np.cos(X_DB[2]), twist[0] * np.sin(X_DB[2]), twist[1]])
        ranges[i] = scan(AHEAD.reshape(1, 4), then, 0.0, angles[i : i + 1], np.zeros(1), CONFIG).ranges[0]
    scanned = scan(AHEAD.reshape(1, 4), X_DB, 0.0, angles, np.zeros(len(angles)), CONFIG)
    lines = scan_lines(replace(scanned, ranges=ranges))
    assert len(lines)
    for line in lines:
        off, naive = (wall_rows(X_DB, mount, twist, line, WALL)[:, ERROR] for mount in (swept, np.zeros(5)))
        assert (np.abs(off) < 0.01 * np.abs(naive).max()).all()
