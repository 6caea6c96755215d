"""Rollouts against what can be computed by hand."""

import numpy as np
import pytest
from scipy.stats import norm

from benchmarks.monte_carlo import collisions, draw
from tfg_drake.config import OdometryConfig, RobotConfig, TagSensorConfig
from tfg_drake.messages import replace
from tfg_drake.planning.chance_constraint import TRACKING_DEVIATION
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.tfg.graph import empty_map as empty_tfg

ROBOT = RobotConfig()
EXACT_WHEELS = OdometryConfig(0.0, 0.0, 0.0, 0.0, 0.0)
ROLLOUTS = 20_000


def beside_a_wall(sensor_range, pose_sigma, tag_sigma, shared=0.0):
    """A wall y = 0 carried by three tags, the robot's departure at (0, 0.3); all shifted together by `shared`, m."""
    p = np.array([[-2.0, 0.0], [0.5, 0.0], [3.0, 0.0]])
    S = np.zeros((9, 9))
    S[:6, :6] = tag_sigma**2 * np.eye(6)
    S[6:8, 6:8] = pose_sigma**2 * np.eye(2)
    every = np.vstack([np.eye(2)] * 3 + [np.eye(3, 2)])
    S += shared**2 * every @ every.T
    ids = np.arange(3)
    X_MD = np.array([0.0, 0.3, 0.0])
    estimate = replace(empty_map(), ids=ids, local=ids, p_ML=p, X_MD=X_MD, covariance=S)
    walls = np.array([[-2.0, 0.0, 0.5, 0.0], [0.5, 0.0, 3.0, 0.0]])
    facing = np.tile([0.0, 1.0], (3, 1))
    pieces = np.array([[0, 1], [1, 2]])
    tfg = replace(
        empty_tfg(), segments=walls, segment_ids=pieces, segment_kind=np.zeros(2, dtype=np.int64), facing=facing
    )
    path = np.stack([np.linspace(0.0, 1.0, 6), np.full(6, 0.3)], axis=1)
    return path, estimate, tfg, TagSensorConfig(range=sensor_range)


def shares(case, odometry=EXACT_WHEELS, seed=0):
    path, estimate, tfg, sensor = case
    rng = np.random.default_rng(seed)
    return collisions(path, estimate, tfg, ROBOT, sensor, odometry, rng, ROLLOUTS).mean(axis=0)


def test_samples_have_the_joint_covariance():
    for shared in (0.0, 0.1):
        _, estimate, _, _ = beside_a_wall(1e-3, 0.05, 0.02, shared=shared)
        samples = draw(estimate, np.random.default_rng(0), 200_000)
        every = np.hstack([samples.dL.reshape(-1, 6), samples.dX])
        np.testing.assert_allclose(np.cov(every.T), estimate.covariance, rtol=0.03, atol=1e-4)


def test_a_blind_robot_collides_as_often_as_its_pose_and_the_wall_are_off():
    # At the middle tag: its own deviation, the pose's and the follower's, all independent.
    share = shares(beside_a_wall(1e-3, 0.05, 0.03))
    sigma = np.sqrt(0.05**2 + 0.03**2 + TRACKING_DEVIATION**2)
    assert share[0] > 0.0
    middle = np.argmin(np.abs(np.linspace(0.0, 1.0, 6) - 0.5))
    assert share[middle] == pytest.approx(norm.cdf((ROBOT.radius - 0.3) / sigma), rel=0.15)


def test_what_shifts_robot_and_wall_together_does_no_harm():
    alone, together = shares(beside_a_wall(1e-3, 0.05, 0.03)), shares(beside_a_wall(1e-3, 0.05, 0.03, shared=0.5))
    np.testing.assert_allclose(together, alone, atol=0.005)


def test_sightings_make_it_safer_and_bad_wheels_more_dangerous():
    blind = shares(beside_a_wall(1e-3, 0.08, 0.01))
    assert shares(beside_a_wall(5.0, 0.08, 0.01))[-1] < 0.5 * blind[-1]
    assert shares(beside_a_wall(1e-3, 0.08, 0.01), OdometryConfig(gyro_noise=0.2))[-1] > 1.2 * blind[-1]


def test_a_path_through_a_wall_collides():
    path, estimate, tfg, sensor = beside_a_wall(5.0, 0.01, 0.01)
    path = np.stack([np.zeros(7), np.linspace(0.3, -0.3, 7)], axis=1)
    assert shares((path, estimate, tfg, sensor))[3] > 0.999
