"""A ROS bag of a robot with a planar laser scanner, as a recording: its messages as they were recorded, none judged."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tfg_drake.config import OdometryConfig, ScanConfig
from tfg_drake.datasets.recording import DatasetError, Recording, said_of_scanner
from tfg_drake.hardware.ros.bag_files import Logged, bag_files, read_messages
from tfg_drake.hardware.ros.conversions import field, laser_scan, number, odometry, ros_stamp, unit_quaternion
from tfg_drake.hardware.ros.preset import Scanner
from tfg_drake.io.extras import pip_install
from tfg_drake.messages import FloatArray, LaserScan, Odometry
from tfg_drake.notes import Note

SCAN, ODOMETRY, TRANSFORMS = "sensor_msgs/LaserScan", "nav_msgs/Odometry", "tf2_msgs/TFMessage"
KINDS = (SCAN, ODOMETRY, TRANSFORMS, "tf/tfMessage")
STATIC = "tf_static"
# Frames of the body, by preference, if odometry does not name one (REP 105).
BODIES = ("base_footprint", "base_link")
# Least cosine of the tilt of a level scanner: 8 degrees.
UPRIGHT = 0.99
# A transform is constant if no entry of its matrix, m or of the rotation, changes by more than _FIXED.
_FIXED = 1e-3
# Standard deviations of the scanner's mount, m and rad: TOLD if it is stated, UNTOLD if not.
TOLD, UNTOLD = ScanConfig(mount_deviation=0.02, yaw_deviation=0.02), ScanConfig(mount_deviation=0.2, yaw_deviation=0.05)
# Stamps are not used if on average _SHARED or more messages have the same one.
_SHARED = 3
# Parent of each frame, and the frame's pose (4, 4) in it, by frame.
Transforms = dict[str, tuple[str, FloatArray]]
# The option that states a scanner's mount.
SAID = "--set hardware.scanner.KEY=VALUE"


def load_bag(path: Path, scanner: Mapping[str, Any] | None = None) -> Recording:
    """Return the run in a bag, a file or a folder: its scans and odometry, each from the topic with the most messages.

    scanner: stated fields of `Scanner`, which override the bag's. Otherwise the mount comes from fixed transforms;
    without them the scanner is assumed at the body's origin, within some 0.2 m. Stamps are the headers', or, if these
    are not set, the recorder's, relative to the odometry's first. The odometry's errors are assumed as a TurtleBot's. A
    message that cannot be used is left out.

    Raises:
        DatasetError: no file can be read, there are no scans or no odometry in it that can be used, or the package that
            reads bags is missing.
    """
    try:
        decoded = _decoder()
    except ImportError:
        raise DatasetError(f"{path}: a ROS bag needs an extra; {pip_install('bag')}") from None
    said = said_of_scanner(path, scanner)
    files, told = bag_files(path)
    of_topic: dict[tuple[str, str], list[Logged]] = collections.defaultdict(list)
    for one in read_messages(files, KINDS, told.append):
        of_topic[one.kind, one.topic].append(one)
    notes = [Note("file", None, text) for text in told]
    topics = [_Topic(path, kind, name, logged, decoded) for (kind, name), logged in sorted(of_topic.items())]
    if not topics:
        why = "; ".join(told) or "record scans and odometry"
        raise DatasetError(f"{path}: no {SCAN} and no {ODOMETRY} in it; {why}")
    seen, way = (_fullest(path, topics, kind, notes) for kind in (SCAN, ODOMETRY))
    parents = _fixed([topic for topic in topics if topic.kind not in (SCAN, ODOMETRY)])
    return _recording(path, seen, way, parents, said, notes)


@functools.cache
def _decoder() -> Callable[[Logged], Any]:
    """Return a function that decodes a message of a bag, or raises any exception. Raises ImportError."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ros2, ros1 = (get_typestore(store) for store in (Stores.ROS2_HUMBLE, Stores.ROS1_NOETIC))
    ros1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))

    def decoded(one: Logged) -> Any:
        kind = one.kind.replace("tf/tf", "tf2_msgs/TF").replace("/", "/msg/")
        return ros1.deserialize_ros1(one.data, kind) if one.ros1 else ros2.deserialize_cdr(one.data, kind)

    return decoded


