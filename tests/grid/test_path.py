import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from tfg_drake.config import RobotConfig
from tfg_drake.grid.frontier import FREE, classify
from tfg_drake.grid.path import (
    cheapest,
    find_ways,
    path_in_grid_is_free,
    path_in_scan_is_free,
    plan_path,
    room_needed,
    with_returns,
)
from tfg_drake.messages import GridMap, LaserScan

ROBOT = RobotConfig()
RES = 0.05


def room(width=4.0, height=3.0, boxes=()):
    """A grid, free inside a wall, with occupied boxes x0, y0, x1, y1, m; its corner is the origin."""
    probability = np.full((round(height / RES), round(width / RES)), 0.1, dtype=np.float32)
    probability[[0, -1]] = probability[:, [0, -1]] = 0.9
    for x0, y0, x1, y1 in boxes:
        probability[round(y0 / RES) : round(y1 / RES), round(x0 / RES) : round(x1 / RES)] = 0.9
    return GridMap(1, 0.0, RES, np.zeros(2), probability)


def planned(grid, start, goal):
    start, goal = np.array(start), np.array(goal)
    return plan_path(grid, find_ways(grid, start, ROBOT), start, goal)


def room_along(grid, points):
    """Distance (m) of a finely sampled polyline to the nearest occupied cell's side, as the planner counts it."""
    distance = RES * (ndimage.distance_transform_edt(grid.probability < 0.5) - 0.5)
    along = np.linspace(points[:-1], points[1:], 8).reshape(-1, 2)
    return ndimage.map_coordinates(distance, (along / RES - 0.5)[:, ::-1].T, order=1).min()


def settle(traversable, weight, source):
    """Costs by relaxing all cells until nothing changes."""
    cost = np.full(traversable.shape, np.inf)
    cost[source] = 0.0
    while True:
        before = cost.copy()
        for i, j in np.argwhere(traversable):
            for a in range(max(i - 1, 0), min(i + 2, len(cost))):
                for b in range(max(j - 1, 0), min(j + 2, cost.shape[1])):
                    if traversable[a, b] and traversable[a, j] and traversable[i, b]:
                        step = np.hypot(a - i, b - j) * 0.5 * (weight[a, b] + weight[i, j])
                        cost[i, j] = min(cost[i, j], cost[a, b] + step)
        if (cost == before).all():
            return cost


@settings(max_examples=20)
@given(st.integers(0, 10000))
def test_costs_are_those_of_relaxation(seed):
    rng = np.random.default_rng(seed)
    traversable, weight = rng.random((6, 8)) < 0.7, rng.uniform(1.0, 3.0, (6, 8))
    traversable[2, 3] = True
    cost, length, before = cheapest(traversable, weight, np.array([2 * 8 + 3]), np.zeros(1), np.zeros(1))
    np.testing.assert_allclose(cost, settle(traversable, weight, (2, 3)))
    assert (np.isfinite(length) == np.isfinite(cost)).all()
    assert ((before >= 0) == (np.isfinite(cost) & (cost > 0.0))).all()


def test_the_length_of_a_straight_way():
    ways = find_ways(room(), np.array([0.525, 1.525]), ROBOT)
    assert ways.length[30, 60] == pytest.approx(50 * RES)
    assert not ways.reachable[3, 3]


@settings(max_examples=30)
@given(st.integers(0, 10000))
def test_a_path_keeps_its_distance_from_whatever_is_occupied(seed):
    rng = np.random.default_rng(seed)
    low = rng.uniform(0.3, 3.0, (8, 2))
    grid = room(boxes=np.hstack([low, low + rng.uniform(0.05, 0.5, (8, 2))]).clip(0.0, 2.95))
    roomy = np.argwhere(find_ways(grid, np.array([0.3, 0.3]), ROBOT).room >= room_needed(ROBOT))
    start = (roomy[rng.integers(len(roomy))][::-1] + 0.5) * RES
    ways = find_ways(grid, start, ROBOT)
    row, column = rng.permutation(np.argwhere(ways.reachable))[0]
    goal = (np.array([column, row]) + 0.5) * RES
    points = plan_path(grid, ways, start, goal)
    if len(points):
        np.testing.assert_allclose(points[[0, -1]], [start, goal], atol=1e-9)
        assert np.hypot(*np.diff(points, axis=0).T).max() <= 0.1 + 1e-9
        # Between the points of the rounded way the path is straight.
        assert room_along(grid, points) >= room_needed(ROBOT) - 0.035
        assert (classify(grid)[tuple((points / RES).astype(int)[:, ::-1].T)] == FREE).all()
        assert path_in_grid_is_free(points, grid, start, ROBOT)


