"""The panorama of a turn against rays cast from its centre."""

import numpy as np
import pytest

from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.messages import LaserScan
from tfg_drake.tfg.panorama import BINS, build_panorama

START = np.array([2.0, 3.0, 0.3])


def test_noiseless_panorama_lies_on_the_walls(two_rooms) -> None:
    two_rooms.noise = 0.0
    panorama = two_rooms.panorama(START)
    hit = np.isfinite(panorama.ranges)
    exact = cast_rays(two_rooms.walls, START[:2], panorama.angles + START[2], 10.0)
    # A bin that straddles a corner holds the mean of points on both walls, less than the bin is wide off either.
    np.testing.assert_allclose(panorama.ranges[hit], exact[hit], atol=0.02)
    straight = np.abs(panorama.ranges[hit] - exact[hit]) < 1e-4
    assert straight.mean() > 0.9
    assert not np.isnan(panorama.ranges).any()
    assert (np.diff(panorama.angles) > 0.0).all()


def test_averaging_beats_the_noise_of_one_ray(two_rooms) -> None:
    panorama = two_rooms.panorama(START)
    exact = cast_rays(two_rooms.walls, START[:2], panorama.angles + START[2], 10.0)
    both = np.isfinite(panorama.ranges) & np.isfinite(exact)
    assert np.median(np.abs(panorama.ranges[both] - exact[both])) < 0.005


def test_no_point_floats_between_two_surfaces(two_rooms) -> None:
    panorama = two_rooms.panorama(START)
    hit = np.isfinite(panorama.ranges)
    angles = panorama.angles + START[2]
    near = np.array([cast_rays(two_rooms.walls, START[:2], angles + d, 10.0) for d in np.linspace(-0.005, 0.005, 21)])
    near = np.where(np.isinf(near), 99.0, near)
    assert (np.abs(near - panorama.ranges).min(axis=0)[hit] < 0.05).all()


def test_free_and_unseen_bins() -> None:
    angles = np.linspace(-0.5, 0.5, 200)
    scan = LaserScan(0.0, angles, np.full(200, np.inf), 10.0, 0.01)
    panorama = build_panorama([scan], np.array([0.0]), np.zeros((1, 3)))
    free = np.isinf(panorama.ranges)
    assert np.isnan(panorama.ranges[~free]).all()
    assert free.sum() == pytest.approx(BINS / (2.0 * np.pi), abs=3)


def test_where_a_turn_looked() -> None:
    scan = LaserScan(0.0, np.linspace(-0.5, 0.5, 400), np.full(400, 3.0), 10.0, 0.01)
    panorama = build_panorama([scan], np.array([0.0]), np.zeros((1, 3)))
    assert panorama.looked_at(np.array([0.0, -0.49, 0.49, 2.0 * np.pi - 0.3])).all()
    assert not panorama.looked_at(np.array([-0.52, 0.52, np.pi, -np.pi, 2.0])).any()


def test_scans_are_placed_by_the_pose_at_their_stamp() -> None:
    """Half way between two poses, across the jump of the heading at pi."""
    scan = LaserScan(0.5, np.array([0.0]), np.array([2.0]), 10.0, 0.01)
    late = LaserScan(1.5, np.array([0.0]), np.array([1.0]), 10.0, 0.01)
    X_AB = np.array([[0.0, 0.0, np.pi - 0.1], [0.2, 0.0, -np.pi + 0.2]])
    panorama = build_panorama([scan, late], np.array([0.0, 1.0]), X_AB)
    hit = np.flatnonzero(np.isfinite(panorama.ranges))
    expected = np.array([0.1 + 2.0 * np.cos(np.pi + 0.05), 2.0 * np.sin(np.pi + 0.05)])
    assert len(hit) == 1
    np.testing.assert_allclose(panorama.points[hit[0]], expected, atol=1e-12)


def test_a_panorama_needs_poses_and_scans() -> None:
    with pytest.raises(ValueError, match="pose"):
        build_panorama([], np.zeros(0), np.zeros((0, 3)))
    with pytest.raises(ValueError, match="scan"):
        build_panorama([], np.zeros(1), np.zeros((1, 3)))


