"""A robot that is not there: a round differential drive among walls, with scans and tags, as the simulator has it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tfg_drake.config import RobotConfig, ScanConfig, TagSensorConfig
from tfg_drake.hardware.emulation.sensor_faults import Fault, unchanged
from tfg_drake.messages import FloatArray
from tfg_drake.simulation import differential_drive as drive
from tfg_drake.simulation import laser_scanner, tag_sensor
from tfg_drake.world.world import World


class EmulatedRobot:
    """Base of the emulated robots.

    state: of tfg_drake.simulation.differential_drive, the truth. distance: how far it has gone so far, m. faults: of
    "tags" or "scan", see sensor_fault.
    """

    def __init__(
        self,
        world: World,
        robot: RobotConfig | None = None,
        tags: TagSensorConfig | None = None,
        scanner: ScanConfig | None = None,
        seed: int | None = None,
    ) -> None:
        """seed: of the sensors' noise, None for none."""
        self._world, self._robot = world, robot or RobotConfig()
        self.tags, self.scanner = tags or TagSensorConfig(), scanner or ScanConfig()
        self.state = drive.initial_state(world.start, world.walls, self._robot)
        self.distance = 0.0
        self._angles = laser_scanner.ray_angles(self.scanner)
        self._random = None if seed is None else np.random.default_rng(seed)
        self.faults: dict[str, Fault] = {}

    @property
    def pose(self) -> FloatArray:
        """The true pose X_WB (3,)."""
        pose: FloatArray = self.state[drive.X : drive.THETA + 1]
        return pose

    def move(self, command: tuple[float, float], duration: float) -> None:
        """Moves on for `duration`, s, told a forward speed, m/s, and turn rate, rad/s."""
        before = self.pose
        self.state = drive.step(self.state, np.array(command), self._world.walls, self._robot, duration)
        self.distance += math.hypot(*(self.pose - before)[:2])

    def truth(self, stamp: float) -> dict[str, Any]:
        """How it fared until `stamp`, s of this machine's monotonic clock: pose X_WB (m, rad), contacts with walls so
        far and distance gone so far (m)."""
        contacts = int(self.state[drive.CONTACTS])
        return {"stamp": stamp, "pose": self.pose.tolist(), "contacts": contacts, "distance": self.distance}

    def noise(self, *shape: int) -> FloatArray:
        """Standard normal numbers, or zeros without a seed."""
        return np.zeros(shape) if self._random is None else self._random.normal(size=shape)

    def told_scan(self, X_WS: FloatArray, stamp: float) -> Any:
        """The scan from a pose X_WS (3,) after its fault; None where none is sent."""
        noise = self.noise(len(self._angles))
        scan = laser_scanner.scan(self._world.walls, X_WS, stamp, self._angles, noise, self.scanner)
        return self.faults.get("scan", unchanged)(scan)

    def told_tags(self, X_WB: FloatArray, stamp: float) -> Any:
        """Detections from a pose X_WB (3,) after their fault; None where none are sent."""
        noise = self.noise(len(self._world.tag_ids), tag_sensor.NOISE_PER_TAG)
        return self.faults.get("tags", unchanged)(tag_sensor.detect(self._world, X_WB, stamp, noise, self.tags))
