"""Occupancy grids in shared tiles: rays against brute force, sharing, growth."""

import math

import numpy as np
import pytest

from tfg_drake.grid.occupancy import (
    HIT,
    LIMIT,
    PASS,
    empty_maps,
    grown,
    insert_scan,
    log_odds,
    mark_scan,
    probability,
    surface_points,
)
from tfg_drake.messages import LaserScan


def scan(angles, ranges, range_max=10.0):
    return LaserScan(0.0, np.array(angles, dtype=float), np.array(ranges, dtype=float), range_max, 0.01)


def value(maps, particle, x, y):
    origin, steps = log_odds(maps, particle)
    j, i = np.floor((np.array([x, y]) - origin) / maps.resolution).astype(int)
    return int(steps[i, j])


@pytest.mark.parametrize("seed", range(100))
def test_a_ray_meets_the_cells_that_its_points_lie_in(seed):
    # Nowhere near the border of cells, where rounding decides.
    x, y, theta, length, resolution = np.random.default_rng(seed).uniform(
        [2.0, 2.0, -math.pi, 0.01, 0.02], [3.0, 3.0, math.pi, 1.9, 0.2]
    )
    cells = np.zeros((int(6.0 / resolution),) * 2, dtype=np.uint8)
    mark_scan(cells, x, y, theta, np.zeros(1), np.array([length]), 10.0, resolution)
    along = np.linspace(0.0, length, 40_001)
    j = np.floor((x + along * np.cos(theta)) / resolution).astype(int)
    i = np.floor((y + along * np.sin(theta)) / resolution).astype(int)
    brute = np.zeros_like(cells)
    brute[i, j] = 1
    assert not np.any((brute == 1) & (cells == 0))
    # The points may miss a cell whose corner the ray cuts.
    assert np.sum(cells) <= np.sum(brute) + 2
    assert np.sum(cells) == 1 + abs(j[-1] - j[0]) + abs(i[-1] - i[0])


def test_one_ray_frees_its_way_and_fills_its_end():
    maps = insert_scan(empty_maps(1, 0.1), np.zeros(1, dtype=int), np.array([[0.05, 0.05, 0.0]]), scan([0.0], [1.0]))
    assert [value(maps, 0, 0.1 * k + 0.05, 0.05) for k in range(12)] == [PASS] * 10 + [HIT, 0]
    _, steps = log_odds(maps, 0)
    assert np.count_nonzero(steps) == 11


@pytest.mark.parametrize("far", [math.inf, 2.5])
def test_a_ray_without_a_return_is_free_up_to_the_greatest_range(far):
    maps = insert_scan(
        empty_maps(1, 0.1), np.zeros(1, dtype=int), np.array([[0.05, 0.05, 0.0]]), scan([0.0], [far], 1.0)
    )
    _, steps = log_odds(maps, 0)
    assert sorted(set(steps.ravel().tolist())) == [PASS, 0]
    assert np.count_nonzero(steps) == 11


def test_what_says_nothing_changes_nothing():
    maps = insert_scan(
        empty_maps(2, 0.1), np.arange(2), np.zeros((2, 3)), scan([0.0, 0.1, 0.2, 0.3], [np.nan, 0.0, -1.0, -np.inf])
    )
    assert not log_odds(maps, 0)[1].any()


def test_log_odds_are_bounded_and_never_look_unmeasured():
    maps, seen = empty_maps(1, 0.1), set()
    for k in range(60):
        one = scan([0.0], [1.0 if k < 20 or k % 2 else 2.0])
        maps = insert_scan(maps, np.zeros(1, dtype=int), np.array([[0.05, 0.05, 0.0]]), one)
        seen |= {value(maps, 0, 1.05, 0.05), value(maps, 0, 0.55, 0.05)}
    assert max(seen) == LIMIT
    assert min(seen) == -LIMIT
    assert 0 not in seen


def test_probabilities():
    p = probability(np.array([[0, HIT, PASS]], dtype=np.int8))
    np.testing.assert_allclose(p, [[0.5, 1 / (1 + math.exp(-0.9)), 1 / (1 + math.exp(0.4))]], rtol=1e-6)


def test_children_of_one_parent_share_its_tiles_and_old_maps_stay():
    rng = np.random.default_rng(0)
    one = scan(np.linspace(-1, 1, 50), np.full(50, 3.0))
    poses = rng.normal(size=(4, 3))
    first = insert_scan(empty_maps(4, 0.05), np.arange(4), poses, one)
    before = [log_odds(first, p)[1].copy() for p in range(4)]
    second = insert_scan(first, np.array([1, 1, 1, 3]), poses + 0.1, one)
    np.testing.assert_array_equal(second.table[0], second.table[2])
    assert not np.array_equal(second.table[0], second.table[3])
    for p in range(4):
        np.testing.assert_array_equal(log_odds(first, p)[1], before[p])
    # Every tile of the pool is somebody's.
    assert set(np.unique(second.table)) | {0} == set(range(len(second.tiles)))
    with pytest.raises(ValueError, match="read-only"):
        second.tiles[0, 0, 0, 0] = 1


def test_tiles_shared_or_not_the_map_is_that_of_one_particle_alone():
    rng = np.random.default_rng(1)
    poses = rng.normal(size=(3, 5, 3))
    scans = [scan(np.linspace(-1, 1, 40), rng.uniform(0.5, 4.0, 40)) for _ in range(3)]
    parents = [np.arange(5), np.array([0, 0, 2, 2, 2]), np.array([1, 2, 2, 3, 4])]
    together, rows = empty_maps(5, 0.05), np.arange(5)
    for X, one, origin in zip(poses, scans, parents, strict=True):
        together = insert_scan(together, origin, X, one)
    for p in range(5):
        rows = [p]
        for origin in parents[::-1]:
            rows.append(int(origin[rows[-1]]))
        alone = empty_maps(1, 0.05)
        for X, one, row in zip(poses, scans, rows[:0:-1], strict=True):
            alone = insert_scan(alone, np.zeros(1, dtype=int), X[row : row + 1], one)
        a, b = log_odds(together, p), log_odds(alone, 0)
        for origin, steps in (a, b):
            assert steps.any()
            i, j = np.nonzero(steps)
            a_cells = set(zip(i + round(origin[1] / 0.05), j + round(origin[0] / 0.05), steps[i, j], strict=True))
            if origin is a[0]:
                first = a_cells
        assert first == a_cells


def test_growing_keeps_what_is_known():
    maps = insert_scan(empty_maps(1, 0.1), np.zeros(1, dtype=int), np.zeros((1, 3)), scan([0.3], [1.0]))
    wide = grown(maps, np.array([-20.0, -3.0]), np.array([5.0, 30.0]))
    assert wide.table.shape[1] * 3.2 > 33.0
    for x, y in ((0.05, 0.05), (math.cos(0.3), math.sin(0.3)), (0.5, 0.9)):
        assert value(wide, 0, x, y) == value(maps, 0, x, y)
    assert grown(wide, np.zeros(2), np.ones(2)) is wide


def test_neighbouring_returns_are_joined_and_distant_ones_not():
    points = surface_points(np.array([0.0, 0.1, 0.2, 0.3]), np.array([2.0, 2.0, 5.0, np.inf]), 10.0, 0.05)
    assert len(points) == 3 + 3
    np.testing.assert_allclose(points[0], [2.0, 0.0])
    np.testing.assert_allclose(np.linalg.norm(np.diff(points[:5], axis=0), axis=1), 0.05, atol=1e-3)
