"""Ground truth of a simulated mission."""

from __future__ import annotations

import math

import numpy as np
from pydrake.systems.framework import Context, System
from pydrake.systems.primitives import VectorLogSink

from tfg_drake.messages import FloatArray
from tfg_drake.world.changing import WorldNow
from tfg_drake.world.world import World


class Truth:
    """Reads the truth ports of a simulated station.

    contacts: so far with walls, and with people whom the robot moved towards. contacts_received: those that people
    made, or walls while it was pushed. clearance: least distance of the outline to any wall so far, m. All as of the
    last look; None and inf of a station that tells no more than its pose.
    """

    def __init__(self, station: System, log: VectorLogSink) -> None:
        """log: of the station's truth.pose."""
        self._station, self._log = station, log
        self.contacts: int | None = 0
        self.contacts_received: int | None = 0
        self.clearance = math.inf

    def look(self, root: Context) -> None:
        """Takes note of contacts and clearance, so that they are known when the diagram has failed."""
        self.contacts = self._count("truth.contacts", root)
        self.contacts_received = self._count("truth.contacts_received", root)
        if self._station.HasOutputPort("truth.clearance"):
            self.clearance = float(self._eval("truth.clearance", root)[0])

    def world(self, root: Context) -> World | None:
        """The world as it is, None where nothing changes in it."""
        if not self._station.HasOutputPort("truth.world"):
            return None
        now = self._station.GetOutputPort("truth.world").Eval(self._station.GetMyContextFromRoot(root))
        assert isinstance(now, WorldNow)
        return now.world

    def pose(self, root: Context) -> FloatArray:
        """The robot's X_WB (3,), m and rad."""
        return self._eval("truth.pose", root)[:3]

    def poses(self, root: Context, end_time: float) -> tuple[FloatArray, FloatArray]:
        """Stamps (n,) in s and true poses X_WB (n, 3), one an odometry period, up to the end (s)."""
        log = self._log.FindLog(root)
        stamps, data = log.sample_times(), log.data()
        lived = stamps <= end_time
        return stamps[lived], data[:3, lived].T

    def _count(self, port: str, root: Context) -> int | None:
        return int(self._eval(port, root)[0]) if self._station.HasOutputPort(port) else None

    def _eval(self, port: str, root: Context) -> FloatArray:
        return np.asarray(self._station.GetOutputPort(port).Eval(self._station.GetMyContextFromRoot(root)))
