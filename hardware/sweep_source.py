"""Scans of a scanner that turns while the robot moves: its sweeps, undone by the robot's own odometry."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tfg_drake.geometry.sweep import Sweep, scan_of
from tfg_drake.hardware.sensor import Source
from tfg_drake.messages import FloatArray, Odometry


class SweepSource:
    """A source of scans made of another's sweeps, by what the robot's odometry said at the time."""

    def __init__(self, sweeps: Source, odometry: Callable[[float], Odometry | None]) -> None:
        """odometry: the message nearest to a time, s; None where there is none."""
        self._sweeps, self._odometry = sweeps, odometry

    def take(self, kind: type[Any], until: float) -> list[Any]:
        """The scans stamped `until` (s) or before that were not taken yet, in order."""
        return [scan_of(sweep, self._velocity(sweep.stamp)) for sweep in self._sweeps.take(Sweep, until)]

    def take_remarks(self) -> list[str]:
        """Lines for the operator since the last call."""
        return self._sweeps.take_remarks()

    def close(self) -> None:
        """Lets go of the scanner."""
        self._sweeps.close()

    def _velocity(self, stamp: float) -> FloatArray:
        odometry = self._odometry(stamp)
        return np.zeros(2) if odometry is None else odometry.V_B
