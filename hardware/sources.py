"""Sources of tags and scans, and those that are made of others: the tags of several cameras, scans of sweeps."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

import numpy as np

from tfg_drake.geometry.sweep import Sweep, scan_of
from tfg_drake.messages import LaserScan, Odometry, TagDetections

T = TypeVar("T", LaserScan, Sweep, TagDetections)


class Source(Protocol):
    """Source of messages, such as a SensorSource."""

    def take(self, kind: type[T], until: float) -> list[T]:
        """The messages of a kind stamped `until` (s of the host's monotonic clock) or before, not taken yet."""

    def take_remarks(self) -> list[str]:
        """Lines for the operator since the last call."""

    def close(self) -> None:
        """Lets go of what it reads."""


class _MadeOf:
    """A source that is made of others."""

    def __init__(self, *sources: Source) -> None:
        self._sources = sources

    def take_remarks(self) -> list[str]:
        """Lines for the operator since the last call."""
        return [line for source in self._sources for line in source.take_remarks()]

    def close(self) -> None:
        """Lets go of them."""
        for source in self._sources:
            source.close()


class CamerasSource(_MadeOf):
    """Tags of several cameras as those of one: in order, one message a call, for what looks at them takes one at a
    time. Where they say more than is taken the oldest are missed, of each camera alike."""

    def __init__(self, cameras: Sequence[Source]) -> None:
        super().__init__(*cameras)
        self._waiting: list[TagDetections] = []
        self._given = -math.inf

    def take(self, kind: type[Any], until: float) -> list[Any]:
        """The oldest message stamped `until` (s) or before that was not taken yet, if there is one."""
        arrived = [one for camera in self._sources for one in camera.take(TagDetections, until)]
        # One that was longer on its way than another camera's next is of no use any more.
        waiting = [one for one in (*self._waiting, *arrived) if one.stamp > self._given]
        waiting.sort(key=lambda one: one.stamp)
        self._waiting = waiting[-len(self._sources) :]
        if not self._waiting:
            return []
        oldest = self._waiting.pop(0)
        self._given = oldest.stamp
        return [oldest]


class SweepSource(_MadeOf):
    """Scans of a scanner that turns while the robot moves: its sweeps, undone by what the robot's odometry said."""

    def __init__(self, sweeps: Source, odometry: Callable[[float], Odometry | None]) -> None:
        """odometry: the message nearest to a time, s; None where there is none."""
        super().__init__(sweeps)
        self._odometry = odometry

    def take(self, kind: type[Any], until: float) -> list[Any]:
        """The scans stamped `until` (s) or before that were not taken yet, in order."""
        scans = []
        for sweep in self._sources[0].take(Sweep, until):
            odometry = self._odometry(sweep.stamp)
            scans.append(scan_of(sweep, np.zeros(2) if odometry is None else odometry.V_B))
        return scans
