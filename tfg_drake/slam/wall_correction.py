"""Corrects the localiser by the lines of a scan: matched to the map's walls, and how far they are off these."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.slam.localizer_kernels import POSE, Considered, State, update
from tfg_drake.slam.measurement import (
    COLUMNS,
    ERROR,
    OF_LANDMARK,
    OF_MOUNT,
    OF_SENSOR,
    OF_TWIST,
    SCANNER,
    linearise_wall,
    look_of,
    sensor_pose,
)
from tfg_drake.slam.scan_lines import bearing_of
from tfg_drake.slam.walls import OVERLAP, SAME_DIRECTION, UNCLEAR, WallSet

# The robot's speed and turn rate (2,), m/s and rad/s, and their variances (2,).
Twist = tuple[FloatArray, FloatArray]


@njit(cache=True)
def walls_seen(
    X_DB: FloatArray, shared: FloatArray, twist: FloatArray, lines: FloatArray, in_D: WallSet
) -> tuple[IntArray, int]:
    """The wall (k,) of each line (k, 11) of a scan, -1 where there is none or more than one that may be it; and the
    number of those without one that lie behind a wall where that has been seen.

    X_DB: (3,) and twist (2,): the robot's. in_D: walls in D.
    """
    found, through, (walls, p_DC, reach) = np.full(len(lines), -1), 0, in_D
    for j in range(len(lines)):
        s_x, s_y, c, s, m_x, m_y = _line_from(X_DB, shared, twist, lines[j])
        least, is_behind = min(OVERLAP, 0.5 * (lines[j, 3] - lines[j, 2])), False
        for w in range(len(walls)):
            n_x, n_y = math.cos(walls[w, 0]), math.sin(walls[w, 0])
            d_x, d_y = s_x - p_DC[w, 0], s_y - p_DC[w, 1]
            # How far the scanner is before the wall, and the line's middle behind it.
            before = walls[w, 1] - n_x * d_x - n_y * d_y
            behind = n_x * m_x + n_y * m_y - before
            if before > 0.0 and behind >= UNCLEAR:
                share = before / (before + behind)
                at = n_x * (d_y + share * m_y) - n_y * (d_x + share * m_x)
                is_behind |= reach[w, 0] + OVERLAP < at < reach[w, 1] - OVERLAP
            if n_x * c + n_y * s < SAME_DIRECTION or abs(behind) > UNCLEAR:
                continue
            at = n_x * (d_y + m_y) - n_y * (d_x + m_x) - lines[j, 4]
            if min(reach[w, 1], at + lines[j, 3]) - max(reach[w, 0], at + lines[j, 2]) >= least:
                found[j] = w if found[j] == -1 else -2
        through += is_behind and found[j] < 0
    return np.maximum(found, -1), through


@njit(cache=True)
def _line_from(
    X_DB: FloatArray, shared: FloatArray, twist: FloatArray, line: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """In D, of the instant when the middle of a line was measured: where the scanner was (x, y), m, the normal's
    direction (x, y) and the middle (x, y) from the scanner, m."""
    bearing, mount = bearing_of(line), shared[SCANNER:]
    x, y, theta = sensor_pose(X_DB, mount, twist, mount[3] + mount[4] * bearing)
    c, s = math.cos(theta + line[0]), math.sin(theta + line[0])
    return x, y, c, s, c * line[1] - s * line[4], s * line[1] + c * line[4]


@njit(cache=True)
def correct_by_walls(
    state: State, considered: Considered, twist: Twist, lines: FloatArray, column: IntArray, in_D: WallSet
) -> BoolArray:
    """Correct the state, in place, by lines (k, 11) of a scan; which of them are inside their gate, (k,), and are used.

    column: (k,) where what is considered has each one's wall, in_D: that wall in D.
    """
    (mean, _, _), (shared, C), m, (walls, p_DC, _) = state, considered, 2 * len(lines), in_D
    H, H_c, off, noise = np.zeros((m, len(mean))), np.zeros((m, len(C))), np.empty(m), np.empty(m)
    rows, look = np.empty((2, COLUMNS)), np.empty(7)
    for j in range(len(lines)):
        a, b = 2 * j, 2 * j + 2
        look_of(lines[j], look)
        linearise_wall(rows, mean, shared[SCANNER:], twist[0], look, walls[j], p_DC[j])
        H[a:b, :POSE], H_c[a:b, SCANNER : SCANNER + OF_SENSOR] = rows[:, :POSE], rows[:, OF_MOUNT:OF_LANDMARK]
        H_c[a:b, column[j] : column[j] + 2] = rows[:, OF_LANDMARK:ERROR]
        off[a:b], noise[a:b] = rows[:, ERROR], lines[j, 5:7] ** 2 + rows[:, OF_TWIST:] ** 2 @ twist[1]
    return update(state, C, H, H_c, -off, noise)