def test_a_ray_or_two_that_are_swallowed_are_no_free_ground():
    """But a slit that five scans see through is."""
    angles = np.arange(-100, 101) * 2.0 * np.pi / BINS
    ranges = np.full(len(angles), 2.0)
    ranges[[40, 120, 121]] = np.inf
    scans = [LaserScan(0.1 * k, angles, ranges, 10.0, 0.01) for k in range(5)]
    bearings = angles[[40, 120]] + 0.5 * 2.0 * np.pi / BINS
    for seen, looked in ((scans[:1], [False, False]), (scans, [True, True])):
        panorama = build_panorama(seen, np.array([0.0, 0.4]), np.zeros((2, 3)))
        np.testing.assert_array_equal(panorama.looked_at(bearings), looked)


def test_a_third_of_the_rays_may_be_lost_and_a_wall_is_a_wall():
    """Seven scans of one, 2 m off; a slit of five bins that two scans in seven do not see through is one."""
    rng, angles = np.random.default_rng(4), np.arange(-200, 201) * 2.0 * np.pi / BINS
    scans = []
    for k in range(7):
        ranges = np.where(rng.random(len(angles)) < 0.35, np.inf, 2.0)
        ranges[200:205] = np.inf if k > 1 else 2.0
        scans.append(LaserScan(0.1 * k, angles, ranges, 10.0, 0.01))
    free = np.isinf(build_panorama(scans, np.array([0.0, 0.7]), np.zeros((2, 3))).ranges)
    bearings = (np.arange(BINS) + 0.5) * 2.0 * np.pi / BINS
    assert free[(bearings > angles[200]) & (bearings < angles[204])].all()
    assert free.sum() < 40


def test_a_ray_that_is_swallowed_between_bins_without_rays_is_no_free_ground():
    """Rays a degree apart leave every second bin empty."""
    angles = (2.0 * np.arange(-50, 51) + 0.5) * 2.0 * np.pi / BINS
    ranges = np.full(len(angles), 2.0)
    ranges[[40, *range(80, 85)]] = np.inf
    panorama = build_panorama([LaserScan(0.0, angles, ranges, 10.0, 0.01)], np.zeros(1), np.zeros((1, 3)))
    np.testing.assert_array_equal(panorama.looked_at(angles[[40, 80, 81]]), [False, True, True])


def test_a_ray_that_falls_half_on_either_of_two_surfaces_is_left_out():
    """But a post, a ray wide, is not, nor a wall seen aslant, where every ray differs from the next."""
    angles = (np.arange(-100, 101) + 0.5) * 2.0 * np.pi / BINS
    corner = np.where(angles < 0.0, 1.0, 4.0)
    corner[100], corner[150] = 1.7, 2.0
    aslant = np.where(angles > 0.02, 0.1 / np.sin(np.maximum(angles, 0.02)), np.inf)
    for ranges, kept in ((corner, np.arange(201) != 100), (aslant, np.full(201, True))):
        panorama = build_panorama([LaserScan(0.0, angles, ranges, 10.0, 0.01)], np.zeros(1), np.zeros((1, 3)))
        np.testing.assert_array_equal(panorama.looked_at(angles), kept)


def test_a_coarse_scan_leaves_no_gaps_between_its_rays():
    """A scanner of one ray a degree amid a square room of 4 m sees all of it."""
    angles = np.radians(np.arange(-179.0, 181.0))
    ranges = 2.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    ranges[10:40] = np.inf
    coarse = LaserScan(0.0, angles, ranges, 10.0, 0.01)
    seen = build_panorama([coarse], np.array([0.0]), np.zeros((1, 3)))
    assert not np.isnan(seen.ranges).any()
    bearing = (seen.angles + np.pi) % (2.0 * np.pi) - np.pi
    free = (bearing > angles[10]) & (bearing < angles[39])
    assert np.isinf(seen.ranges[free]).all()
    walls = np.isfinite(seen.ranges)
    expected = 2.0 / np.maximum(np.abs(np.cos(seen.angles)), np.abs(np.sin(seen.angles)))
    np.testing.assert_allclose(seen.ranges[walls], expected[walls], atol=0.03)
    assert np.count_nonzero(~walls) >= 58


def test_a_coarse_scan_knows_nothing_beside_a_ray_that_says_nothing():
    angles = np.radians(np.arange(-179.0, 181.0, 2.0))
    ranges = np.full(180, 3.0)
    ranges[90] = np.nan
    seen = build_panorama([LaserScan(0.0, angles, ranges, 10.0, 0.01)], np.array([0.0]), np.zeros((1, 3)))
    assert 4 <= np.count_nonzero(np.isnan(seen.ranges)) <= 8
