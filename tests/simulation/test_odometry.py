"""Dead reckoning: exact without noise, and the noise as configured."""

import numpy as np
import pytest

from tfg_drake.config import OdometryConfig, OdometryRealityConfig
from tfg_drake.geometry.motion import advance
from tfg_drake.geometry.se2 import between
from tfg_drake.simulation.odometry import TIME, initial_state, integrate, message, run_errors

START = np.array([3.0, -2.0, 2.5])
PERIOD = 1.0 / 32.0


def reckon(config, errors, normals, speed=0.4, turn_rate=0.9, reality=None):
    """Odometry over len(normals) periods of a constant arc; also the true pose in the frame O."""
    state, pose = initial_state(START), START
    for k, normal in enumerate(normals):
        pose = advance(pose, speed, turn_rate, PERIOD)
        true = np.array([*pose, speed, turn_rate])
        state = integrate(state, (k + 1) * PERIOD, true, run_errors(errors, config), normal, config, reality=reality)
    return message(state), between(START, pose)


def test_exact_without_noise():
    odometry, X_SB = reckon(OdometryConfig(), np.zeros(3), np.zeros((320, 2)))
    assert pytest.approx(X_SB, abs=1e-12) == odometry.X_OB
    assert pytest.approx([0.4, 0.9]) == odometry.V_B
    assert odometry.stamp == 10.0


def test_constant_errors():
    config = OdometryConfig(distance_scale=0.02, gyro_bias=0.01, gyro_scale=0.03)
    straight, _ = reckon(config, np.array([1.0, 0.0, 0.0]), np.zeros((320, 2)), 0.5, 0.0)
    assert pytest.approx([5.0 * 1.02, 0, 0]) == straight.X_OB
    assert pytest.approx([0.51, 0]) == straight.V_B
    standing, _ = reckon(config, np.array([0.0, -1.0, 0.0]), np.zeros((320, 2)), 0.0, 0.0)
    assert pytest.approx([0, 0, -0.1]) == standing.X_OB
    turning, _ = reckon(config, np.array([0.0, 0.0, 1.0]), np.zeros((320, 2)), 0.0, 0.1)
    assert pytest.approx([0, 0, 1.03]) == turning.X_OB


def test_random_walks_have_the_configured_spread():
    config = OdometryConfig(distance_noise=0.02, gyro_noise=0.005)
    rng = np.random.default_rng(0)
    ends = np.array([reckon(config, np.zeros(3), rng.normal(size=(64, 2)), 0.5, 0.0)[0].X_OB for _ in range(2000)])
    # One metre in two seconds; headings this small hardly bend the track.
    assert ends[:, 0].std() == pytest.approx(0.02, rel=0.1)
    assert ends[:, 2].std() == pytest.approx(0.005 * np.sqrt(2.0), rel=0.1)
    assert ends[:, 0].mean() == pytest.approx(1.0, abs=0.002)


def test_nothing_changes_before_time_passes():
    state = initial_state(START)
    same = integrate(state, 0.0, np.array([*START, 0.0, 0.0]), np.ones(3), np.ones(2), OdometryConfig())
    assert (same == state).all()
    assert same[TIME] == 0.0


def test_encoders_count_whole_ticks_and_lose_none():
    silent, reality = OdometryConfig(0.0, 0.0, 0.0, 0.0, 0.0), OdometryRealityConfig(ticks_per_metre=30.0)
    for speed in (0.4, -0.4):
        for steps in (1, 7, 320):
            counted, X_SB = reckon(silent, np.zeros(3), np.zeros((steps, 2)), speed, 0.0, reality)
            assert counted.X_OB[0] == pytest.approx(np.floor(speed * steps * PERIOD * 30.0 + 1e-9) / 30.0)
            assert abs(counted.X_OB[0] - X_SB[0]) < 1.0 / 30.0


def test_wheels_slip_in_turns():
    silent, reality = OdometryConfig(0.0, 0.0, 0.0, 0.0, 0.0), OdometryRealityConfig(slip_per_turn_rate=0.02)
    straight, X_SB = reckon(silent, np.zeros(3), np.zeros((320, 2)), 0.4, 0.0, reality)
    assert pytest.approx(X_SB, abs=1e-9) == straight.X_OB
    turning, X_SB = reckon(silent, np.zeros(3), np.zeros((320, 2)), 0.4, -0.9, reality)
    assert pytest.approx([*(1.0 + 0.9 * 0.02) * X_SB[:2], X_SB[2]]) == turning.X_OB
