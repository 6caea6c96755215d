"""Poses of robot and people for a SceneGraph."""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.common.value import AbstractValue
from pydrake.geometry import FrameId, FramePoseVector
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.simulation.people import People, discs_at
from tfg_drake.systems.ports import MessageInputs
from tfg_drake.systems.rendered_world import PlanarPose

# Pose of people who have not appeared yet: below the floor, out of sight.
_AWAY = RigidTransform([0.0, 0.0, -100.0])


class PlanarFramePoses(LeafSystem):
    """Outputs the poses of frames that move on the floor.

    .. pydrake_system::

        name: PlanarFramePoses
        input_ports:
        - pose
        - people
        output_ports:
        - geometry_pose

    pose: x, y, theta, v, w of the plant. people: a People message, unconnected without people.
    geometry_pose: a FramePoseVector of robot and people.
    """

    def __init__(self, robot: FrameId, people: Sequence[FrameId] = ()):
        super().__init__()
        self._robot, self._walking = robot, people
        self._pose = self.DeclareVectorInputPort("pose", 5)
        self._people = MessageInputs(self, people=People)
        self.DeclareAbstractOutputPort(
            "geometry_pose",
            lambda: AbstractValue.Make(FramePoseVector()),
            self._CalcPoses,
            {self._pose.ticket(), self._people.ports["people"].ticket(), self.time_ticket()},
        )

    def _CalcPoses(self, context: Context, output: AbstractValue) -> None:
        poses = FramePoseVector()
        poses.set_value(self._robot, PlanarPose(self._pose.Eval(context)[:3]))
        people = self._people.optional(context, "people") if self._walking else None
        discs = None if people is None else discs_at(people, context.get_time())
        for k, frame in enumerate(self._walking):
            X_WP = _AWAY if discs is None or k >= len(discs) else RigidTransform([*discs[k, :2], 0.0])
            poses.set_value(frame, X_WP)
        output.set_value(poses)
