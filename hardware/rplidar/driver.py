"""The RPLidar on its serial port, as a sensor's process reads it; see tfg_drake.hardware.device."""

from __future__ import annotations

import contextlib
import os
import termios
import time
from multiprocessing.connection import wait

from tfg_drake.config import RobotScannerConfig
from tfg_drake.geometry.sweep import Sweep
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.process import TICK
from tfg_drake.hardware.rplidar import codec
from tfg_drake.hardware.rplidar.codec import Command, Health, NodeDecoder
from tfg_drake.hardware.rplidar.sweeps import SweepMaker
from tfg_drake.hardware.sensor_reader import PATIENCE, SILENT, SensorReader
from tfg_drake.hardware.serial_port import SerialDevice, open_port

RPLIDAR = SerialDevice("the scanner", "10c4:ea60")
# Time to wait for an answer, and for the scanner after a reset, s.
ANSWER_WITHIN, RESET_WITHIN = 0.5, 1.0


class RplidarDriver(SensorReader):
    """Starts the motor and reads two sweeps a turn; see tfg_drake.hardware.device.Driver. A scanner that was
    unplugged or is silent is started again.

    refusals: lost bytes.
    """

    def __init__(self, path: str, mount: RobotScannerConfig) -> None:
        """Wait for a whole revolution. path: of the serial port. mount: of the scanner. Raises DeviceError."""
        name = f"rplidar:{path}"
        super().__init__(name, {Sweep: f"scan of {name}"})
        self._path, self._mount = path, mount
        self._model = 0
        self._begin()

    def _missing(self) -> str:
        return "" if self._messages else f"no whole revolution in {PATIENCE:.0f} s; does it turn freely?"

    def _connect(self) -> None:
        """Open the port at the rate at which a scanner answers, and start it. Raises DeviceError."""
        for baud_rate in codec.BAUD_RATES:
            self._device = open_port(self._path, baud_rate, RPLIDAR)
            with contextlib.ExitStack() as undo:
                undo.callback(self._hang_up)
                try:
                    self._say(codec.request(Command.STOP))
                    time.sleep(TICK)
                    self._device.reset_input_buffer()
                    if (told := self._asked(Command.GET_INFO)) is not None:
                        self._start(codec.model(told))
                        undo.pop_all()
                        return
                except (OSError, termios.error) as error:
                    raise DeviceError(f"{self.name}: {error.args[-1]}; plug the scanner in again") from None
        rates = " or ".join(map(str, codec.BAUD_RATES))
        raise DeviceError(f"{self.name}: no RPLidar answers at {rates} baud; name the scanner's port")

    def _start(self, model: int) -> None:
        """Start the motor and the scan. Raises DeviceError, OSError."""
        health = self._asked(Command.GET_HEALTH)
        if health is not None and health[0] == Health.FAILED:
            self._say(codec.request(Command.RESET))
            time.sleep(RESET_WITHIN)
            self._device.reset_input_buffer()
            health = self._asked(Command.GET_HEALTH)
        if health is None or health[0] == Health.FAILED:
            code = "nothing" if health is None else f"error {int.from_bytes(health[1:3], 'little')}"
            raise DeviceError(
                f"{self.name}: the scanner says {code} of its health; unplug it, and see that it turns freely"
            )
        with contextlib.suppress(OSError):  # the line has no DTR
            self._device.dtr = False  # lets the motor turn
        if model >= 2:
            self._say(codec.motor(codec.DUTY))
        self._say(codec.request(Command.SCAN))
        self._model, self._decoder = model, NodeDecoder()
        self._maker = SweepMaker(self._mount, model)
        self._heard = time.monotonic()
        # Bytes received until the descriptor of the rays is found, None after that.
        self._preamble: bytes | None = b""

    def _say(self, data: bytes) -> None:
        os.write(self._device.fileno(), data)

    def _asked(self, command: Command) -> bytes | None:
        """Return the answer to a command, None if there is none. Raises OSError."""
        self._say(codec.request(command))
        heard, end = b"", time.monotonic() + ANSWER_WITHIN
        while (told := codec.answer(heard, command)) is None and (left := end - time.monotonic()) > 0.0:
            if wait([self._device.fileno()], left):
                heard += self._device.read(self._device.in_waiting)
        return told

    def _receive(self, left: float) -> None:
        try:
            if wait([self._device.fileno()], left):
                self._take_in(self._device.read(self._device.in_waiting), time.monotonic())
            if time.monotonic() - self._heard > SILENT:
                self._lose(f"says nothing for {SILENT:.0f} s: does it turn? It is started again")
        except OSError:
            self._lose("the connection is lost; plug the scanner in again, it is looked for")

    def _take_in(self, data: bytes, now: float) -> None:
        if self._preamble is not None:
            self._preamble += data
            data = codec.answer(self._preamble, Command.SCAN) or b""
            self._preamble = None if data else self._preamble[-len(codec.descriptor(Command.SCAN)) :]
        before = self._decoder.lost
        nodes = self._decoder.feed(data)
        if nodes:
            self._heard = now
        self._messages += self._maker.add(nodes, now)
        if self._decoder.lost > before:
            self.refusals.add(self.name, "bytes", "bytes are lost on the way; the other rays are used, check the cable")

    def close(self) -> None:
        """Stop the motor and close the port."""
        if self._device is not None:
            with contextlib.suppress(OSError):
                self._say(codec.request(Command.STOP))
                if self._model >= 2:
                    self._say(codec.motor(0))
                self._device.dtr = True
        self._hang_up()
