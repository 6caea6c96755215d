"""Dead reckoning as wheel encoders and a gyro give it.

The state is one vector, so that it fits Drake's discrete state; its entries are named by the constants below.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.config import OdometryConfig, OdometryRealityConfig
from tfg_drake.messages import FloatArray, Odometry
from tfg_drake.simulation.differential_drive import UNMOVED

# Where the entries of the state begin: the time (s) it holds at, the true pose X_WB (3), the integrated pose X_OB (3),
# the measured forward speed and turn rate, whether the wheels stood, and how far they have rolled since the last
# tick of their encoders (m).
TIME, TRUTH, INTEGRATED, SPEED, TURN_RATE, AT_REST, UNCOUNTED = 0, 1, 4, 7, 8, 9, 10
STATE_SIZE = 11
# Motion below this turns no encoder by a tick, m and rad.
TICK = 1e-5


@njit(cache=True)
def _wrap(angle: float) -> float:
    return float(math.pi - (math.pi - angle) % (2.0 * math.pi))


@njit(cache=True)
def _integrate(
    state: FloatArray,
    stamp: float,
    pose: FloatArray,
    moved: FloatArray,
    errors: FloatArray,
    normal: FloatArray,
    distance_noise: float,
    gyro_noise: float,
    ticks_per_metre: float,
) -> FloatArray:
    duration = stamp - state[TIME]
    if duration <= 0.0:
        return state.copy()
    dx, dy = pose[0] - state[TRUTH], pose[1] - state[TRUTH + 1]
    cosine, sine = math.cos(state[TRUTH + 2]), math.sin(state[TRUTH + 2])
    # The wheels notice only what is not done to the base from outside, and the gyro not every turn of that.
    along, across = cosine * dx + sine * dy - moved[0], cosine * dy - sine * dx - moved[1]
    turned = _wrap(pose[2] - state[TRUTH + 2] - moved[2] + moved[3])
    scale = 1.0 + errors[0]
    slip = distance_noise * math.sqrt(math.hypot(along, across)) * normal[0]
    ahead, uncounted = scale * along + slip, 0.0
    if ticks_per_metre > 0.0:
        rolled = state[UNCOUNTED] + ahead
        ahead = math.floor(rolled * ticks_per_metre) / ticks_per_metre
        uncounted = rolled - ahead
    aside = scale * across
    turn = (1.0 + errors[2]) * turned + errors[1] * duration
    turn += gyro_noise * math.sqrt(duration) * normal[1]

    after = np.empty(STATE_SIZE)
    after[TIME], after[UNCOUNTED] = stamp, uncounted
    after[TRUTH : TRUTH + 3] = pose[:3]
    cosine, sine = math.cos(state[INTEGRATED + 2]), math.sin(state[INTEGRATED + 2])
    after[INTEGRATED] = state[INTEGRATED] + cosine * ahead - sine * aside
    after[INTEGRATED + 1] = state[INTEGRATED + 1] + sine * ahead + cosine * aside
    after[INTEGRATED + 2] = _wrap(state[INTEGRATED + 2] + turn)
    after[SPEED] = scale * pose[3]
    after[TURN_RATE] = turn / duration
    still = math.hypot(along, across) < TICK and abs(_wrap(turned - moved[3])) < TICK
    after[AT_REST] = 1.0 if still else 0.0
    return after


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
    ticks_per_metre = 0.0
    if reality is not None:
        ticks_per_metre = reality.ticks_per_metre
        errors = errors + np.array([reality.slip_per_turn_rate * abs(pose[4]), 0.0, 0.0])
    after: FloatArray = _integrate(
        state, stamp, pose, moved, errors, standard_normal, config.distance_noise, config.gyro_noise, ticks_per_metre
    )
    return after


def initial_state(X_WS: FloatArray) -> FloatArray:
    """The state (STATE_SIZE,) at time 0, at rest at X_WS (3,): X_OB = 0."""
    state = np.zeros(STATE_SIZE)
    state[TRUTH : TRUTH + 3] = X_WS
    return state


def message(state: FloatArray) -> Odometry:
    """What the state (STATE_SIZE,) says to the robot."""
    return Odometry(
        stamp=float(state[TIME]),
        X_OB=state[INTEGRATED : INTEGRATED + 3],
        V_B=state[SPEED : TURN_RATE + 1],
        at_rest=bool(state[AT_REST]),
    )
