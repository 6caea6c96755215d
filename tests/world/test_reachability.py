import numpy as np
import pytest
from shapely.geometry import LineString, Point

from tfg_drake.world.reachability import (
    CELL,
    cut_walls,
    free_cells,
    make_grid,
    reachable_cells,
    reachable_faces,
    reachable_tags,
    second_faces,
)
from tfg_drake.world.world import World

ROBOT_RADIUS = 0.18
# A room of 6 x 4 m, a wall across it at x = 4 with a door from y = 1 to 2, and a sealed closet in its upper right.
ROOM = [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0], [4, 0, 4, 1], [4, 2, 4, 4], [4, 2.5, 6, 2.5]]


def make_world(walls=ROOM, positions=(), facing=(), start=(1.0, 2.0, 0.0)) -> World:
    return World(
        walls=np.array(walls, dtype=float).reshape(-1, 4),
        tag_ids=np.arange(len(positions)),
        p_WT=np.array(positions, dtype=float).reshape(-1, 2),
        tag_facing=np.array(facing, dtype=float),
        start=np.array(start, dtype=float),
    )


def test_free_cells_agree_with_shapely():
    random = np.random.default_rng(1)
    walls = random.uniform(-1.0, 1.0, (12, 4))
    grid = make_grid(make_world(walls, start=(0, 0, 0)))
    free = free_cells(grid, walls, 0.2)
    centers = grid.centers(np.ones(grid.shape, dtype=bool))
    lines = [LineString(w.reshape(2, 2)) for w in walls]
    for k in random.integers(len(centers), size=300):
        distance = min(line.distance(Point(centers[k])) for line in lines)
        assert free.ravel()[k] == (distance >= 0.2)


def test_the_cell_of_a_centre_is_its_own():
    grid = make_grid(make_world())
    mask = np.ones(grid.shape, dtype=bool)
    row, column = grid.cell(grid.centers(mask))
    np.testing.assert_array_equal(row * grid.shape[1] + column, np.arange(mask.size))


def test_reachable_cells_pass_the_door_and_not_the_closet():
    world = make_world()
    grid = make_grid(world)
    centers = grid.centers(reachable_cells(grid, world, ROBOT_RADIUS))
    assert np.hypot(*(centers - [5.0, 1.0]).T).min() < CELL
    assert np.hypot(*(centers - [5.0, 3.2]).T).min() > 0.5
    inside = (centers > 0.23 - 1e-9).all(axis=1) & (centers < np.array([6, 4]) - 0.23 + 1e-9).all(axis=1)
    assert inside.all()
    assert len(centers) * CELL**2 == pytest.approx(3.54 * 3.54 + 1.54 * 2.04 + 0.46 * 0.54, rel=0.05)


def test_a_door_narrower_than_the_robot_is_closed():
    world = make_world([*ROOM[:4], [4, 0, 4, 1], [4, 1.4, 4, 4]])
    grid = make_grid(world)
    assert grid.centers(reachable_cells(grid, world, ROBOT_RADIUS))[:, 0].max() < 4.0


def test_a_start_in_the_margin_counts_from_the_nearest_cell_and_a_pocket_reaches_nothing():
    tight = make_world(start=(0.19, 2.0, 0.0))
    grid = make_grid(tight)
    assert reachable_cells(grid, tight, ROBOT_RADIUS).sum() > 1000
    pocket = make_world([[0, 0, 0.4, 0], [0.4, 0, 0.4, 0.4], [0.4, 0.4, 0, 0.4], [0, 0.4, 0, 0]], start=(0.2, 0.2, 0))
    assert not reachable_cells(make_grid(pocket), pocket, ROBOT_RADIUS).any()


