"""What records a mission's picture over time."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem, System

from tfg_drake.messages import (
    FloatArray,
    GoalChoice,
    GridMap,
    LaserScan,
    MapEstimate,
    MissionStatus,
    Path,
    PoseEstimate,
    Roadmap,
    TfgMap,
)
from tfg_drake.pictures import scene
from tfg_drake.planning.requested_goal import REASON
from tfg_drake.simulation.people import People, places_at
from tfg_drake.slam.pose_prediction import pose_at
from tfg_drake.storage.timeline import TimelineWriter
from tfg_drake.systems.ports import declare_message_input, eval_message

T = TypeVar("T")

# Poses a simulated second, and how many of them to a scan: the page draws what lies between.
RATE = 8.0
POSES_A_SCAN = 4

_MESSAGES = {
    "map": MapEstimate,
    "tfg": TfgMap,
    "roadmap": Roadmap,
    "goal": GoalChoice,
    "path": Path,
    "grid": GridMap,
    "mission": MissionStatus,
    "pose": PoseEstimate,
    "scan": LaserScan,
    "people": People,
}
# The layer of a message that is the most to write, where it has several.
_HEAVIEST = {"goal": "gains"}


class TimelineRecorder(LeafSystem):
    """Writes what a mission looks like to a file, see tfg_drake.storage.timeline and tfg_drake.pictures.scene.

    .. pydrake_system::

        name: TimelineRecorder
        input_ports:
        - map
        - tfg
        - roadmap
        - goal
        - path
        - grid
        - mission
        - pose
        - scan
        - people
        - enabled
        - truth

    Every port is optional and gives its own layers, which are written when their message has changed. enabled: (1,)
    whether the base may move. truth: the true pose (x, y, theta, v, w) in W.

    It changes nothing in the Context; the file is a side effect outside of it: one simulation to a file.
    """

    def __init__(self, writer: TimelineWriter) -> None:
        """writer: where to; whoever opened it closes it."""
        super().__init__()
        self._writer = writer
        self._newest: dict[str, object] = {}  # what stands in the file
        self._stars: tuple[FloatArray, ...] = ()
        self._count = 0
        self._inputs = {name: declare_message_input(self, name) for name in _MESSAGES}
        self._enabled = self.DeclareVectorInputPort("enabled", 1)
        self._truth = self.DeclareVectorInputPort("truth", 5)
        self.DeclarePeriodicPublishEvent(1.0 / RATE, 0.0, self._Write)
        self.DeclareForcedPublishEvent(self._WriteAll)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder, station: System, explorer: System, writer: TimelineWriter
    ) -> TimelineRecorder:
        """Adds a recorder of a mission, connected to its station and explorer by port name."""
        recorder = TimelineRecorder(writer)
        builder.AddNamedSystem("timeline_recorder", recorder)
        for name in _MESSAGES:
            if explorer.HasOutputPort(name):
                builder.Connect(explorer.GetOutputPort(name), recorder.GetInputPort(name))
        for name, port in (
            ("scan.ranges", "scan"),
            ("base.enabled", "enabled"),
            ("truth.pose", "truth"),
            ("truth.people", "people"),
        ):
            if station.HasOutputPort(name):
                builder.Connect(station.GetOutputPort(name), recorder.GetInputPort(port))
        return recorder

    def _WriteAll(self, context: Context) -> EventStatus:
        self._Record(context, everything=True)
        self._writer.flush()
        return EventStatus.Succeeded()

    def _Write(self, context: Context) -> EventStatus:
        self._Record(context, everything=False)
        self._writer.flush(all_of_it=False)
        return EventStatus.Succeeded()

    def _Get(self, context: Context, name: str) -> Any:
        port = self._inputs[name]
        return eval_message(port, context, _MESSAGES[name]) if port.HasValue(context) else None

    def _Record(self, context: Context, everything: bool) -> None:
        now = context.get_time()
        for name in ("map", "tfg", "roadmap", "goal", "path", "grid", "mission"):
            message = self._Get(context, name)
            before = self._newest.get(name)
            if message is None or message is before:
                continue
            if isinstance(before, MapEstimate) and before.stage == message.stage == 0:
                continue  # Until there is a view the map is made anew at every look.
            if everything or self._writer.is_due(_HEAVIEST.get(name, name), now):
                self._newest[name] = message
                self._WriteMessage(name, message, now, context)
        if self._enabled.HasValue(context):
            enabled = bool(self._enabled.Eval(context)[0] > 0.0)
            if enabled != self._newest.get("enabled"):
                self._newest["enabled"] = enabled
                self._writer.write("enabled", now, {}, enabled=enabled)
        self._WriteMoving(context, now, scans=everything or self._count % POSES_A_SCAN == 0)
        self._count += 1

    def _WriteMessage(self, name: str, message: Any, now: float, context: Context) -> None:
        write = self._writer.write
        if name == "map":
            layer = dict(scene.landmarks(message))
            layer["covariance"] = layer["covariance"].astype(np.float32)
            told = {"stage": message.stage, "entropy": message.entropy, "views": len(message.X_MA)}
            write("map", now, layer, **told)
        elif name == "tfg":
            layer = dict(scene.surfaces(message))
            layer["kind"] = layer["kind"].astype(np.uint8)
            estimate = self._Get(context, "map")
            if estimate is not None and len(estimate.ids) == len(message.facing):
                layer["facing"] = scene.tag_normals(message, estimate.ids).astype(np.float32)
            write("tfg", now, layer)
            write("frontiers", now, scene.frontiers(message))
            stars = scene.free_space(message)
            changed = scene.changed_stars(self._stars, stars)
            if len(changed):
                write("free", now, scene.packed_stars(stars, changed))
                kept = list(self._stars) + [None] * (len(stars) - len(self._stars))
                for i in changed:
                    kept[i] = stars[i]
                self._stars = tuple(star for star in kept if star is not None)
        elif name == "roadmap":
            write("roadmap", now, scene.roadmap_lines(message))
        elif name == "goal":
            roadmap = self._Get(context, "roadmap")
            there = scene.goal(message) if message.node >= 0 else {"points": np.zeros((0, 2))}
            told = {"verdict": message.verdict, "reason": message.reason, "stage": message.stage}
            told["sent"] = message.reason == REASON
            write("goal", now, there, **told)
            if roadmap is not None:
                layer = dict(scene.gains(message, roadmap))
                layer["share"] = layer["share"].astype(np.float32)
                write("gains", now, layer, explained=scene.explained(message, roadmap), stage=message.stage)
        elif name == "path":
            write("path", now, scene.path(message))
        elif name == "grid":
            write("grid", now, scene.grid_cells(message), resolution=message.resolution, stage=message.stage)
        else:
            told = {"phase": message.phase, "stage": message.stage, "outcome": message.outcome}
            write("mission", now, {}, **told, reason=message.reason, drives=message.drives)

    def _WriteMoving(self, context: Context, now: float, scans: bool) -> None:
        pose = self._Get(context, "pose")
        if pose is not None:
            P = pose.covariance
            values = [*pose_at(pose, now), P[0, 0], P[0, 1], P[1, 1], P[2, 2]]
            self._writer.write("pose", now, {"pose": np.array(values, dtype=np.float32)})
        if self._truth.HasValue(context):
            self._writer.write("truth", now, {"pose": self._truth.Eval(context)[:3].astype(np.float32)})
        people = self._Get(context, "people")
        if people is not None:
            self._writer.write("people", now, {"points": places_at(people, now)})
        scan = self._Get(context, "scan") if scans else None
        if scan is not None and pose is not None and scan is not self._newest.get("scan"):
            self._newest["scan"] = scan
            self._writer.write("scan", now, scene.scan_points(scan, pose))
