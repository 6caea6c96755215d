"""The odometry model: the motion of an increment, its Jacobian on the calibration and its covariance.

The measured distance is (1 + s) times the true one plus a random walk, the measured turn (1 + g) times the true one
plus a bias b times the time plus a random walk. The calibration c = (s, b, g) is among the shared parameters.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, Odometry, message

# At rest errors accrue at this share of their rate in motion, as a robot may turn by less than an encoder's tick: 0.3
# mrad in half a minute, where one tick of a Kobuki's wheel is 0.4 mrad.
REST_SHARE = 0.0001
# Deviations of a motion that is extrapolated by the previous velocity: a constant, m, m, rad, and their growth, m/s,
# m/s, rad/s.
BREAK, BREAK_RATE = np.array([0.02, 0.02, 0.02]), np.array([0.5, 0.5, 1.0])


def random_walks(config: OdometryConfig) -> FloatArray:
    """Return random walks (3,) of distance (m per root m), heading (rad per root s) and position (m per root s)."""
    return np.array([config.distance_noise, max(config.gyro_noise, 1e-6), config.position_noise])


@njit(cache=True)
def wrap(angle: float) -> float:
    """The angle (rad) in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)


@njit(cache=True)
def arc(X_OB0: FloatArray, X_OB1: FloatArray) -> FloatArray:
    """Return the increment (u, v, dtheta) between two poses: the chord (m) in the direction at half the turn dtheta
    (rad).

    On the arc of a differential drive v is zero.
    """
    dx, dy = X_OB1[0] - X_OB0[0], X_OB1[1] - X_OB0[1]
    dtheta = wrap(X_OB1[2] - X_OB0[2])
    middle = X_OB0[2] + 0.5 * dtheta
    c, s = math.cos(middle), math.sin(middle)
    return np.array([c * dx + s * dy, -s * dx + c * dy, dtheta])


@message
class DeadReckoning:
    """Odometry as the estimator uses it: the gyro is ignored while no wheel turns.

    stamp: s. clock: s since the first message, the time in which errors accrue: that of motion and a little of the
    rest. X_OB: (3,) and V_B: (2,) as in Odometry.
    """

    stamp: float
    clock: float
    X_OB: FloatArray
    V_B: FloatArray


def first_reckoning(odometry: Odometry) -> DeadReckoning:
    """Return the dead reckoning at the first odometry message.

    Its clock begins at 0, as a moment of rest would be lost in rounding beside the seconds since 1970.
    """
    return DeadReckoning(stamp=odometry.stamp, clock=0.0, X_OB=odometry.X_OB, V_B=odometry.V_B)


def reckon(last: DeadReckoning, before: Odometry, after: Odometry) -> DeadReckoning:
    """Return the dead reckoning after one more message: `last` was made from `before`, and `after` follows."""
    dt = after.stamp - before.stamp
    if after.at_rest:
        return DeadReckoning(after.stamp, last.clock + REST_SHARE * dt, last.X_OB, np.zeros(2))
    X_OB = se2.compose(last.X_OB, se2.between(before.X_OB, after.X_OB))
    return DeadReckoning(after.stamp, last.clock + dt, X_OB, after.V_B)


def reckoned_at(before: DeadReckoning, after: DeadReckoning, stamp: float) -> DeadReckoning:
    """Return the dead reckoning at a stamp between two."""
    span = after.stamp - before.stamp
    share = (stamp - before.stamp) / span if span > 0.0 else 1.0
    clock = before.clock + share * (after.clock - before.clock)
    return DeadReckoning(stamp, clock, interpolate(before, after, stamp), after.V_B)


def interpolate(before: Odometry | DeadReckoning, after: Odometry | DeadReckoning, stamp: float) -> FloatArray:
    """Return X_OB (3,) at a stamp between two messages, with a constant twist between them."""
    span = after.stamp - before.stamp
    share = (stamp - before.stamp) / span if span > 0.0 else 1.0
    return np.asarray(_along(before.X_OB, after.X_OB, share))


@njit(cache=True)
def _along(X_OB0: FloatArray, X_OB1: FloatArray, share: float) -> FloatArray:
    """The pose at a share of the arc between two."""
    u, v, dtheta = arc(X_OB0, X_OB1)
    half = 0.5 * dtheta
    scale = math.sin(share * half) / math.sin(half) if abs(half) > 1e-9 else share
    c, s = math.cos(share * half) * scale, math.sin(share * half) * scale
    dx, dy = c * u - s * v, s * u + c * v
    c, s = math.cos(X_OB0[2]), math.sin(X_OB0[2])
    return np.array([X_OB0[0] + c * dx - s * dy, X_OB0[1] + s * dx + c * dy, wrap(X_OB0[2] + share * dtheta)])


@njit(cache=True)
def predict_increment(
    increment: FloatArray, dt: float, calibration: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the motion X_B0B1 (3,) of a measured arc, its Jacobian on the calibration and its random covariance.

    increment: (3,) of `arc`. dt: s. calibration: (3,) s, b, g. noise: (3,) of `random_walks`. Returns X_B0B1, (3, 3)
    Jacobian on (s, b, g), and the (3, 3) covariance of (x, y) in B0 and theta. The heading drifts during the increment,
    so its noise also moves the end sideways.
    """
    scale = 1.0 / (1.0 + calibration[0])
    gyro = 1.0 / (1.0 + calibration[2])
    turn = (increment[2] - calibration[1] * dt) * gyro
    c, s = math.cos(0.5 * turn), math.sin(0.5 * turn)
    u, v = increment[0] * scale, increment[1] * scale
    X = np.array([c * u - s * v, s * u + c * v, turn])
    on_turn = np.array([-0.5 * X[1], 0.5 * X[0], 1.0])
    jacobian = np.empty((3, 3))
    jacobian[0, 0], jacobian[1, 0], jacobian[2, 0] = -X[0] * scale, -X[1] * scale, 0.0
    for i in range(3):
        jacobian[i, 1] = -on_turn[i] * dt * gyro
        jacobian[i, 2] = -on_turn[i] * turn * gyro
    length = math.sqrt(u * u + v * v)
    heading = noise[1] * noise[1] * dt
    floor = noise[2] * noise[2] * dt
    along = noise[0] * noise[0] * length + floor
    across = heading * length * length / 3.0 + floor
    coupling = 0.5 * heading * length
    direction_x, direction_y = (X[0] / length, X[1] / length) if length > 0.0 else (1.0, 0.0)
    covariance = np.empty((3, 3))
    covariance[0, 0] = along * direction_x * direction_x + across * direction_y * direction_y
    covariance[1, 1] = along * direction_y * direction_y + across * direction_x * direction_x
    covariance[0, 1] = covariance[1, 0] = (along - across) * direction_x * direction_y
    covariance[0, 2] = covariance[2, 0] = -coupling * direction_y
    covariance[1, 2] = covariance[2, 1] = coupling * direction_x
    covariance[2, 2] = heading
    return X, jacobian, covariance
