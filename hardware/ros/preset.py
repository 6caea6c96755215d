"""Preset of a TurtleBot's ROS graph: topics, types, quality of service, limits and mounts, read from YAML."""

import dataclasses
from pathlib import Path
from typing import Annotated, ClassVar

from tfg_drake.constraints import Angle, NotNegative, OneOf, Positive, Radians, Signed
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.watchdog import Limits
from tfg_drake.io.yaml_text import parse_yaml
from tfg_drake.typed_tree import Misfit, read

PRESETS = Path(__file__).parent / "presets"


class PresetError(DeviceError):
    """A preset that cannot be used; the message is one line: file, key, what is wrong, how to mend it."""


class _NotEmpty:
    """A text that says something."""

    def fault(self, value: str) -> str:
        """The complaint about a value, "" for none."""
        return "" if value else "must not be empty"


_Name = Annotated[str, _NotEmpty()]


@dataclasses.dataclass(frozen=True)
class Topic:
    """A topic. type: package/msg/Name. qos: "sensor_data" (best effort) or "reliable"."""

    example: ClassVar[str] = "a topic as {name: /scan, type: sensor_msgs/msg/LaserScan}"
    name: _Name
    type: _Name
    qos: Annotated[str, OneOf(("sensor_data", "reliable"))] = "sensor_data"


@dataclasses.dataclass(frozen=True)
class Topics:
    """The topics of one robot; those of tags, hazards and battery may be absent. camera_info: for apriltag_msgs; images
    have their own beside them. initial_pose: where somebody says that the robot is, as RViz does."""

    example: ClassVar[str] = "odometry, scan and command, each as {name: /scan, type: sensor_msgs/msg/LaserScan}"
    odometry: Topic
    scan: Topic
    command: Topic
    hazards: list[Topic] = dataclasses.field(default_factory=list)
    battery: Topic | None = None
    detections: Topic | None = None
    camera_info: Topic | None = None
    initial_pose: Topic = Topic("/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped", "reliable")


@dataclasses.dataclass(frozen=True)
class Scanner:
    """X_BS, the pose of the scan's frame in base_link (m, rad), and the standard deviation of a range (m).

    flip: it is mounted upside down. clockwise: it counts its rays so, as seen from above it. field_of_view: what its
    rays span, rad, symmetric to its x axis, 0: as its messages say. clock_offset: how far its clock is ahead of the
    odometry's, s. unanswered: what a ray says that gives no answer: nothing is known there, or nothing was met.
    least_range: nothing nearer is seen, m.
    """

    x: Signed = 0.0
    y: Signed = 0.0
    yaw: Angle = 0.0
    flip: bool = False
    clockwise: bool = False
    field_of_view: Annotated[float, NotNegative(), Radians()] = 0.0
    clock_offset: Signed = 0.0
    sigma: Positive = 0.015
    unanswered: Annotated[str, OneOf(("unknown", "free"))] = "unknown"
    least_range: float = 0.0


@dataclasses.dataclass(frozen=True)
class Camera:
    """The camera's pose in base_link (m, rad; pitch is downward) and its tags.

    tag_size: side of a tag's black square, m. corner_sigma: standard deviation of a corner, pixels.
    """

    x: Signed = 0.0
    y: Signed = 0.0
    yaw: Angle = 0.0
    pitch: Angle = 0.0
    tag_size: Positive = 0.16
    corner_sigma: Positive = 0.5


@dataclasses.dataclass(frozen=True)
class Frames:
    """Names of frames (REP 105): the map's, that of the base's odometry, the base's body."""

    map: _Name = "map"
    odom: _Name = "odom"
    base: _Name = "base_link"


@dataclasses.dataclass(frozen=True)
class Publish:
    """Names of the topics on which the explorer says what it knows; PUBLISHED has their types."""

    map: _Name = "/map"
    markers: _Name = "/tfg/markers"
    path: _Name = "/tfg/path"
    pose: _Name = "/tfg/pose"
    tf: _Name = "/tf"


# Type of the message of each key in `publish`, and whether a late subscriber gets the newest one (latched).
PUBLISHED = {
    "map": ("nav_msgs/msg/OccupancyGrid", True),
    "markers": ("visualization_msgs/msg/MarkerArray", True),
    "path": ("nav_msgs/msg/Path", True),
    "pose": ("geometry_msgs/msg/PoseWithCovarianceStamped", False),
    "tf": ("tf2_msgs/msg/TFMessage", False),
}


@dataclasses.dataclass(frozen=True)
class Preset:
    """One kind of robot. discovery: how far ROS 2 looks for it: in the whole network, as it does by itself, or on this
    machine only."""

    example: ClassVar[str] = Topics.example
    topics: Topics
    limits: Limits = dataclasses.field(default_factory=Limits)
    scanner: Scanner = dataclasses.field(default_factory=Scanner)
    camera: Camera = dataclasses.field(default_factory=Camera)
    frames: Frames = dataclasses.field(default_factory=Frames)
    publish: Publish = dataclasses.field(default_factory=Publish)
    discovery: Annotated[str, OneOf(("subnet", "localhost"))] = "subnet"


# Types of images in which tags can be detected.
IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
# Permitted types of a topic by its key in `topics`.
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
        preset: Preset = read(tree, Preset, "preset")
    except Misfit as error:
        raise PresetError(f"{path}: {str(error).removeprefix('preset.')}") from None
    if told := _misfit(preset.topics):
        raise PresetError(f"{path}: {told}")
    return preset


def _misfit(topics: Topics) -> str:
    """A complaint about the types of the topics, "" for none."""
    for key, known in TYPES.items():
        entry = getattr(topics, key)
        for topic in entry if isinstance(entry, list) else [entry] if entry is not None else []:
            if told := OneOf(known).fault(topic.type):
                return f"topics.{key}.type: {told}"
    if topics.detections is not None and topics.detections.type.startswith("apriltag") and topics.camera_info is None:
        return "topics.camera_info: missing; corners of tags say nothing without it"
    return ""
