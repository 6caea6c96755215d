"""The Kobuki on its serial port, as a robot's process drives it; see tfg_drake.hardware.device."""

from __future__ import annotations

import functools
import math
import time
from multiprocessing.connection import wait

from tfg_drake.hardware.device import BaseState, Button, Device, DeviceError, Driver, Message
from tfg_drake.hardware.kobuki import codec as p
from tfg_drake.hardware.kobuki import odometry
from tfg_drake.hardware.kobuki.connection import Connection
from tfg_drake.hardware.kobuki.guardian import Guardian
from tfg_drake.hardware.process import TICK
from tfg_drake.hardware.sensor_reader import BACK_OFF
from tfg_drake.hardware.serial_port import SerialDevice, open_port
from tfg_drake.hardware.watchdog import Limits
from tfg_drake.messages import Hazards, Odometry

KOBUKI = SerialDevice("the base", "0403:6001")
_VERSIONS = p.RequestExtra(p.Extra.HARDWARE | p.Extra.FIRMWARE | p.Extra.UNIQUE_ID)
# Colours of the first LED: orange while the base may not move, green while it may.
_ORANGE, _GREEN = p.Output.RED | p.Output.GREEN, p.Output.GREEN
_TUNE_ON, _TUNE_OFF = p.SoundSequence(p.Tune.ON), p.SoundSequence(p.Tune.OFF)
# The wheels are blocked or their encoders stuck if the base, commanded to drive at _MOVES, m/s, or turn at _TURNS,
# rad/s, or faster, has no tick for _WITHOUT_TICK, s.
_MOVES, _TURNS, _WITHOUT_TICK = 0.05, 0.3, 0.4
_STOP = p.BaseControl()


def connect(port: str = "/dev/kobuki", limits: Limits | None = None) -> Device:
    """Return the base on a serial port, driven within limits. Raises DeviceError."""
    return Device(functools.partial(KobukiDriver, port, limits or Limits()))


class KobukiDriver(Driver):
    """Holds the port open, and opens it again after a loss of the connection; see tfg_drake.hardware.device.Driver.

    After a loss odometry continues from its last pose. The base obeys its last command for ever, so a guardian stops it
    if this process is killed.
    """

    def __init__(self, path: str, limits: Limits) -> None:
        """Wait until the base answers. path: of the serial port. Raises DeviceError."""
        super().__init__()
        self.limits = limits
        self.sources = {Odometry: f"odometry of {path}", Hazards: f"alarms of {path}", BaseState: f"state of {path}"}
        self._path = path
        self._connection: Connection | None = None
        # None until it is certain that a base is connected.
        self._guardian: Guardian | None = None
        self._reckoning: odometry.Reckoning | None = None
        # Why no base is connected; "" if one is, or if that is not known yet.
        self._trouble = ""
        self._lights = _ORANGE
        # Time of the last request for the versions, and of the next attempt to connect, s.
        self._asked, self._retry_at = 0.0, 0.0
        # Time since which the base has been commanded to move, s; inf while it is not.
        self._moves_since = math.inf
        while self._guardian is None:
            self.spin(TICK)
            if self._trouble:
                self.close()
                raise DeviceError(self._trouble)

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""
        end = time.monotonic() + duration
        while (now := time.monotonic()) < end:
            if self._connection is None:
                time.sleep(end - now)
            elif wait([self._connection.fileno()], end - now) and not self._connection.read(time.monotonic()):
                self._lose("the connection broke; put the cable back and switch the base on")
        self._tend(time.monotonic())

    def _tend(self, now: float) -> None:
        """Connect if there is no connection, otherwise check it, and ask a new base for its versions."""
        if self._connection is None:
            if now >= self._retry_at:
                self._connect(now)
        elif trouble := self._connection.trouble(now):
            self._lose(trouble)
        elif self._guardian is None and self._connection.ready:
            self._begin(self._connection)
        elif self._guardian is None and self._connection.core is not None and now - self._asked > BACK_OFF:
            # Nothing is sent before the first frame: the device may not be a base.
            self._asked = now
            self._connection.say(_VERSIONS)

    def _connect(self, now: float) -> None:
        try:
            self._connection = Connection(open_port(self._path, p.BAUD_RATE, KOBUKI), now, self._reckoning)
        except DeviceError as error:
            self._retry(str(error))

    def _begin(self, connection: Connection) -> None:
        try:
            self._guardian = Guardian(connection.fileno())
        except OSError as error:
            self._lose(f"no process can be started to stop it in an emergency: {error.strerror}; end other programs")
            return
        self._trouble = ""
        connection.say(_STOP, _TUNE_ON, p.GeneralOutput(p.Output.POWER | self._lights))

    def _lose(self, why: str) -> None:
        self._disconnect(_STOP)
        self._retry(f"{self._path}: {why}")

    def _retry(self, trouble: str) -> None:
        """Schedule the next attempt; until then a base whose cable was pulled drives on, so BACK_OFF is short."""
        self._trouble = trouble
        self._retry_at = time.monotonic() + BACK_OFF

    def _disconnect(self, *last: p.SubPayload) -> None:
        if self._connection is None:
            return
        if self._guardian is not None:
            self._connection.say(*last)
            self._guardian.close()
        self._reckoning = self._connection.reckoning
        self._connection.close()
        self._connection = self._guardian = None

    def take(self) -> list[Message]:
        """Return the messages since the last call."""
        return [] if self._connection is None or self._guardian is None else self._connection.take()

    def fault(self) -> str | None:
        """Return why there is no base, that its stop button B0 is pressed, or a fault of its clock, gyro or wheels;
        None without a fault."""
        connection = self._connection
        if self._trouble or connection is None or connection.core is None:
            return self._trouble or None
        fault = connection.fault() or self._standstill(connection)
        return "stopped by the button B0" if connection.core.buttons & Button.B0 else fault

    def _standstill(self, connection: Connection) -> str | None:
        reckoning = connection.reckoning
        if reckoning is None or reckoning.stamp - max(reckoning.moved, self._moves_since) < _WITHOUT_TICK:
            return None
        self._moves_since = math.inf
        return "the wheels were told to turn and do not: see what blocks them, or the encoders are stuck"

    def send(self, speed: float, turn_rate: float) -> None:
        """Sends a velocity, m/s and rad/s, to the base."""
        moves = abs(speed) >= _MOVES or abs(turn_rate) >= _TURNS
        self._moves_since = min(self._moves_since, time.monotonic()) if moves else math.inf
        if self._connection is None or self._guardian is None:
            return
        self._connection.driven = speed != 0.0 or turn_rate != 0.0
        self._connection.say(odometry.base_control(speed, turn_rate))
        if trouble := self._guardian.trouble(time.monotonic()):
            self._lose(f"the process that would stop the base in an emergency {trouble}; enable the base again")

    def show(self, enabled: bool) -> None:
        """Set the first LED: green while the base may move, orange while it may not."""
        lights = _GREEN if enabled else _ORANGE
        if lights != self._lights and self._connection is not None and self._guardian is not None:
            self._connection.say(p.GeneralOutput(p.Output.POWER | lights))
        self._lights = lights

    def close(self) -> None:
        """Stop the base, play its off tune and close the port."""
        self._disconnect(_STOP, _TUNE_OFF, p.GeneralOutput(p.Output.POWER))
