"""The body of a robot that is not there: a round differential drive among walls, as the simulator has it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from tfg_drake.config import RobotConfig
from tfg_drake.messages import FloatArray
from tfg_drake.simulation import differential_drive as drive


class EmulatedBody:
    """state: of tfg_drake.simulation.differential_drive, the truth. distance: how far it has gone so far, m."""

    def __init__(self, walls: FloatArray, start: FloatArray, robot: RobotConfig) -> None:
        """walls: (m, 4) in W, m. start: (3,) X_WS."""
        self._walls, self._robot = walls, robot
        self.state = drive.initial_state(start, walls, robot)
        self.distance = 0.0

    @property
    def pose(self) -> FloatArray:
        """The true pose X_WB (3,)."""
        pose: FloatArray = self.state[drive.X : drive.THETA + 1]
        return pose

    def move(self, command: tuple[float, float], duration: float) -> None:
        """Moves on for `duration`, s, told a forward speed, m/s, and turn rate, rad/s."""
        before = self.pose
        self.state = drive.step(self.state, np.array(command), self._walls, self._robot, duration)
        self.distance += math.hypot(*(self.pose - before)[:2])

    def truth(self, stamp: float) -> dict[str, Any]:
        """How it fared until `stamp`, s of this machine's monotonic clock: pose X_WB (m, rad), contacts with walls so
        far and distance gone so far (m)."""
        contacts = int(self.state[drive.CONTACTS])
        return {"stamp": stamp, "pose": self.pose.tolist(), "contacts": contacts, "distance": self.distance}
