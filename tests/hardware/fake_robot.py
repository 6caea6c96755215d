"""A robot that is all in one's own hands: what the real devices promise, without a process or real time."""

from typing import ClassVar

import numpy as np

from tfg_drake.hardware.device import BaseState, DeviceError
from tfg_drake.messages import Hazards, LaserScan, Odometry, TagDetections, replace


def base_state(stamp, **changes):
    """What a base says of itself where nothing is wrong with it, but for some fields."""
    return replace(BaseState(stamp, 13.8), **changes)


class FakeDevice:
    """Speaks at fixed rates from the host's time it is first asked for; what it was told is kept."""

    PERIODS: ClassVar = {Odometry: 0.02, Hazards: 0.02, TagDetections: 0.1, LaserScan: 0.1}

    def __init__(self):
        self.begin = None
        self.said = dict.fromkeys(self.PERIODS, 0)
        self.silent = set()
        self.bumper = 0
        self.state = None  # what it says of itself
        self.remarks = []
        self.moving_at = ()  # numbers of the odometry messages that say that it moved
        self.locked = "not enabled yet"
        self.refuses = None
        self.enabled = 0
        self.commands = []
        self.dead = False

    def message(self, kind, number):
        stamp = self.begin + number * self.PERIODS[kind]
        if kind is Odometry:
            return Odometry(stamp, np.array([0.01 * number, 0.0, 0.0]), np.zeros(2), number not in self.moving_at)
        if kind is Hazards:
            return Hazards(stamp, self.bumper, 0, 0)
        if kind is TagDetections:
            one = np.ones(1)
            return TagDetections(stamp, np.array([number]), one, one, one, one)
        angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
        return LaserScan(stamp, angles, np.full(360, number + 5.0), 1e6, 0.01)

    def first(self, kind):
        self.begin = 0.0
        message, self.begin = self.message(kind, 7), None
        return message

    def take(self, kind, until):
        if self.begin is None:
            self.begin = until
        taken = []
        while self.begin + self.said[kind] * self.PERIODS[kind] <= until + 1e-9:
            if kind not in self.silent:
                taken.append(self.message(kind, self.said[kind]))
            self.said[kind] += 1
        return taken

    def newest(self, kind):
        assert kind is BaseState
        return self.state

    def take_remarks(self):
        taken, self.remarks = self.remarks, []
        return taken

    def enable(self):
        if self.refuses:
            raise DeviceError(f"the robot is not enabled: {self.refuses}")
        self.enabled, self.locked = self.enabled + 1, None

    def lock(self, reason):
        self.locked = reason

    def command(self, speed, turn_rate, due):
        if self.dead:
            raise DeviceError("the robot's process has ended")
        self.commands.append((due - self.begin if self.begin is not None else 0.0, speed, turn_rate))


class SameClock:
    """A host clock whose station began with the host."""

    def host(self, stamp, _now):
        return stamp
