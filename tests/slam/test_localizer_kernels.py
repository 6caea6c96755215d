"""Lines of a scan, compared with the walls that the localiser knows."""

import numpy as np
import pytest

from tests.arrays import frozen
from tests.slam.test_scan_lines import ANGLES, CONFIG
from tests.walls import walls_between
from tfg_drake.simulation.laser_scanner import scan
from tfg_drake.slam.localizer_kernels import walls_seen
from tfg_drake.slam.scan_lines import scan_lines
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.walls import WallSet

# A room's far wall and the wall on its left, each from where it is seen to begin to where it ends, counterclockwise.
AHEAD = np.array([[4.0, -3.0], [4.0, 3.0]])
LEFT = np.array([[4.0, 3.0], [-4.0, 3.0]])
TWIST = np.array([0.3, 0.5])
ORIGIN, PARAMETERS = frozen(np.zeros(3)), frozen(np.zeros(SHARED))


def known(ends, reach=None):
    """Walls, anchors and reaches of walls between ends (w, 2, 2), seen so far, (w, 2) m from the first."""
    walls, anchor, whole = walls_between(ends)
    return WallSet(walls, anchor, whole if reach is None else np.asarray(reach) + whole[:, :1])


def lines_from(X_DB, *walls):
    scanned = scan(frozen(np.reshape(walls, (-1, 4))), np.array(X_DB), 0.0, ANGLES, np.zeros(len(ANGLES)), CONFIG)
    return scan_lines(scanned)


def test_lines_are_of_the_walls_that_they_lie_on():
    X_DB = frozen([0.5, -0.2, 0.4])
    lines = lines_from(X_DB, AHEAD, LEFT)
    wall, _ = walls_seen(X_DB, PARAMETERS, TWIST, lines, known([AHEAD, LEFT]))
    assert sorted(wall) == [0, 1]


@pytest.mark.parametrize(("shift", "found"), [(0.1, 0), (0.6, -1)])
def test_a_wall_must_be_near_its_line(shift, found):
    lines = lines_from(np.zeros(3), AHEAD)
    assert walls_seen(ORIGIN, PARAMETERS, TWIST, lines, known(AHEAD[None] + [shift, 0.0]))[0] == [found]


def test_what_may_be_two_walls_is_neither():
    """Nor is it one that was seen elsewhere, or from the other side."""
    lines = lines_from(np.zeros(3), AHEAD)
    both = AHEAD + np.array([[[0.0, 0.0]], [[0.2, 0.0]]])
    assert walls_seen(ORIGIN, PARAMETERS, TWIST, lines, known(both))[0] == [-1]
    for wall, reach in ((AHEAD, [5.8, 9.0]), (AHEAD[::-1], [0.0, 6.0])):
        assert walls_seen(ORIGIN, PARAMETERS, TWIST, lines, known(wall[None], [reach]))[0] == [-1]


@pytest.mark.parametrize(
    ("wall", "reach", "found", "count"),
    [
        (AHEAD - [2.0, 0.0], (0.0, 6.0), -1, 1),
        (AHEAD - [2.0, 0.0], (0.0, 6.0), 0, 0),
        (AHEAD - [2.0, 0.0], (0.0, 2.9), -1, 0),
        (AHEAD[::-1] - [2.0, 0.0], (0.0, 6.0), -1, 0),
        (AHEAD - [-2.0, 0.0], (0.0, 6.0), -1, 0),
        (AHEAD - [0.2, 0.0], (0.0, 6.0), 1, 0),
    ],
    ids=["behind it", "found", "through what was not seen", "from its back", "before it", "hardly behind it"],
)
def test_a_line_behind_a_wall_is_seen_through_it(wall, reach, found, count):
    lines = lines_from(np.zeros(3), AHEAD)
    # Far enough ahead, or where it is.
    other = AHEAD if found == 0 else AHEAD - [-9.0, 0.0]
    against = known(np.array([other, wall]), [[0.0, 6.0], reach])
    assert walls_seen(ORIGIN, PARAMETERS, TWIST, lines, against) == ([found], count)
