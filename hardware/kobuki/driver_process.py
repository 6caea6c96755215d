"""The process between the serial port and everybody else: python -m tfg_drake.hardware.kobuki.driver_process.

It does nothing but wait for bytes, requests and the next period, so that it stops the base in time whatever its parent
does: plan for a second, hang, crash or be killed. Started by tfg_drake.hardware.kobuki.driver.KobukiDriver.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import sys
import time

from tfg_drake.hardware.kobuki import odometry
from tfg_drake.hardware.kobuki import payloads as p
from tfg_drake.hardware.kobuki.connection import Connection
from tfg_drake.hardware.kobuki.link import KobukiError, Report, Request, decode_request, encode_report
from tfg_drake.hardware.kobuki.serial_port import open_port
from tfg_drake.hardware.kobuki.watchdog import allowed_velocity
from tfg_drake.hardware.watchdog import Limits

# Time between two commands to the base, s: it says as many frames, and the vendor's driver answers each.
PERIOD = 0.02
# A base that has not been heard for so long is no longer connected, and has so long to say its versions, s.
LOST_AFTER, VERSION_WITHIN = 1.0, 2.0
# Between two attempts to connect: at first, twice as long each time, at most; s.
FIRST_RETRY, LAST_RETRY = 0.5, 5.0
# Requests taken up before the base has its turn again, however many there are.
_REQUESTS_AT_ONCE = 100
# Between two requests of the versions, s.
_ASK_EVERY = 0.2
_VERSIONS = p.RequestExtra(0x0B)
# Every power rail on, and the first LED: off, orange (red and green) while disabled, green while enabled.
_POWER, _ORANGE, _GREEN = 0x00F0, 0x0300, 0x0200
_TUNE_ON, _TUNE_OFF = p.SoundSequence(0), p.SoundSequence(1)
_STOP = p.BaseControl(0, 0)
# The major number of the firmware whose protocol this is.
_MAJOR = "1"


class DriverProcess:
    """Holds the port open, keeps the base within bounds, and tells the parent what the base says."""

    def __init__(self, path: str, limits: Limits, parent: socket.socket) -> None:
        """path: of the serial port. parent: a socket of datagrams; at its end the process ends."""
        self._path, self._limits, self._parent = path, limits, parent
        self._parent.setblocking(False)
        self._parent_id = os.getppid()
        self._ended = False
        # As in Report.
        self._state, self._detail, self._number = "disconnected", "", 0
        self._connection: Connection | None = None
        self._reckoning: odometry.Reckoning | None = None
        self._wanted: Request | None = None
        # When the versions were asked for last, s, and the LEDs as they were set last.
        self._asked, self._leds = 0.0, -1
        self._velocity = (0.0, 0.0)
        self._retry_at, self._retry_after = 0.0, FIRST_RETRY

    def end(self, *_: object) -> None:
        """Ends run() within a period; a signal's handler."""
        self._ended = True

    def run(self) -> None:
        """Until end(), or until the parent is gone; whatever happens, the base is told to stop at the end."""
        due = time.monotonic()
        try:
            while not self._ended:
                sources: list[socket.socket | Connection] = [self._parent]
                if self._connection is not None:
                    sources.append(self._connection)
                ready, _, _ = select.select(sources, [], [], max(0.0, due - time.monotonic()))
                if self._parent in ready:
                    self._hear_parent()
                if self._connection is not None and self._connection in ready:
                    self._hear_base(self._connection, time.monotonic())
                if (now := time.monotonic()) >= due:
                    due = max(due, now - PERIOD) + PERIOD
                    self._tick(now)
        finally:
            if self._connection is not None:
                self._connection.say(_STOP, _TUNE_OFF, p.GeneralOutput(_POWER))
                self._connection.say(_STOP)

    def _hear_parent(self) -> None:
        with contextlib.suppress(BlockingIOError):
            for _ in range(_REQUESTS_AT_ONCE):
                try:
                    datagram = self._parent.recv(65536)
                except ConnectionResetError:
                    datagram = b""
                if not datagram:
                    self.end()
                    return
                request = decode_request(datagram)
                if request.enable is None:
                    self._wanted = request
                elif self._state == "disabled" and request.enable == self._number:
                    # What was wanted before does not count.
                    self._state, self._wanted = "enabled", None

    def _hear_base(self, connection: Connection, now: float) -> None:
        there = connection.read(now)
        self._reckoning = connection.reckoning
        if not there:
            self._disconnect(now, "the connection broke; put the cable back and switch the base on")

    def _tick(self, now: float) -> None:
        """What happens every period."""
        if os.getppid() != self._parent_id:
            self.end()
            return
        if self._connection is None and now >= self._retry_at:
            self._connect(now)
        if self._connection is not None:
            self._check(self._connection, now)
        if self._connection is not None:
            self._command(self._connection, now)
        with contextlib.suppress(BlockingIOError, BrokenPipeError, ConnectionResetError):
            self._parent.send(encode_report(self._status()))

    def _status(self) -> Report:
        connection, reckoning = self._connection, self._reckoning
        if self._state == "disconnected" or connection is None or connection.core is None or reckoning is None:
            return Report(detail=self._detail, connection=self._number)
        return Report(
            state=self._state,
            connection=self._number,
            odometry=odometry.odometry_message(reckoning),
            hazards=odometry.hazards_message(connection.core, reckoning.stamp),
            battery=round(0.1 * connection.core.battery, 1),
            charging=connection.core.charger != 0,
            firmware=connection.firmware,
            hardware=connection.hardware,
            unique_id=connection.unique_id,
            bad_frames=connection.bad_frames,
        )

    def _connect(self, now: float) -> None:
        try:
            port = open_port(self._path)
        except KobukiError as error:
            self._retry(now, str(error))
            return
        self._connection = Connection(port, now, self._reckoning)
        self._leds = -1

    def _check(self, connection: Connection, now: float) -> None:
        """Whether the connection is one, and when it becomes one."""
        if now - connection.heard > LOST_AFTER:
            if connection.core is not None:
                why = "the base fell silent; switch it on and check the cable"
            elif connection.said_anything:
                why = "what answers there is no Kobuki at 115200 baud; name the base's port"
            else:
                why = "no answer at 115200 baud; switch the base on, or name its port"
            self._disconnect(now, why)
        elif self._state == "disconnected":
            firmware = connection.firmware
            if not firmware:
                if now - connection.opened > VERSION_WITHIN:
                    self._disconnect(now, "the base does not say its firmware's version; switch it off and on again")
            elif firmware.split(".")[0] != _MAJOR:
                self._disconnect(now, f"firmware {firmware} is not supported; flash the base with a version {_MAJOR}.x")
            elif connection.core is not None:
                self._state, self._detail, self._number = "disabled", "", self._number + 1
                self._retry_after = FIRST_RETRY
                connection.say(_TUNE_ON)

    def _command(self, connection: Connection, now: float) -> None:
        """Tells the base what to do in the next period. Before its first frame it is told nothing."""
        if connection.core is None:
            return
        self._velocity = (
            allowed_velocity(self._velocity, self._wanted, now, connection.heard, connection.core, self._limits, PERIOD)
            if self._state == "enabled"
            else (0.0, 0.0)
        )
        parts: list[p.SubPayload] = [odometry.base_control(*self._velocity)]
        leds = {"disabled": _ORANGE, "enabled": _GREEN}.get(self._state, 0)
        if leds != self._leds:
            self._leds = leds
            parts.append(p.GeneralOutput(_POWER | leds))
        if self._state == "disconnected" and now - self._asked > _ASK_EVERY:
            self._asked = now
            parts.append(_VERSIONS)
        connection.say(*parts)

    def _disconnect(self, now: float, why: str) -> None:
        if self._connection is not None:
            self._connection.say(_STOP)
            self._connection.close()
        self._connection = None
        self._retry(now, f"{self._path}: {why}")

    def _retry(self, now: float, detail: str) -> None:
        """Nothing that was wanted of the base holds any longer; later is soon enough to try again."""
        self._retry_at, self._retry_after = now + self._retry_after, min(LAST_RETRY, 2.0 * self._retry_after)
        self._velocity, self._wanted = (0.0, 0.0), None
        self._state, self._detail = "disconnected", detail


def main(path: str, limits: str, descriptor: str) -> None:
    """path: of the port. limits: of Limits, as JSON. descriptor: of the socket to the parent."""
    process = DriverProcess(path, Limits(**json.loads(limits)), socket.socket(fileno=int(descriptor)))
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, process.end)
    process.run()


if __name__ == "__main__":
    main(*sys.argv[1:])
