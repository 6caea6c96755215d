"""The whole filter: exact without noise, better than odometry with it, reproducible, hard to upset."""

import copy
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.config import GridConfig, OdometryConfig, ScanConfig
from tfg_drake.geometry import se2
from tfg_drake.grid.gmapping import (
    effective_number,
    grid_map,
    initial_state,
    pose_estimate,
    process_odometry,
    process_scan,
    resample,
)
from tfg_drake.messages import LaserScan, Odometry, replace
from tfg_drake.simulation import odometry as wheels
from tfg_drake.simulation.laser_scanner import ray_angles, scan

ROOM = np.array(
    [[-3, -2, 4, -2], [4, -2, 4, 1], [4, 1, 1, 1], [1, 1, 1, 3], [1, 3, -3, 3], [-3, 3, -3, -2], [2, -1, 2.5, -0.6]],
    dtype=float,
)
START = np.array([-1.0, -0.5, 0.3])
EXACT = OdometryConfig(0.0, 0.0, 0.0, 0.0, 0.0)
POOR = OdometryConfig(distance_noise=0.05, distance_scale=0.05, gyro_noise=0.02, gyro_bias=0.01, gyro_scale=0.05)


def true_pose(t):
    """Round and round on a circle of 0.8 m."""
    turn = 0.4 * t
    return se2.compose(START, np.array([0.8 * math.sin(turn), 0.8 * (1.0 - math.cos(turn)), turn]))


def drive(duration, config, model, scanner, seed=0):
    """The last state, and the errors (n, 3) of pose estimate and odometry at every scan put in."""
    rng = np.random.default_rng(seed)
    angles = ray_angles(scanner)
    errors = wheels.run_errors(np.ones(3), model)
    integrated, state = wheels.initial_state(START), initial_state(config, model, seed)
    estimate_errors, odometry_errors = [], []
    for k in range(int(80 * duration) + 1):
        t = k / 80
        if k % 5 == 0:
            pose = np.append(true_pose(t), [0.32, 0.4])
            integrated = wheels.integrate(integrated, t, pose, errors, rng.standard_normal(2), model)
            state = process_odometry(state, wheels.message(integrated))
        if k % 8 == 0:
            one = scan(ROOM, true_pose(t), t, angles, rng.standard_normal(len(angles)), scanner)
            before, state = state, process_scan(state, one)
            if state is not before and k % 5 == 0:
                X_MB = se2.between(START, true_pose(t))
                estimate_errors.append(se2.between(X_MB, pose_estimate(state, 0).X_MB))
                odometry_errors.append(se2.between(X_MB, integrated[wheels.INTEGRATED : wheels.INTEGRATED + 3]))
    return state, np.array(estimate_errors), np.array(odometry_errors)


@pytest.fixture(scope="module")
def driven():
    return drive(25.0, GridConfig(particles=20), POOR, ScanConfig())


def test_without_noise_the_pose_is_exact_and_the_map_is_the_room():
    state, errors, _ = drive(16.0, GridConfig(particles=5), EXACT, ScanConfig(noise=0.0))
    # POSE_FLOOR and the cells leave this much.
    assert np.abs(errors[:, :2]).max() < 0.02
    assert np.abs(errors[:, 2]).max() < 0.01
    grid = grid_map(state, 3)
    i, j = np.nonzero(grid.probability > 0.5)
    p_MC = grid.origin + grid.resolution * (np.column_stack([j, i]) + 0.5)
    from tfg_drake.geometry.distance import point_distance

    assert point_distance(se2.transform(START, p_MC), ROOM).max() < 0.12
    assert (grid.stage, grid.stamp, grid.resolution) == (3, state.stamp, 0.05)
    assert len(i) > 200


def test_drifted_odometry_is_corrected(driven):
    _, errors, odometry = driven
    assert np.hypot(*odometry[-1, :2]) > 0.2
    assert np.hypot(*errors[:, :2].T).mean() < 0.25 * np.hypot(*odometry[:, :2].T).mean()
    assert np.hypot(*errors[:, :2].T).max() < 0.1


def test_the_same_seed_gives_the_same_bits_and_a_copy_goes_on_alike():
    runs = [drive(6.0, GridConfig(particles=5), POOR, ScanConfig())[0] for _ in range(2)]
    other = drive(6.0, GridConfig(particles=5), POOR, ScanConfig(), seed=1)[0]
    np.testing.assert_array_equal(runs[0].X_MU, runs[1].X_MU)
    np.testing.assert_array_equal(runs[0].maps.tiles, runs[1].maps.tiles)
    assert not np.array_equal(runs[0].X_MU, other.X_MU)
    state = runs[0]
    assert copy.deepcopy(state) is state
    one = scan(ROOM, true_pose(6.1), 6.1, np.linspace(-1, 1, 100), np.zeros(100), ScanConfig())
    a, b = (process_scan(state, one, force=True) for _ in range(2))
    assert a.updates == state.updates + 1
    np.testing.assert_array_equal(a.X_MU, b.X_MU)


