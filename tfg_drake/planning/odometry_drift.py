"""The drift of a pose by odometry over a straight way."""

from __future__ import annotations

import numpy as np

from tfg_drake.config import OdometryConfig
from tfg_drake.messages import FloatArray


def straight_drift(
    distance: FloatArray, time: FloatArray, odometry: OdometryConfig
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the drift of odometry over straight ways, for distance, m, and time, s, of any array shape: the variances
    along and across the way, m^2, the covariance of across and heading, m rad, and the variance of the heading, rad^2.

    The along-track error is the encoders', the heading's the gyro's random walk and bias, the cross-track error the
    integral of the heading's.
    """
    walk, bias = odometry.gyro_noise**2 * time, (odometry.gyro_bias * time) ** 2
    along = odometry.distance_noise**2 * distance + (odometry.distance_scale * distance) ** 2
    return along, (walk / 3.0 + bias / 4.0) * distance**2, (walk + bias) / 2.0 * distance, walk + bias


def odometry_covariance(
    X_MD: FloatArray, points: FloatArray, distance: FloatArray, time: FloatArray, odometry: OdometryConfig
) -> FloatArray:
    """Return the covariance (c, 3, 3), in M, that odometry adds between X_MD (3,) and an arrival at each point (c, 2),
    m.

    distance: (c,) m and time: (c,) s of travel, modelled as straight.
    """
    direction = np.arctan2(points[:, 1] - X_MD[1], points[:, 0] - X_MD[0])
    Q = np.zeros((len(points), 3, 3))
    Q[:, 0, 0], Q[:, 1, 1], across_heading, Q[:, 2, 2] = straight_drift(distance, time, odometry)
    Q[:, 1, 2] = Q[:, 2, 1] = across_heading
    R = np.zeros_like(Q)
    R[:, 0, 0] = R[:, 1, 1] = np.cos(direction)
    R[:, 1, 0] = np.sin(direction)
    R[:, 0, 1] = -R[:, 1, 0]
    R[:, 2, 2] = 1.0
    return np.asarray(R @ Q @ R.transpose(0, 2, 1))
