"""Corrects the localiser by the lines of a scan: matched to the map's walls, and how far they are off these."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.slam.localizer_kernels import POSE, State, update
from tfg_drake.slam.odometry_model import wrap
from tfg_drake.slam.scan_lines import bearing_of
from tfg_drake.slam.shared import SCANNER_CLOCK, SCANNER_X, SCANNER_Y, SCANNER_YAW, SHARED, SWEEP
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
        X_DS = _scanner(X_DB, shared, twist, lines[j])
        c, s = math.cos(X_DS[2] + lines[j, 0]), math.sin(X_DS[2] + lines[j, 0])
        x, y = X_DS[0] + c * lines[j, 1] - s * lines[j, 4], X_DS[1] + s * lines[j, 1] + c * lines[j, 4]
        least = min(OVERLAP, 0.5 * (lines[j, 3] - lines[j, 2]))
        for w in range(len(walls)):
            a_x, a_y = walls[w, 1, 0] - walls[w, 0, 0], walls[w, 1, 1] - walls[w, 0, 1]
            length = math.hypot(a_x, a_y)
            a_x, a_y, d_x, d_y = a_x / length, a_y / length, x - walls[w, 0, 0], y - walls[w, 0, 1]
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
        X_DS = _scanner(X_DB, shared, twist, lines[j])
        c, s = math.cos(X_DS[2] + lines[j, 0]), math.sin(X_DS[2] + lines[j, 0])
        m_x, m_y = c * lines[j, 1] - s * lines[j, 4], s * lines[j, 1] + c * lines[j, 4]
        for w in range(len(walls)):
            a_x, a_y = walls[w, 1, 0] - walls[w, 0, 0], walls[w, 1, 1] - walls[w, 0, 1]
            length = math.hypot(a_x, a_y)
            a_x, a_y, d_x, d_y = a_x / length, a_y / length, X_DS[0] - walls[w, 0, 0], X_DS[1] - walls[w, 0, 1]
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
def _scanner(X_DB: FloatArray, shared: FloatArray, twist: FloatArray, line: FloatArray) -> FloatArray:
    """X_DS (3,) when the middle of a line was measured."""
    earlier = shared[SCANNER_CLOCK] + shared[SWEEP] * bearing_of(line)
    ahead, left, c, s = shared[SCANNER_X] - earlier * twist[0], shared[SCANNER_Y], math.cos(X_DB[2]), math.sin(X_DB[2])
    heading = X_DB[2] + shared[SCANNER_YAW] - earlier * twist[1]
    return np.array([X_DB[0] + c * ahead - s * left, X_DB[1] + s * ahead + c * left, heading])


@njit(cache=True)
def line_off(
    mean: FloatArray, shared: FloatArray, twist: FloatArray, line: FloatArray, p_DL: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """How far a line (11,) is turned from a wall through p_DL (2, 2), rad, and its middle off it, m, (2,); derivatives
    on the pose, the first three of the mean (2, 3), the parameters (2, 13), the wall's points (2, 4) and the twist (2,
    2)."""
    by_pose, by_shared, by_points = np.zeros((2, POSE)), np.zeros((2, SHARED)), np.empty((2, 4))
    c, s, X_DS = math.cos(mean[2]), math.sin(mean[2]), _scanner(mean, shared, twist, line)
    angle, bearing = X_DS[2] + line[0], bearing_of(line)
    m_x, m_y = (
        math.cos(angle) * line[1] - math.sin(angle) * line[4],
        math.sin(angle) * line[1] + math.cos(angle) * line[4],
    )
    p_x, p_y = X_DS[0] + m_x - mean[0], X_DS[1] + m_y - mean[1]
    a_x, a_y = p_DL[1, 0] - p_DL[0, 0], p_DL[1, 1] - p_DL[0, 1]
    length = math.hypot(a_x, a_y)
    a_x, a_y = a_x / length, a_y / length
    n_x, n_y, d_x, d_y = a_y, -a_x, mean[0] + p_x - p_DL[0, 0], mean[1] + p_y - p_DL[0, 1]
    share = (a_x * d_x + a_y * d_y) / length
    n_ahead, by_turn = c * n_x + s * n_y, n_y * m_x - n_x * m_y
    by_sweep = twist[1] * line[7:9] + twist[0] * n_ahead * line[9:]
    turned = wrap(math.atan2(n_y, n_x) - angle - shared[SWEEP] * (bearing * twist[1] - by_sweep[0]))
    off = n_x * d_x + n_y * d_y - shared[SWEEP] * by_sweep[1]
    by_angle = shared[SWEEP] * twist[0] * (c * n_y - s * n_x) * line[9:]
    by_pose[0, 2], by_pose[1, 0], by_pose[1, 1] = by_angle[0] - 1.0, n_x, n_y
    by_pose[1, 2] = n_y * p_x - n_x * p_y - by_angle[1]
    by_shared[0, SCANNER_YAW], by_shared[0, SCANNER_CLOCK] = -1.0, twist[1]
    by_shared[0, SWEEP] = by_sweep[0]
    by_shared[1, SCANNER_YAW], by_shared[1, SCANNER_X], by_shared[1, SCANNER_Y] = by_turn, n_ahead, c * n_y - s * n_x
    by_shared[1, SCANNER_CLOCK] = -twist[0] * n_ahead - twist[1] * by_turn
    by_shared[1, SWEEP] = bearing * by_shared[1, SCANNER_CLOCK] - by_sweep[1]
    for i, n in enumerate((n_x, n_y)):
        turned_by = np.array([1.0 - by_angle[0], by_angle[1]]) * n / length
        by_points[:, i], by_points[:, 2 + i] = turned_by, -turned_by
        by_points[1, i] += (share - 1.0) * n
        by_points[1, 2 + i] -= share * n
    earlier = shared[SCANNER_CLOCK] + shared[SWEEP] * bearing
    by_twist = np.array([[0.0, shared[SCANNER_CLOCK]], [-earlier * n_ahead, -earlier * by_turn]])
    by_twist += shared[SWEEP] * np.array([[n_ahead * line[9], line[7]], [-n_ahead * line[10], -line[8]]])
    return np.array([turned, off]), by_pose, by_shared, by_points, by_twist


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
    for j in range(len(lines)):
        a, b, at, k = 2 * j, 2 * j + 2, column[j], (column[j] - SHARED) // 2
        off[a:b], H[a:b, :POSE], H_c[a:b, :SHARED], H_c[a:b, at : at + 4], by_twist = line_off(
            mean, shared, twist[0], lines[j], p_DL[k : k + 2]
        )
        noise[a:b] = lines[j, 5:7] ** 2 + by_twist**2 @ twist[1]
    return update(state, C, H, H_c, -off, noise)
