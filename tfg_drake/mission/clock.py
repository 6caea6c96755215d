"""The clock of a mission, as somebody who looks on wants it to go: held, one stage at a time, at another speed."""

from __future__ import annotations


class Clock:
    """State asked of the clock. It changes when something happens, never what: a held simulation goes on to the bit.

    rate: simulated seconds a second at most, 0 for no limit. held: the clock stands. stepping: it will at the next
    stage. version: another number whenever something was asked for.
    """

    def __init__(self, rate: float = 0.0) -> None:
        self.rate, self.held, self.version = rate, False, 0
        self.stepping, self._stage = False, 0

    def hold(self) -> None:
        """Stand."""
        self.held, self.stepping = True, False
        self.version += 1

    def go(self) -> None:
        """Go on."""
        self.held = self.stepping = False
        self.version += 1

    def step(self) -> None:
        """Go on until the next stage, then stand."""
        self.held, self.stepping = False, True
        self.version += 1

    def set_rate(self, rate: float) -> None:
        """Go at another speed."""
        self.rate = rate
        self.version += 1

    def at_stage(self, stage: int) -> bool:
        """Takes note of the stage that the mission is in; whether that was the end of a step."""
        ended = self.stepping and stage > self._stage
        self._stage = stage
        if ended:
            self.hold()
        return ended
