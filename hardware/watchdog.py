"""Guards the wheels: limits every command, and sends zero velocity on any fault.

It runs in the process that sends the commands, by the host's monotonic clock (s).
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Annotated

from tfg_drake.constraints import Bounds, Positive
from tfg_drake.hardware.process import TICK
from tfg_drake.messages import Hazards
from tfg_drake.mission.operation import stopped_by
from tfg_drake.slam.odometry_rules import FASTEST, FASTEST_TURN

# The velocity is zero if the newest command is older than SILENCE, s; likewise if odometry is, then until the robot is
# enabled again. With a tick and transmission the robot stops within 0.6 s.
SILENCE = 0.5
# A base's own alarm stops it after LASTING, s: a starting wheel or a garbled frame is no alarm.
LASTING = 0.2
# Reasons to be locked that any other reason replaces.
_NOT_ENABLED = "not enabled yet"
_NO_ODOMETRY = f"no odometry for more than {SILENCE} s"


@dataclasses.dataclass(frozen=True)
class Limits:
    """Limits on a command: m/s, rad/s, m/s^2, rad/s^2."""

    speed: Annotated[float, Bounds(0.0, FASTEST)] = 0.3
    turn_rate: Annotated[float, Bounds(0.0, FASTEST_TURN)] = 1.5
    acceleration: Positive = 0.5
    turn_acceleration: Positive = 3.5


class Watchdog:
    """Holds the newest command and determines the velocity to send; locked until enabled.

    Without a fresh, finite command it stops at once, and goes on with the next one. A wheel drop and a cliff lock it,
    and so do lasting alarms of charger, battery and current. While the bumper is pressed it turns and backs, but does
    not go forward.
    """

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._locked: str | None = _NOT_ENABLED
        self._command, self._sent = (0.0, 0.0), -math.inf
        self._heard = -math.inf
        self._hazard: str | None = None
        # Reason and begin, s, of each alarm, by kind; None before the base's first state.
        self._alarms: dict[str, tuple[str, float]] | None = None
        self._blocked = False
        self._velocity, self._when = (0.0, 0.0), -math.inf

    @property
    def locked(self) -> str | None:
        """Why the robot may not move; None if it may."""
        return self._locked

    def hear(self, when: float) -> None:
        """Take note of odometry stamped `when`."""
        self._heard = when

    def hear_hazards(self, hazards: Hazards) -> None:
        """Take in the base's hazards, which hold until its next message."""
        self._hazard, self._blocked = stopped_by(hazards), hazards.bumper != 0
        if self._hazard is not None:
            self.lock(self._hazard)

    def hear_alarms(self, alarms: Mapping[str, str], now: float) -> None:
        """Take in why the base must not drive by its state at `now`, s, by kind of reason."""
        # Alarms of the first state count as lasting.
        since, before = (-math.inf, {}) if self._alarms is None else (now, self._alarms)
        self._alarms = {kind: (why, before[kind][1] if kind in before else since) for kind, why in alarms.items()}

    def lock(self, reason: str) -> None:
        """Send zero velocity from now on, until `enable`. The first reason counts that says more than "no odometry"."""
        if self._locked in (None, _NOT_ENABLED, _NO_ODOMETRY):
            self._locked = reason

    def enable(self, now: float) -> None:
        """Let the following commands through, unless odometry is stale, a wheel hangs or there is a cliff; earlier
        commands are discarded."""
        self._sent = -math.inf
        self._locked = self._hazard
        self._check(now)

    def command(self, sent: float, speed: float, turn_rate: float) -> None:
        """Take in a command, m/s and rad/s, given at `sent`. One that is not finite counts as zero."""
        finite = math.isfinite(speed) and math.isfinite(turn_rate)
        self._command, self._sent = (speed, turn_rate) if finite else (0.0, 0.0), sent if finite else -math.inf

    def velocity(self, now: float) -> tuple[float, float]:
        """Return the velocity to send, m/s and rad/s: within the limits of speed and acceleration, or zero at once.

        Braking is not limited: a command to stop may be urgent.
        """
        # After a gap of more than SILENCE between calls the robot's motion in between is unknown.
        if SILENCE < now - self._when < math.inf:
            self._heard = -math.inf
        self._check(now)
        dt, self._when = min(max(0.0, now - self._when), 2.0 * TICK), now
        if self._locked is not None or not now - self._sent <= SILENCE:
            self._velocity = (0.0, 0.0)
        else:
            (v, w), limits = self._velocity, self._limits
            v = _towards(_bounded(self._command[0], limits.speed), v, limits.acceleration * dt)
            w = _towards(_bounded(self._command[1], limits.turn_rate), w, limits.turn_acceleration * dt)
            self._velocity = (min(v, 0.0) if self._blocked else v, w)
        return self._velocity

    def _check(self, now: float) -> None:
        for why, since in (self._alarms or {}).values():
            if now - since >= LASTING:
                self.lock(why)
        if not now - self._heard <= SILENCE:
            self._locked = self._locked or _NO_ODOMETRY


def _towards(target: float, value: float, change: float) -> float:
    """Return the target, or the value nearest to it that speeds up by at most `change`."""
    slower = min(abs(target), abs(value)) if target * value > 0.0 else 0.0
    begin = math.copysign(slower, target)
    return begin + _bounded(target - begin, change)


def _bounded(value: float, bound: float) -> float:
    return min(bound, max(-bound, value))