def test_a_path_in_the_open_is_straight():
    points = planned(room(8.0, 8.0), [1.525, 1.525], [6.025, 4.525])
    assert np.hypot(*np.diff(points, axis=0).T).sum() == pytest.approx(np.hypot(4.5, 3.0), rel=1e-6)


def test_no_path_through_a_gap_that_is_too_narrow_nor_into_the_unknown():
    wall = [(2.0, 0.0, 2.1, 1.3), (2.0, 1.7, 2.1, 3.0)]
    assert len(planned(room(boxes=wall), [1.0, 1.5], [3.0, 1.5])) == 0
    wide = [(2.0, 0.0, 2.1, 1.2), (2.0, 1.75, 2.1, 3.0)]
    assert len(planned(room(boxes=wide), [1.0, 1.5], [3.0, 1.5])) > 0
    probability = room().probability.copy()
    probability[:, 40:42] = 0.5
    assert len(planned(GridMap(1, 0.0, RES, np.zeros(2), probability), [1.0, 1.5], [3.0, 1.5])) == 0


def test_a_robot_without_room_drives_straight_out_first():
    grid, start = room(), np.array([0.17, 1.52])
    ways = find_ways(grid, start, ROBOT)
    points = plan_path(grid, ways, start, np.array([3.0, 1.5]))
    np.testing.assert_array_equal(points[0], start)
    # Never nearer to the wall than it was.
    assert points[:, 0].min() == start[0]
    assert path_in_grid_is_free(points, grid, start, ROBOT)
    # Even from within a wall there is a way.
    assert len(planned(grid, [0.02, 1.5], [3.0, 1.5])) > 0
    assert len(planned(room(0.4, 3.0), [0.2, 1.5], [0.2, 2.0])) == 0


def test_no_path_to_where_the_robot_is():
    assert planned(room(), [1.51, 1.51], [1.52, 1.52]).shape in ((0, 2), (2, 2))


def test_a_newer_grid_blocks_what_is_left_of_the_path_only():
    points = planned(room(), [0.5, 1.525], [3.5, 1.525])
    later = room(boxes=[(2.0, 1.5, 2.1, 1.6)])
    assert path_in_grid_is_free(points, room(), np.array([1.0, 1.5]), ROBOT)
    assert not path_in_grid_is_free(points, later, np.array([1.0, 1.5]), ROBOT)
    assert path_in_grid_is_free(points, later, np.array([3.0, 1.5]), ROBOT)
    assert path_in_grid_is_free(np.zeros((0, 2)), later, np.array([3.0, 1.5]), ROBOT)


def test_what_the_scan_meets_blocks_the_path_and_the_next_leads_round_it():
    grid, X_MB = room(), np.array([1.0, 1.525, 0.0])
    points = planned(grid, X_MB[:2], [3.5, 1.525])
    angles = np.array([-0.05, 0.0, 0.05])
    empty = LaserScan(0.0, angles, np.full(3, np.inf), 10.0, 0.01)
    met = LaserScan(0.0, angles, np.full(3, 1.0), 10.0, 0.01)
    assert path_in_scan_is_free(points, grid, empty, X_MB, ROBOT)
    assert not path_in_scan_is_free(points, grid, met, X_MB, ROBOT)
    marked = with_returns(grid, met, X_MB)
    assert (marked.probability != grid.probability).sum() == 3
    assert path_in_scan_is_free(planned(marked, X_MB[:2], [3.5, 1.525]), grid, met, X_MB, ROBOT)
