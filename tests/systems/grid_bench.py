"""One system of the grid baseline with its inputs at hand, and messages for it."""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from tfg_drake.messages import GridMap, LaserScan, PoseEstimate

NONE = np.zeros((0, 2))
ANGLES = np.linspace(-1.0, 1.0, 121)


def grid(stage=1, stamp=0.0, known=4.0):
    """A room of 6 x 4 m, walled in, of which the left `known` metres were seen."""
    probability = np.full((80, 120), 0.1, dtype=np.float32)
    probability[[0, -1]] = probability[:, [0, -1]] = 0.9
    probability[:, round(known / 0.05) :] = 0.5
    return GridMap(stage, stamp, 0.05, np.zeros(2), probability)


def pose(x=1.0, y=2.0, stamp=0.0):
    return PoseEstimate(stamp, np.array([x, y, 0.0]), 1e-4 * np.eye(3), np.zeros(2), 1, NONE[:, 0].astype(int), NONE)


def scan(stamp=0.0, ranges=10.0):
    return LaserScan(stamp, ANGLES, np.full(len(ANGLES), ranges), 10.0, 0.015)


class Bench:
    """One system with its inputs at hand."""

    def __init__(self, system, **messages):
        self.system, self.simulator = system, Simulator(system)
        self.context = self.simulator.get_mutable_context()
        self.set(**messages)
        self.simulator.Initialize()

    def set(self, **messages):
        for name, value in messages.items():
            self.system.GetInputPort(name).FixValue(self.context, AbstractValue.Make(value))
        return self

    def run(self, seconds=0.125):
        self.simulator.AdvanceTo(self.context.get_time() + seconds)
        return self

    def output(self, name):
        return self.system.GetOutputPort(name).Eval(self.context)