class _Topic:
    """The messages of a topic. read: those that can be decoded, each with its header's stamp and the recorder's, s."""

    def __init__(
        self, path: Path, kind: str, name: str, logged: list[Logged], decoded: Callable[[Logged], Any]
    ) -> None:
        self.kind, self.name, self.total, self._path = kind, name, len(logged), path
        self._reasons: list[tuple[float, str]] = []
        self.read: list[tuple[float, float, Any]] = []
        for one in logged:
            arrival = 1e-9 * one.time_ns
            with self.leaving_out(arrival):
                message = decoded(one)
                self.read.append((_stamp(message) if kind in (SCAN, ODOMETRY) else math.nan, arrival, message))

    @contextlib.contextmanager
    def leaving_out(self, arrival: float) -> Iterator[None]:
        """Leave out the message recorded at `arrival`, s, if its use in this context raises any exception."""
        try:
            with np.errstate(all="ignore"):
                yield
        except Exception as error:  # damaged bytes may raise any exception
            self._reasons.append((arrival, " ".join(str(error).split())[:200] or type(error).__name__))

    def check(self, used: int) -> None:
        """Raise DatasetError if fewer than two messages can be used."""
        if used < 2:
            why = f": {self._reasons[0][1]}" if self._reasons else ""
            told = f"{used} of {self.total} messages of {self.name} can be used{why}"
            raise DatasetError(f"{self._path}: {told}; record more")

    def notes(self, begin: float) -> list[Note]:
        """Return a note on the messages left out, if there are any. begin: the recorder's clock at time 0, s."""
        if not self._reasons:
            return []
        text = f"{len(self._reasons)} of {self.total} messages of {self.name} are not used: {self._reasons[0][1]}"
        return [Note("messages", float(self._reasons[0][0] - begin), text)]


def _fullest(path: Path, topics: list[_Topic], kind: str, notes: list[Note]) -> _Topic:
    """Return the topic of a kind with the most messages; a note names the others."""
    found = sorted((topic for topic in topics if topic.kind == kind), key=lambda topic: (-topic.total, topic.name))
    if not found:
        has = ", ".join(sorted({topic.kind for topic in topics}))
        raise DatasetError(f"{path}: no {kind} in it, but {has}; record scans and odometry")
    if found[1:]:
        others = ", ".join(topic.name for topic in found[1:])
        notes.append(Note("topics", None, f"Of {kind} {found[0].name} is read, not {others}."))
    return found[0]


def _recording(
    path: Path, seen: _Topic, way: _Topic, parents: Transforms, said: Mapping[str, Any], notes: list[Note]
) -> Recording:
    """Return the recording of the scans `seen` and the odometry `way`."""
    for topic in (way, seen):
        topic.check(len(topic.read))
    stamps, recorded = ([np.array([one[k] for one in topic.read]) for topic in (way, seen)] for k in (0, 1))
    is_recorded = all(map(_is_clock, recorded))
    if unstamped := [topic.name for topic, t in zip((way, seen), stamps, strict=True) if not _is_clock(t)]:
        names = " and ".join(unstamped)
        if not is_recorded:
            raise DatasetError(f"{path}: neither headers nor the recorder stamp {names}; record it again")
        notes.append(Note("stamps", None, f"the headers of {names} are not stamped: the recorder's stamps are used"))
        stamps = recorded
    first, told, looks = float(stamps[0][0]), stamps[0] - stamps[0][0], stamps[1] - stamps[0][0]
    scanner, is_told = _scanner(path, way, seen, parents, said, notes)

    odometry_messages: list[Odometry] = []
    drove: list[int] = []
    for k, stamp in enumerate(told):
        with way.leaving_out(recorded[0][k]):
            before = odometry_messages[-1] if odometry_messages else None
            odometry_messages.append(odometry(way.read[k][2], float(stamp), before))
            drove.append(k)
    way.check(len(drove))
    # A sweep's velocity is that of the odometry before it: by stamps if they are in order, else by recording time.
    in_order = all((np.diff(t) >= 0.0).all() for t in (told, looks))
    of_way, of_look = (told[drove], looks) if in_order else (recorded[0][drove], recorded[1])
    newest = np.searchsorted(np.maximum.accumulate(of_way), of_look, "right") - 1
    scans: list[LaserScan] = []
    looked: list[int] = []
    for k, stamp in enumerate(looks):
        with seen.leaving_out(recorded[1][k]):
            V_B = odometry_messages[max(newest[k], 0)].V_B
            scans.append(laser_scan(seen.read[k][2], float(stamp), scanner, V_B))
            looked.append(k)
    seen.check(len(looked))
    for topic in (way, seen):
        notes += topic.notes(recorded[0][0])
    mount_known = is_told or "yaw" in said
    place, yaw = (TOLD if known else UNTOLD for known in (is_told or {"x", "y"} & said.keys(), mount_known))
    believed = ScanConfig(mount_deviation=place.mount_deviation, yaw_deviation=yaw.yaw_deviation)
    return Recording(
        name=path.name.split(".")[0],
        odometry=tuple(odometry_messages),
        scans=tuple(scans),
        model=OdometryConfig(),
        truth=None,
        notes=tuple(notes),
        detections=(),
        scanner=believed,
        odometry_arrivals=recorded[0][drove] - first if is_recorded else np.empty(0),
        scan_arrivals=recorded[1][looked] - first if is_recorded else np.empty(0),
        mount_known=mount_known,
    )


