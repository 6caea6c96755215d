"""Recording for Foxglove's 3D panel, in Foxglove's own schemas: poses, scans, map and path.

Frames: "map" (M) and "base" (B), which the estimated pose ties together. A scan is a foxglove.LaserScan that carries
the fields of our message, too, under numbers that Foxglove has not given: so nothing stands in the file twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan as FoxgloveScan
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf import descriptor_pb2

from tfg_drake.messages import FloatArray, LaserScan, MapEstimate, Path, PoseEstimate, TfgMap

MAP, BASE = "map", "base"
POSE, PATH, SURFACES = "display.pose", "display.path", "display.map"
# Our fields of a scan have numbers from here on, but for the ranges, which are Foxglove's; and what is only Foxglove's.
FIRST_OWN = 1000
RANGES = FoxgloveScan.DESCRIPTOR.fields_by_name["ranges"].number
ONLY_ITS = frozenset(one.name for one in FoxgloveScan.DESCRIPTOR.fields) - {"ranges"}
# Widths of lines and sizes of landmarks, m.
_WALL, _WAY, _LANDMARK = 0.04, 0.05, 0.14
# Colours, red, green, blue and opacity.
_WALL_COLOUR, _WAY_COLOUR = (0.25, 0.3, 0.38, 1.0), (0.1, 0.45, 0.9, 1.0)
_LANDMARK_COLOUR = (0.85, 0.35, 0.1, 1.0)
# Bytes of a map in the file, about: of a surface and of a landmark.
_SURFACE_BYTES, _LANDMARK_BYTES = 40, 110


def file_set(kind: Any) -> descriptor_pb2.FileDescriptorSet:
    """The files that declare one of Foxglove's messages and all that they need, what is needed first."""
    files: dict[str, Any] = {}

    def add(file: Any) -> None:
        for needed in file.dependencies:
            add(needed)
        if file.name not in files:
            files[file.name] = descriptor_pb2.FileDescriptorProto()
            file.CopyToProto(files[file.name])

    add(kind.DESCRIPTOR.file)
    return descriptor_pb2.FileDescriptorSet(file=files.values())


def scan_files(own: Sequence[Any]) -> tuple[str, descriptor_pb2.FileDescriptorSet]:
    """The name of a scan's declaration and the files with it, own fields (FieldDescriptorProto) in it besides."""
    files = file_set(FoxgloveScan)
    declared = next(one for one in files.file[-1].message_type if one.name == FoxgloveScan.DESCRIPTOR.name)
    declared.field.extend(own)
    return FoxgloveScan.DESCRIPTOR.full_name, files


def complete_scan(written: Any, scan: LaserScan) -> None:
    """Says Foxglove's fields of a scan, too, which are all but its ranges."""
    written.frame_id = BASE
    _stamp(written.timestamp, scan.stamp)
    written.pose.orientation.w = 1.0
    if len(scan.angles):
        written.start_angle, written.end_angle = float(scan.angles[0]), float(scan.angles[-1])


def pose_message(_time: float, pose: PoseEstimate) -> bytes:
    """The estimated pose, as a FrameTransform from map to base."""
    written = FrameTransform(parent_frame_id=MAP, child_frame_id=BASE)
    _stamp(written.timestamp, pose.stamp)
    x, y, theta = pose.X_MB.tolist()
    written.translation.x, written.translation.y = x, y
    written.rotation.z, written.rotation.w = math.sin(0.5 * theta), math.cos(0.5 * theta)
    return bytes(written.SerializeToString())


def path_message(time: float, path: Path) -> bytes:
    """A path that the robot takes from a time, s, on, as a SceneUpdate."""
    return _scene(_entity(time, "path", [_lines(path.points, 0, _WAY, _WAY_COLOUR)]))


def map_message(time: float, shown: tuple[MapEstimate, TfgMap]) -> bytes:
    """Surfaces and landmarks at a time, s, as a SceneUpdate."""
    estimate, tfg = shown
    lines = _lines(tfg.segments.reshape(-1, 2), 2, _WALL, _WALL_COLOUR)
    surfaces, landmarks = _entity(time, "surfaces", [lines]), _entity(time, "landmarks")
    for tag, (x, y) in zip(estimate.ids.tolist(), estimate.p_ML.tolist(), strict=True):
        cube = landmarks.cubes.add()
        cube.pose.position.x, cube.pose.position.y, cube.pose.orientation.w = x, y, 1.0
        cube.size.x = cube.size.y = cube.size.z = _LANDMARK
        _colour(cube.color, _LANDMARK_COLOUR)
        landmarks.metadata.add(key=str(tag), value=f"{x:.3f}, {y:.3f}")
    return _scene(surfaces, landmarks)


# What is shown, by topic: its schema, and what makes its bytes of a time, s, and what is recorded then.
TOPICS: dict[str, tuple[Any, Callable[[float, Any], bytes]]] = {
    POSE: (FrameTransform, pose_message),
    PATH: (SceneUpdate, path_message),
    SURFACES: (SceneUpdate, map_message),
}


def map_size(estimate: MapEstimate, tfg: TfgMap) -> int:
    """Bytes of a map's message, about, before it is made."""
    return _SURFACE_BYTES * len(tfg.segments) + _LANDMARK_BYTES * len(estimate.ids)


def _stamp(timestamp: Any, time: float) -> None:
    if math.isfinite(time):
        timestamp.seconds, timestamp.nanos = divmod(round(time * 1e9), 10**9)


def _entity(time: float, name: str, lines: Sequence[Any] = ()) -> Any:
    entity = SceneEntity(frame_id=MAP, id=name, lines=lines)
    _stamp(entity.timestamp, time)
    return entity


def _colour(field: Any, colour: tuple[float, float, float, float]) -> None:
    field.r, field.g, field.b, field.a = colour


def _lines(points: FloatArray, kind: Any, thickness: float, colour: tuple[float, float, float, float]) -> Any:
    """A line through points (n, 2), kind 0, or the lines between each two of them, kind 2."""
    line = LinePrimitive(type=kind, thickness=thickness, points=[Point3(x=x, y=y) for x, y in points.tolist()])
    line.pose.orientation.w = 1.0
    _colour(line.color, colour)
    return line


def _scene(*entities: Any) -> bytes:
    return bytes(SceneUpdate(entities=entities).SerializeToString())
