"""What is remembered to be free, and how far the base may drive through it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.config import ScanConfig
from tfg_drake.geometry.motion import advance
from tfg_drake.geometry.se2 import compose
from tfg_drake.messages import LaserScan, replace
from tfg_drake.safety.corridor import touch_distance
from tfg_drake.safety.seen_space import CELL, MEMORY, nothing_seen, open_distance, remembered
from tfg_drake.simulation.laser_scanner import ray_angles, scan

RADIUS, SCAN = 0.18, ScanConfig()
WALL = np.array([[1.0, -5.0, 1.0, 5.0]])


def scan_of(walls, X_WB=(0.0, 0.0, 0.0), stamp=1.0, least_range=0.0):
    scanner = ScanConfig(least_range=least_range)
    return scan(np.array(walls, dtype=float), np.array(X_WB), stamp, ray_angles(SCAN), np.zeros(249), scanner)


def open_ahead(space, X_OB=(0.0, 0.0, 0.0), newest=1.0, reach=0.6, curvature=0.0):
    return open_distance(space, np.array(X_OB), curvature, RADIUS, reach, newest)


@given(x=st.floats(0.05, 2.0), y=st.floats(-1.0, 1.0), curvature=st.floats(-4.0, 4.0), margin=st.floats(-0.1, 0.1))
def test_the_disc_touches_the_point_where_it_is_said_to(x, y, curvature, margin):
    distance = touch_distance(x, y, curvature, RADIUS, RADIUS + margin)
    straight = abs(curvature) < 1e-6
    off = abs(y) if straight else abs(np.hypot(x, y - 1.0 / curvature) - 1.0 / abs(curvature))
    assert (distance == np.inf) == (off >= RADIUS + margin)
    if distance < np.inf and off < RADIUS:
        pose = advance(np.zeros(3), 1.0, 0.0 if straight else curvature, distance)
        assert np.hypot(x - pose[0], y - pose[1]) == pytest.approx(RADIUS, abs=1e-6)


def test_nothing_is_free_before_it_was_seen():
    assert open_ahead(nothing_seen()) < CELL


def test_what_a_scan_shows_is_free_up_to_the_wall():
    wall = WALL - [0.3, 0.0, 0.3, 0.0]
    space = remembered(nothing_seen(), scan_of(wall), np.zeros(3), RADIUS)
    assert open_ahead(space, reach=0.4) == np.inf
    # The wall itself is the newest scan's to tell; what lies behind it nobody saw.
    assert 0.7 - RADIUS - CELL <= open_ahead(space, reach=0.7) <= 0.7 - RADIUS + CELL


@pytest.mark.parametrize("ranges", [np.full(249, np.nan), np.zeros(0)])
def test_rays_that_say_nothing_show_nothing(ranges):
    blind = LaserScan(1.0, ray_angles(SCAN)[: len(ranges)], ranges, 10.0, 0.015)
    assert open_ahead(remembered(nothing_seen(), blind, np.zeros(3), RADIUS)) < CELL


def test_rays_that_met_nothing_show_that_the_way_is_free():
    clear = LaserScan(1.0, ray_angles(SCAN), np.full(249, np.inf), 10.0, 0.015)
    assert open_ahead(remembered(nothing_seen(), clear, np.zeros(3), RADIUS)) == np.inf


@pytest.mark.parametrize("least_range", [0.3, 0.45, 0.6])
def test_a_wall_in_the_blind_zone_is_remembered(least_range):
    space = nothing_seen()
    for k in range(75):
        X_OB, stamp = np.array([0.01 * k, 0.0, 0.0]), 1.0 + 0.1 * k
        space = remembered(space, scan_of(WALL, X_OB, stamp, least_range), X_OB, RADIUS)
    room = open_ahead(space, X_OB, stamp)
    # The base is to stay a cell away from where the wall was, which is known to a cell.
    assert 1.0 - X_OB[0] - RADIUS - 2.0 * CELL <= room <= 1.0 - X_OB[0] - RADIUS


def test_what_was_seen_is_forgotten():
    space = remembered(nothing_seen(), scan_of(WALL), np.zeros(3), RADIUS)
    assert open_ahead(space, newest=1.0 + MEMORY) == np.inf
    assert open_ahead(space, newest=1.1 + MEMORY) < CELL


def test_what_was_met_and_is_gone_is_free_again():
    post = np.array([[0.6, -0.03, 0.6, 0.03]])
    space = remembered(nothing_seen(), scan_of(post), np.zeros(3), RADIUS)
    assert open_ahead(space, newest=1.1) < 0.6 - RADIUS
    space = remembered(space, scan_of(np.array([[5.0, -5, 5, 5]]), stamp=1.1), np.zeros(3), RADIUS)
    assert open_ahead(space, newest=1.1) == np.inf


def test_single_lost_rays_do_not_matter_and_gaps_do():
    whole = scan_of(np.array([[5.0, -5, 5, 5]]))
    lost = np.arange(249) % 4 == 0
    few = remembered(nothing_seen(), replace(whole, ranges=np.where(lost, np.nan, whole.ranges)), np.zeros(3), RADIUS)
    assert open_ahead(few) == np.inf
    ahead = np.abs(whole.angles) < 0.1
    gap = remembered(nothing_seen(), replace(whole, ranges=np.where(ahead, np.nan, whole.ranges)), np.zeros(3), RADIUS)
    assert open_ahead(gap) < 0.6


def test_a_wall_beside_the_way_is_where_it_is_though_ranges_are_noisy():
    """In a passage of half a metre, 4 cm from one side, a poor scanner's robot may drive on."""
    passage, angles = np.array([[-1.0, -0.223, 4.0, -0.223], [-1.0, 0.277, 4.0, 0.277]]), ray_angles(SCAN)
    stood = 0
    for seed in range(5):
        random, space = np.random.default_rng(seed), nothing_seen()
        for k in range(60):
            X_OB, stamp = np.array([0.03 * k, 0.0, 0.0]), 1.0 + 0.1 * k
            noisy = scan(passage, X_OB, stamp, angles, random.normal(size=len(angles)), ScanConfig(noise=0.02))
            space = remembered(space, noisy, X_OB, RADIUS)
            # It has come in when what it has beside it was before it.
            stood += k > 8 and open_ahead(space, X_OB, stamp, reach=0.04) <= 0.04
    assert stood <= 5


