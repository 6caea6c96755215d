"""Preset of a TurtleBot's ROS graph: topics, types, quality of service, limits and mounts, read from YAML."""

from __future__ import annotations

import dataclasses
import types
import typing
from pathlib import Path
from typing import Any

from tfg_drake.bad_input import not_radians
from tfg_drake.hardware.watchdog import Limits
from tfg_drake.io.yaml_text import parse_yaml
from tfg_drake.slam.odometry_rules import FASTEST, FASTEST_TURN

PRESETS = Path(__file__).parent / "presets"


class PresetError(ValueError):
    """A preset that cannot be used; the message is one line: file, key, what is wrong, how to mend it."""


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic. type: package/msg/Name. qos: "sensor_data" (best effort) or "reliable"."""

    name: str
    type: str
    qos: str = "sensor_data"


@dataclasses.dataclass(frozen=True)
class Topics:
    """The topics of one robot; those of tags, hazards and battery may be absent. camera_info: for apriltag_msgs; images
    have their own beside them. initial_pose: where somebody says that the robot is, as RViz does."""

    odometry: Topic
    scan: Topic
    command: Topic
    hazards: tuple[Topic, ...] = ()
    battery: Topic | None = None
    detections: Topic | None = None
    camera_info: Topic | None = None
    initial_pose: Topic = Topic("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped", "reliable")


@dataclasses.dataclass(frozen=True)
class Scanner:
    """X_BS, the pose of the scan's frame in base_link (m, rad), and the standard deviation of a range (m).

    flip: it is mounted upside down. clockwise: it counts its rays so, as seen from above it. field_of_view: what its
    rays span, rad, symmetric to its x axis, 0: as its messages say. clock_offset: how far its clock is ahead of the
    odometry's, s. unanswered: what a ray says that gives no answer, one of UNANSWERED. least_range: nothing nearer is
    seen, m.
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    flip: bool = False
    clockwise: bool = False
    field_of_view: float = 0.0
    clock_offset: float = 0.0
    sigma: float = 0.015
    unanswered: str = "unknown"
    least_range: float = 0.0


@dataclasses.dataclass(frozen=True)
class Camera:
    """The camera's pose in base_link (m, rad; pitch is downward) and its tags.

    tag_size: side of a tag's black square, m. corner_sigma: standard deviation of a corner, pixels.
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    pitch: float = 0.0
    tag_size: float = 0.16
    corner_sigma: float = 0.5


@dataclasses.dataclass(frozen=True)
class Frames:
    """Names of frames (REP 105): the map's, that of the base's odometry, the base's body."""

    map: str = "map"
    odom: str = "odom"
    base: str = "base_link"


@dataclasses.dataclass(frozen=True)
class Publish:
    """Names of the topics on which the explorer says what it knows; PUBLISHED has their types."""

    map: str = "/map"
    markers: str = "/tfg/markers"
    path: str = "/tfg/path"
    pose: str = "/tfg/pose"
    tf: str = "/tf"


# By the key in `publish`: the type, and whether a late listener gets the newest message.
PUBLISHED = {
    "map": ("nav_msgs/msg/OccupancyGrid", True),
    "markers": ("visualization_msgs/msg/MarkerArray", True),
    "path": ("nav_msgs/msg/Path", True),
    "pose": ("geometry_msgs/msg/PoseWithCovarianceStamped", False),
    "tf": ("tf2_msgs/msg/TFMessage", False),
}


@dataclasses.dataclass(frozen=True)
class Preset:
    """One kind of robot. discovery: how far ROS 2 looks for it, one of DISCOVERY."""

    topics: Topics
    limits: Limits = dataclasses.field(default_factory=Limits)
    scanner: Scanner = dataclasses.field(default_factory=Scanner)
    camera: Camera = dataclasses.field(default_factory=Camera)
    frames: Frames = dataclasses.field(default_factory=Frames)
    publish: Publish = dataclasses.field(default_factory=Publish)
    discovery: str = "subnet"


# What tags may be looked for in.
IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
# The types that a topic may have, by its key in `topics`.
TYPES = {
    "odometry": ("nav_msgs/msg/Odometry",),
    "scan": ("sensor_msgs/msg/LaserScan",),
    "command": ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"),
    "hazards": (
        "irobot_create_msgs/msg/HazardDetectionVector",
        "kobuki_ros_interfaces/msg/BumperEvent",
        "kobuki_ros_interfaces/msg/CliffEvent",
        "kobuki_ros_interfaces/msg/WheelDropEvent",
        "turtlebot3_msgs/msg/SensorState",
    ),
    "battery": ("sensor_msgs/msg/BatteryState",),
    "detections": ("apriltag_msgs/msg/AprilTagDetectionArray", "sensor_msgs/msg/PointCloud2", IMAGE, COMPRESSED_IMAGE),
    "camera_info": ("sensor_msgs/msg/CameraInfo",),
    "initial_pose": ("geometry_msgs/msg/PoseWithCovarianceStamped",),
}
QOS = ("sensor_data", "reliable")
# Nothing is known there, or nothing was met.
UNANSWERED = ("unknown", "free")
# In the whole network, as ROS 2 does by itself, or on this machine only.
DISCOVERY = ("subnet", "localhost")
_POSITIVE = ("limits.", "scanner.sigma", "camera.tag_size", "camera.corner_sigma")
# No number in a preset is greater; no robot's limit of speed or turn rate, m/s and rad/s.
_GREATEST = 1e6
_MOST = {"limits.speed": FASTEST, "limits.turn_rate": FASTEST_TURN}


