"""Records the layers of a mission's picture over time."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem, System

from tfg_drake.geometry.se2 import pose_at
from tfg_drake.messages import FloatArray, MapEstimate
from tfg_drake.pictures import scene, tables
from tfg_drake.pictures.rows import Table
from tfg_drake.planning.requested_goal import REASON
from tfg_drake.simulation.disturbance import Pushes
from tfg_drake.simulation.people import People, places_at
from tfg_drake.systems.ports import MessageInputs, connect_by_name

# Poses are written RATE times per simulated second, the page interpolates; a scan every POSES_A_SCAN poses, and slowly
# changing layers are checked every POSES_A_LOOK poses.
RATE = 8.0
POSES_A_SCAN, POSES_A_LOOK = 4, 2

_MESSAGES = ("map", "tfg", "roadmap", "goal", "path", "grid", "mission", "pose", "scan", "local_roadmap", "landmarks")
# Names of the station's outputs by the recorder's inputs.
_HEARD_AS = {"scan": "scan.ranges", "enabled": "base.enabled", "truth": "truth.pose", "people": "truth.people"}
# Layers of each message that has several.
_LAYERS = {
    "map": ("map", "wall_landmarks"),
    "goal": ("goal", "gains"),
    "tfg": ("tfg", "frontiers"),
    "roadmap": ("nodes", "roadmap"),
}


class LayerWriter(Protocol):
    """A writer of layers: a TimelineWriter, or an object that draws them."""

    def is_due(self, layer: str, time: float) -> bool:
        """Return True if a layer may be written at a time, s."""

    def write(self, layer: str, time: float, arrays: Mapping[str, NDArray[Any]], **told: Any) -> None:
        """Write a record of a layer."""

    def write_rows(self, layer: str, time: float, table: Table, **told: Any) -> None:
        """Write the changes of a table."""

    def flush(self, *, all_of_it: bool = True) -> None:
        """Finish an instant, after all its records."""


class TimelineRecorder(LeafSystem):
    """Writes the layers of a mission to a file, see tfg_drake.storage.timeline and tfg_drake.pictures.scene.

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
        - pushes
        - local_roadmap
        - landmarks
        - enabled
        - truth

    map: MapEstimate, tfg: TfgMap, roadmap: Roadmap, goal: GoalChoice, path: Path, grid: GridMap, mission:
    MissionStatus, pose: PoseEstimate, local_roadmap: Roadmap, landmarks: MapEstimate of tags and walls, written with
    map, all in M. scan: LaserScan. people: People, in W. pushes: Pushes, motions that the wheels do not cause.

    Every port is optional and has its own layers, which are written when their message has changed. enabled: (1,), 1
    while the base may move. truth: the true pose (x, y, theta, v, w) in W.

    The recorder changes nothing in the Context; the file is a side effect, so each simulation needs its own file.
    """

    def __init__(self, writer: LayerWriter) -> None:
        """writer: of the file, closed by its owner."""
        super().__init__()
        self._writer = writer
        self._Forget()
        self._Get = MessageInputs(self, *_MESSAGES, people=People, pushes=Pushes).optional
        self._enabled = self.DeclareVectorInputPort("enabled", 1)
        self._truth = self.DeclareVectorInputPort("truth", 5)
        self.DeclarePeriodicPublishEvent(1.0 / RATE, 0.0, functools.partial(self._Write, False))
        self.DeclareForcedPublishEvent(functools.partial(self._Write, True))

    def Connect(self, builder: DiagramBuilder, station: System, explorer: System, *others: System) -> None:
        """Connect it to a mission's station, explorer and other systems, such as its operator, by port name."""
        connect_by_name(builder, self, explorer, *others)
        connect_by_name(builder, self, station, **_HEARD_AS)

    def _Forget(self) -> None:
        """Mark all layers as not yet written."""
        self._newest: dict[str, object] = {}  # newest message in the file, by layer
        self._stars: dict[int, FloatArray] = {}  # free space in the file, by view
        self._count = 0

    def _Write(self, everything: bool, context: Context) -> None:
        now = context.get_time()
        if everything or self._count % POSES_A_LOOK == 0:
            self._Look(context, now, everything)
        if self._enabled.HasValue(context):
            enabled = bool(self._enabled.Eval(context)[0] > 0.0)
            if enabled != self._newest.get("enabled"):
                self._newest["enabled"] = enabled
                self._writer.write("enabled", now, {}, enabled=enabled)
        self._WriteMoving(context, now, scans=everything or self._count % POSES_A_SCAN == 0)
        self._count += 1
        self._writer.flush(all_of_it=everything)

    def _Look(self, context: Context, now: float, everything: bool) -> None:
        """Write what has changed since the last call; everything: also layers that have exceeded their rate."""
        for name in ("map", "tfg", "roadmap", "goal", "path", "grid", "pushes", "mission"):
            message = self._Get(context, name)
            before = self._newest.get(name)
            if message is None or message is before:
                continue
            if isinstance(before, MapEstimate) and before.stage == message.stage == 0:
                continue  # Before the first view the map is a new object at every look.
            if everything or self._IsDue(name, now):
                self._newest[name] = message
                self._WriteMessage(name, message, now, context)

    def _IsDue(self, name: str, now: float) -> bool:
        return all(self._writer.is_due(layer, now) for layer in _LAYERS.get(name, (name,)))

    def _WriteMessage(self, name: str, message: Any, now: float, context: Context) -> None:
        write, write_rows = self._writer.write, self._writer.write_rows
        if name == "map":
            told = {"stage": message.stage, "entropy": message.entropy, "views": len(message.X_MA)}
            write_rows("map", now, tables.landmarks(message), **told)
            with_walls = self._Get(context, "landmarks")
            if with_walls is not None:
                write_rows("wall_landmarks", now, tables.wall_landmarks(with_walls))
        elif name == "tfg":
            write_rows("tfg", now, tables.surfaces(message))
            write_rows("frontiers", now, tables.frontiers(message))
            stars = scene.free_space(message)
            changed = scene.changed_stars(self._stars, stars)
            if len(changed):
                write("free", now, scene.packed_stars(stars, changed))
                self._stars |= {index: stars[index] for index in changed.tolist()}
        elif name == "roadmap":
            write_rows("nodes", now, tables.nodes(message))
            write_rows("roadmap", now, tables.edges(message))
        elif name == "goal":
            near = self._Get(context, "local_roadmap")
            roadmap = self._Get(context, "roadmap") if near is None else near
            there = {**scene.goal(message), **(scene.tour(message, roadmap) if roadmap is not None else {})}
            told = {"verdict": message.verdict, "reason": message.reason, "stage": message.stage}
            told |= {"sent": message.reason == REASON, "most": round(float(message.gain.max(initial=0.0)), 4)}
            write("goal", now, there, **told)
            if roadmap is not None:
                told = {"explained": scene.explained(message, roadmap), "stage": message.stage}
                write_rows("gains", now, tables.gains(message, roadmap), **told)
        elif name == "path":
            write("path", now, scene.path(message))
        elif name == "grid":
            write("grid", now, scene.grid_cells(message), resolution=message.resolution, stage=message.stage)
        elif name == "pushes":
            write("pushes", now, {}, pushes=[dataclasses.asdict(push) for push in message.pushes])
        else:
            told = {"phase": message.phase, "stage": message.stage, "outcome": message.outcome}
            write("mission", now, {}, **told, reason=message.reason, drives=message.drives)

    def _WriteMoving(self, context: Context, now: float, scans: bool) -> None:
        pose = self._Get(context, "pose")
        if pose is not None:
            P = pose.covariance
            values = [*pose_at(pose, now), P[0, 0], P[0, 1], P[1, 1], P[2, 2]]
            self._writer.write("pose", now, {"pose": np.array(values, dtype=np.float32)})
            if pose.places != self._newest.get("places"):
                self._newest["places"] = pose.places
                self._writer.write("places", now, {}, places=pose.places)
        if self._truth.HasValue(context):
            self._writer.write("truth", now, {"pose": self._truth.Eval(context)[:3].astype(np.float32)})
        people = self._Get(context, "people")
        if people is not None:
            self._writer.write("people", now, {"points": places_at(people, now)})
        scan = self._Get(context, "scan") if scans else None
        if scan and pose and np.isfinite(scan.stamp) and scan is not self._newest.get("scan"):
            self._newest["scan"] = scan
            self._writer.write("scan", now, scene.scan_rays(scan, pose))
        if scans and pose is not None and pose.new_ids.tolist() != self._newest.get("sighted", []):
            self._newest["sighted"] = pose.new_ids.tolist()
            self._writer.write("sighted", now, {"points": pose.p_MU, "ids": pose.new_ids})
