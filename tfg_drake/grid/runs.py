"""Cells of a grid as line segments, for pictures and metrics that know only those."""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, GridMap


def row_runs(grid: GridMap, which: BoolArray) -> FloatArray:
    """Some of the cells (h, w) as segments (n, 4), m in M: from the centre of the first to that of the last of each run
    of neighbours in a row."""
    edges = np.diff(np.pad(which.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    row, first = np.nonzero(edges == 1)
    _, after = np.nonzero(edges == -1)
    x, y = grid.origin
    middle = y + (row + 0.5) * grid.resolution
    return np.stack([x + (first + 0.5) * grid.resolution, middle, x + (after - 0.5) * grid.resolution, middle], axis=1)


def cell_sides(grid: GridMap, which: BoolArray) -> FloatArray:
    """Some of the cells (h, w) as segments (n, 4), m in M: each one side long, through its centre."""
    row, column = np.nonzero(which)
    x, y = grid.origin
    left, middle = x + column * grid.resolution, y + (row + 0.5) * grid.resolution
    return np.stack([left, middle, left + grid.resolution, middle], axis=1)
