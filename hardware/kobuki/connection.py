"""One open port to a base: what was heard there, and how to say something."""

from __future__ import annotations

import contextlib
import os
from typing import TYPE_CHECKING

from tfg_drake.hardware.kobuki import odometry
from tfg_drake.hardware.kobuki import payloads as p
from tfg_drake.hardware.kobuki.codec import FEEDBACK, Deframer, decode, encode

if TYPE_CHECKING:
    import serial


class Connection:
    """What the base has said since the port was opened.

    opened, heard: when it was, and when a frame came last, s. said_anything: bytes came, frames or not. core: the
    newest frame's, None before the first. reckoning: dead reckoning, going on from an earlier connection's. firmware,
    hardware, unique_id: as in tfg_drake.hardware.kobuki.link.Report.
    """

    def __init__(self, port: serial.Serial, now: float, before: odometry.Reckoning | None) -> None:
        """before: dead reckoning up to the end of the connection before, if there was one."""
        self._port, self._deframer = port, Deframer()
        self.opened = self.heard = now
        self.said_anything = False
        self.core: p.CoreSensors | None = None
        self.reckoning = before
        self.firmware = self.hardware = self.unique_id = ""

    @property
    def bad_frames(self) -> int:
        """Beginnings of frames that were garbled."""
        return self._deframer.bad

    def fileno(self) -> int:
        """The port's file descriptor, ready when there is something to read."""
        descriptor: int = self._port.fileno()
        return descriptor

    def read(self, now: float) -> bool:
        """Takes in what has come by now, s; False where the port is gone, which a ready port without bytes is."""
        try:
            data = os.read(self.fileno(), 4096)
        except BlockingIOError:
            return True
        except OSError:
            return False
        self.said_anything |= bool(data)
        for payload in self._deframer.feed(data):
            self._take(decode(payload, FEEDBACK), now)
        return bool(data)

    def _take(self, parts: tuple[p.SubPayload, ...], now: float) -> None:
        """One frame."""
        core = inertia = None
        for part in parts:
            match part:
                case p.CoreSensors():
                    core = part
                case p.Inertia():
                    inertia = part
                case p.HardwareVersion():
                    self.hardware = f"{part.major}.{part.minor}.{part.patch}"
                case p.FirmwareVersion():
                    self.firmware = f"{part.major}.{part.minor}.{part.patch}"
                case p.UniqueId():
                    self.unique_id = f"{part.a:08x}{part.b:08x}{part.c:08x}"
        if core is None or inertia is None:
            return
        if self.core is None or self.reckoning is None:
            self.reckoning = odometry.first(core, inertia, now, self.reckoning)
        else:
            self.reckoning = odometry.advanced(self.reckoning, core, inertia, now)
        self.core, self.heard = core, now

    def say(self, *parts: p.SubPayload) -> None:
        """Writes a frame, unless the line is so full that it would wait, or gone, which the next read shows."""
        with contextlib.suppress(OSError):
            os.write(self.fileno(), encode(*parts))

    def close(self) -> None:
        """Closes the port."""
        with contextlib.suppress(OSError):
            self._port.close()
