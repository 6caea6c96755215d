"""A Kobuki on a pseudo-terminal, in real time: a stand-in for the base that needs no base."""

from __future__ import annotations

import collections
import random
import time

import numpy as np

from tfg_drake.config import RobotConfig, ScanConfig, TagSensorConfig
from tfg_drake.hardware.emulation.emulated_base import PERIOD, EmulatedBase
from tfg_drake.hardware.emulation.emulated_device import EmulatedDevice, PseudoTerminal
from tfg_drake.hardware.emulation.sensor_faults import Fault, unchanged
from tfg_drake.hardware.emulation.sensor_socket import SensorSocket, sensor_line
from tfg_drake.hardware.kobuki.codec import COMMANDS, BaseControl, Deframer, decode, encode
from tfg_drake.messages import LaserScan, TagDetections
from tfg_drake.simulation.differential_drive import CONTACTS
from tfg_drake.simulation.laser_scanner import ray_angles, scan
from tfg_drake.simulation.tag_sensor import NOISE_PER_TAG, detect
from tfg_drake.world.world import World, bare_world

# Commands remembered, some twenty seconds of a driver's.
_REMEMBERED = 1000
# How late a late frame is, s.
DELAY = 0.2


def empty_plane() -> World:
    """A world without walls and tags; the robot starts at the origin."""
    return bare_world(np.zeros((0, 4)), np.zeros(3))


class Emulator(EmulatedDevice):
    """The base, switched on from `with` or start() until close(). Without its cable it goes on with what it was told
    last.

    sensors: address (host, port) of the socket with tags and scans. base: the base itself, with the truth. commands:
    what a driver told the wheels, newest last: (time, BaseControl), the time when it was read, s of time.monotonic().
    corrupt, lost, late: shares of frames that leave with a byte changed, not at all, or DELAY late with their old
    stamp. silent: it says nothing, but obeys. faults: what is wrong with "tags" or "scan" on the socket, see
    sensor_faults.

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
        self.corrupt = self.lost = self.late = 0.0
        self.silent = False
        self.faults: dict[str, Fault] = {}
        # Late frames, and when they are due, s of the base's time.
        self._late: collections.deque[tuple[float, bytearray]] = collections.deque()
        self._deframer = Deframer()
        self._begin = 0.0
        self._socket = SensorSocket()
        self.sensors = self._socket.address
        super().__init__("kobuki")

    def _switch_on(self) -> None:
        self.base.step()
        self._sense(time.monotonic(), -1.0)
        self._begin = time.monotonic() - self.base.time

    def unplug(self) -> None:
        """Pulls the cable; half a frame that has come is forgotten."""
        super().unplug()
        self._deframer = Deframer()

    def report(self) -> dict[str, object]:
        """The truth: stamp (s of time.monotonic()), pose X_WB (m, rad), contacts so far, distance gone so far (m)."""
        with self._lock:
            return {
                "stamp": self._begin + self.base.time,
                "pose": self.base.pose.tolist(),
                "contacts": int(self.base.state[CONTACTS]),
                "distance": self.base.distance,
            }

    def close(self) -> None:
        """Switches the base off, pulls the cable and closes the socket."""
        super().close()
        self._socket.close()

    def _run(self) -> None:
        while not self._stop.wait(max(0.0, self._begin + self.base.time + PERIOD - time.monotonic())):
            with self._lock:
                before = self.base.time
                if self._line is not None:
                    self._listen(self._line)
                self.base.step()
                if self._line is not None:
                    self._speak(self._line)
            self._sense(self._begin, before)

    def _listen(self, line: PseudoTerminal) -> None:
        for payload in self._deframer.feed(line.read()):
            for part in decode(payload, COMMANDS):
                self.base.obey(part)
                if isinstance(part, BaseControl):
                    self.commands.append((time.monotonic(), part))

    def _speak(self, line: PseudoTerminal) -> None:
        frame = bytearray(encode(*self.base.feedback()))
        if self._chance.random() < self.corrupt:
            frame[self._chance.randrange(len(frame))] ^= self._chance.randrange(1, 256)
        if self._chance.random() < self.late:
            self._late.append((self.base.time + DELAY, frame))
        elif not self.silent and self._chance.random() >= self.lost:
            line.write(frame)
        while self._late and self._late[0][0] <= self.base.time:
            _, frame = self._late.popleft()
            line.write(frame)

    def _sense(self, begin: float, before: float) -> None:
        """Tags and a scan, each when another of its periods is over since `before`, s."""
        now, pose, world = self.base.time, self.base.pose, self._world
        if _count(now, self._tags.rate) > _count(before, self._tags.rate):
            normal = self._noise.normal(size=(len(world.tag_ids), NOISE_PER_TAG))
            self._say("tags", detect(world, pose, begin + now, normal, self._tags))
        if _count(now, self._scanner.rate) > _count(before, self._scanner.rate):
            normal = self._noise.normal(size=len(self._angles))
            self._say("scan", scan(world.walls, pose, begin + now, self._angles, normal, self._scanner))

    def _say(self, sensor: str, message: TagDetections | LaserScan) -> None:
        if (said := self.faults.get(sensor, unchanged)(message)) is not None:
            self._socket.send(sensor_line(said))


def _count(now: float, rate: float) -> int:
    """Periods of a rate (Hz) that are over."""
    return int(now * rate + 1e-6)
