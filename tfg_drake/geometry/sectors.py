"""Segments sorted by the directions in which they lie, seen from one point (numba kernels).

A line of sight can only be crossed by what lies in its own sector, so most segments need no look at all.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray

# Equal parts of the full turn, in diamond angle.
SECTORS = 32
# Rounding of a diamond angle, generously.
_ROUNDING = 1e-9


@njit(cache=True)
def diamond_angle(dx: float, dy: float) -> float:
    """A number in [0, 4) that grows with the direction of (dx, dy) and by 2 with half a turn; 1 for (0, 0)."""
    length = abs(dx) + abs(dy)
    sine = dy / length if length > 0.0 else 0.0
    if dx >= 0.0:
        return 1.0 + sine
    return 3.0 - sine if sine > -1.0 else 0.0


@njit(cache=True)
def sector_of(dx: float, dy: float) -> int:
    """The sector that the direction (dx, dy) lies in."""
    return min(SECTORS - 1, int(diamond_angle(dx, dy) * (SECTORS / 4.0)))


@njit(cache=True)
def segments_by_sector(segments: FloatArray, x: float, y: float) -> tuple[IntArray, IntArray]:
    """(offsets (SECTORS + 1,), rows): sector k, seen from (x, y), meets the segments rows[offsets[k]:offsets[k + 1]].

    segments: (m, 4), m. A segment that (x, y) lies on, as far as rounding can tell, meets all sectors.
    """
    m = len(segments)
    first, span = np.empty(m, dtype=np.int64), np.empty(m, dtype=np.int64)
    count = np.zeros(SECTORS + 1, dtype=np.int64)
    for j in range(m):
        ax, ay, bx, by = segments[j, 0] - x, segments[j, 1] - y, segments[j, 2] - x, segments[j, 3] - y
        a, b = diamond_angle(ax, ay), diamond_angle(bx, by)
        turn = b - a if b >= a else b - a + 4.0
        if abs(turn - 2.0) < 1e-6 or (ax == 0.0 and ay == 0.0) or (bx == 0.0 and by == 0.0):
            first[j], span[j] = 0, SECTORS
        else:
            begin, turn = (a, turn) if turn < 2.0 else (b, 4.0 - turn)
            low = int(np.floor((begin - _ROUNDING) * (SECTORS / 4.0)))
            high = int(np.floor((begin + turn + _ROUNDING) * (SECTORS / 4.0)))
            first[j], span[j] = low, high - low + 1
        for k in range(first[j], first[j] + span[j]):
            count[k % SECTORS + 1] += 1
    offsets = np.cumsum(count)
    rows, filled = np.empty(offsets[-1], dtype=np.int64), offsets[:-1].copy()
    for j in range(m):
        for k in range(first[j], first[j] + span[j]):
            rows[filled[k % SECTORS]] = j
            filled[k % SECTORS] += 1
    return offsets, rows
