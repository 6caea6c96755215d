import numpy as np
import pytest

from tfg_drake.world.world import World, WorldError, check_world, odd_tags, wall_distance


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
            make_world([[5, 5, 6, 6], [-1, 0.1, 1, 0.1]]),
            "world.start: (0, 0) is inside a wall: 0.100 m from world.walls[1], the robot's radius is 0.18 m;"
            " start further away",
        ),
    ],
)
def test_a_bad_world_is_refused_in_one_line(world, message):
    with pytest.raises(WorldError) as error:
        check_world(world, 0.18)
    assert str(error.value) == message


WALLS = [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]


@pytest.mark.parametrize("backwards", [False, True])
def test_tags_that_nobody_would_hang_so_are_told(backwards):
    """On walls that run either way: off the wall, on its line, in mid-room, and turned to the wall."""
    walls = [[x1, y1, x0, y0] if backwards else [x0, y0, x1, y1] for x0, y0, x1, y1 in WALLS]
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
