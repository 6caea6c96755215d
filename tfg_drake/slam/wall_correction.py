"""Corrects the localiser by the lines of a scan: matched to the map's walls, and how far they are off these."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.slam.localizer_kernels import POSE, State, update
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
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.walls import OVERLAP, SAME_DIRECTION, UNCLEAR


@njit(cache=True)
def walls_seen(
    X_DB: FloatArray, shared: FloatArray, twist: FloatArray, lines: FloatArray, walls: FloatArray, reach: FloatArray
) -> IntArray:
    """The wall (k,) of each line (k, 11) of a scan, -1 where there is none or more than one that may be it.

    X_DB: (3,) and twist (2,): the robot's. walls: (w, 2, 2) pairs of points in D, reach: (w, 2) m from the first
    towards the second.
    """
    found = np.full(len(lines), -1)
    for j in range(len(lines)):
        s_x, s_y, c, s, m_x, m_y = _line_from(X_DB, shared, twist, lines[j])
        least = min(OVERLAP, 0.5 * (lines[j, 3] - lines[j, 2]))
        for w in range(len(walls)):
            a_x, a_y = walls[w, 1, 0] - walls[w, 0, 0], walls[w, 1, 1] - walls[w, 0, 1]
            length = math.hypot(a_x, a_y)
            a_x, a_y, d_x, d_y = a_x / length, a_y / length, s_x + m_x - walls[w, 0, 0], s_y + m_y - walls[w, 0, 1]
            if a_y * c - a_x * s < SAME_DIRECTION or abs(a_y * d_x - a_x * d_y) > UNCLEAR:
                continue
            at = a_x * d_x + a_y * d_y - lines[j, 4]
            if min(reach[w, 1], at + lines[j, 3]) - max(reach[w, 0], at + lines[j, 2]) < least:
                continue
            found[j] = w if found[j] == -1 else -2
    return np.asarray(np.maximum(found, -1))


@njit(cache=True)
def seen_through(
    X_DB: FloatArray,
    shared: FloatArray,
    twist: FloatArray,
    lines: FloatArray,
    found: IntArray,
    walls: FloatArray,
    reach: FloatArray,
) -> int:
    """The number of lines (k, 11) of a scan, of no wall found (k,), that lie behind a wall where that has been seen.

    Further arguments as of `walls_seen`.
    """
    count = 0
    for j in range(len(lines)):
        if found[j] >= 0:
            continue
        s_x, s_y, _, _, m_x, m_y = _line_from(X_DB, shared, twist, lines[j])
        for w in range(len(walls)):
            a_x, a_y = walls[w, 1, 0] - walls[w, 0, 0], walls[w, 1, 1] - walls[w, 0, 1]
            length = math.hypot(a_x, a_y)
            a_x, a_y, d_x, d_y = a_x / length, a_y / length, s_x - walls[w, 0, 0], s_y - walls[w, 0, 1]
            # How far the scanner is before the wall, and the line's middle behind it.
            before, behind = a_x * d_y - a_y * d_x, a_y * (d_x + m_x) - a_x * (d_y + m_y)
            if before <= 0.0 or behind < UNCLEAR:
                continue
            share = before / (before + behind)
            at = a_x * (d_x + share * m_x) + a_y * (d_y + share * m_y)
            if reach[w, 0] + OVERLAP < at < reach[w, 1] - OVERLAP:
                count += 1
                break
    return count


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
    state: State,
    considered: tuple[FloatArray, FloatArray],
    twist: tuple[FloatArray, FloatArray],
    lines: FloatArray,
    column: IntArray,
    p_DL: FloatArray,
) -> BoolArray:
    """Correct the state, in place, by lines (k, 11) of a scan; which of them are inside their gate, (k,), and are used.

    column: (k,) where what is considered has the first point of each one's wall, the second next to it. p_DL: (s, 2) of
    what is considered. twist: (2,) and its variances (2,).
    """
    (mean, _, _), (shared, C), m = state, considered, 2 * len(lines)
    H, H_c, off, noise = np.zeros((m, len(mean))), np.zeros((m, len(C))), np.empty(m), np.empty(m)
    rows, look, wall = np.empty((2, COLUMNS)), np.empty(7), np.zeros(2)
    for j in range(len(lines)):
        a, b, at, k = 2 * j, 2 * j + 2, column[j], (column[j] - SHARED) // 2
        n_x, n_y = p_DL[k + 1, 1] - p_DL[k, 1], p_DL[k, 0] - p_DL[k + 1, 0]
        length = math.hypot(n_x, n_y)
        wall[0] = math.atan2(n_y, n_x)
        look_of(lines[j], look)
        linearise_wall(rows, mean, shared[SCANNER:], twist[0], look, wall, p_DL[k])
        H[a:b, :POSE], H_c[a:b, SCANNER : SCANNER + OF_SENSOR] = rows[:, :POSE], rows[:, OF_MOUNT:OF_LANDMARK]
        # The wall turns as its points part, and its distance is from the first.
        for i, n in enumerate((n_x / length, n_y / length)):
            turned = rows[:, OF_LANDMARK] * n / length
            H_c[a:b, at + i], H_c[a:b, at + 2 + i] = turned + rows[:, OF_LANDMARK + 1] * n, -turned
        off[a:b], noise[a:b] = rows[:, ERROR], lines[j, 5:7] ** 2 + rows[:, OF_TWIST:] ** 2 @ twist[1]
    return update(state, C, H, H_c, -off, noise)
