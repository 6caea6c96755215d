import itertools
import re

import numpy as np
import pytest
import shapely

from tfg_drake.world.world import World, WorldError, check_world, odd_tags, wall_distance

RING = [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]


def make_world(walls=(), ids=(), positions=(), facing=(), start=(0.0, 0.0, 0.0)) -> World:
    return World(
        walls=np.array(walls, dtype=float).reshape(-1, 4),
        tag_ids=np.array(ids, dtype=np.int64),
        p_WT=np.array(positions, dtype=float).reshape(-1, 2),
        tag_facing=np.array(facing, dtype=float),
        start=np.array(start, dtype=float),
    )


def test_an_empty_world_is_valid():
    check_world(make_world(), 0.18)


def test_a_world_is_read_only():
    with pytest.raises(ValueError, match="read-only"):
        make_world([[1, 0, 2, 0]]).walls[0, 0] = 5.0


def test_distance_to_walls():
    walls = np.array([[0.0, 1.0, 2.0, 1.0], [3.0, 4.0, 3.0, 9.0], [1.0, 1.0, 1.0, 1.0]])
    np.testing.assert_allclose(wall_distance(np.array([1.0, 0.0]), walls), [1.0, np.hypot(2, 4), 1.0])


@pytest.mark.parametrize(
    ("world", "message"),
    [
        (
            make_world([[0, 1, 1, 1], [0, 2, np.nan, 2]]),
            "world.walls[1]: a coordinate is not a finite number; write [x0, y0, x1, y1] in metres",
        ),
        (make_world([[1, 2, 1, 2]]), "world.walls[0]: zero length at (1, 2); remove the wall"),
        (
            make_world(ids=[7, 8, 7], positions=[[0, 0]] * 3, facing=[0, 0, 0]),
            "world.tags[2].id: 7 is taken by world.tags[0]; give each tag an id",
        ),
        (
            make_world(ids=[7], positions=[[0, 0]], facing=[np.inf]),
            "world.tags[0]: position or facing is not a finite number; write metres and radians",
        ),
        (
            make_world(start=[0, np.nan, 0]),
            "world.start: not a finite number; write [x, y, yaw] in metres and radians",
        ),
        (
            make_world([[0, 0, 10, 0], [10, 0, 10, 8]], start=[5, 18.1, 0]),
            "world.start: (5, 18.1) is far from the walls, which reach from (0, 0) to (10, 8); start between them",
        ),
        (
            make_world([[5, -5, 6, 6], [-1, 0.1, 1, 0.1]]),
            "world.start: (0, 0) is too near to the wall from (-1, 0.1) to (1, 0.1): 0.100 m, the robot's radius is"
            " 0.18 m; start at (0, -0.2), the nearest free place",
        ),
        (
            make_world([[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]),
            "world.start: (0, 0) is too near to the wall from (0, 0) to (6, 0): 0.000 m, the robot's radius is 0.18 m;"
            " start at (0.3, 0.3), the nearest free place",
        ),
        (
            make_world([[x, -5, x, 5] for x in np.arange(-5, 5, 0.3)]),
            "world.start: (0, 0) is too near to the wall from (0.1, -5) to (0.1, 5): 0.100 m, the robot's radius is"
            " 0.18 m; start farther away",
        ),
        (
            # In a sofa.
            make_world([*RING, [1, 1, 3, 1], [3, 1, 3, 1.8], [3, 1.8, 1, 1.8], [1, 1.8, 1, 1]], start=[1.1, 1.3, 0]),
            "world.start: (1.1, 1.3) is too near to the wall from (1, 1.8) to (1, 1): 0.100 m, the robot's radius is"
            " 0.18 m; start at (1.1, 0.7), the nearest free place",
        ),
    ],
)
def test_a_bad_world_is_refused_in_one_line(world, message):
    with pytest.raises(WorldError) as error:
        check_world(world, 0.18)
    assert str(error.value) == message


def test_the_place_that_is_named_is_the_nearest_free_one_on_this_side():
    """Two rooms, from places near their walls, against shapely and every place of the lattice."""
    rng = np.random.default_rng(5)
    walls = np.array([[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0], [3, 0, 3, 3], [1, 2, 2, 2]], dtype=float)
    lines = shapely.MultiLineString(walls.reshape(-1, 2, 2).tolist())
    lattice = [shapely.Point(0.1 * i, 0.1 * j) for i, j in itertools.product(range(-20, 81), range(-20, 61))]
    free = [p for p in lattice if p.distance(lines) > 0.279]
    for _ in range(20):
        wall, along = walls[rng.integers(len(walls))], rng.uniform(0.1, 0.9)
        start = wall[:2] + along * (wall[2:] - wall[:2]) + rng.uniform(0.02, 0.1, size=2)
        with pytest.raises(WorldError) as error:
            check_world(make_world(walls, start=[*start, 0]), 0.18)
        x, y = map(float, re.search(r"; start at \((.*), (.*)\), the nearest free place$", str(error.value)).groups())
        check_world(make_world(walls, start=[x, y, 0]), 0.18)
        in_sight = [p for p in free if not shapely.LineString([start, (p.x, p.y)]).intersects(lines)]
        least = min(p.distance(shapely.Point(start)) for p in in_sight)
        assert np.hypot(x - start[0], y - start[1]) == pytest.approx(least, abs=1e-6)
        assert not shapely.LineString([start, (x, y)]).intersects(lines)


@pytest.mark.parametrize("backwards", [False, True])
def test_tags_that_nobody_would_hang_so_are_told(backwards):
    """On walls that run either way: off the wall, on its line, in mid-room, and turned to the wall."""
    walls = [[x1, y1, x0, y0] if backwards else [x0, y0, x1, y1] for x0, y0, x1, y1 in RING]
    up = 0.5 * np.pi
    good = {1: (2, 0.01, up), 2: (3, 0, up), 3: (5.99, 2, -2 * up), 4: (5.95, 3.99, -up), 5: (4, 0.05, 0.3)}
    bad = {11: (3, 2, 0), 12: (1, 1, up), 21: (2, 0.01, -up), 22: (0.01, 2, 2 * up)}
    rows = np.array([*good.values(), *bad.values()])
    ids = [*good, *bad]
    assert odd_tags(make_world(walls, ids, rows[:, :2], rows[:, 2])) == (
        "tags that hang on no wall: 11, 12; is this meant?",
        "tags that face into their wall, where nobody sees them: 21, 22; is this meant?",
    )
    assert odd_tags(make_world(walls, list(good), rows[:5, :2], rows[:5, 2])) == ()
    assert odd_tags(make_world([], [1], [[0, 0]], [0])) == ()