@given(aside=st.floats(0.03, 0.1), far=st.floats(0.4, 0.7))
def test_a_wall_seen_aslant_may_end_before_the_first_place_that_a_ray_met(aside, far):
    wall = [[far, 0.0, far + 2.0, 0.0]]
    space = remembered(nothing_seen(), scan_of(wall, (0.0, aside, -0.1)), np.array([0.0, aside, -0.1]), RADIUS)
    assert open_ahead(space, reach=0.7, newest=1.1) <= far - RADIUS


def test_past_what_it_is_near_to_already_the_base_drives_on():
    """A corner was met 1.5 cm beside the outline; for a base 5 cm farther to that side it is in the way."""
    X_OB = np.array([-0.3, 0.0, -0.6])
    space = remembered(nothing_seen(), scan_of([[0.05, -0.195, 0.05, -0.6]], X_OB), X_OB, RADIUS)
    assert open_ahead(space, reach=0.2, newest=1.1) == np.inf
    assert open_ahead(space, (-0.1, -0.05, 0.0), reach=0.2, newest=1.1) < 0.0


def test_a_walls_end_in_the_blind_zone_is_remembered_though_odometry_errs():
    end = np.array([[0.4, 0.14, 0.4, 3.0]])
    space = remembered(nothing_seen(), scan_of(end), np.zeros(3), RADIUS)
    room = open_ahead(space, newest=1.1)
    # The robot is 2 cm farther to the right than it takes itself to be: rays pass where the end was seen.
    space = remembered(space, scan_of(end, (0.0, -0.02, 0.0), 1.1, least_range=0.5), np.zeros(3), RADIUS)
    assert open_ahead(space, newest=1.1) == pytest.approx(room)


@given(x=st.floats(-3.0, 3.0), y=st.floats(-3.0, 3.0), heading=st.floats(-3.1, 3.1))
def test_the_memory_moves_along(x, y, heading):
    """It is the same wherever odometry began, but for where its cells lie."""
    X_OB = np.array([x, y, heading])
    space = nothing_seen()
    for k in range(4):
        X_BC = np.array([0.1 * k, 0.0, 0.0])
        space = remembered(space, scan_of(WALL, X_BC, 1.0 + k), compose(X_OB, X_BC), RADIUS)
    assert open_ahead(space, compose(X_OB, X_BC), 4.0, reach=0.3) == np.inf
    # What was left behind the window is not known any more.
    far = compose(X_OB, np.array([5.0, 0.0, 0.0]))
    blind = LaserScan(5.0, np.zeros(0), np.zeros(0), 10.0, 0.015)
    assert open_ahead(remembered(space, blind, far, RADIUS), far, 5.0) < CELL
