"""Shared parts of the drivers of sensors: one that drives nothing, and one that connects again after a loss."""

from __future__ import annotations

import abc
import contextlib
import time
from collections.abc import Mapping
from typing import Any

from tfg_drake.hardware.device import DeviceError, Driver, Message
from tfg_drake.hardware.plausible import Refusals
from tfg_drake.hardware.watchdog import TICK

# Between two attempts to connect again, s: the first and the last.
BACK_OFF, LONGEST_BACK_OFF = 0.2, 2.0


class Inbox:
    """Messages, lines for the operator and a fault until they are taken. refusals: the lines, of what cannot be used,
    too."""

    def __init__(self) -> None:
        self.refusals = Refusals()
        self._messages: list[Message] = []
        self._fault: str | None = None

    def remarks(self) -> list[str]:
        """Lines for the operator since the last call."""
        return self.refusals.take()

    def take(self) -> list[Message]:
        """The messages since the last call."""
        taken, self._messages = self._messages, []
        return taken

    def fault(self) -> str | None:
        """Why the robot must stop, once."""
        fault, self._fault = self._fault, None
        return fault


class SensorReader(Inbox, Driver):
    """A driver that drives nothing; a subclass opens a device and reads it.

    name: of its source, such as "socket:127.0.0.1:5000". _device: what is open, such as a port; None while it is lost.
    """

    def __init__(self, name: str, sources: Mapping[type, str]) -> None:
        """sources: what the messages of a kind are called."""
        super().__init__()
        self.name, self.sources = name, sources
        self._device: Any = None

    def close(self) -> None:
        """Lets go of the device."""
        self._hang_up()

    def _hang_up(self) -> None:
        if self._device is not None:
            with contextlib.suppress(OSError, RuntimeError):  # it is gone already
                self._device.close()
        self._device = None

    def _remark(self, line: str) -> None:
        self.refusals.tell(f"{self.name}: {line}")


class ReconnectingReader(SensorReader, abc.ABC):
    """A driver of a sensor that connects again where the device was lost; a subclass connects and receives."""

    _back_off, _retry = BACK_OFF, 0.0

    @abc.abstractmethod
    def _connect(self) -> None:
        """Opens the device; raises OSError, DeviceError."""

    @abc.abstractmethod
    def _receive(self, left: float) -> None:
        """Takes in what arrives within `left` s; may return before."""

    def _wait_for_first(self, patience: float, why: str) -> None:
        """Waits for a message, s; raises DeviceError where none comes, why in words."""
        end = time.monotonic() + patience
        while not self._messages:
            if time.monotonic() > end:
                self.close()
                raise DeviceError(f"{self.name}: {why}")
            self.spin(TICK)

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            if self._device is None:
                self._connect_again(left)
            else:
                self._receive(left)

    def _connect_again(self, left: float) -> None:
        """Connects where it is time to, for up to `left` s; says so where that helps."""
        if (wait := self._retry - time.monotonic()) > 0.0:
            time.sleep(min(wait, left))
            return
        try:
            self._connect()
        except (OSError, DeviceError):
            self._back_off = min(2.0 * self._back_off, LONGEST_BACK_OFF)
            self._retry = time.monotonic() + self._back_off
            return
        self._back_off = BACK_OFF
        self._remark("connected again")

    def _lose(self, why: str) -> None:
        """The device is lost, and looked for."""
        self._remark(why)
        self._hang_up()