def test_estimates_have_regular_covariances(driven):
    estimate = pose_estimate(driven[0], 7)
    assert estimate.stage == 7
    assert np.linalg.eigvalsh(estimate.covariance)[0] > 0.0
    assert estimate.stamp == 25.0
    np.testing.assert_allclose(np.exp(driven[0].log_weight).sum(), 1.0)


def ahead(stamp, x):
    return Odometry(stamp, np.array([x, 0.0, 0.0]), np.array([0.5, 0.0]))


def wall_scan(stamp):
    return LaserScan(stamp, np.linspace(-1.0, 1.0, 200), np.full(200, 2.0), 10.0, 0.015)


def test_scans_go_in_after_time_way_or_turn():
    config = GridConfig(particles=2)
    start = process_scan(process_odometry(initial_state(config, EXACT, 0), ahead(0.0, 0.0)), wall_scan(0.0))
    assert start.updates == 1
    cases = [
        (Odometry(1.0, np.array([0.9, 0.0, 0.4]), np.zeros(2)), 1.0, 1),
        (Odometry(1.0, np.array([1.1, 0.0, 0.0]), np.zeros(2)), 1.0, 2),
        (Odometry(1.0, np.array([0.0, 0.0, -0.6]), np.zeros(2)), 1.0, 2),
        (Odometry(3.1, np.array([0.1, 0.0, 0.0]), np.zeros(2)), 3.1, 2),
        (Odometry(3.1, np.zeros(3), np.zeros(2), at_rest=True), 3.1, 1),
    ]
    for message, stamp, updates in cases:
        state = process_odometry(start, message)
        assert process_scan(state, wall_scan(stamp)).updates == updates
        assert process_scan(state, wall_scan(stamp), force=True).updates == 2


def test_the_pose_at_the_scans_stamp_is_used():
    base = process_odometry(initial_state(GridConfig(particles=1), EXACT, 0), ahead(0.0, 0.0))
    for k in range(1, 5):
        base = process_odometry(base, ahead(k / 16, 0.5 * k / 16))
    early = process_scan(base, wall_scan(0.2), force=True)
    np.testing.assert_allclose(early.X_OU, [0.1, 0.0, 0.0], atol=1e-12)
    late = process_scan(base, wall_scan(0.3), force=True)
    np.testing.assert_allclose(late.X_OU, [0.15, 0.0, 0.0], atol=1e-12)
    # The robot braked: the next odometry says where it was.
    braked = process_odometry(late, ahead(5 / 16, 0.13))
    np.testing.assert_allclose(braked.X_OU[0], 0.125 + 0.005 * 0.8, atol=1e-12)


def test_useless_messages_change_nothing():
    state = initial_state(GridConfig(particles=2), POOR, 0)
    assert process_scan(state, wall_scan(0.0)) is state
    state = process_scan(process_odometry(state, ahead(0.0, 0.0)), wall_scan(0.0))
    state = process_odometry(state, ahead(1.0, 0.5))
    none = LaserScan(1.0, np.zeros(0), np.zeros(0), 10.0, 0.015)
    for useless in (none, replace(wall_scan(1.0), ranges=np.full(200, np.nan)), wall_scan(0.0), wall_scan(-1.0)):
        assert process_scan(state, useless, force=True) is state
    for stamp in (math.nan, -math.inf, math.inf, 1.3):
        assert process_scan(state, wall_scan(stamp), force=True) is state
    for odometry in (ahead(0.5, 1.0), ahead(1.0, 1.0), ahead(math.nan, 1.0), ahead(2.0, math.nan)):
        assert process_odometry(state, odometry) is state
    far = process_scan(state, replace(wall_scan(1.0), ranges=np.full(200, np.inf)), force=True)
    assert far.updates == 2
    assert np.isfinite(far.X_MU).all()


def test_before_any_message_there_is_an_estimate():
    state = initial_state(GridConfig(particles=3), POOR, 0)
    np.testing.assert_array_equal(pose_estimate(state, 0).X_MB, np.zeros(3))
    assert grid_map(state, 0).probability.shape == (0, 0)


@given(st.lists(st.floats(-50.0, 0.0), min_size=1, max_size=40), st.floats(0.0, 1.0, exclude_max=True))
def test_resampling_draws_in_proportion(log_weight, share):
    log_weight = np.array(log_weight)
    weight = np.exp(log_weight) / np.exp(log_weight).sum()
    rows = resample(log_weight, share)
    n = len(weight)
    assert len(rows) == n
    assert (np.diff(rows) >= 0).all()
    counts = np.bincount(rows, minlength=n)
    assert (counts >= np.floor(n * weight - 1e-6)).all()
    assert (counts <= np.ceil(n * weight + 1e-6)).all()
    assert 1.0 - 1e-9 <= effective_number(log_weight) <= n + 1e-9


def test_effective_number():
    assert effective_number(np.zeros(7)) == pytest.approx(7.0)
    assert effective_number(np.array([0.0, -1000.0])) == pytest.approx(1.0)
