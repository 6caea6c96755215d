"""Records the station's ports."""

from __future__ import annotations

import functools
from collections.abc import Mapping

from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem, OutputPort, System

from tfg_drake.storage import port_recording as storage
from tfg_drake.storage.foxglove import PATH, POSE
from tfg_drake.storage.port_recording import PortWriter
from tfg_drake.systems.ports import PERIOD, MessageInputs, connect_by_name

# Ports of an explorer that are recorded for display.
SHOWN = ("pose", "path", "map", "tfg", "landmarks")


class PortRecorder(LeafSystem):
    """Writes the values of the station's ports to a file, see tfg_drake.storage.port_recording.

    .. pydrake_system::

        name: PortRecorder
        input_ports:
        - base.odometry
        - base.hazards
        - tags.detections
        - scan.ranges
        - base.velocity_commanded
        - base.enabled
        - operator.goal
        - operator.pose
        - pose
        - path
        - map
        - tfg
        - landmarks

    base.odometry: Odometry, base.hazards: Hazards, tags.detections: TagDetections, scan.ranges: LaserScan,
    base.velocity_commanded: (2,) forward speed (m/s) and turn rate (rad/s), base.enabled: (1,), 1 while the base may
    move. pose: PoseEstimate, path: Path, map: MapEstimate, tfg: TfgMap, landmarks: MapEstimate of tags and
    walls, in M.

    operator.goal: RequestedGoal, the requested place, operator.pose: SaidPose, the stated pose, if there is an operator
    for them. The last five are the explorer's, if it has them; they are recorded for display, not for replay.
    The recorder changes nothing in the Context; the file is a side effect, so each simulation needs its own file. At
    each instant it records the values that updates at that instant see, since both precede the instant's changes.
    """

    def __init__(self, writer: PortWriter) -> None:
        """writer: the file's writer, closed by its owner."""
        super().__init__()
        self._writer = writer
        requests = {port: storage.PORTS[port] for port in storage.REQUESTS.values()}
        self._inputs = MessageInputs(self, *SHOWN, **storage.MESSAGES, **requests)
        self._command = self.DeclareVectorInputPort(storage.COMMAND, 2)
        self._enabled = self.DeclareVectorInputPort(storage.ENABLED, 1)
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, self._Write)

    def Connect(
        self, builder: DiagramBuilder, station: System, explorer: System, requested: Mapping[str, OutputPort]
    ) -> None:
        """Connect it to the ports between a station and an explorer. requested: outputs with the operator's requests,
        by the names of the inputs here."""
        for name, output in requested.items():
            builder.Connect(output, self.GetInputPort(name))
        # Requests come only from `requested`, not from a recorded station's outputs of the same names.
        unheard = dict.fromkeys(storage.REQUESTS.values(), "")
        connect_by_name(builder, self, explorer, station, **unheard)

    def _Write(self, context: Context) -> None:
        now = context.get_time()
        for name in storage.MESSAGES:
            self._writer.write(name, now, self._inputs(context, name))
        self._writer.write(storage.COMMAND, now, storage.Velocity(*self._command.Eval(context).tolist()))
        self._writer.write(storage.ENABLED, now, storage.Enabled(*self._enabled.Eval(context).tolist()))
        for name in storage.REQUESTS.values():
            requested = self._inputs.optional(context, name)
            if requested is not None and requested.count:
                self._writer.write(name, now, requested)
        look = functools.partial(self._inputs.optional, context)
        pose = look("pose")
        for topic, message in ((POSE, pose), (PATH, look("path"))):
            if message is not None:
                self._writer.write(topic, now, message)
        if pose is not None and self._writer.wants_map(pose.stage):
            estimate, tfg = look("map"), look("tfg")
            # The TFG gets the surfaces of a stage shortly after the map gets its landmarks.
            if tfg is not None and tfg.stage == estimate.stage:
                self._writer.write_map(now, estimate, tfg, look("landmarks"))
