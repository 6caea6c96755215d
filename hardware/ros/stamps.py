"""The robot's ROS clock against the host's monotonic clock.

ROS stamps serve for order and age only. The offset is the least of host's arrival minus stamp, of the odometry (the
shortest way there is), tracked slowly because two quartzes drift apart. Where only sensors are heard it is theirs:
their stamps are then late by the least delay with which any of them arrives.
"""

from __future__ import annotations

import math
import time

# The clock is learned from this much odometry before anything is believed, s.
LEARN = 0.5
# The least offset is taken over the newest one to two spans of this, s.
SPAN = 10.0
# The offset changes no faster than this, s/s, so that stamps keep their order.
SLEW = 1e-3
# A stamp this far in the future, or before the one before it, is a jump of the clock, s.
JUMP = 0.25
# Odometry silent for longer is a new connection: the clock is learned anew, s.
SILENCE = 0.5
# The same of sensors alone, which may be slow, s.
SENSOR_SILENCE = 2.0
# The robot's clock may differ from the host's by this, s; what a camera sees may be this old when it arrives.
MAX_SKEW = 0.25
MAX_AGE = 0.5


class ClockJump(Exception):
    """The robot's clock was set, or a topic's is another one."""


class StampClock:
    """Brings ROS stamps to the host's monotonic clock."""

    def __init__(self, silence: float = SILENCE) -> None:
        """silence: s without a message to learn from, after which the clock is learned anew."""
        self._offset, self._source, self._silence = 0.0, "", silence
        self._reset()

    def _reset(self) -> None:
        self._least: dict[str, float] = {}
        self._last: dict[str, float] = {}
        self._began = self._heard = math.nan
        self._span_began, self._span, self._span_before = math.nan, math.inf, math.inf

    @property
    def ready(self) -> bool:
        """True if it is learned."""
        return self._heard - self._began >= LEARN

    def odometry(self, topic: str, stamp: float, arrival: float) -> float | None:
        """As `learn`, for the topic whose messages arrive at once."""
        self._source = topic
        return self.learn(topic, stamp, arrival)

    def learn(self, topic: str, stamp: float, arrival: float) -> float | None:
        """As `host`, for a topic that the clock is learned from."""
        if arrival - self._heard > self._silence:
            self._reset()
        dt = arrival - self._heard
        if not math.isfinite(self._began):
            self._began = self._span_began = arrival
        if arrival - self._span_began > SPAN:
            self._span_began, self._span_before, self._span = arrival, self._span, math.inf
        self._span = min(self._span, arrival - stamp)
        target = min(self._span, self._span_before)
        if not self.ready:
            self._offset = target
        elif arrival - stamp > self._offset - JUMP:
            self._offset += min(SLEW * dt, max(-SLEW * dt, target - self._offset))
        self._heard = arrival
        return self.host(topic, stamp, arrival)

    def host(self, topic: str, stamp: float, arrival: float) -> float | None:
        """The host's time, s, of a stamp that arrived at `arrival`; None where the clock is not learned yet, or the
        message is late: not newer than the one before it. Raises ClockJump, and starts to learn anew."""
        self._least[topic] = min(self._least.get(topic, math.inf), arrival - stamp)
        last = self._last.get(topic, -math.inf)
        if self.ready and (stamp < last - JUMP or stamp + self._offset > arrival + JUMP):
            self._reset()
            raise ClockJump(f"the clock of {topic} has jumped")
        self._last[topic] = max(last, stamp)
        return stamp + self._offset if self.ready and stamp > last else None

    def robot(self, now: float) -> float:
        """The ROS time, s, at the host's time `now`, as last learned."""
        return now - self._offset

    def skew(self) -> str | None:
        """Why the clocks differ too much to begin, in one line; None when they agree."""
        wall = time.time() - time.monotonic()
        for topic, least in self._least.items():
            behind = wall + least
            allowed = MAX_SKEW if behind < 0.0 or topic == self._source else MAX_AGE
            if abs(behind) > allowed:
                side = "behind" if behind > 0.0 else "ahead of"
                return (
                    f"{topic} is stamped {abs(behind):.2f} s {side} this computer's clock ({allowed} s are allowed); "
                    "synchronise both, with chrony for example"
                )
        return None
