"""What the estimator believes of how the tag camera is mounted and how its clock runs, learnt with the map.

The camera's yaw y in the body frame cannot be told from the tags, for it turns all that is seen about the camera. So it
is the camera's heading that the estimator knows the robot by, and in that the robot drives to -y. Its clock is ahead of
the base's by t: a frame stamped s shows what there was at s - t. What a turn or a piece of the way tells of t is the
prior of all that comes after, as with the odometry's calibration; y is an unknown of the keyframe graph.
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.config import TagSensorConfig
from tfg_drake.messages import FloatArray, message

# A known constant is still an unknown: least standard deviations of both.
LEAST_SIGMA = 1e-6


@message
class CameraModel:
    """Gaussian of (y, t). mean: (2,) rad and s, covariance: (2, 2)."""

    mean: FloatArray
    covariance: FloatArray

    @property
    def yaw(self) -> float:
        """The expected heading of the camera in the body frame, rad."""
        return float(self.mean[0])

    @property
    def offset(self) -> float:
        """The camera's clock less the base's as expected, s."""
        return float(self.mean[1])

    @property
    def sigma(self) -> FloatArray:
        """(2,) standard deviations, rad and s."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def with_yaw(self, yaw: FloatArray) -> CameraModel:
        """The same clock with another yaw: (2,) mean and standard deviation, rad, independent of it."""
        return CameraModel(np.array([yaw[0], self.offset]), np.diag([yaw[1] ** 2, self.covariance[1, 1]]))


def camera_model(sensor: TagSensorConfig) -> CameraModel:
    """Before the first turn: it looks ahead and its clock is the base's, as surely as the data sheet says."""
    sigma = np.maximum([sensor.yaw_deviation, sensor.clock_deviation], LEAST_SIGMA)
    return CameraModel(np.zeros(2), np.diag(sigma**2))


def exact_camera() -> CameraModel:
    """A camera that looks ahead and whose clock is the base's, known before."""
    return CameraModel(np.zeros(2), LEAST_SIGMA**2 * np.eye(2))


def seen_from_camera(increment: FloatArray, yaw: float) -> FloatArray:
    """An odometry increment (3,), see `tfg_drake.slam.odometry_model.arc`, of a robot known by the heading of a camera
    with this yaw, rad."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([c * increment[0] + s * increment[1], -s * increment[0] + c * increment[1], increment[2]])
