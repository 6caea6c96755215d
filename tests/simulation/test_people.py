"""People who walk about: where they may be, and how they keep off the robot."""

import numpy as np
import pytest

from tfg_drake.geometry.distance import point_distance
from tfg_drake.simulation import people
from tfg_drake.simulation.people import (
    BUMP,
    COMFORT,
    NUMBERS,
    PATIENCE,
    RADIUS,
    discs_at,
    first_met,
    ground,
    step,
    way_between,
)
from tfg_drake.world.world import World, WorldError

# Two rooms, 6 x 4 m in all, and a door of 0.9 m between them.
WALLS = np.array([[0.0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0], [3, 0, 3, 2.5], [3, 3.4, 3, 4]])
WORLD = World(WALLS, np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0), np.array([1.0, 1.0, 0.0]))
ROBOT_RADIUS, PERIOD = 0.18, 0.125
TOUCHING = RADIUS + ROBOT_RADIUS
FAR = np.array([9.0, 9.0])
STANDING = np.array([1.0, 1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def floor():
    return ground(WORLD, ROBOT_RADIUS)


def walk(floor, count, steps, robot=STANDING, seed=0):
    """All places (steps, count, 2)."""
    rng = np.random.default_rng(seed)
    now = first_met(0.0, robot, rng.random((count, NUMBERS)), floor)
    places = [now.p_WP]
    for k in range(1, steps):
        now = step(now, k * PERIOD, PERIOD, robot, ROBOT_RADIUS, rng.random((count, NUMBERS)), floor)
        places.append(now.p_WP)
    return np.array(places)


def one(p_WP, way, **changes):
    """A person at p_WP (2,), 1 m/s, on its way to a place."""
    no, zero = np.zeros(1, dtype=bool), np.zeros(1)
    fields = {"standing": zero, "waited": zero, "noticed": ~no, "heedless": no} | changes
    return people.People(
        stamp=0.0, p_WP=np.array([p_WP]), v_WP=np.zeros((1, 2)), speed=np.ones(1), ways=(np.array([way]),), **fields
    )


def go_on(now, floor, robot, steps, mind=0.5):
    for k in range(1, steps + 1):
        now = step(now, k * PERIOD, PERIOD, robot, ROBOT_RADIUS, np.full((1, NUMBERS), mind), floor)
    return now


def test_they_keep_off_walls_and_come_through_the_door(floor):
    places = walk(floor, 6, 1600)
    between = np.concatenate([places[:-1] + t * np.diff(places, axis=0) for t in (0.0, 0.5)]).reshape(-1, 2)
    assert point_distance(between, WALLS).min() >= RADIUS
    assert (np.ptp(places[..., 0], axis=0) > 3.0).any()
    speeds = np.hypot(*np.diff(places, axis=0).transpose(2, 0, 1)) / PERIOD
    assert speeds.max() <= people.SPEED[1] + 1e-9
    assert 0.05 < (speeds == 0.0).mean() < 0.95


def test_the_same_numbers_make_the_same_walk(floor):
    assert (walk(floor, 2, 200, seed=3) == walk(floor, 2, 200, seed=3)).all()
    assert (walk(floor, 2, 200, seed=3) != walk(floor, 2, 200, seed=4)).any()


def test_ways_are_short_and_lead_round_walls(floor):
    way = np.vstack([[2.5, 0.5], way_between(floor, np.array([2.5, 0.5]), 0.0, FAR, 0.5)])
    place = way[-1]
    across = way_between(floor, np.array([5.0, 0.5]), 0.0, FAR, 0.5)
    assert (across[-1] == place).all()
    assert len(across) > 1
    assert np.hypot(*np.diff(way, axis=0).T).sum() < 1.3 * np.hypot(*(place - [2.5, 0.5]))


def test_ways_lead_round_the_robot_if_there_is_room(floor):
    robot = np.array([1.5, 0.8])
    direct, around = (way_between(floor, np.array([2.6, 0.8]), 0.0, p, 0.6) for p in (FAR, robot))
    assert (direct[-1] == around[-1]).all()
    lines = np.vstack([[2.6, 0.8], around])
    assert point_segment_distance_of(robot, lines) >= 0.6 - people.CELL
    # Through the door, with the robot in it, nobody comes.
    assert not len(way_between(floor, np.array([5.0, 0.8]), 0.0, np.array([3.0, 2.95]), 0.6))
    assert len(way_between(floor, np.array([5.0, 0.8]), 0.0, FAR, 0.6))


def test_who_stands_at_the_edge_of_a_door_goes_back_from_the_robot_before_it(floor):
    for p_WP in ([3.06, 2.8], [3.08, 2.76], [3.1, 2.78]):
        way = way_between(floor, np.array(p_WP), 0.0, np.array([3.53, 3.225]), TOUCHING + people.PASSING)
        assert len(way)


def point_segment_distance_of(p, polyline):
    """The least distance, m, of a point from a polyline."""
    return point_distance(p[None], np.hstack([polyline[:-1], polyline[1:]]))[0]


def test_nobody_walks_into_the_robot(floor):
    for seed in range(3):
        places = walk(floor, 6, 800, np.array([1.0, 1.0, 0.0, 0.3, 0.0]), seed)
        assert np.hypot(*(places - STANDING[:2]).transpose(2, 0, 1)).min() > TOUCHING


def test_who_has_the_robot_in_its_way_waits_and_then_walks_elsewhere(floor):
    for speed, nearest in ((0.0, people.PASSING), (0.01, COMFORT)):
        robot = np.array([1.5, 1.0, np.pi / 2, speed, 0.0])
        now = go_on(one([0.5, 1.0], [2.5, 1.0]), floor, robot, 8)
        gap = 1.5 - now.p_WP[0, 0] - TOUCHING
        assert nearest - 1e-9 <= gap < nearest + 0.13
        assert now.v_WP.tolist() == [[0.0, 0.0]]
        later = go_on(now, floor, robot, round(PATIENCE / PERIOD))
        assert (later.ways[0][-1:] != [[2.5, 1.0]]).any()


def test_whom_the_robot_has_come_near_steps_back_and_walks_on(floor):
    robot = np.array([1.5, 1.0, 0.0, 0.0, 0.0])
    start = np.array([1.5 - TOUCHING - 0.001, 1.0])
    now = go_on(one(start, [2.5, 1.0]), floor, robot, 3)
    assert 1.5 - now.p_WP[0, 0] - TOUCHING >= people.PASSING
    assert np.hypot(*(go_on(now, floor, robot, 30).p_WP[0] - start)) > 0.5


def test_nobody_steps_in_front_of_a_robot_that_drives(floor):
    robot = np.array([1.0, 1.0, 0.0, 0.5, 0.0])
    way = [1.6, 3.0]
    crossing = go_on(one([1.6, 2.0], [1.6, 0.5]), floor, robot, 16)
    assert crossing.p_WP[0, 1] - 1.0 - TOUCHING >= COMFORT - 1e-9 or not (crossing.ways[0][0] == [1.6, 0.5]).all()
    assert go_on(one([1.6, 2.0], way), floor, robot, 4).p_WP[0, 1] > 2.3


def test_who_overlooks_a_robot_that_stands_touches_it_and_no_more(floor):
    heedless = one([0.5, 1.0], [2.5, 1.0], heedless=np.ones(1, dtype=bool))
    standing = np.array([1.5, 1.0, 0.0, 0.0, 0.0])
    depths = []
    for k in range(1, 9):
        heedless = step(heedless, k * PERIOD, PERIOD, standing, ROBOT_RADIUS, np.full((1, NUMBERS), 0.5), floor)
        depths.append(TOUCHING - np.hypot(*(heedless.p_WP[0] - standing[:2])))
    assert max(depths) == pytest.approx(BUMP)
    moving = go_on(
        one([0.5, 1.0], [2.5, 1.0], heedless=np.ones(1, dtype=bool)), floor, np.array([1.5, 1.0, 0.0, 0.1, 0.0]), 8
    )
    assert 1.5 - moving.p_WP[0, 0] - TOUCHING >= COMFORT - 1e-9


def test_some_stop_to_look_at_the_robot(floor):
    new = one([0.5, 1.0], [2.5, 1.0], noticed=np.zeros(1, dtype=bool))
    robot = np.array([1.8, 1.0, 0.0, 0.3, 0.0])
    assert go_on(new, floor, robot, 1, mind=0.99).standing[0] > 1.0
    assert go_on(new, floor, robot, 1, mind=0.5).standing[0] == 0.0


def test_between_two_steps_they_walk_on(floor):
    now = go_on(one([4.0, 1.0], [5.0, 1.0]), floor, STANDING, 1)
    assert discs_at(now, 0.125 + 0.0625)[0] == pytest.approx([4.0625, 1.0, RADIUS])


def test_where_there_is_no_room_for_anybody_is_told():
    cell = 0.5 * np.array([[0.0, 0, 1, 0], [1, 0, 1, 1], [1, 1, 0, 1], [0, 1, 0, 0]])
    world = World(cell, WORLD.tag_ids, WORLD.p_WT, WORLD.tag_facing, np.array([0.25, 0.25, 0.0]))
    with pytest.raises(WorldError, match=r"reality\.people: nowhere in this world is there room"):
        ground(world, ROBOT_RADIUS)


def test_who_is_between_a_corner_and_the_robot_gets_out():
    corner = np.array([[0.0, 0, 4, 0], [4, 0, 4, 2], [4, 2, 2, 2], [2, 2, 2, 3], [2, 3, 0, 3], [0, 3, 0, 0]])
    room = ground(World(corner, WORLD.tag_ids, WORLD.p_WT, WORLD.tag_facing, WORLD.start), ROBOT_RADIUS)
    robot = np.array([2.31, 1.394, 0.0, 0.0, 0.0])
    start = np.array([1.914, 1.724])
    later = go_on(one(start, robot[:2]), room, robot, 30, mind=0.0)
    assert np.hypot(*(later.p_WP[0] - start)) > 0.5
