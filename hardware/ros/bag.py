"""A ROS 2 bag (MCAP) of a robot with a planar laser scanner, as a recording."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.config import OdometryConfig, ScanConfig
from tfg_drake.datasets.recording import DatasetError, Recording
from tfg_drake.geometry import se2
from tfg_drake.hardware.ros.conversions import field, laser_scan, number, odometry, ros_stamp
from tfg_drake.hardware.ros.preset import Scanner
from tfg_drake.messages import FloatArray, LaserScan, Odometry
from tfg_drake.slam.estimator_state import EXACT_CAMERA
from tfg_drake.slam.shared import by_data_sheet

SCAN, ODOMETRY, TRANSFORMS = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
STATIC = "/tf_static"
# Least cosine of the tilt of what is upright: 8 degrees.
UPRIGHT = 0.99
# What is believed of a scanner whose place the bag tells, and of one whose place it does not.
TOLD = ScanConfig(mount_deviation=0.02, yaw_deviation=0.02)
UNTOLD = ScanConfig(mount_deviation=0.2, yaw_deviation=0.05)


def load_bag(path: Path) -> Recording:
    """The run in a file: its scans and its odometry, of several topics the one with the most messages.

    Where the scanner sits is read from the fixed transforms; where these do not tell, it is taken to be at the body's
    origin, within some 0.2 m. Stamps are those of the headers, from the first message on. The odometry is believed to
    be as good as a TurtleBot's.

    Raises:
        DatasetError: the file cannot be read, a message is broken, there are no scans or no odometry in it, or the
            package that reads bags is missing.
    """
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError:
        raise DatasetError(f"{path}: a ROS bag needs an extra; pip install 'tfg_drake[bag]'") from None
    try:
        with path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            scans, told, fixed, notes = _chosen(path, reader.get_summary())
            topics = [topic for topic in (scans, told, fixed) if topic]
            read = ((channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages(topics))
            return _recording(path, read, scans, told, notes)
    except FileNotFoundError:
        raise DatasetError(f"{path}: no such file or folder; name a data set") from None
    except (OSError, McapError, ValueError) as error:
        if isinstance(error, DatasetError):
            raise
        raise DatasetError(f"{path}: not a whole ROS 2 bag ({' '.join(str(error).split())}); copy it again") from None


def _chosen(path: Path, summary: Any) -> tuple[str, str, str, tuple[str, ...]]:
    """The topics of scans, of odometry and of fixed transforms, "" where there are none, and what is left out."""
    counts = {} if summary is None or summary.statistics is None else summary.statistics.channel_message_counts
    topics: dict[str, list[tuple[int, str]]] = {SCAN: [], ODOMETRY: [], TRANSFORMS: []}
    for key, channel in ({} if summary is None else summary.channels).items():
        schema = summary.schemas.get(channel.schema_id)
        if schema is not None and schema.name in topics:
            topics[schema.name].append((counts.get(key, 0), channel.topic))
    notes = []
    for kind in (SCAN, ODOMETRY):
        if not topics[kind]:
            raise DatasetError(f"{path}: no {kind} in it; record scans and odometry of ROS 2")
        _, best = max(topics[kind])
        others = sorted(topic for _, topic in topics[kind] if topic != best)
        notes += [f"Of {kind} {best} is read, not {', '.join(others)}."] if others else []
    static = STATIC if any(topic == STATIC for _, topic in topics[TRANSFORMS]) else ""
    return max(topics[SCAN])[1], max(topics[ODOMETRY])[1], static, tuple(notes)


def _recording(
    path: Path, read: Iterator[tuple[str, Any]], scan_topic: str, odometry_topic: str, notes: tuple[str, ...]
) -> Recording:
    """The recording of the messages, each with its topic."""
    seen: list[tuple[float, Any]] = []
    told: list[tuple[float, Any]] = []
    parents: dict[str, Any] = {}
    for topic, message in read:
        if topic == scan_topic:
            seen.append((_stamp(message), message))
        elif topic == odometry_topic:
            told.append((_stamp(message), message))
        else:
            for one in field(message, "transforms"):
                parents[field(one, "child_frame_id")] = one
    if len(seen) < 2 or len(told) < 2:
        raise DatasetError(f"{path}: {len(seen)} scans and {len(told)} messages of odometry in it; record more")
    seen.sort(key=lambda one: one[0])
    told.sort(key=lambda one: one[0])
    first = min(seen[0][0], told[0][0])
    way: list[Odometry] = []
    for stamp, message in told:
        if not way or stamp - first > way[-1].stamp:
            way.append(odometry(message, stamp - first, way[-1] if way else None))
    X_BS = _mount(path, parents, field(seen[0][1], "header.frame_id"), field(told[0][1], "child_frame_id"))
    if X_BS is None:
        notes += ("Where the scanner sits is not told; it is learnt, from the body's origin on.",)
    x, y, yaw = (0.0, 0.0, 0.0) if X_BS is None else X_BS
    stamps = np.array([one.stamp for one in way])
    scans: list[LaserScan] = []
    for stamp, message in seen:
        before = way[max(int(np.searchsorted(stamps, stamp - first, "right")) - 1, 0)]
        scan = laser_scan(message, stamp - first, Scanner(float(x), float(y), float(yaw)), before.V_B)
        if (scans[-1].stamp if scans else way[0].stamp) < scan.stamp <= way[-1].stamp:
            scans.append(scan)
    if len(scans) < 2:
        raise DatasetError(f"{path}: fewer than two scans while there is odometry; record both at once")
    return Recording(
        name=path.name.split(".")[0],
        odometry=tuple(way),
        scans=tuple(scans),
        model=OdometryConfig(),
        truth=None,
        notes=notes,
        detections=(),
        prior=by_data_sheet(OdometryConfig(), EXACT_CAMERA, UNTOLD if X_BS is None else TOLD),
    )


def _stamp(message: Any) -> float:
    stamp = ros_stamp(message)
    if stamp is None:
        raise ValueError("a message without a header")
    return stamp


def _planar(transform: Any) -> FloatArray | None:
    """The pose (3,) of a geometry_msgs/TransformStamped in the plane, None where it is not upright."""
    x, y = (number(transform, f"transform.translation.{axis}") for axis in "xy")
    q = [number(transform, f"transform.rotation.{axis}") for axis in "xyzw"]
    if 1.0 - 2.0 * (q[0] ** 2 + q[1] ** 2) < UPRIGHT:
        return None
    yaw = math.atan2(2.0 * (q[3] * q[2] + q[0] * q[1]), q[3] ** 2 + q[0] ** 2 - q[1] ** 2 - q[2] ** 2)
    return np.array([x, y, yaw])


def _mount(path: Path, parents: dict[str, Any], scanner: str, body: str) -> FloatArray | None:
    """X_BS (3,), from the scanner's frame up to the body's by transforms to their parents; None where that is not told.

    Raises DatasetError where the scanner is not upright.
    """
    X, frame = np.zeros(3), scanner
    for _ in range(len(parents) + 1):
        if frame == body:
            return X
        if frame not in parents:
            break
        step = _planar(parents[frame])
        if step is None:
            raise DatasetError(f"{path}: {STATIC} has {frame} tilted or upside down; a scanner must be upright")
        frame, X = field(parents[frame], "header.frame_id"), se2.compose(step, X)
    return None
