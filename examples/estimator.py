"""Puts another estimator into the explorer: one that knows the true pose, a bound for what any other can do.

It says the pose and nothing else; MakePoseEstimator makes an estimator of it, which maps what is seen from there. Its
input truth.pose is connected to the station's port of that name; base.odometry would be there as well, a message.
"""

import numpy as np
from pydrake.systems.framework import LeafSystem

import tfg_drake
from tfg_drake.diagrams.pose_estimator import MakePoseEstimator
from tfg_drake.geometry.se2 import between


class TruePose(LeafSystem):
    """The pose X_MB of the body in the map frame M, which is where the robot began."""

    def __init__(self, scenario):
        super().__init__()
        self.X_WM = np.array(scenario.world.start)
        self.truth = self.DeclareVectorInputPort("truth.pose", 5)
        self.DeclareVectorOutputPort("X_MB", 3, self.calc)

    def calc(self, context, output):
        output.SetFromVector(between(self.X_WM, self.truth.Eval(context)[:3]))


def MakeTruthEstimator(scenario):
    return MakePoseEstimator(TruePose(scenario), sigma=(1e-3, 1e-3, 1e-3))


if __name__ == "__main__":
    for name, estimator in (("as it is", None), ("the truth", MakeTruthEstimator)):
        mission = tfg_drake.explore("house", estimator=estimator, until=600.0)
        print(f"{name}: {mission}")
