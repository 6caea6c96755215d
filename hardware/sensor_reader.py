"""Shared part of the drivers of sensors: they drive nothing, and reconnect after a loss."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from tfg_drake.hardware.device import DeviceError, Driver, Message
from tfg_drake.hardware.plausible import Refusals

# Between two attempts to connect again, s: the first and the last.
BACK_OFF, LONGEST_BACK_OFF = 0.2, 2.0


class Inbox:
    """Messages and lines for the operator until they are taken. refusals: of what arrived and cannot be used."""

    def __init__(self) -> None:
        self.refusals = Refusals()
        self._remarks: list[str] = []
        self._messages: list[Message] = []

    def remarks(self) -> list[str]:
        """Lines for the operator since the last call."""
        remarks, self._remarks = self._remarks, []
        return [*remarks, *self.refusals.take()]

    def take(self) -> list[Message]:
        """The messages since the last call."""
        taken, self._messages = self._messages, []
        return taken


class SensorReader(Inbox, Driver):
    """A driver that drives nothing.

    name: of its source, such as "socket:127.0.0.1:5000".
    """

    def __init__(self, name: str, sources: Mapping[type, str]) -> None:
        """sources: what the messages of a kind are called."""
        super().__init__()
        self.name, self.sources = name, sources
        self._back_off, self._retry = BACK_OFF, 0.0

    def _connect_again(self, connect: Callable[[], None], left: float) -> None:
        """Tries `connect`, which raises OSError or DeviceError, where it is time to, for up to `left` s; says so where
        that helps."""
        if (wait := self._retry - time.monotonic()) > 0.0:
            time.sleep(min(wait, left))
            return
        try:
            connect()
        except (OSError, DeviceError):
            self._back_off = min(2.0 * self._back_off, LONGEST_BACK_OFF)
            self._retry = time.monotonic() + self._back_off
            return
        self._back_off = BACK_OFF
        self._remark("connected again")

    def _remark(self, line: str) -> None:
        self._remarks.append(f"{self.name}: {line}")
