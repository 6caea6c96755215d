import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.geometry.segment_grid import CELL, MOST_CELLS, rows_in_box, segment_grid

SEEDS = st.integers(0, 2**32 - 1)


def found(grid, left, low, right, high):
    """The segments in the cells that meet a box."""
    rows = np.empty(len(grid[-1]), dtype=np.int64)
    return set(rows[: rows_in_box(grid, left, right, low, high, rows)].tolist())


@given(seed=SEEDS)
def test_a_box_finds_all_segments_whose_own_box_meets_it(seed):
    rng = np.random.default_rng(seed)
    start = rng.uniform(-6.0, 6.0, (30, 2))
    segments = np.hstack([start, start + rng.normal(0.0, 1.5, (30, 2))])
    grid = segment_grid(segments)
    for _ in range(10):
        centre, half = rng.uniform(-12.0, 12.0, 2), rng.uniform(0.0, 4.0, 2)
        (left, low), (right, high) = centre - half, centre + half
        x, y = np.sort(segments[:, [0, 2]], axis=1), np.sort(segments[:, [1, 3]], axis=1)
        meets = (x[:, 0] <= right) & (x[:, 1] >= left) & (y[:, 0] <= high) & (y[:, 1] >= low)
        assert set(np.flatnonzero(meets).tolist()) <= found(grid, left, low, right, high)
    assert found(grid, -np.inf, -np.inf, np.inf, np.inf) == set(range(30))


def test_places_off_the_grid_find_nothing():
    grid = segment_grid(np.array([[0.0, 0.0, 3.0, 1.0]]))
    for box in ((50.0, 0.0, 51.0, 1.0), (0.0, 50.0, 1.0, 51.0), (-9.0, 0.0, -8.0, 1.0), (0.0, -1e300, 1.0, -1e299)):
        assert found(grid, *box) == set()


def test_no_segments_make_one_empty_cell():
    assert found(segment_grid(np.zeros((0, 4))), -np.inf, -np.inf, np.inf, np.inf) == set()


def test_cells_grow_with_the_extent():
    frame, columns, rows, _, _ = segment_grid(np.array([[0.0, 0.0, 1.0, 0.0], [1e6, 1e6, 1e6 + 1.0, 1e6]]))
    assert frame[2] > CELL
    assert columns * rows <= MOST_CELLS
