"""The simulation clock as set from the page: held, advanced by one stage, or at another rate."""

from __future__ import annotations


class Clock:
    """The requested state of the clock. It affects only when events happen: a simulation that was held gives the same
    result to the bit.

    rate: greatest number of simulated seconds per second, 0 for no limit. held: the clock stands. stepping: the clock
    stands from the next stage on. version: changes with every request.
    """

    def __init__(self, rate: float = 0.0) -> None:
        self.rate, self.held, self.version = rate, False, 0
        self.stepping, self._stage = False, 0

    def hold(self) -> None:
        """Stop the clock."""
        self.held, self.stepping = True, False
        self.version += 1

    def go(self) -> None:
        """Start the clock."""
        self.held = self.stepping = False
        self.version += 1

    def step(self) -> None:
        """Run until the next stage, then stop."""
        self.held, self.stepping = False, True
        self.version += 1

    def set_rate(self, rate: float) -> None:
        """Set the rate."""
        self.rate = rate
        self.version += 1

    def at_stage(self, stage: int) -> bool:
        """Note the stage of the mission, and return whether it ended a step."""
        ended = self.stepping and stage > self._stage
        self._stage = stage
        if ended:
            self.hold()
        return ended
