"""Recording for Foxglove's 3D panel, in Foxglove's own schemas: poses, scans, map and path.

Frames: "map" (M) and "base" (B), which the estimated pose ties together. A scan is a foxglove.LaserScan that carries
the fields of our message, too, under numbers that Foxglove has not given: so nothing stands in the file twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan as FoxgloveScan
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf import descriptor_pb2

from tfg_drake.messages import FloatArray, LaserScan, MapEstimate, Path, PoseEstimate, TfgMap
from tfg_drake.pictures import scene
from tfg_drake.pictures.layers import LETTER, Layer, layers, of_map

MAP, BASE = "map", "base"
POSE, PATH, SURFACES = "display.pose", "display.path", "display.map"
# Our fields of a scan are numbered from here on, but for the ranges, a field of Foxglove's; fields that only Foxglove
# has.
FIRST_OWN = 1000
ONLY_ITS = frozenset(one.name for one in FoxgloveScan.DESCRIPTOR.fields) - {"ranges"}
# Foxglove's type of a LinePrimitive that has a line between each two points.
LINE_LIST = 2
_UPRIGHT = {"w": 1.0}


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
    return _scene(time, layers("path", scene.path(path)))


def map_message(time: float, shown: tuple[MapEstimate, TfgMap, MapEstimate | None]) -> bytes:
    """Tags, TFG and walls that are landmarks at a time, s, as a SceneUpdate."""
    return _scene(time, of_map(*shown))


# Displayed topics: the schema, and the function from a time, s, and the recorded message to the bytes.
TOPICS: dict[str, tuple[Any, Callable[[float, Any], bytes]]] = {
    POSE: (FrameTransform, pose_message),
    PATH: (SceneUpdate, path_message),
    SURFACES: (SceneUpdate, map_message),
}


def _stamp(time: float) -> dict[str, int] | None:
    if not math.isfinite(time):
        return None
    seconds, nanos = divmod(round(time * 1e9), 10**9)
    return {"seconds": seconds, "nanos": nanos}


def _scene(time: float, shown: Iterable[Layer]) -> bytes:
    """A SceneUpdate of layers in the map frame."""
    known = {"frame_id": MAP, "timestamp": _stamp(time)}
    return _written(SceneUpdate, entities=[{"id": layer.name, **known, **_primitives(layer)} for layer in shown])


def _primitives(layer: Layer) -> dict[str, Any]:
    """The parts of a SceneEntity that draw a layer."""
    look, colour = layer.look, {"color": layer.look.rgba}

    def at(place: FloatArray, above: float = 0.0) -> dict[str, Any]:
        x, y = place.tolist()
        return {"pose": {"position": {"x": x, "y": y, "z": look.high + above}, "orientation": _UPRIGHT}, **colour}

    letters = {"billboard": True, "font_size": LETTER}
    texts = [{**at(place, LETTER), **letters, "text": words} for words, place in layer.labels.items()]
    if layer.kind == "points":
        size = dict.fromkeys("xyz", 2.0 * look.width)
        return {"spheres": [{**at(place), "size": size} for place in layer.shapes], "texts": texts}
    points = [{"x": x, "y": y} for x, y in layer.segments.reshape(-1, 2).tolist()]
    line = {**at(np.zeros(2)), "type": LINE_LIST, "thickness": look.width, "points": points}
    return {"lines": [line], "texts": texts}


def _written(kind: Any, **fields: Any) -> bytes:
    return bytes(kind(**fields).SerializeToString())
