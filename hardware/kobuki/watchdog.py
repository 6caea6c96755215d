"""What the base may be told to do: the rules of the driver, apart from its wires.

Source: kobuki_node's command timeout, kobuki_core's limits and "alive" check; the base itself stops on nothing.
"""

from __future__ import annotations

import math

from tfg_drake.hardware.kobuki.link import Request
from tfg_drake.hardware.kobuki.payloads import CoreSensors
from tfg_drake.hardware.watchdog import Limits

# The wheels have been told to stop 0.6 s after the last command; the loop and the wire need their part of that, s.
COMMAND_TIMEOUT = 0.55
# The base has been silent for so long that nobody knows what it does, s.
FEEDBACK_TIMEOUT = 0.2


def allowed_velocity(
    before: tuple[float, float],
    wanted: Request | None,
    now: float,
    heard: float,
    core: CoreSensors | None,
    limits: Limits,
    period: float,
) -> tuple[float, float]:
    """Forward speed (m/s) and turn rate (rad/s) for the next period (s) of an enabled base.

    before: the velocity of the last period. wanted: the newest command. now, and heard, when the newest frame came: s.
    core: what that frame said. The base stops at once without a command younger than COMMAND_TIMEOUT, without feedback
    younger than FEEDBACK_TIMEOUT, where the command is not finite and while a wheel hangs. While the bumper is pressed
    or there is a cliff it does not go forward. Otherwise it follows the command within the limits.
    """
    if wanted is None or core is None or core.wheel_drop:
        return 0.0, 0.0
    if now - wanted.stamp > COMMAND_TIMEOUT or now - heard > FEEDBACK_TIMEOUT:
        return 0.0, 0.0
    if not (math.isfinite(wanted.speed) and math.isfinite(wanted.turn_rate)):
        return 0.0, 0.0
    speed = _towards(before[0], wanted.speed, limits.speed, limits.acceleration * period)
    turn_rate = _towards(before[1], wanted.turn_rate, limits.turn_rate, limits.turn_acceleration * period)
    return min(speed, 0.0) if core.bumper or core.cliff else speed, turn_rate


def _towards(value: float, target: float, limit: float, change: float) -> float:
    """The value moved towards the target, the target kept within +-limit and the step within +-change."""
    target = min(limit, max(-limit, target))
    return value + min(change, max(-change, target - value))
