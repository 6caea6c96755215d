"""Sweeps of an RPLidar's rays.

An A1 turns five times a second. A sweep is made every half turn, of the rays of the last whole turn, so that no scan is
old when the next one comes.
"""

from __future__ import annotations

import collections
import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from tfg_drake.config import RobotScannerConfig
from tfg_drake.geometry.sweep import Sweep
from tfg_drake.hardware.rplidar.codec import Node

# Greatest range by model, least range of all models, and standard deviation of a range, m.
RANGES, LEAST_RANGE, SIGMA = {1: 12.0, 2: 12.0, 3: 25.0}, 0.15, 0.02
# A revolution has at least _FEWEST rays.
_FEWEST = 30
# Number of revolutions whose arrivals are kept: four seconds of an A1.
_REMEMBERED = 24
# An earlier revolution was lost if _IN_A_ROW in a row arrive late by more than the share _LATE of a revolution.
_LATE, _IN_A_ROW = 0.5, 5


class TurnClock:
    """Estimates the begin of turns from the arrival of their first rays: the motor turns evenly, but bytes are delayed.

    It fits the highest line below the arrivals (Moon, Skelly, Towsley 1999): those without a delay determine it,
    however late the others are. Times are s."""

    def __init__(self) -> None:
        self._arrivals: collections.deque[float] = collections.deque(maxlen=_REMEMBERED)
        self._late = 0

    def mark(self, arrival: float) -> tuple[float, float] | None:
        """Return begin and period of the turn whose first ray has arrived at `arrival`, None if not known yet.

        Arrivals do not decrease.
        """
        self._arrivals.append(arrival)
        arrivals = np.array(self._arrivals)
        if len(arrivals) < 2:
            return None
        # Of the lines through two arrivals that lie above no arrival, the one with the highest mean.
        turn = np.arange(len(arrivals))
        one, other = np.triu_indices(len(arrivals), 1)
        periods = (arrivals[other] - arrivals[one]) / (other - one)
        lines = arrivals[one, None] + periods[:, None] * (turn - one[:, None])
        passes = (lines <= arrivals + 1e-9).all(axis=1)
        best = int(np.where(passes, lines.mean(axis=1), -math.inf).argmax())
        period, began = float(periods[best]), float(lines[best, -1])
        self._late = self._late + 1 if arrival - began > _LATE * period else 0
        if self._late >= _IN_A_ROW:
            self._late = 0
            self._arrivals.clear()
            self._arrivals.append(arrival)
            return None
        return (began, period) if period > 0.0 else None


class SweepMaker:
    """Makes sweeps of rays as they arrive."""

    def __init__(self, mount: RobotScannerConfig, model: int) -> None:
        """model: as returned by tfg_drake.hardware.rplidar.codec.model."""
        self._mount, self._range_max = mount, RANGES.get(model, min(RANGES.values()))
        self._clock = TurnClock()
        # Begin and period of this turn, s; None if not known.
        self._turn: tuple[float, float] | None = None
        # Nodes of this revolution and of the previous one.
        self._nodes: list[Node] = []
        self._before: list[Node] = []

    def add(self, nodes: Sequence[Node], arrival: float) -> list[Sweep]:
        """Return the sweeps that are complete with rays which arrived at `arrival`, s."""
        sweeps = []
        for node in nodes:
            over = node.begins or (self._nodes and node.angle < self._nodes[-1].angle - math.pi)
            # Angles waver near the full turn, and the first ray of a turn may be lost.
            if over and not 0 < len(self._nodes) < _FEWEST:
                sweeps += self._turn_over(arrival)
            elif self._nodes and self._nodes[-1].angle < math.pi <= node.angle:
                sweeps += self._half_over()
            self._nodes.append(node)
        return sweeps

    def _turn_over(self, arrival: float) -> list[Sweep]:
        """Return the sweep of the turn that ends with the ray that arrived at `arrival`, s, if it is complete."""
        before = self._turn
        self._before, self._nodes, self._turn = self._nodes, [], self._clock.mark(arrival)
        if before is None or self._turn is None:
            self._before = []  # the turn was not seen from its beginning
            return []
        began, period = self._turn
        return [self._sweep(self._before, math.pi, began - 0.5 * period, period)]

    def _half_over(self) -> list[Sweep]:
        """Return the sweep of this turn's first half and the previous one's second half, if they are known."""
        if self._turn is None or not self._before:
            return []
        last = [one for one in self._before if one.angle >= math.pi]
        nodes = [*(dataclasses.replace(one, angle=one.angle - 2.0 * math.pi) for one in last), *self._nodes]
        return [self._sweep(nodes, 0.0, *self._turn)]

    def _sweep(self, nodes: list[Node], middle: float, stamp: float, period: float) -> Sweep:
        """Return the sweep of a turn's rays. period: of the turn, s. stamp: when it was at the angle middle (rad),
        s."""
        angles = np.array([node.angle for node in nodes])
        ranges = np.array([node.range for node in nodes])
        ranges[ranges < LEAST_RANGE] = math.nan
        ranges[ranges > self._range_max] = math.inf
        return Sweep(
            stamp=stamp,
            directions=self._mount.yaw + (angles if self._mount.flip else -angles),
            ranges=ranges,
            after=period * (angles - middle) / (2.0 * math.pi),
            x=self._mount.x,
            y=self._mount.y,
            range_max=self._range_max,
            sigma=SIGMA,
        )
