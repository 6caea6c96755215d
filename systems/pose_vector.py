"""The pose estimate as plain vectors, for Drake's own loggers."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from tfg_drake.systems.ports import MessageInputs


class PoseVector(LeafSystem):
    """Converts a pose estimate to a vector of 4: stamp (s) and X_MB (x, y in m, theta in rad); with_covariance: 13
    numbers, the same followed by the covariance of X_MB, row by row.

    .. pydrake_system::

        name: PoseVector
        input_ports:
        - pose
        output_ports:
        - vector
        - with_covariance

    pose: PoseEstimate. vector: (4,), with_covariance: (13,), as above.
    """

    def __init__(self) -> None:
        super().__init__()
        self._inputs = MessageInputs(self, "pose")
        ticket = self._inputs.ports["pose"].ticket()
        self.DeclareVectorOutputPort("vector", 4, self._CalcVector, {ticket})
        self.DeclareVectorOutputPort("with_covariance", 13, self._CalcWithCovariance, {ticket})

    def _CalcVector(self, context: Context, output: BasicVector) -> None:
        pose = self._inputs(context, "pose")
        output.SetFromVector(np.append(pose.stamp, pose.X_MB))

    def _CalcWithCovariance(self, context: Context, output: BasicVector) -> None:
        pose = self._inputs(context, "pose")
        output.SetFromVector(np.concatenate([[pose.stamp], pose.X_MB, pose.covariance.ravel()]))
