import numpy as np

from tfg_drake.config import OdometryConfig
from tfg_drake.planning.odometry_drift import odometry_covariance


def test_odometry_covariance_is_that_of_simulated_dead_reckoning():
    rng = np.random.default_rng(0)
    config = OdometryConfig()
    runs, steps, distance, time = 4000, 200, 5.0, 10.0
    heading = np.cumsum(rng.normal(0, config.gyro_noise * np.sqrt(time / steps), (runs, steps)), axis=1)
    heading += rng.normal(0, config.gyro_bias, (runs, 1)) * np.linspace(0, time, steps)
    step = distance / steps * (1 + rng.normal(0, config.distance_scale, (runs, 1)))
    step = step + rng.normal(0, config.distance_noise * np.sqrt(distance / steps), (runs, steps))
    ends = np.stack([np.sum(step, axis=1), np.sum(step * heading, axis=1), heading[:, -1]], axis=1)
    X_MD, point = np.array([1.0, 2.0, 0.3]), np.array([[1.0, 7.0]])
    Q = odometry_covariance(X_MD, point, np.array([distance]), np.array([time]), config)[0]
    forward = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    scale = np.sqrt(np.diag(Q))
    np.testing.assert_allclose(forward @ np.cov(ends.T) @ forward.T / np.outer(scale, scale),
                               Q / np.outer(scale, scale), atol=0.08)  # fmt: skip