def _stamp(message: Any) -> float:
    stamp = ros_stamp(message)
    if stamp is None:
        raise ValueError("no header")
    return stamp


def _is_clock(stamps: FloatArray) -> bool:
    """Return True if stamps (n,) distinguish messages: those never set, or cut to whole seconds, do not."""
    return len(np.unique(stamps)) * _SHARED > len(stamps)


def _fixed(topics: Iterable[_Topic]) -> Transforms:
    """Return the fixed transforms: those of /tf_static, and those of /tf that never change."""
    parents: Transforms = {}
    static: Transforms = {}
    moving: set[str] = set()
    for topic in topics:
        is_static = _frame(topic.name) == STATIC
        for _, arrival, message in topic.read:
            with topic.leaving_out(arrival):
                for one in field(message, "transforms"):
                    child, parent, pose = _frame(one.child_frame_id), _frame(one.header.frame_id), _pose(one)
                    if is_static:
                        static[child] = parent, pose
                    elif np.abs(parents.setdefault(child, (parent, pose))[1] - pose).max() > _FIXED:
                        moving.add(child)
    return {child: one for child, one in parents.items() if child not in moving} | static


def _frame(name: str) -> str:
    """Return a frame's or topic's name without the leading slash of ROS 1."""
    return str(name).lstrip("/")


def _pose(transform: Any) -> FloatArray:
    """Return the pose (4, 4) of a geometry_msgs/TransformStamped."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_quat(unit_quaternion(transform, "transform.rotation")).as_matrix()
    pose[:3, 3] = [number(transform, f"transform.translation.{axis}") for axis in "xyz"]
    return pose


def _above(parents: Transforms, frame: str) -> dict[str, FloatArray]:
    """Return the frame's poses (4, 4) in itself and in all frames above it, by frame."""
    pose, found = np.eye(4), {frame: np.eye(4)}
    while frame in parents and parents[frame][0] not in found:
        frame, step = parents[frame]
        pose = step @ pose
        found[frame] = pose
    return found


def _scanner(
    path: Path, way: _Topic, seen: _Topic, parents: Transforms, said: Mapping[str, Any], notes: list[Note]
) -> tuple[Scanner, bool]:
    """Return the scanner by fixed transforms and stated fields, and whether the transforms give its mount."""
    own = _above(parents, _frame(field(seen.read[0][2], "header.frame_id")))
    body = _frame(field(way.read[0][2], "child_frame_id"))
    bodies = [_above(parents, one) for one in ((body,) if body else BODIES)]
    X_BS = next((np.linalg.inv(above[one]) @ own[one] for above in bodies for one in above if one in own), None)
    if X_BS is None:
        if "yaw" not in said:
            text = "No transform says where the scanner sits: it is taken to look ahead from the body's origin."
            notes.append(Note("mount", None, f"{text} Say otherwise by {SAID}, with x, y, yaw."))
        return dataclasses.replace(Scanner(), **said), False
    if abs(X_BS[2, 2]) < UPRIGHT and not {"yaw", "flip"} <= said.keys():
        tilt = math.degrees(math.acos(min(abs(X_BS[2, 2]), 1.0)))
        frame = next(iter(own))
        raise DatasetError(
            f"{path}: transforms have {frame} tilted by {tilt:.0f} degrees, a scanner must be level; if it is, say so "
            f"by {SAID}, with yaw and flip"
        )
    x, y, yaw = float(X_BS[0, 3]), float(X_BS[1, 3]), math.atan2(X_BS[1, 0], X_BS[0, 0])
    return dataclasses.replace(Scanner(x, y, yaw, flip=bool(X_BS[2, 2] < 0.0)), **said), True
