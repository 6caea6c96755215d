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
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf import descriptor_pb2

from tfg_drake.messages import FloatArray, LaserScan, MapEstimate, Path, PoseEstimate, TfgMap

MAP, BASE = "map", "base"
POSE, PATH, SURFACES = "display.pose", "display.path", "display.map"
# Our fields of a scan have numbers behind this, but for the ranges, which are Foxglove's; and what is only Foxglove's.
FIRST_OWN = 1000
ONLY_ITS = frozenset(one.name for one in FoxgloveScan.DESCRIPTOR.fields) - {"ranges"}
# A LinePrimitive's types: a line through its points, or the lines between each two of them.
LINE_STRIP, LINE_LIST = 0, 2
# Widths of lines and sizes of landmarks, m.
_WALL, _WAY, _LANDMARK = 0.04, 0.05, 0.14
_WALL_COLOUR = {"r": 0.25, "g": 0.3, "b": 0.38, "a": 1.0}
_WAY_COLOUR = {"r": 0.1, "g": 0.45, "b": 0.9, "a": 1.0}
_LANDMARK_COLOUR = {"r": 0.85, "g": 0.35, "b": 0.1, "a": 1.0}
_UPRIGHT = {"w": 1.0}
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


def scan_fields(scan: LaserScan) -> dict[str, Any]:
    """Foxglove's fields of a scan, but for its ranges."""
    fields: dict[str, Any] = {"frame_id": BASE, "timestamp": _stamp(scan.stamp), "pose": {"orientation": _UPRIGHT}}
    if len(scan.angles):
        fields |= {"start_angle": float(scan.angles[0]), "end_angle": float(scan.angles[-1])}
    return fields


def pose_message(_time: float, pose: PoseEstimate) -> bytes:
    """The estimated pose, as a FrameTransform from map to base."""
    x, y, theta = pose.X_MB.tolist()
    return _written(
        FrameTransform,
        parent_frame_id=MAP,
        child_frame_id=BASE,
        timestamp=_stamp(pose.stamp),
        translation={"x": x, "y": y},
        rotation={"z": math.sin(0.5 * theta), "w": math.cos(0.5 * theta)},
    )


def path_message(time: float, path: Path) -> bytes:
    """A path that the robot takes from a time, s, on, as a SceneUpdate."""
    return _scene(time, path={"lines": [_line(path.points, LINE_STRIP, _WAY, _WAY_COLOUR)]})


def map_message(time: float, shown: tuple[MapEstimate, TfgMap]) -> bytes:
    """Surfaces and landmarks at a time, s, as a SceneUpdate."""
    estimate, tfg = shown
    size = dict.fromkeys("xyz", _LANDMARK)
    cubes, names = [], []
    for tag, (x, y) in zip(estimate.ids.tolist(), estimate.p_ML.tolist(), strict=True):
        pose = {"position": {"x": x, "y": y}, "orientation": _UPRIGHT}
        cubes.append({"pose": pose, "size": size, "color": _LANDMARK_COLOUR})
        names.append({"key": str(tag), "value": f"{x:.3f}, {y:.3f}"})
    lines = [_line(tfg.segments.reshape(-1, 2), LINE_LIST, _WALL, _WALL_COLOUR)]
    return _scene(time, surfaces={"lines": lines}, landmarks={"cubes": cubes, "metadata": names})


# What is shown, by topic: its schema, and what makes its bytes of a time, s, and what is recorded then.
TOPICS: dict[str, tuple[Any, Callable[[float, Any], bytes]]] = {
    POSE: (FrameTransform, pose_message),
    PATH: (SceneUpdate, path_message),
    SURFACES: (SceneUpdate, map_message),
}


def map_size(estimate: MapEstimate, tfg: TfgMap) -> int:
    """Bytes of a map's message, about, before it is made."""
    return _SURFACE_BYTES * len(tfg.segments) + _LANDMARK_BYTES * len(estimate.ids)


def _stamp(time: float) -> dict[str, int] | None:
    if not math.isfinite(time):
        return None
    seconds, nanos = divmod(round(time * 1e9), 10**9)
    return {"seconds": seconds, "nanos": nanos}


def _line(points: FloatArray, kind: int, thickness: float, colour: dict[str, float]) -> dict[str, Any]:
    """A LinePrimitive through points (n, 2)."""
    places = [{"x": x, "y": y} for x, y in points.tolist()]
    return {"type": kind, "thickness": thickness, "color": colour, "points": places, "pose": {"orientation": _UPRIGHT}}


def _scene(time: float, **entities: dict[str, Any]) -> bytes:
    """A SceneUpdate of entities of the map by their names."""
    known = {"frame_id": MAP, "timestamp": _stamp(time)}
    return _written(SceneUpdate, entities=[{"id": name, **known, **one} for name, one in entities.items()])


def _written(kind: Any, **fields: Any) -> bytes:
    return bytes(kind(**fields).SerializeToString())
