"""Plausibility rules for wheel odometry, live and recorded, message by message.

Speeds are limited, and the pose jumps no farther than stamps and lost messages explain. A message that violates this
means that the base was restarted, its wheels slipped or messages are missing: the odometry then continues from the last
pose with the last velocity, and the motion in between is unknown. The code uses plain numbers, as a robot's driver must
not wait for kernels.
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, Odometry, message, replace
from tfg_drake.notes import Note

# The greatest velocity of any ground robot, m/s and rad/s.
FASTEST, FASTEST_TURN = 5.0, 20.0
# The expected limit: these velocities, m/s and rad/s, or TWIST_SHARE times the previous one, if that is more.
USUAL, USUAL_TURN, TWIST_SHARE = 1.5, 2.0 * math.pi, 1.5
# Motion in excess of the expected limit, summed, is a jump from here on, m and rad: stamps are late and messages get
# lost.
LEAP, LEAP_TURN = 0.5, 0.5
# A single step longer than this, m, is a jump if it is faster than FASTEST.
SUDDEN = 0.15
# A LEAP or LEAP_TURN in more than SILENCE, s, is unknown motion. Over a jump velocity is held for at most HELD, s.
SILENCE, HELD = 2.0, 1.0


@message
class WatchedOdometry:
    """The newest odometry as received and as passed on; X_OR (3,): pose, in the odometry frame, of the frame of the
    received odometry. beyond: (2,) m and rad, the motion in excess of the speed limits."""

    told: Odometry | None = None
    believed: Odometry | None = None
    X_OR: tuple[float, float, float] = (0.0, 0.0, 0.0)
    beyond: tuple[float, float] = (0.0, 0.0)


def watch(
    state: WatchedOdometry, told: Odometry, silence: float = SILENCE
) -> tuple[WatchedOdometry, Odometry | None, Note | None]:
    """Return the state after a message; the corrected message, itself if it is plausible, None if it is not newer than
    the last or not finite; and a note on what was corrected.

    silence: s without a message, after which the way between is unknown if the robot has moved.
    """
    before, believed = state.told, state.believed
    if not all(math.isfinite(value) for value in (told.stamp, *told.X_OB)):
        return state, None, Note("odometry", told.stamp, "odometry is no number; it is left out")
    if before is not None and told.stamp <= before.stamp:
        return state, None, None
    dt = told.stamp - (told if before is None else before).stamp
    step = np.zeros(3) if before is None else se2.between(before.X_OB, told.X_OB)
    passed, note = told, None
    if not (abs(told.V_B[0]) <= FASTEST and abs(told.V_B[1]) <= FASTEST_TURN):
        text = f"odometry tells {told.V_B[0]:g} m/s and {told.V_B[1]:g} rad/s; the way between its poses serves"
        note = Note("speed", told.stamp, text)
        passed = replace(told, V_B=velocity(step, dt))
    if before is None or believed is None:
        return WatchedOdometry(told, passed), passed, note
    far, turned = math.hypot(step[0], step[1]), abs(step[2])
    fastest, fastest_turn = (TWIST_SHARE * abs(float(value)) for value in believed.V_B)
    beyond = (
        max(0.0, state.beyond[0] + far - min(max(USUAL, fastest), FASTEST) * dt),
        max(0.0, state.beyond[1] + turned - min(max(USUAL_TURN, fastest_turn), FASTEST_TURN) * dt),
    )
    X_OR, unknown = state.X_OR, False
    if beyond[0] > LEAP or beyond[1] > LEAP_TURN or far > max(SUDDEN, FASTEST * dt):
        ahead, turn = believed.V_B * min(dt, HELD)
        way = np.array([ahead * math.cos(0.5 * turn), ahead * math.sin(0.5 * turn), turn])
        X_OB = se2.compose(believed.X_OB, way)
        x, y, _ = se2.compose(np.array([0.0, 0.0, X_OB[2] - told.X_OB[2]]), told.X_OB)
        X_OR, beyond, unknown = (X_OB[0] - x, X_OB[1] - y, X_OB[2] - told.X_OB[2]), state.beyond, True
        passed = replace(passed, V_B=believed.V_B)
        text = f"odometry jumps by {far:.1f} m and {math.degrees(turned):.0f} degrees"
        note = Note("jump", told.stamp, text)
    elif dt > silence and (far > LEAP or turned > LEAP_TURN):
        unknown = True
        note = Note("silence", told.stamp, f"no odometry for {dt:.1f} s while the robot moves")
    if X_OR != (0.0, 0.0, 0.0):
        passed = replace(passed, X_OB=se2.compose(np.array(X_OR), told.X_OB))
    if breaks := believed.breaks + unknown:
        passed = replace(passed, breaks=breaks, at_rest=passed.at_rest and not unknown)
    return WatchedOdometry(told, passed, X_OR, beyond), passed, note


def velocity(step: FloatArray, dt: float) -> FloatArray:
    """Return V_B (2,), limited to plausible values, of a step (3,) in the frame where it began, dt s long."""
    middle = 0.5 * step[2]
    ahead = math.copysign(math.hypot(step[0], step[1]), math.cos(middle) * step[0] + math.sin(middle) * step[1])
    most = np.array([FASTEST, FASTEST_TURN])
    return np.clip(np.array([ahead, step[2]]) / max(dt, 1e-3), -most, most)
