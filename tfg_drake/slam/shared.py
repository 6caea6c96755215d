"""The shared parameters: constant errors of odometry, camera and scanner, unknowns of the keyframe graph.

The data sheets are their prior. Every keyframe depends on them and informs them, so they are estimated jointly with the
map; the published pose includes their uncertainty.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numba import njit

from tfg_drake.config import OdometryConfig, ScanConfig, TagSensorConfig
from tfg_drake.messages import FloatArray, TagDetections, message, replace

# The places of the parameters in all vectors. Measured distance = (1 + DISTANCE_SCALE) * distance, measured turn =
# (1 + GYRO_SCALE) * turn + GYRO_BIAS (rad/s) * time, measured range = (1 + RANGE_SCALE) * range. The camera looks
# CAMERA_YAW (rad) to the left, sits LEVER_X ahead and LEVER_Y to the left (m) of where it is believed to sit, and its
# clock is CLOCK (s) ahead of the base's: a frame stamped s was taken at s - CLOCK. The scanner's parameters mean the
# same; its ray at bearing b (rad, to the left) was taken SWEEP * b earlier, SWEEP in s/rad.
DISTANCE_SCALE, GYRO_BIAS, GYRO_SCALE = range(3)
CAMERA_YAW, LEVER_X, LEVER_Y, CLOCK, RANGE_SCALE = range(3, 8)
SCANNER_YAW, SCANNER_X, SCANNER_Y, SCANNER_CLOCK, SWEEP = range(8, 13)
SHARED = 13
# The unit of a keyframe's lengths is the index of the parameter that scales them, or METRES if scans measured them.
METRES = -1
# Least standard deviation of a parameter: a known one is still an unknown.
LEAST_SIGMA = 1e-6


@message
class Shared:
    """Gaussian of the shared parameters. mean: (13,), covariance: (13, 13), in the units and the order above."""

    mean: Annotated[FloatArray, SHARED]
    covariance: Annotated[FloatArray, SHARED, SHARED]

    @property
    def sigma(self) -> FloatArray:
        """The standard deviations (13,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def with_information(self, information: FloatArray, gradient: FloatArray) -> Shared:
        """Return the Gaussian after adding a measurement: information (13, 13) and gradient (13,) at zero
        parameters."""
        before = np.linalg.inv(self.covariance)
        covariance = np.linalg.inv(before + information)
        return Shared(covariance @ (before @ self.mean - gradient), 0.5 * (covariance + covariance.T))


def by_data_sheet(odometry: OdometryConfig, sensor: TagSensorConfig, scanner: ScanConfig | None = None) -> Shared:
    """Return the parameters before the first frame: zero, with the deviations of the data sheets."""
    scanner, mount = scanner or ScanConfig(), sensor.mount_deviation
    camera = [sensor.yaw_deviation, mount, mount, sensor.clock_deviation, sensor.range_scale_deviation]
    mount = scanner.mount_deviation
    lidar = [scanner.yaw_deviation, mount, mount, scanner.clock_deviation, scanner.sweep_deviation]
    return exactly_known(np.concatenate([calibration_sigma(odometry), camera, lidar]))


@njit(cache=True)
def scale_of(unit: int, shared: FloatArray) -> float:
    """Return the length of a metre in a keyframe's unit for the parameters `shared` (13,)."""
    return 1.0 if unit == METRES else 1.0 + shared[unit]


def calibration_sigma(odometry: OdometryConfig) -> FloatArray:
    """Return the standard deviations (3,) of the odometry's parameters by the data sheet."""
    return np.array([odometry.distance_scale, odometry.gyro_bias, odometry.gyro_scale])


def exactly_known(sigma: FloatArray | None = None) -> Shared:
    """Return zero parameters with standard deviations sigma (13,), by default exactly known."""
    sigma = np.zeros(SHARED) if sigma is None else sigma
    return Shared(np.zeros(SHARED), np.diag(np.maximum(sigma, LEAST_SIGMA) ** 2))


def seen_from_body(detections: TagDetections, shared: Shared) -> TagDetections:
    """Return detections corrected for the expected range scale and camera's yaw, as seen by a camera that looks
    ahead."""
    return replace(
        detections,
        range=detections.range / (1.0 + shared.mean[RANGE_SCALE]),
        bearing=detections.bearing + shared.mean[CAMERA_YAW],
    )
