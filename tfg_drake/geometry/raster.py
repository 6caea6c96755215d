"""Polygons and segments drawn on the cells of a grid. All are in cells, from the grid's lowest corner; what lies beyond
the grid is left out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tfg_drake.messages import FloatArray


def fill_polygon(cells: NDArray[Any], corners: FloatArray, value: int) -> None:
    """Gives a value to the cells (rows, columns) whose centres are in a polygon (n, 2): an odd number of its sides is
    to their left."""
    if len(corners) < 3:
        return
    size = cells.shape[::-1]
    low = np.clip(np.floor(corners.min(axis=0)).astype(int), 0, size)
    high = np.clip(np.ceil(corners.max(axis=0)).astype(int), 0, size)
    (x0, y0), (x1, y1) = corners.T, np.roll(corners, -1, axis=0).T
    rows = np.arange(low[1], high[1])
    y = rows[:, None] + 0.5
    row, side = np.nonzero((y0 > y) != (y1 > y))
    x = x0[side] + (y[row, 0] - y0[side]) / (y1 - y0)[side] * (x1 - x0)[side]
    # The first cell whose centre is to the right of the side.
    column = np.ceil(x - 0.5).astype(int) - low[0]
    sides = np.zeros((len(rows), high[0] - low[0] + 1), dtype=np.int64)
    np.add.at(sides, (row, np.clip(column, 0, sides.shape[1] - 1)), 1)
    inside = np.cumsum(sides, axis=1)[:, :-1] % 2 == 1
    cells[low[1] : high[1], low[0] : high[0]][inside] = value


def draw_segments(cells: NDArray[Any], segments: FloatArray, value: int) -> None:
    """Gives a value to the cells (rows, columns) that segments (m, 4) run through."""
    start, along = segments[:, :2], segments[:, 2:] - segments[:, :2]
    # Four points a cell: what a segment only clips at a corner may be left out.
    n = np.ceil(4.0 * np.hypot(*along.T)).astype(int) + 1
    owner = np.repeat(np.arange(len(segments)), n)
    share = (np.arange(len(owner)) - np.repeat(np.cumsum(n) - n, n)) / np.maximum(n - 1, 1)[owner]
    places = np.floor(start[owner] + share[:, None] * along[owner]).astype(int)
    column, row = places[((places >= 0) & (places < cells.shape[::-1])).all(axis=1)].T
    cells[row, column] = value
