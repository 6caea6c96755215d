"""The laser scanner against geometry, and its noise."""

import numpy as np
import pytest

from tests.arrays import frozen
from tfg_drake.config import ScanConfig, ScanRealityConfig
from tfg_drake.geometry.motion import advance
from tfg_drake.geometry.se2 import compose, inverse
from tfg_drake.simulation.laser_scanner import along_rays, no_scan, ray_angles, scan, spoilt, swept

CONFIG = ScanConfig()
WALL = frozen([[4.0, -100.0, 4.0, 100.0]])


def test_rays_cover_the_field_of_view():
    angles = ray_angles(CONFIG)
    assert len(angles) == 249
    assert angles[[0, -1]] == pytest.approx([-0.5 * CONFIG.field_of_view, 0.5 * CONFIG.field_of_view])
    assert angles[124] == 0.0
    assert np.diff(angles) == pytest.approx(np.full(248, CONFIG.resolution))


def test_exact_without_noise():
    angles = ray_angles(CONFIG)
    message = scan(WALL, np.array([1.0, 0.5, 0.2]), 2.5, angles, np.zeros(249), CONFIG)
    expected = 3.0 / np.cos(angles + 0.2)
    hit = (expected > 0) & (expected <= 10.0)
    assert message.ranges[hit] == pytest.approx(expected[hit], abs=1e-12)
    assert np.isinf(message.ranges[~hit]).all()
    assert (message.stamp, message.range_max, message.sigma) == (2.5, 10.0, 0.015)
    assert np.isinf(scan(np.zeros((0, 4)), np.zeros(3), 0.0, angles, np.ones(249), CONFIG).ranges).all()


def test_noise_has_the_configured_spread():
    rng = np.random.default_rng(0)
    angles = np.zeros(4000)
    ranges = scan(WALL, np.zeros(3), 0.0, angles, rng.normal(size=4000), CONFIG).ranges
    assert ranges.mean() == pytest.approx(4.0, abs=0.001)
    assert ranges.std() == pytest.approx(0.015, rel=0.05)


def test_returns_stay_within_range():
    far = np.array([[9.999, -1.0, 9.999, 1.0]])
    near = np.array([[0.001, -1.0, 0.001, 1.0]])
    assert np.isinf(scan(far, np.zeros(3), 0.0, np.zeros(1), np.ones(1), CONFIG).ranges).all()
    assert scan(near, np.zeros(3), 0.0, np.zeros(1), -np.ones(1), CONFIG).ranges.tolist() == [0.0]


def test_before_the_first_scan():
    assert no_scan(CONFIG).stamp == -np.inf
    assert no_scan(CONFIG).ranges.shape == (0,)


def test_rays_that_fail():
    walls = np.array([[4.0, -100.0, 4.0, 0.0], [6.0, -100.0, 6.0, 100.0]])
    angles = np.linspace(-0.3, 0.3, 60)
    whole = scan(walls, np.zeros(3), 1.0, angles, np.zeros(60), CONFIG)
    edge = int(np.flatnonzero(np.diff(whole.ranges) > 1.0)[0])
    uniform = np.full(60, 0.9)
    uniform[3], uniform[edge] = 0.04, 0.05 + 0.5 * 0.2
    found = spoilt(whole, uniform, ScanRealityConfig(dropout_probability=0.05, mixed_probability=0.2))
    assert np.isinf(found.ranges[3])
    assert found.ranges[edge] == pytest.approx(0.5 * (whole.ranges[edge] + whole.ranges[edge + 1]))
    others = np.setdiff1d(np.arange(60), [3, edge])
    assert (found.ranges[others] == whole.ranges[others]).all()
    assert found.stamp == 1.0


def test_rays_end_at_people_in_front_of_the_wall():
    angles = np.array([-0.3, 0.0, 0.3])
    discs = np.array([[2.0, 0.0, 0.25], [5.0, 2.0, 0.25]])
    noise = np.array([0.0, 1.0, 0.0])
    found = scan(WALL, np.zeros(3), 0.0, angles, noise, CONFIG, discs=discs)
    alone = scan(WALL, np.zeros(3), 0.0, angles, noise, CONFIG)
    assert found.ranges[1] == pytest.approx(1.75 + CONFIG.noise)
    assert (found.ranges[[0, 2]] == alone.ranges[[0, 2]]).all()


def test_a_sweep_of_a_robot_that_stands_is_a_scan():
    angles, X_WS = ray_angles(CONFIG), np.array([1.0, 0.5, 0.2])
    noise = np.random.default_rng(0).normal(size=249)
    X_BS = np.array([0.03, -0.02, 0.1])
    robot = np.array([*compose(X_WS, inverse(X_BS)), 0.0, 0.0])
    one, other = swept(WALL, robot, X_BS, 0.1, 2.5, angles, noise, CONFIG), scan(WALL, X_WS, 2.5, angles, noise, CONFIG)
    assert one.ranges == pytest.approx(other.ranges, abs=1e-12)
    assert (one.stamp, one.angles.tolist()) == (2.5 - 0.1, angles.tolist())


@pytest.mark.parametrize(("speed", "turn_rate"), [(0.5, 0.0), (0.0, 1.2), (0.4, -0.9)])
def test_rays_of_a_sweep_are_taken_one_after_the_other(speed, turn_rate):
    angles, pose = ray_angles(CONFIG), np.array([1.0, 0.5, 0.2])
    robot, still = np.array([*pose, speed, turn_rate]), np.zeros(1)
    found = swept(WALL, robot, np.zeros(3), 0.2, 0.0, angles, np.zeros(249), CONFIG)
    for k in range(0, 249, 31):
        then = advance(pose, speed, turn_rate, 0.2 * (k / 248 - 1.0))
        alone = scan(WALL, then, 0.0, angles[k : k + 1], still, CONFIG).ranges[0]
        if alone < 8.0:
            assert found.ranges[k] == pytest.approx(alone, abs=0.01)
    assert found.ranges[124] != scan(WALL, pose, 0.0, angles, np.zeros(249), CONFIG).ranges[124]


def test_a_wall_seen_aslant_is_not_mixed_with_itself():
    """Along a corridor neighbouring rays differ by decimetres; at its end it is open, and behind that is a wall."""
    angles = np.arange(-60, 61) * 0.01
    corridor = np.array([[-1.0, -1.0, 8.0, -1.0], [8.0, 5.0, 9.0, -5.0]])
    whole = scan(corridor, np.zeros(3), 0.0, angles, np.zeros(len(angles)), ScanConfig(noise=0.0, range=20.0))
    found = spoilt(whole, np.full(len(angles), 0.5), ScanRealityConfig(mixed_probability=1.0))
    changed = np.flatnonzero(found.ranges != whole.ranges)
    steps = np.abs(np.diff(whole.ranges[np.isfinite(whole.ranges)]))
    assert np.count_nonzero(steps > 0.1) > 5
    assert len(changed) <= 1


def test_errors_of_rays_are_correlated_over_an_angle():
    angles = np.linspace(0.0, 0.1 * 4000, 4001)
    white = np.random.default_rng(5).normal(size=4001)
    errors = along_rays(white, angles, 0.5)
    assert abs(errors.std() - 1.0) < 0.06
    for steps in (1, 5, 10):
        assert abs(np.mean(errors[steps:] * errors[:-steps]) - np.exp(-0.2 * steps)) < 0.08
