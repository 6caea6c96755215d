"""One odometry increment as a GTSAM factor on two poses and the odometry's calibration."""

from __future__ import annotations

import math

import gtsam
import numpy as np

from tfg_drake.messages import FloatArray
from tfg_drake.slam.odometry_model import predict_increment


def odometry_factor(
    before: int, after: int, calibration: int, increment: FloatArray, dt: float, noise: FloatArray
) -> gtsam.CustomFactor:
    """The motion between two Pose2 less the odometry corrected by the calibration (Vector3), in the frame of the first.

    before, after, calibration: keys. increment: (3,) of `odometry_model.arc`, over dt seconds. noise: (3,) of
    OdometryModel. The error is whitened.
    """
    covariance = predict_increment(increment, dt, np.zeros(3), noise)[2]
    whitener = np.linalg.inv(np.linalg.cholesky(covariance))

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[FloatArray] | None) -> FloatArray:
        X_0, X_1 = values.atPose2(before), values.atPose2(after)
        predicted, on_calibration, _covariance = predict_increment(increment, dt, values.atVector(calibration), noise)
        dx, dy, turn = X_1.x() - X_0.x(), X_1.y() - X_0.y(), X_1.theta() - X_0.theta()
        c, s = math.cos(X_0.theta()), math.sin(X_0.theta())
        x, y = c * dx + s * dy, -s * dx + c * dy
        if jacobians is not None:
            # Pose2 moves in its own frame: X (+) d = X Exp(d).
            jacobians[0] = whitener @ np.array([[-1.0, 0.0, y], [0.0, -1.0, -x], [0.0, 0.0, -1.0]])
            c, s = math.cos(turn), math.sin(turn)
            jacobians[1] = whitener @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            jacobians[2] = -whitener @ on_calibration
        heading = math.remainder(turn - predicted[2], 2.0 * math.pi)
        return np.asarray(whitener @ np.array([x - predicted[0], y - predicted[1], heading]))

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(3), [before, after, calibration], error)