def test_reachable_tags():
    positions = [[0.01, 2.0], [5.99, 1.0], [5.0, 2.51], [3.99, 3.0], [4.01, 3.0], [-0.01, 2.0]]
    facing = [0.0, np.pi, 0.5 * np.pi, np.pi, 0.0, np.pi]
    world = make_world(positions=positions, facing=facing)
    grid = make_grid(world)
    reachable = reachable_cells(grid, world, ROBOT_RADIUS)
    seen = reachable_tags(world, grid, reachable, 10.0, np.deg2rad(75))
    # In the closet, on the closet's face of a wall, and outside: never seen.
    np.testing.assert_array_equal(seen, [True, True, False, True, False, False])
    assert not reachable_tags(world, grid, reachable, 0.1, np.deg2rad(75)).any()


def test_incidence_decides():
    # A tag that looks along its wall at a corridor's end is out of incidence for every cell.
    world = make_world(positions=[[0.01, 2.0], [2.0, 0.01]], facing=[np.pi, 0.5 * np.pi])
    grid = make_grid(world)
    seen = reachable_tags(world, grid, reachable_cells(grid, world, ROBOT_RADIUS), 10.0, np.deg2rad(75))
    np.testing.assert_array_equal(seen, [False, True])


def test_reachable_surface():
    world = make_world()
    grid = make_grid(world)
    faces, normals = reachable_faces(world, grid, reachable_cells(grid, world, ROBOT_RADIUS), 10.0)
    surface = faces[~second_faces(faces, normals)]
    # All but the closet's outer faces: 2 m of the top wall, 1.5 m of the right one.
    assert len(surface) * 0.05 == pytest.approx(20 - 3.5 + 3 + 2, abs=0.2)
    assert not ((surface[:, 0] > 4.1) & (surface[:, 1] > 2.6)).any()


def test_both_faces_of_a_thin_wall_count_where_both_can_be_seen():
    """A room of 4 x 3 m in two by a wall without thickness and with a door, and a closet that nobody can look into."""
    world = make_world(
        [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0], [2, 1, 2, 3], [4, 1, 3, 1], [3, 1, 3, 0]]
    )
    grid = make_grid(world)
    points, normals = reachable_faces(world, grid, reachable_cells(grid, world, ROBOT_RADIUS), 10.0)
    on_wall = (abs(points - [2, 2]) < [0.1, 2]).all(axis=1)
    for side in (1.0, -1.0):
        assert 0.05 * np.sum(on_wall & (normals == [side, 0.0]).all(axis=1)) == pytest.approx(2.0)
    # Of the closet its outer faces alone: 1 m each.
    assert 0.05 * np.sum((abs(points - [3.5, 1]) < [0.5, 0.01]).all(axis=1)) == pytest.approx(1.0)
    assert 0.05 * len(points) == pytest.approx(14.0 - 2.0 + 2.0 * 2.0 + 2.0)


def test_two_faces_of_a_thick_wall_count_once():
    points = np.array([[0.025, 0.0], [0.075, 0.0], [0.025, 0.2], [0.075, 0.3], [0.0, 0.1]])
    normals = np.array([[0.0, 1.0], [0.0, 1.0], [0.0, -1.0], [0.0, 1.0], [1.0, 0.0]])
    np.testing.assert_array_equal(second_faces(points, normals), [False, False, True, False, False])


def test_cut_walls():
    points, normals = cut_walls(np.array([[0.0, 0.0, 0.2, 0.0], [1.0, 0.0, 1.0, 0.06]]))
    expected = [[0.025, 0], [0.075, 0], [0.125, 0], [0.175, 0], [1, 0.015], [1, 0.045]]
    np.testing.assert_allclose(points, expected, atol=1e-12)
    np.testing.assert_allclose(normals, [[0, 1]] * 4 + [[-1, 0]] * 2, atol=1e-12)
    assert cut_walls(np.zeros((0, 4)))[0].shape == (0, 2)


def test_a_world_without_walls_is_a_square_round_the_start():
    world = make_world([], start=(3.0, 4.0, 0.0))
    grid = make_grid(world)
    reachable = reachable_cells(grid, world, ROBOT_RADIUS)
    assert reachable.all()
    assert [part.shape for part in reachable_faces(world, grid, reachable, 10.0)] == [(0, 2), (0, 2)]
    assert reachable_tags(world, grid, reachable, 10.0, 1.0).shape == (0,)
