"""Dead reckoning as wheel encoders and a gyro give it.

The state is one vector, so that it fits Drake's discrete state; its entries are named by the constants below.
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.config import OdometryConfig, OdometryRealityConfig
from tfg_drake.messages import FloatArray, Odometry
from tfg_drake.simulation.differential_drive import UNMOVED

# Where the entries of the state begin: the time (s) it holds at, the true pose X_WB (3), the integrated pose X_OB (3),
# the measured forward speed and turn rate, whether the wheels stood, and how far they have rolled since the last
# tick of their encoders (m).
TIME, TRUTH, INTEGRATED, SPEED, TURN_RATE, AT_REST, UNCOUNTED = 0, 1, 4, 7, 8, 9, 10
STATE_SIZE = 11
# Motion below this is less than an encoder tick, m and rad.
TICK = 1e-5


def run_errors(standard_normal: FloatArray, config: OdometryConfig) -> FloatArray:
    """The errors that stay constant over a run, from (3,) standard normal numbers.

    Returns (3,): relative scale error of distance, gyro bias (rad/s), relative scale error of the gyro. The
    configuration holds their standard deviations.
    """
    errors: FloatArray = standard_normal * np.array([config.distance_scale, config.gyro_bias, config.gyro_scale])
    return errors


def integrate(
    state: FloatArray,
    stamp: float,
    pose: FloatArray,
    errors: FloatArray,
    standard_normal: FloatArray,
    config: OdometryConfig,
    moved: FloatArray = UNMOVED,
    reality: OdometryRealityConfig | None = None,
) -> FloatArray:
    """The state (STATE_SIZE,) at stamp (s), some time after the one given.

    pose: (5,) true x, y, theta of X_WB, forward speed and turn rate. errors: (3,) from run_errors. standard_normal:
    (2,) numbers, fresh every time. The distance takes the scale error and a random walk that grows with distance; the
    heading takes the gyro's scale error, its bias and a random walk that grows with time. The random walk of distance
    is slip, which the wheels' speed does not show; a robot that stands turns no wheel. moved: how far something else
    has moved the base meanwhile, see tfg_drake.simulation.disturbance.displacement. reality: what encoders and wheels
    do besides: distance comes in whole ticks, and grows in turns, where wheels slip. Before any time has passed the
    state stays as it is.
    """
    duration = stamp - float(state[TIME])
    if duration <= 0.0:
        return state.copy()
    scale_error, gyro_bias, gyro_scale = errors.tolist()
    if reality is not None:
        scale_error += reality.slip_per_turn_rate * abs(float(pose[4]))
    x, y, theta, east, north, heading = state[TRUTH : INTEGRATED + 3].tolist()
    ahead_moved, aside_moved, turn_moved, turn_noticed = moved.tolist()
    dx, dy = float(pose[0]) - x, float(pose[1]) - y
    cosine, sine = math.cos(theta), math.sin(theta)
    # The wheels notice only what is not done to the base from outside, and the gyro not every turn of that.
    along, across = cosine * dx + sine * dy - ahead_moved, cosine * dy - sine * dx - aside_moved
    turned = _wrap(float(pose[2]) - theta - turn_moved + turn_noticed)
    scale, way = 1.0 + scale_error, float(np.hypot(along, across))
    ahead, uncounted = scale * along + config.distance_noise * math.sqrt(way) * float(standard_normal[0]), 0.0
    if reality is not None and reality.ticks_per_metre > 0.0:
        rolled = float(state[UNCOUNTED]) + ahead
        ahead = math.floor(rolled * reality.ticks_per_metre) / reality.ticks_per_metre
        uncounted = rolled - ahead
    aside = scale * across
    turn = (1.0 + gyro_scale) * turned + gyro_bias * duration
    turn += config.gyro_noise * math.sqrt(duration) * float(standard_normal[1])
    cosine, sine = math.cos(heading), math.sin(heading)
    X_OB = east + cosine * ahead - sine * aside, north + sine * ahead + cosine * aside, _wrap(heading + turn)
    still = way < TICK and abs(_wrap(turned - turn_noticed)) < TICK
    return np.array([stamp, *pose[:3], *X_OB, scale * float(pose[3]), turn / duration, still, uncounted])


def _wrap(angle: float) -> float:
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


def initial_state(X_WS: FloatArray) -> FloatArray:
    """The state (STATE_SIZE,) at time 0, at rest at X_WS (3,): X_OB = 0."""
    state = np.zeros(STATE_SIZE)
    state[TRUTH : TRUTH + 3] = X_WS
    return state


def message(state: FloatArray) -> Odometry:
    """The message of a state (STATE_SIZE,)."""
    return Odometry(
        stamp=float(state[TIME]),
        X_OB=state[INTEGRATED : INTEGRATED + 3],
        V_B=state[SPEED : TURN_RATE + 1],
        at_rest=bool(state[AT_REST]),
    )
