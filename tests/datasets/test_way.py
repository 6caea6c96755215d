"""The way between known poses, against odometry without noise."""

import numpy as np

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.evaluation import poses_between
from tfg_drake.datasets.recording import Recording
from tfg_drake.messages import LaserScan, Odometry

NONE = np.zeros(0)


def test_poses_between_known_ones_share_what_odometry_is_off():
    log = Recording(
        name="straight",
        odometry=tuple(Odometry(float(k), np.array([k, 0.0, 0.0]), np.zeros(2)) for k in range(80)),
        detections=(),
        model=OdometryConfig(),
        truth=None,
        scans=tuple(LaserScan(0.5 * k, NONE, NONE, 10.0, 0.01) for k in range(160)),
    )
    X_MB = np.array([[0.0, 0.0, 0.0], [8.0, 0.8, 0.0]])
    found = poses_between(log, np.array([0.0, 10.0]), X_MB)
    np.testing.assert_allclose(found[::2][:11, 0], np.arange(11) * 0.8)
    np.testing.assert_allclose(found[::2][:11, 1], np.arange(11) * 0.08)
    np.testing.assert_allclose(found[22], [9.0, 0.8, 0.0])  # Beyond them odometry alone tells.
