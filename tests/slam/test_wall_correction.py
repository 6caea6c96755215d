"""Lines of a scan, compared with the walls that the localiser knows."""

from dataclasses import replace

import numpy as np
import pytest

from tests.slam.test_scan_lines import ANGLES, CONFIG
from tfg_drake.simulation.laser_scanner import scan
from tfg_drake.slam.scan_lines import scan_lines
from tfg_drake.slam.shared import SCANNER_CLOCK, SCANNER_X, SCANNER_Y, SCANNER_YAW, SHARED, SWEEP
from tfg_drake.slam.wall_correction import line_off, seen_through, walls_seen

# A room's far wall and the wall on its left, each from where it is seen to begin to where it ends, counterclockwise.
AHEAD = np.array([[4.0, -3.0], [4.0, 3.0]])
LEFT = np.array([[4.0, 3.0], [-4.0, 3.0]])
TWIST = np.array([0.3, 0.5])
REACH = np.array([[0.0, 6.0], [0.0, 8.0]])


def lines_from(X_DB, *walls):
    scanned = scan(np.array(walls).reshape(-1, 4), X_DB, 0.0, ANGLES, np.zeros(len(ANGLES)), CONFIG)
    return scan_lines(scanned)


def test_a_line_without_error_is_on_its_wall():
    X_DB = np.array([0.5, -0.2, 0.4])
    lines = lines_from(X_DB, AHEAD, LEFT)
    wall = walls_seen(X_DB, np.zeros(SHARED), TWIST, lines, np.array([AHEAD, LEFT]), REACH)
    assert sorted(wall) == [0, 1]
    for line, w in zip(lines, wall, strict=True):
        off, *_ = line_off(X_DB, np.zeros(SHARED), TWIST, line, (AHEAD, LEFT)[w])
        np.testing.assert_allclose(off, 0.0, atol=1e-6)


def test_derivatives_are_those_of_differences():
    rng = np.random.default_rng(0)
    mean, shared, p_DL = np.array([0.5, -0.2, 0.4]), np.zeros(SHARED), AHEAD + 0.1 * rng.normal(size=(2, 2))
    shared[[SCANNER_YAW, SCANNER_X, SCANNER_Y, SCANNER_CLOCK, SWEEP]] = 0.02, 0.1, -0.05, 0.03, 0.02
    line = lines_from(mean, AHEAD)[0]

    def off(x):
        return line_off(x[:3], x[3 : 3 + SHARED], x[-2:], line, x[3 + SHARED : -2].reshape(2, 2))[0]

    x = np.concatenate([mean, shared, p_DL.ravel(), TWIST])
    _, *derivatives = line_off(mean, shared, TWIST, line, p_DL)
    for i, column in enumerate(np.hstack(derivatives).T):
        step = 1e-6 * np.eye(len(x))[i]
        np.testing.assert_allclose(column, (off(x + step) - off(x - step)) / 2e-6, atol=1e-6)


@pytest.mark.parametrize(("shift", "found"), [(0.1, 0), (0.6, -1)])
def test_a_wall_must_be_near_its_line(shift, found):
    lines = lines_from(np.zeros(3), AHEAD)
    assert walls_seen(np.zeros(3), np.zeros(SHARED), TWIST, lines, AHEAD[None] + [shift, 0.0], REACH[:1]) == [found]


def test_what_may_be_two_walls_is_neither():
    """Nor is it one that was seen elsewhere, or from the other side."""
    lines = lines_from(np.zeros(3), AHEAD)
    both = AHEAD + np.array([[[0.0, 0.0]], [[0.2, 0.0]]])
    assert walls_seen(np.zeros(3), np.zeros(SHARED), TWIST, lines, both, REACH[[0, 0]]) == [-1]
    for wall, reach in ((AHEAD, [5.8, 9.0]), (AHEAD[::-1], [0.0, 6.0])):
        assert walls_seen(np.zeros(3), np.zeros(SHARED), TWIST, lines, wall[None], np.array([reach])) == [-1]


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
    shared, X_DB, twist = np.zeros(SHARED), np.array([0.0, 0.0, heading]), np.array(twist)
    shared[SWEEP] = 0.005
    ranges = np.empty(len(angles))
    for i, angle in enumerate(angles):
        ago = shared[SWEEP] * angle
        then = X_DB - ago * np.array([twist[0] * np.cos(X_DB[2]), twist[0] * np.sin(X_DB[2]), twist[1]])
        ranges[i] = scan(AHEAD.reshape(1, 4), then, 0.0, angles[i : i + 1], np.zeros(1), CONFIG).ranges[0]
    scanned = scan(AHEAD.reshape(1, 4), X_DB, 0.0, angles, np.zeros(len(angles)), CONFIG)
    lines = scan_lines(replace(scanned, ranges=ranges))
    assert len(lines)
    for line in lines:
        off, naive = (line_off(X_DB, known, twist, line, AHEAD)[0] for known in (shared, np.zeros(SHARED)))
        assert (np.abs(off) < 0.01 * np.abs(naive).max()).all()


@pytest.mark.parametrize(
    ("wall", "reach", "found", "count"),
    [
        (AHEAD - [2.0, 0.0], (0.0, 6.0), -1, 1),
        (AHEAD - [2.0, 0.0], (0.0, 6.0), 0, 0),
        (AHEAD - [2.0, 0.0], (0.0, 2.9), -1, 0),
        (AHEAD[::-1] - [2.0, 0.0], (0.0, 6.0), -1, 0),
        (AHEAD - [-2.0, 0.0], (0.0, 6.0), -1, 0),
        (AHEAD - [0.2, 0.0], (0.0, 6.0), -1, 0),
    ],
    ids=["behind it", "found", "through what was not seen", "from its back", "before it", "hardly behind it"],
)
def test_a_line_behind_a_wall_is_seen_through_it(wall, reach, found, count):
    lines = lines_from(np.zeros(3), AHEAD)
    against = np.ascontiguousarray(wall)[None], np.array([reach])
    assert seen_through(np.zeros(3), np.zeros(SHARED), TWIST, lines, np.array([found]), *against) == count
