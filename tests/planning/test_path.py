import numpy as np
import pytest

from tests.arrays import frozen
from tests.planning.test_roadmap import ROBOT
from tfg_drake.geometry.distance import clearance
from tfg_drake.messages import LaserScan, replace
from tfg_drake.planning.path import (
    BODY,
    STRAYS,
    lines_between,
    path_is_free,
    round_corners,
    seen_past,
    shortcut,
    unmapped_obstacles,
)
from tfg_drake.planning.roadmap import in_free_space
from tfg_drake.tfg.graph import empty_map


def returns(distance, bearing=0.0, stamp=1.0):
    angles = bearing + np.linspace(-0.05, 0.05, 9)
    return LaserScan(stamp, angles, np.full(9, distance), 10.0, 0.015)


@pytest.mark.parametrize(("distance", "free", "mapped"), [(1.1, False, False), (1.5, True, False), (1.5, False, True)])
def test_a_path_is_watched_from_the_robot_on(distance, free, mapped):
    """Two metres ahead where the map has a surface that is touched, less far where it has nothing."""
    path = frozen(np.stack([np.linspace(0.0, 6.0, 61), np.zeros(61)], axis=1))
    X_MB = np.array([3.0, 0.0, 0.0])
    surface = np.array([[4.5, -0.1, 4.5, 0.1]])[: int(mapped)]
    assert path_is_free(path, returns(distance), X_MB, ROBOT.radius, surface) == free
    assert path_is_free(path, returns(2.5), X_MB, ROBOT.radius, surface)


def test_returns_of_one_obstacle_are_joined_and_those_of_mapped_walls_are_none():
    path = np.stack([np.linspace(0.0, 3.0, 31), np.zeros(31)], axis=1)
    wall = np.array([[1.0, 0.8, 2.0, 0.8]])
    angles = np.concatenate([np.linspace(-0.1, 0.1, 5), [0.49]])
    scan = LaserScan(0.0, angles, np.append(np.full(5, 1.5), 1.7), 10.0, 0.015)
    for mapped, count in ((wall, 5), (np.zeros((0, 4)), 6)):
        met = unmapped_obstacles(path, scan, np.zeros(3), ROBOT.radius, mapped)
        # Each with a body behind it.
        met, bodies = met[:count], met[count:]
        assert (bodies[:, :2] == met[:, :2]).all()
        np.testing.assert_allclose(np.hypot(*bodies[:, 2:].T) - np.hypot(*bodies[:, :2].T), BODY)
        length = np.hypot(*(met[:, 2:] - met[:, :2]).T)
        np.testing.assert_allclose(length[:4], 2 * 1.5 * np.sin(0.025), rtol=1e-6)
        assert not length[4:].any()


def test_what_the_robot_may_touch_blocks_its_path_and_is_planned_round_though_the_map_explains_it():
    """A wall beside the path that goes on a little beyond its end in the map, as far as the returns do."""
    path = np.stack([np.linspace(0.0, 3.0, 31), np.zeros(31)], axis=1)
    wall = np.array([[1.5, 0.25, 1.5, 2.0]])
    for end, free in ((0.195, True), (0.18, False), (0.17, False)):
        y = np.arange(end, 0.5, 0.006)
        scan = LaserScan(0.0, np.arctan2(y, 1.5), np.hypot(y, 1.5), 10.0, 0.015)
        assert path_is_free(path, scan, np.zeros(3), ROBOT.radius, wall) == free
        assert path_is_free(path, scan, np.zeros(3), ROBOT.radius, wall, bold=True)
        met = unmapped_obstacles(path, scan, np.zeros(3), ROBOT.radius, wall)
        np.testing.assert_allclose(met[:, 1], y[y < ROBOT.radius + STRAYS], atol=1e-9)


def test_a_shortcut_does_not_lead_through_what_was_never_seen():
    corridors = np.array(
        [[-1.0, -0.5], [3.5, -0.5], [3.5, 0.5], [-1.0, 0.5], [2.5, -0.5], [3.5, -0.5], [3.5, 4.0], [2.5, 4.0]]
    )
    tfg = replace(
        empty_map(),
        star_offsets=np.array([0, 4, 8]),
        star_vertices=corridors,
        star_centers=np.array([[0.0, 0], [3, 0]]),
    )
    short = shortcut(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0]]), tfg, np.zeros((0, 4)), 0.35, 0.0)
    assert in_free_space(np.hstack([short[:-1], short[1:]]), tfg).all()


def test_an_obstacle_is_gone_when_a_scan_sees_past_it():
    obstacles = np.array([[1.0, -0.1, 1.0, 0.1], [1.0, 2.0, 1.2, 2.2], [-1.0, 0.0, -1.0, 0.2]])
    angles = np.linspace(-1.0, 1.0, 201)
    pose = np.array([0.5, 0.0, 0.3])

    def gone(distance):
        return seen_past(obstacles, LaserScan(0.0, angles, np.full(201, distance), 10.0, 0.015), pose)[0].tolist()

    # The second is out of view, the third behind.
    assert gone(0.55) == [False] * 3
    assert gone(0.7) == gone(np.inf) == [True, False, False]
    assert gone(np.nan) == [False] * 3
    # Half of the rays still end at it.
    ranges = np.where(angles + 0.3 < 0.0, 0.5, 3.0)
    assert seen_past(obstacles, LaserScan(0.0, angles, ranges, 10.0, 0.015), pose)[0].tolist() == [False] * 3


def test_no_shortcut_leads_nearer_to_a_wall_than_the_robot_is_wide():
    # The map has a wall go on too far into a door: the robot has come through with 0.1 m to its left. A line past the
    # other side of the door must not come as near to that.
    square = np.array([[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0], [-4.0, 4.0]])
    walls = np.array([[-4.0, 1.0, -0.1, 1.0], [0.3, 1.0, 4.0, 1.0]])
    tfg = replace(empty_map(), star_offsets=np.array([0, 4]), star_vertices=square, star_centers=np.zeros((1, 2)))
    for least in (0.0, 0.23):
        short = shortcut(np.array([[2.4, 0.4], [0.0, 0.4], [0.0, 2.8]]), tfg, walls, 0.35, least)
        for line in (short, round_corners(short, walls, 0.35, least)):
            aside = np.abs(line[:-1, 0]) > 1e-9
            room = clearance(lines_between(line[:-1], line[1:])[aside], walls, 1.0)
            assert (room.min() >= 0.23) == (least > 0.0)
