"""Plays a recording of a station's ports."""

from __future__ import annotations

import functools
from typing import Any

from pydrake.systems.framework import BasicVector, Context, LeafSystem

from tfg_drake.messages import PoseEstimate
from tfg_drake.storage import port_recording as storage
from tfg_drake.storage.port_recording import PortRecording
from tfg_drake.systems.ports import MessageInputs, declare_message_output


class PortPlayer(LeafSystem):
    """Outputs at every time what the recorded station's ports carried then.

    .. pydrake_system::

        name: PortPlayer
        input_ports:
        - base.velocity_commanded
        - base.enable
        - base.pose
        output_ports:
        - base.odometry
        - base.hazards
        - tags.detections
        - scan.ranges
        - base.enabled
        - operator.goal
        - operator.pose

    base.velocity_commanded: (2,) forward speed (m/s) and turn rate (rad/s), base.enable: (1,), base.pose: PoseEstimate,
    as of the station. base.odometry: Odometry, base.hazards: Hazards, tags.detections: TagDetections, scan.ranges:
    LaserScan, base.enabled: (1,), 1 while the base might move. operator.goal: RequestedGoal, in M.
    operator.pose: SaidPose.

    It is the station of a replayed mission: at any time its outputs are those of the recorded station, with the same
    delays. The inputs have no effect. It has no state; its outputs depend on time only.
    """

    def __init__(self, recording: PortRecording, source: Any = None) -> None:
        """source: the origin of the recording, stored for other code."""
        super().__init__()
        self.recording, self.source = recording, source
        self.DeclareVectorInputPort(storage.COMMAND, 2)
        self.DeclareVectorInputPort("base.enable", 1)
        MessageInputs(self, **{"base.pose": PoseEstimate})
        for name in (*storage.MESSAGES, *storage.REQUESTS.values()):
            declare_message_output(self, name, functools.partial(self._Message, name), {self.time_ticket()})
        self.DeclareVectorOutputPort("base.enabled", 1, self._CalcEnabled, {self.time_ticket()})

    def _Message(self, name: str, context: Context) -> object:
        return self.recording.at(name, context.get_time())

    def _CalcEnabled(self, context: Context, output: BasicVector) -> None:
        output.SetAtIndex(0, self.recording.enabled(context.get_time()))
