"""Shared parts of the sensors' drivers: their remarks, and a connection that is opened again after a loss."""

from __future__ import annotations

import abc
import contextlib
import time
from collections.abc import Iterator, Mapping
from typing import Any

from tfg_drake.hardware.device import DeviceError, Driver
from tfg_drake.hardware.process import TICK

# Time to wait for a device's first message, s.
PATIENCE = 10.0
# A device that is silent for SILENT, s, is opened, or connected, again.
SILENT = 2.0
# First and longest delay between two attempts to connect, s.
BACK_OFF, LONGEST_BACK_OFF = 0.2, 2.0
# Greatest age of a message on arrival, s; an older stamp is taken to be of another clock.
OLDEST = 1.0


def delays() -> Iterator[float]:
    """Yield the delay before each attempt to connect again, s: doubled each time, up to LONGEST_BACK_OFF."""
    delay = BACK_OFF
    while True:
        yield delay
        delay = min(2.0 * delay, LONGEST_BACK_OFF)


def stamped(stamp: float, arrival: float, otherwise: float) -> float:
    """Return a device's stamp of a message that has just arrived, s, or `otherwise` if it cannot be of this clock."""
    return stamp if arrival - OLDEST < stamp <= arrival else otherwise


class SensorReader(Driver, abc.ABC):
    """A driver of a sensor. It opens a device and reads it, and opens it again after a loss; a subclass connects and
    receives.

    name: of its source, such as "socket:127.0.0.1:5000". _device: the open device, such as a port; None while lost.
    """

    def __init__(self, name: str, sources: Mapping[type, str]) -> None:
        """sources: names of the kinds of messages."""
        super().__init__()
        self.name, self.sources = name, sources
        self._device: Any = None
        # Reason of the loss, "" without one; time of the next attempt to connect, s; the delays after that, s.
        self._lost, self._retry, self._delays = "", 0.0, delays()

    @abc.abstractmethod
    def _connect(self) -> None:
        """Open the device. Raises OSError, DeviceError."""

    @abc.abstractmethod
    def _receive(self, left: float) -> None:
        """Takes in what arrives within `left` s; may return before."""

    @abc.abstractmethod
    def _missing(self) -> str:
        """Return the complaint about what has not arrived within PATIENCE, "" if nothing is missing."""

    def _begin(self) -> None:
        """Connect, and wait until nothing is missing. Raises OSError, DeviceError."""
        self._connect()
        end = time.monotonic() + PATIENCE
        while missing := self._missing():
            if time.monotonic() > end:
                self.close()
                raise DeviceError(f"{self.name}: {missing}")
            self.spin(TICK)

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            if self._device is None:
                self._connect_again(left)
                continue
            before = len(self._messages)
            self._receive(left)
            if self._lost and len(self._messages) > before:
                self._lost, self._delays = "", delays()
                self._remark("connected again")

    def _connect_again(self, left: float) -> None:
        """Connect if the next attempt is due, otherwise wait, for up to `left` s."""
        if (wait := self._retry - time.monotonic()) > 0.0:
            time.sleep(min(wait, left))
            return
        try:
            self._connect()
        except (OSError, DeviceError):
            self._wait()

    def _lose(self, why: str) -> None:
        """Close the lost device and schedule the next attempt; a reason is reported once until something arrives."""
        if why != self._lost:
            self._remark(why)
        self._lost = why
        self._hang_up()
        self._wait()

    def _wait(self) -> None:
        self._retry = time.monotonic() + next(self._delays)

    def close(self) -> None:
        """Close the device."""
        self._hang_up()

    def _hang_up(self) -> None:
        if self._device is not None:
            with contextlib.suppress(OSError, RuntimeError):  # the device is gone already
                self._device.close()
        self._device = None

    def _remark(self, line: str) -> None:
        self.refusals.tell(f"{self.name}: {line}")
