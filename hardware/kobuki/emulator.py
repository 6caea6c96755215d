"""A Kobuki on a pseudo-terminal, in real time: a stand-in for the base that needs no base."""

from __future__ import annotations

import collections
import contextlib
import os
import random
import threading
import time
import tty
from types import TracebackType

import numpy as np

from tfg_drake.config import RobotConfig, ScanConfig, TagSensorConfig
from tfg_drake.hardware.kobuki.codec import COMMANDS, Deframer, decode, encode
from tfg_drake.hardware.kobuki.emulated_base import PERIOD, EmulatedBase
from tfg_drake.hardware.kobuki.payloads import BaseControl
from tfg_drake.hardware.kobuki.sensor_socket import SensorSocket, sensor_line
from tfg_drake.simulation.laser_scanner import ray_angles, scan
from tfg_drake.simulation.tag_sensor import NOISE_PER_TAG, detect
from tfg_drake.world.world import World

# Commands remembered, some twenty seconds of a driver's.
_REMEMBERED = 1000


def empty_plane() -> World:
    """A world without walls and tags; the robot starts at the origin."""
    return World(np.zeros((0, 4)), np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0), np.zeros(3))


class Emulator:
    """The base behind a pseudo-terminal, from `with` or start() until close().

    device: the path that a driver opens. sensors: address (host, port) of the socket with tags and scans. base: the
    base itself, with the truth. commands: what a driver told the wheels, newest last: (time, BaseControl), the time
    when it was read, s of time.monotonic(). corrupt: share of frames that leave with a byte changed. silent: it says
    nothing, but obeys.

    Stamps of tags and scans are s of time.monotonic(), too. There are no stamps of frames but the base's own.
    """

    def __init__(
        self,
        world: World | None = None,
        robot: RobotConfig | None = None,
        tags: TagSensorConfig | None = None,
        scanner: ScanConfig | None = None,
        seed: int = 0,
    ) -> None:
        """world: an empty plane where there is none. seed: of the sensors' noise and of the corrupted bytes."""
        self._world = world or empty_plane()
        self._tags, self._scanner = tags or TagSensorConfig(), scanner or ScanConfig()
        self._angles = ray_angles(self._scanner)
        self._noise, self._chance = np.random.default_rng(seed), random.Random(seed)
        self.base = EmulatedBase(self._world.walls, self._world.start, robot or RobotConfig())
        self.commands: collections.deque[tuple[float, BaseControl]] = collections.deque(maxlen=_REMEMBERED)
        self.corrupt = 0.0
        self.silent = False
        # Both ends raw, or the line discipline would eat bytes; the slave stays open, or the master would see the
        # driver's absence as an error; nothing blocks, or the base would stand still while nobody reads.
        self._master, self._slave = os.openpty()
        tty.setraw(self._master)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.device = os.ttyname(self._slave)
        self._socket = SensorSocket()
        self.sensors = self._socket.address
        self._deframer = Deframer()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="kobuki-emulator", daemon=True)

    def start(self) -> None:
        """Switches the base on. All kernels are compiled before time begins to count."""
        self.base.step()
        self._sense(time.monotonic(), -1.0)
        self._thread.start()

    def close(self) -> None:
        """Switches the base off and pulls the cable."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        for end in (self._master, self._slave):
            os.close(end)
        self._socket.close()

    def __enter__(self) -> Emulator:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _run(self) -> None:
        begin = time.monotonic() - self.base.time
        while not self._stop.wait(max(0.0, begin + self.base.time + PERIOD - time.monotonic())):
            self._listen()
            before = self.base.time
            self.base.step()
            self._speak()
            self._sense(begin, before)

    def _listen(self) -> None:
        with contextlib.suppress(BlockingIOError):
            for payload in self._deframer.feed(os.read(self._master, 65536)):
                for part in decode(payload, COMMANDS):
                    self.base.obey(part)
                    if isinstance(part, BaseControl):
                        self.commands.append((time.monotonic(), part))

    def _speak(self) -> None:
        frame = bytearray(encode(*self.base.feedback()))
        if self._chance.random() < self.corrupt:
            frame[self._chance.randrange(len(frame))] ^= self._chance.randrange(1, 256)
        if not self.silent:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, frame)

    def _sense(self, begin: float, before: float) -> None:
        """Tags and a scan, each when another of its periods is over since `before`, s."""
        now, pose, world = self.base.time, self.base.pose, self._world
        if _count(now, self._tags.rate) > _count(before, self._tags.rate):
            normal = self._noise.normal(size=(len(world.tag_ids), NOISE_PER_TAG))
            self._socket.send(sensor_line(detect(world, pose, begin + now, normal, self._tags)))
        if _count(now, self._scanner.rate) > _count(before, self._scanner.rate):
            normal = self._noise.normal(size=len(self._angles))
            seen = scan(world.walls, pose, begin + now, self._angles, normal, self._scanner)
            self._socket.send(sensor_line(seen))


def _count(now: float, rate: float) -> int:
    """Periods of a rate (Hz) that are over."""
    return int(now * rate + 1e-6)
