"""The best tour of a known map against brute force, and against the measure that missions are judged by."""

import dataclasses
import itertools
import math

import numpy as np
import pytest

from tests.comparison.two_rooms import ROBOT, START, WALLS, cells_and_see, world
from tfg_drake.comparison.best_tour import Search, ToSee, best_tour, driven, turn_time
from tfg_drake.comparison.curves import scan_coverage, seen_from
from tfg_drake.config import ScanConfig, TagSensorConfig
from tfg_drake.geometry.distance import point_distance
from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.geometry.visibility import line_of_sight
from tfg_drake.world.world import World


def test_turns_take_as_long_as_their_ramps():
    # 90 degrees at 1.5 rad/s, reached with 3.5 rad/s^2; 0.1 rad never reaches that.
    assert turn_time(-0.5 * math.pi, ROBOT) == pytest.approx(0.5 * math.pi / 1.5 + 1.5 / 3.5)
    assert turn_time(0.1, ROBOT) == pytest.approx(2.0 * math.sqrt(0.1 / 3.5))


def test_a_straight_drive_takes_its_trapezoid():
    stamps, X_WB = driven(np.array([[0.0, 0.0], [3.0, 0.0]]), np.full(2, np.nan), 0.0, ROBOT)
    # It need not stop at the end.
    assert stamps[-1] == pytest.approx(1.0 + (3.0 - 0.25) / 0.5)
    assert X_WB[-1].tolist() == pytest.approx([3.0, 0.0, 0.0])


def test_a_drive_keeps_the_robots_limits_and_comes_by_its_points():
    points = np.array([[0.0, 0.0], [2.0, 0.0], [2.5, 0.2], [2.6, 0.6], [2.0, 3.0], [2.1, 0.0], [0.0, 0.0]])
    looks = np.array([np.nan, np.nan, np.nan, np.nan, -1.0, np.nan, 2.0])
    stamps, X_WB = driven(points, looks, 1.0, ROBOT)
    moved = np.diff(stamps) > 0.0
    dt, step = np.diff(stamps)[moved], np.hypot(*np.diff(X_WB[:, :2], axis=0).T)
    assert step[~moved].max(initial=0.0) < 1e-6
    speed, rate = step[moved] / dt, np.abs(wrap_angle(np.diff(X_WB[:, 2])))[moved] / dt
    assert speed.max() <= 0.5 + 1e-6
    assert rate.max() <= 1.5 + 1e-6
    assert dt.max() < 0.5
    # Corners are cut by 5 cm at most; a look is taken where it is to be.
    assert max(np.hypot(*(X_WB[:, :2] - p).T).min() for p in points) < 0.06
    there = np.hypot(*(X_WB[:, :2] - points[4]).T) < 1e-6
    assert np.abs(wrap_angle(X_WB[there, 2] + 1.0)).min() < 1e-6
    assert wrap_angle(X_WB[-1, 2] - 2.0) == pytest.approx(0.0, abs=1e-9)


def test_what_is_seen_is_near_ahead_and_behind_no_wall():
    rng = np.random.default_rng(1)
    points = rng.uniform([0.1, 0.1], [6.9, 3.9], (300, 2))
    poses = np.column_stack([rng.uniform([0.3, 0.3], [2.7, 3.7], (6, 2)), rng.uniform(-4.0, 4.0, 6)])
    limits = np.tile([3.0, 0.7, -1.0], (300, 1))
    first = seen_from(poses, points, np.zeros((300, 2)), limits, WALLS)
    for k, pose in enumerate(poses):
        d = points - pose[:2]
        bearing = wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - pose[2])
        expected = (np.hypot(*d.T) <= 3.0) & (np.abs(bearing) <= 0.7) & line_of_sight(WALLS, pose[:2].copy(), points)
        alone = seen_from(poses[k : k + 1], points, np.zeros((300, 2)), limits, WALLS) == 0
        np.testing.assert_array_equal(alone, expected)
        np.testing.assert_array_equal(alone[first == k], True)
        assert not alone[first > k].any()


def test_the_search_finds_the_best_of_all_orders():
    rng = np.random.default_rng(2)
    for _ in range(4):
        places = np.vstack(
            [START[:2], rng.uniform([0.4, 0.4], [2.6, 3.6], (2, 2)), [[4.0, 3.0], [6.0, 1.0], [4.2, 0.6]]]
        )
        points = rng.uniform([0.1, 0.1], [6.9, 3.9], (60, 2))
        see = ToSee(points, np.zeros((60, 2)), np.tile([2.5, 4.0, -1.0], (60, 1)), np.zeros(60, dtype=bool), 0.9)
        search = Search(places, WALLS, see, 0.0, ROBOT)
        orders = [
            [(place, -1) for place in order]
            for count in range(6)
            for order in itertools.permutations(range(1, 6), count)
        ]
        best = min(search.time(order) for order in orders if search.is_enough(order))
        found = search.best([], 40, np.random.default_rng(0))
        assert search.is_enough(found)
        assert search.time(found) <= best + 1e-6


@pytest.mark.parametrize(
    ("scan_range", "degrees", "tags"), [(10.0, 124.0, 0), (10.0, 124.0, 4), (4.0, 86.0, 0)], ids=["", "tags", "depth"]
)
def test_a_tour_sees_what_it_has_to_past_no_wall(scan_range, degrees, tags):
    scan = dataclasses.replace(ScanConfig(), range=scan_range, field_of_view=math.radians(degrees))
    one, eyes = world(tags), TagSensorConfig()
    cells, see = cells_and_see(one, scan, eyes)
    tour = best_tour(one, cells, see, ROBOT, rounds=8)
    assert tour.is_enough
    _, share = scan_coverage(tour.X_WB, see.points[~see.is_tag], WALLS, scan.range, scan.field_of_view)
    assert share[-1] >= 0.99
    for p, facing in zip(one.p_WT, one.tag_facing, strict=True):
        d = p - tour.X_WB[:, :2]
        off = np.abs(wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - tour.X_WB[:, 2]))
        aslant = np.abs(wrap_angle(np.arctan2(-d[:, 1], -d[:, 0]) - facing))
        seen = (np.hypot(*d.T) <= eyes.range) & (off <= 0.5 * eyes.field_of_view + 1e-9)
        seen &= aslant <= eyes.max_incidence + 1e-9
        assert any(line_of_sight(WALLS, tour.X_WB[k, :2].copy(), p[None])[0] for k in np.flatnonzero(seen))
    assert point_distance(tour.X_WB[:, :2].copy(), WALLS).min() >= ROBOT.radius
    assert tour.X_WB[0].tolist() == START.tolist()
    # The same once more.
    again = best_tour(one, cells, see, ROBOT, rounds=8)
    np.testing.assert_array_equal(again.X_WB, tour.X_WB)


def test_what_is_seen_from_the_start_takes_no_time():
    one = World(WALLS, np.zeros(0, dtype=int), np.zeros((0, 2)), np.zeros(0), START)
    cells, _ = cells_and_see(one, ScanConfig(), TagSensorConfig())
    see = ToSee(np.array([[2.0, 1.0]]), np.zeros((1, 2)), np.array([[5.0, 1.0, -1.0]]), np.zeros(1, dtype=bool), 0.99)
    tour = best_tour(one, cells, see, ROBOT, rounds=2)
    assert (tour.time, tour.distance, tour.is_enough) == (0.0, 0.0, True)
