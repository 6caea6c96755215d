"""Cells as line segments."""

import numpy as np

from tfg_drake.grid.frontier import cell_sides, row_runs
from tfg_drake.messages import GridMap

GRID = GridMap(0, 0.0, 0.5, np.array([10.0, 20.0]), np.full((3, 4), 0.5, dtype=np.float32))


def test_runs_join_neighbours_in_a_row_from_centre_to_centre():
    which = np.array([[1, 1, 0, 1], [0, 0, 0, 0], [1, 1, 1, 1]], dtype=bool)
    expected = [[10.25, 20.25, 10.75, 20.25], [11.75, 20.25, 11.75, 20.25], [10.25, 21.25, 11.75, 21.25]]
    assert np.allclose(row_runs(GRID, which), expected)


def test_sides_are_one_cell_long_and_one_a_cell():
    which = np.array([[0, 0, 0, 1], [0, 0, 0, 0], [1, 0, 0, 0]], dtype=bool)
    assert np.allclose(cell_sides(GRID, which), [[11.5, 20.25, 12.0, 20.25], [10.0, 21.25, 10.5, 21.25]])


def test_no_cell_is_no_segment():
    none = np.zeros((3, 4), dtype=bool)
    assert row_runs(GRID, none).shape == cell_sides(GRID, none).shape == (0, 4)
