"""Segments sorted into square cells: a search near a place need not look at all of a building (numba kernels)."""

from __future__ import annotations

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray

# Side of a cell, m, unless there would be more cells than this.
CELL = 1.0
MOST_CELLS = 1_000_000

# See `segment_grid`.
SegmentGrid = tuple[FloatArray, int, int, IntArray, IntArray]


@njit(cache=True)
def cell_range(low: float, high: float, origin: float, cell: float, count: int) -> tuple[int, int]:
    """The first and the one after the last of `count` cells of a side (m) from origin (m) that meet [low, high], m."""
    first = min(float(count), max(0.0, np.floor((low - origin) / cell)))
    last = min(count - 1.0, max(-1.0, np.floor((high - origin) / cell)))
    return int(first), max(int(first), int(last) + 1)


@njit(cache=True)
def segment_grid(segments: FloatArray) -> SegmentGrid:
    """(frame (3,): origin x, y and side of a cell, m; columns; rows; offsets; index) of segments (m, 4), m.

    The cell in column a and row b holds the segments index[offsets[c]:offsets[c + 1]], c = a * rows + b: all whose
    bounding box meets it, in their order.
    """
    frame = np.array([0.0, 0.0, CELL])
    if len(segments) == 0:
        return frame, 1, 1, np.zeros(2, dtype=np.int64), np.zeros(0, dtype=np.int64)
    left, right = min(segments[:, 0].min(), segments[:, 2].min()), max(segments[:, 0].max(), segments[:, 2].max())
    low, high = min(segments[:, 1].min(), segments[:, 3].min()), max(segments[:, 1].max(), segments[:, 3].max())
    frame[0], frame[1] = left, low
    while ((right - left) / frame[2] + 1.0) * ((high - low) / frame[2] + 1.0) > MOST_CELLS:
        frame[2] *= 2.0
    columns, rows = int((right - left) / frame[2]) + 1, int((high - low) / frame[2]) + 1
    count = np.zeros(columns * rows + 1, dtype=np.int64)
    index = np.empty(0, dtype=np.int64)
    offsets = count
    for fill in range(2):
        for j in range(len(segments)):
            x0, y0, x1, y1 = segments[j, 0], segments[j, 1], segments[j, 2], segments[j, 3]
            a0, a1 = cell_range(min(x0, x1), max(x0, x1), left, frame[2], columns)
            b0, b1 = cell_range(min(y0, y1), max(y0, y1), low, frame[2], rows)
            for a in range(a0, a1):
                for b in range(b0, b1):
                    c = a * rows + b
                    if fill == 1:
                        index[count[c]] = j
                        count[c] += 1
                    else:
                        count[c + 1] += 1
        if fill == 0:
            offsets = np.cumsum(count)
            count = offsets.copy()
            index = np.empty(offsets[-1], dtype=np.int64)
    return frame, columns, rows, offsets, index


@njit(cache=True)
def rows_in_box(
    grid: SegmentGrid,
    left: float,
    right: float,
    low: float,
    high: float,
    rows: IntArray,
) -> int:
    """How many rows of segments it has put into rows: of those in the cells of a segment_grid that meet a box, m.

    One that lies in several cells comes several times; there are at most as many as the grid's index has.
    """
    frame, columns, lines, offsets, index = grid
    a0, a1 = cell_range(left, right, frame[0], frame[2], columns)
    b0, b1 = cell_range(low, high, frame[1], frame[2], lines)
    count = 0
    for a in range(a0, a1):
        # Cells of a column lie one after the other.
        for k in range(offsets[a * lines + b0], offsets[a * lines + b1]):
            rows[count] = index[k]
            count += 1
    return count
