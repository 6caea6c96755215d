"""The client of a sensor socket, docs/sensor_socket.md."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import select
import socket
import time

from tfg_drake.hardware.device import DeviceError, Message
from tfg_drake.hardware.kobuki.sensor_socket import message_of
from tfg_drake.hardware.watchdog import TICK, Limits
from tfg_drake.messages import LaserScan, TagDetections

# How long to wait for the server, and for its first lines, s.
PATIENCE = 5.0
# A line that is longer than this is none, bytes.
LONGEST_LINE = 1_000_000
# Between two attempts to connect again, s: the first and the last.
BACK_OFF, LONGEST_BACK_OFF = 0.2, 2.0
# A stamp this far in the future is of another clock, s.
AHEAD = 0.25

_log = logging.getLogger(__name__)

_NAMES = {LaserScan: "scan", TagDetections: "detections"}


@dataclasses.dataclass(frozen=True)
class SocketConfig:
    """What the process is told. kinds: of the messages that are wanted."""

    host: str
    port: int
    kinds: tuple[type[LaserScan] | type[TagDetections], ...]

    def open(self) -> SocketDriver:
        """The driver; raises DeviceError."""
        return SocketDriver(self.host, self.port, self.kinds)


class SocketDriver:
    """Reads lines, and drives nothing; see tfg_drake.hardware.device.Driver. Lost connections are opened again.

    malformed: lines so far that could not be used.
    """

    limits = Limits()

    def __init__(self, host: str, port: int, kinds: tuple[type[LaserScan] | type[TagDetections], ...]) -> None:
        """Waits for a message of each kind; raises DeviceError."""
        self.malformed = 0
        self._address, self._kinds = (host, port), kinds
        self._name = f"socket:{host}:{port}"
        self._pending = bytearray()
        self._messages: list[Message] = []
        self._stamps: dict[type, float] = {}
        self._socket: socket.socket | None = None
        self._back_off, self._retry = BACK_OFF, 0.0
        try:
            self._connect(PATIENCE)
        except OSError as error:
            raise DeviceError(
                f"{self._name}: {error.strerror or error}: start what serves tags and scans there, or name the "
                "HOST:PORT that it prints"
            ) from None
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and len(self._stamps) < len(kinds):
            self.spin(TICK)
        if missing := [_NAMES[kind] for kind in kinds if kind not in self._stamps]:
            self.close()
            refused = f" ({self.malformed} lines could not be used)" if self.malformed else ""
            raise DeviceError(f"{self._name}: no {missing[0]} in {PATIENCE:.0f} s{refused}: name what serves them")

    def _connect(self, timeout: float) -> None:
        self._socket = socket.create_connection(self._address, timeout)
        self._socket.setblocking(False)
        self._pending.clear()  # of a line that the old connection began
        self._back_off = BACK_OFF

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            if self._socket is None:
                self._reconnect(left)
            elif select.select([self._socket], [], [], left)[0]:
                self._receive()

    def _reconnect(self, left: float) -> None:
        if (wait := self._retry - time.monotonic()) > 0.0:
            time.sleep(min(wait, left))
            return
        try:
            self._connect(LONGEST_BACK_OFF)
            _log.warning("%s: connected again", self._name)
        except OSError:
            self._back_off = min(2.0 * self._back_off, LONGEST_BACK_OFF)
            self._retry = time.monotonic() + self._back_off

    def _receive(self) -> None:
        assert self._socket is not None
        try:
            data = self._socket.recv(1 << 20)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._socket.close()
            self._socket = None
            _log.warning("%s: the connection is lost; start what serves it again, it is looked for", self._name)
            return
        self._pending += data
        *lines, rest = self._pending.split(b"\n")
        self._pending = rest
        for line in lines:
            self._read(bytes(line))
        if len(self._pending) > LONGEST_LINE:
            self._pending.clear()  # what is left of it will be malformed, too
            self._refuse(f"a line of more than {LONGEST_LINE} bytes")

    def _read(self, line: bytes) -> None:
        try:
            message = message_of(line)
            if message is None or not isinstance(message, self._kinds):
                return
            if message.stamp > time.monotonic() + AHEAD:
                raise ValueError(f"stamp {message.stamp:.2f} is not of this machine's monotonic clock")
        except ValueError as error:
            self._refuse(str(error))
            return
        if message.stamp > self._stamps.get(type(message), -float("inf")):
            self._stamps[type(message)] = message.stamp
            self._messages.append(message)

    def _refuse(self, why: str) -> None:
        self.malformed += 1
        if self.malformed == 1:
            _log.warning("%s: lines are not used: %s", self._name, why)

    def take(self) -> list[Message]:
        """The messages since the last call."""
        taken, self._messages = self._messages, []
        return taken

    def fault(self) -> str | None:
        """None: there is nothing to stop."""
        return None

    def send(self, speed: float, turn_rate: float) -> None:
        """There is nothing to drive."""

    def show(self, enabled: bool) -> None:
        """A sensor has nothing to show."""

    def close(self) -> None:
        """Ends the connection."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.close()