def load_preset(name_or_path: str | Path) -> Preset:
    """A shipped preset ("turtlebot4") or a YAML file of one's own; raises PresetError."""
    path = PRESETS / f"{name_or_path}.yaml"
    path = path if path.is_file() else Path(name_or_path)
    if not path.is_file():
        names = ", ".join(sorted(file.stem for file in PRESETS.glob("*.yaml")))
        raise PresetError(f"{name_or_path}: no such file or preset; name a YAML file or one of {names}")
    try:
        tree = parse_yaml(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise PresetError(f"{path}: cannot be read: {' '.join(str(error).split())}") from None
    try:
        preset: Preset = _read(tree, Preset, "")
        _check(preset.topics)
        _check_known("discovery: unknown range", preset.discovery, DISCOVERY)
        _check_known("scanner.unanswered: unknown value", preset.scanner.unanswered, UNANSWERED)
    except PresetError as error:
        raise PresetError(f"{path}: {error}") from None
    return preset


def _read(value: Any, schema: Any, place: str) -> Any:
    """A value of YAML as the schema's type."""
    if isinstance(schema, types.UnionType):
        schema = schema.__args__[0]
    if typing.get_origin(schema) is tuple:
        if not isinstance(value, list):
            raise PresetError(f"{place}: expected a list, {_found(value)}")
        return tuple(_read(item, schema.__args__[0], f"{place}[{i}]") for i, item in enumerate(value))
    if dataclasses.is_dataclass(schema):
        return _section(value, schema, place)
    if schema is float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _GREATEST:
            raise PresetError(f"{place}: expected a number, {_found(value)}")
        if place.startswith(_POSITIVE) and value <= 0.0:
            raise PresetError(f"{place}: expected a number above 0, {_found(value)}")
        if value > _MOST.get(place, _GREATEST):
            raise PresetError(f"{place}: expected a number up to {_MOST[place]:g}, found {value!r}")
        if place.endswith(("yaw", "pitch", "field_of_view")) and (told := not_radians(value)):
            raise PresetError(f"{place}: {told}")
        if place in ("scanner.least_range", "scanner.field_of_view") and value < 0.0:
            raise PresetError(f"{place}: expected a number of 0 or more, {_found(value)}")
        return float(value)
    if schema is bool:
        if not isinstance(value, bool):
            raise PresetError(f"{place}: expected true or false, {_found(value)}")
        return value
    if not isinstance(value, str) or not value:
        raise PresetError(f"{place}: expected text, {_found(value)}")
    return value


def _section(value: Any, schema: Any, place: str) -> Any:
    hints = typing.get_type_hints(schema)
    if not isinstance(value, dict):
        raise PresetError(f"{place or 'preset'}: expected the keys {', '.join(hints)}, {_found(value)}")
    within = f"{place}." if place else ""
    for key in value:
        if key not in hints:
            raise PresetError(f"{within}{key}: unknown key; the keys here are {', '.join(hints)}")
    for one in dataclasses.fields(schema):
        required = one.default is dataclasses.MISSING and one.default_factory is dataclasses.MISSING
        if required and one.name not in value:
            _read(None, hints[one.name], f"{within}{one.name}")
    return schema(**{key: _read(item, hints[key], f"{within}{key}") for key, item in value.items()})


def _found(value: Any) -> str:
    return "missing" if value is None else f"found {value!r}"


def _check_known(otherwise: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        raise PresetError(f"{otherwise} {value}; known are {', '.join(known)}")


def _check(topics: Topics) -> None:
    for key, known in TYPES.items():
        entry = getattr(topics, key)
        for topic in entry if isinstance(entry, tuple) else (entry,) if entry is not None else ():
            _check_known(f"topics.{key}: unknown type", topic.type, known)
            _check_known(f"topics.{key}: unknown qos", topic.qos, QOS)
    if topics.detections is not None and topics.detections.type.startswith("apriltag") and topics.camera_info is None:
        raise PresetError("topics.camera_info: missing; corners of tags say nothing without it")
