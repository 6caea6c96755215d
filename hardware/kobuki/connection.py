"""One open port to a base: reads and writes frames, and reports faults."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING

from tfg_drake.hardware.device import BaseState, Inbox
from tfg_drake.hardware.kobuki import codec as p
from tfg_drake.hardware.kobuki import odometry
from tfg_drake.hardware.sensor_reader import SILENT
from tfg_drake.messages import replace

if TYPE_CHECKING:
    import serial

# Major version of the firmware that speaks this protocol.
_MAJOR = "1"


class Connection(Inbox):
    """Reads the base's frames from an open port.

    core: the newest frame's, None before the first. reckoning: dead reckoning, continued from an earlier connection.
    driven: the last command moves the base.
    firmware, hardware, unique_id: as in tfg_drake.hardware.device.BaseState.
    """

    def __init__(self, port: serial.Serial, now: float, before: odometry.Reckoning | None) -> None:
        """before: dead reckoning up to the end of the previous connection, if there was one."""
        super().__init__()
        self._port, self._deframer = port, p.Deframer()
        self._opened = self._heard = now
        self._said_anything = False
        self._state: BaseState | None = None
        # Number of frames since the last state report.
        self._frames = 0
        self.core: p.CoreSensors | None = None
        self.reckoning, self.driven = before, False
        self.firmware = self.hardware = self.unique_id = ""

    def fileno(self) -> int:
        """The port's file descriptor, ready when there is something to read."""
        return int(self._port.fileno())

    @property
    def ready(self) -> bool:
        """True if the base has sent frames and a supported firmware version."""
        return self.core is not None and self.firmware.split(".")[0] == _MAJOR

    def trouble(self, now: float) -> str | None:
        """Return why this connection is unusable, and the remedy; None without a fault."""
        if now - self._heard > odometry.LONGEST_GAP:
            if self.core is not None:
                return "the base fell silent; switch it on and check the cable"
            if self._said_anything:
                return "what answers there is no Kobuki at 115200 baud; name the base's port"
            return "no answer at 115200 baud; switch the base on, or name its port"
        if not self.firmware and now - self._opened > SILENT:
            return "the base does not say its firmware's version; switch it off and on again"
        if self.firmware and self.firmware.split(".")[0] != _MAJOR:
            return f"firmware {self.firmware} is not supported; flash the base with a version {_MAJOR}.x"
        return None

    def read(self, now: float) -> bool:
        """Take in what has arrived by `now`, s; returns False if the port is gone."""
        try:
            data = self._port.read(4096)
        except OSError:
            return False
        self._said_anything |= bool(data)
        for payload in self._deframer.feed(data):
            self._take(p.decode(payload, p.FEEDBACK), now)
        return True

    def _take(self, parts: tuple[p.SubPayload, ...], now: float) -> None:
        """Take in one frame."""
        core = inertia = None
        for part in parts:
            match part:
                case p.CoreSensors():
                    core = part
                case p.Inertia():
                    inertia = part
                case p.HardwareVersion():
                    self.hardware = str(part)
                case p.FirmwareVersion():
                    self.firmware = str(part)
                case p.UniqueId():
                    self.unique_id = f"{part.a:08x}{part.b:08x}{part.c:08x}"
        if core is None or inertia is None:
            return
        before = self.reckoning
        if self.core is None or before is None:
            self.reckoning = odometry.first(core, inertia, now, before)
        else:
            self.reckoning = odometry.advanced(before, core, inertia, now, self.driven)
        if self.reckoning is not before:
            self._fault = self.reckoning.fault or self._fault
        self._frames += 1
        self.core, self._heard = core, now
        # A frame without progress gives no odometry: the watchdog would take it for a sign of life.
        if before is None or self.reckoning.stamp > before.stamp:
            self._messages.append(odometry.odometry_message(self.reckoning))
        self._messages.append(odometry.hazards_message(core, self.reckoning.stamp))
        if self.firmware:
            self._say_state(core, self.reckoning.stamp)

    def _say_state(self, core: p.CoreSensors, stamp: float) -> None:
        before = self._state
        due = 1.0 if before is None else (stamp - before.stamp) / p.PERIOD
        state = replace(
            odometry.base_state(core, stamp),
            firmware=self.firmware,
            hardware=self.hardware,
            unique_id=self.unique_id,
            lost=max(0.0, 1.0 - self._frames / max(due, 1.0)),
        )
        if before is None or _lasting(state) != _lasting(before) or stamp - before.stamp >= odometry.LONGEST_GAP:
            self._messages.append(state)
            self._state, self._frames = state, 0

    def say(self, *parts: p.SubPayload) -> None:
        """Write a frame, unless the line is full, where it would block, or gone, which the next read shows."""
        with contextlib.suppress(OSError):
            os.write(self.fileno(), p.encode(*parts))

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(OSError):
            self._port.close()


def _lasting(state: BaseState) -> tuple[object, ...]:
    """Return the fields whose changes are reported at once."""
    power = state.charger, state.charging, state.overcurrent
    return state.buttons, power, state.firmware, state.hardware, state.unique_id
