"""An RPLidar on a pseudo-terminal, in real time: a stand-in for the scanner that needs no scanner."""

from __future__ import annotations

import math
import random
import re
import time
from collections.abc import Callable

import numpy as np

from tfg_drake.config import ScanConfig
from tfg_drake.geometry.se2 import compose, wrap_angle
from tfg_drake.hardware.emulation.emulated_device import EmulatedDevice, PseudoTerminal
from tfg_drake.hardware.process import TICK
from tfg_drake.hardware.rplidar import codec
from tfg_drake.hardware.rplidar.codec import Command, Health, Node
from tfg_drake.messages import FloatArray
from tfg_drake.simulation.laser_scanner import scan

# Rays and revolutions per second of an A1.
RAYS, TURNS = 2000.0, 5.5


# A request: a command, or one with a payload of two bytes, such as the motor's.
_REQUEST = re.compile(rb"\xa5(?:([\x00-\x7f])|([\x80-\xff])\x02(..).)", re.DOTALL)


class RplidarEmulator(EmulatedDevice):
    """The scanner, switched on from `with` or start() until close().

    model: 1 of an A1, 2 of an A2. stuck: it obeys, but sends no ray. lost: share of the bytes of rays that never
    arrive. health: "good", "failed", or "hung": failed until it is reset. duty: of its motor, as it was told. scanning:
    whether it sends rays.
    """

    def __init__(
        self,
        walls: FloatArray,
        pose: Callable[[], FloatArray],
        X_BS: FloatArray | None = None,
        noise: float = 0.0,
        model: int = 1,
    ) -> None:
        """walls: (n, 4) in W, m. pose: the robot's true X_WB (3,) now. X_BS: (3,) where the scanner sits. noise:
        standard deviation of a range, m."""
        self._walls, self._pose = walls, pose
        self._X_BS = np.zeros(3) if X_BS is None else X_BS
        self._config = ScanConfig(range=12.0, least_range=0.15, noise=noise)
        self.model = model
        self.stuck, self.scanning, self.lost, self.duty = False, False, 0.0, 0
        self.health = "good"
        self._noise, self._chance = np.random.default_rng(0), random.Random(0)
        # Number of rays measured.
        self._rays = 0
        # The robot's pose X_WB at the last of them.
        self._last = pose()
        super().__init__("rplidar")

    def unplug(self) -> None:
        """Pulls the cable, which is its supply, too."""
        super().unplug()
        self.scanning = False

    def _switch_on(self) -> None:
        self._measured(np.zeros(1), self._pose())
        self._last = self._pose()

    def _run(self) -> None:
        begin, sent = time.monotonic(), 0
        while not self._stop.wait(TICK):
            due = int((time.monotonic() - begin) * RAYS)
            with self._lock:
                if self._line is not None:
                    self._obey(self._line)
                    if self.scanning and not self.stuck and due > sent:
                        self._line.write(self._turned(due - sent))
                if not self.scanning:
                    self._last = self._pose()
            sent = due

    def _obey(self, line: PseudoTerminal) -> None:
        for plain, other, payload in _REQUEST.findall(line.read()):
            line.write(self._answer(Command((plain or other)[0]), payload))

    def _answer(self, command: Command, payload: bytes) -> bytes:
        if command == Command.GET_INFO:
            return codec.descriptor(command) + bytes((self.model << 4 | 8, 29, 1, 7)) + bytes(16)
        if command == Command.GET_HEALTH:
            failed = self.health != "good"
            return codec.descriptor(command) + bytes((Health.FAILED if failed else Health.GOOD, 1 if failed else 0, 0))
        if command == Command.RESET:
            self.scanning = False
            self.health = "good" if self.health == "hung" else self.health
            return b"RP LIDAR System.\r\n"
        if command == Command.STOP:
            self.scanning = False
        elif command == Command.MOTOR:
            self.duty = int.from_bytes(payload, "little")
        elif command == Command.SCAN and self.health == "good":
            self.scanning = True
            return codec.descriptor(command)
        return b""

    def _turned(self, count: int) -> bytes:
        """Return the bytes of the next rays."""
        per_turn = RAYS / TURNS
        turns = (self._rays + np.arange(count)) / per_turn
        self._rays += count
        # Since the last rays, whenever they were, the robot is taken to have moved evenly.
        begin, end = self._last, self._pose()
        self._last, moved = end, end - begin
        moved[2] = wrap_angle(moved[2])
        ranges = np.empty(count)
        # The rays of half a tick are cast from one pose.
        for block in np.array_split(np.arange(count), math.ceil(count / (0.5 * RAYS * TICK))):
            angles = -2.0 * math.pi * (turns[block] % 1.0)
            ranges[block] = self._measured(angles, begin + moved * ((block.mean() + 1.0) / count))
        data = b"".join(
            codec.encode(Node(turn % 1.0 < 1.0 / per_turn, 2.0 * math.pi * (turn % 1.0), distance))
            for turn, distance in zip(turns.tolist(), ranges.tolist(), strict=True)
        )
        return data if not self.lost else bytes(byte for byte in data if self._chance.random() >= self.lost)

    def _measured(self, angles: FloatArray, X_WB: FloatArray) -> FloatArray:
        """Return ranges (n,), m, of rays at angles (n,), rad, counter-clockwise from the scanner's x axis; nan without
        a return. X_WB: (3,) of the robot."""
        angles.setflags(write=False)
        normal = self._noise.normal(size=len(angles))
        met = scan(self._walls, compose(X_WB, self._X_BS), 0.0, angles, normal, self._config).ranges
        return np.where(np.isfinite(met), met, math.nan)
