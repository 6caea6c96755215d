"""The frontiers of an occupancy grid: where what is known to be free ends at what was never measured.

Definitions of Yamauchi (CIRA 1997): a cell is free, occupied or unknown as its probability lies below, above or at the
prior; free cells next to unknown ones, joined to their neighbours, are a frontier. They are looked for where a wave of
free cells from the robot arrives (wavefront frontier detection, Keidar and Kaminka, IJRR 2014): what was seen of the
outside through a spurious gap, or lies behind a wall, is none. For pictures and metrics that know only segments, cells
become some.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tfg_drake.messages import BoolArray, FloatArray, GridMap, IntArray

# A cell's probability within DECIDED of PRIOR is undecided.
PRIOR, DECIDED = 0.5, 0.05
# States of a cell.
UNKNOWN, FREE, OCCUPIED = 0, 1, 2

CellArray = NDArray[np.uint8]


def classify(grid: GridMap) -> CellArray:
    """The class of each cell (h, w): UNKNOWN, FREE or OCCUPIED."""
    cells = np.full(grid.probability.shape, UNKNOWN, dtype=np.uint8)
    cells[grid.probability < PRIOR - DECIDED] = FREE
    cells[grid.probability > PRIOR + DECIDED] = OCCUPIED
    return cells


def cell_at(grid: GridMap, points: FloatArray) -> IntArray:
    """Row and column (..., 2) of the cells that hold points (..., 2), m in M; those outside are the nearest inside."""
    column_row = np.floor((points - grid.origin) / grid.resolution).astype(np.int64)
    return np.clip(column_row[..., ::-1], 0, np.array(grid.probability.shape) - 1)


def center_of(grid: GridMap, cells: IntArray) -> FloatArray:
    """The centres (..., 2), m in M, of cells (..., 2), rows and columns."""
    return np.asarray(grid.origin + (cells[..., ::-1] + 0.5) * grid.resolution)


def next_to_unknown(cells: CellArray) -> BoolArray:
    """Which cells (h, w) are free and share a side with an unknown one. Beyond the grid nothing can be explored."""
    unknown = np.pad(cells == UNKNOWN, 1)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    return np.asarray((cells == FREE) & beside)


def _wave_from(cells: CellArray, row: int, column: int) -> BoolArray:
    """The wave's cells (h, w) from the free cell nearest to the robot's: the map may have moved under it."""
    free: BoolArray = cells == FREE
    if not free[row, column]:
        where = np.argwhere(free)
        if len(where) == 0:
            return free
        row, column = where[np.argmin(((where - (row, column)) ** 2).sum(axis=1))]
    # Over sides of cells: at corners a wave would leak.
    label, _ = ndimage.label(free)
    return np.asarray(label == label[row, column])


def find_frontiers(grid: GridMap, cells: CellArray, p_MB: FloatArray, least_length: float) -> tuple[IntArray, IntArray]:
    """The frontiers of a grid and its cells (h, w) (see classify) round a robot at p_MB (2,), m in M: rows and columns
    (f, 2) of all their cells, and which frontier each belongs to, (f,) ascending.

    Cells that touch, be it at a corner, are one frontier; those shorter than least_length (m), a side for each cell,
    are left out.
    """
    edge = next_to_unknown(cells)
    edge &= _wave_from(cells, *cell_at(grid, p_MB))
    label, _ = ndimage.label(edge, structure=np.ones((3, 3)))
    where, of = np.argwhere(edge), label[edge]
    order = np.argsort(of, kind="stable")
    order = order[grid.resolution * np.bincount(of)[of[order]] >= least_length]
    return where[order], of[order]


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
