"""The station's time against the host's: a simulator at real-time rate 1 keeps both in step."""

from __future__ import annotations

import logging
import time

_log = logging.getLogger("tfg_drake.host_clock")


class HostClock:
    """Starts when it is first asked; all systems of a station share one. Real time is nobody's state."""

    def __init__(self) -> None:
        self._origin: float | None = None

    def host(self, station_time: float) -> float:
        """The host's monotonic time, s, at a time of the station, s."""
        return self._started(station_time) + station_time

    def station(self, stamp: float, now: float) -> float:
        """The station's time, s, at a host's monotonic time; now: the station's, s."""
        return stamp - self._started(now)

    def _started(self, station_time: float) -> float:
        if self._origin is None:
            self._origin = time.monotonic() - station_time
            _log.info("the station's time 0 is %.6f s of the host's monotonic clock", self._origin)
        return self._origin
