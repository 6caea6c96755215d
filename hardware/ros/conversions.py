"""ROS messages to ours and velocities to ROS: pure functions on messages of either transport.

A message is an object with attributes, as rclpy gives it, or a dictionary, as rosbridge does. REP 103: metres, radians,
seconds; x forward, y left, counter-clockwise. REP 105: odometry is the pose of base_link in odom, our X_OB. A message
that cannot be used raises ValueError with one line. `stamp` is always the host's time, s: see stamps.py.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tfg_drake.datasets.square_pnp import square_centers
from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.hardware.ros.preset import Camera, Scanner
from tfg_drake.messages import FloatArray, Hazards, LaserScan, Odometry, TagDetections, replace

# A robot whose odometry tells no more motion than this has not turned a wheel: m or m/s, and rad/s.
REST, REST_TURN_RATE = 1e-5, 1e-3
# The bits of tfg_drake.messages.Hazards.
RIGHT, CENTRE, LEFT = 1, 2, 4
# Columns of a plain detections message, see `plain_detections`.
COLUMNS = ("id", "range", "bearing", "sigma_range", "sigma_bearing")
# sensor_msgs/PointField: its datatypes 1 to 8 as numpy's.
_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def field(message: Any, path: str) -> Any:
    """The field at a dotted path, "pose.pose.position.x", of a message of either transport; ValueError without it."""
    value = message
    for name in path.split("."):
        try:
            value = value[name] if isinstance(value, Mapping) else getattr(value, name)
        except (KeyError, AttributeError):
            raise ValueError(f"no field {path}") from None
    return value


def ros_stamp(message: Any) -> float | None:
    """std_msgs/Header's stamp, s since the ROS clock's epoch; None of a message that has no header."""
    try:
        stamp = field(message, "header.stamp")
    except ValueError:
        return None
    seconds, nanoseconds = ("secs", "nsecs") if isinstance(stamp, Mapping) and "secs" in stamp else ("sec", "nanosec")
    return float(field(stamp, seconds)) + 1e-9 * float(field(stamp, nanoseconds))


def odometry(message: Any, stamp: float, before: Odometry | None = None) -> Odometry:
    """nav_msgs/Odometry: the pose is that of child_frame_id in frame_id, the twist is in child_frame_id.

    before: the message before this one, which tells whether the robot stands.
    """
    x, y, z, w = (float(field(message, f"pose.pose.orientation.{axis}")) for axis in "xyzw")
    if not 0.99 < math.hypot(x, y, z, w) < 1.01:
        raise ValueError(f"odometry's orientation {x, y, z, w} is no unit quaternion")
    yaw = math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
    position = [float(field(message, f"pose.pose.position.{axis}")) for axis in "xy"]
    V_B = np.array([field(message, "twist.twist.linear.x"), field(message, "twist.twist.angular.z")], dtype=float)
    X_OB = np.array([*position, yaw])
    if not (np.isfinite(X_OB).all() and np.isfinite(V_B).all()):
        raise ValueError("odometry is not finite")
    at_rest = (
        before is not None
        and float(np.abs(X_OB[:2] - before.X_OB[:2]).max()) < REST
        and abs(V_B[0]) < REST
        and abs(V_B[1]) < REST_TURN_RATE
    )
    return Odometry(stamp, X_OB, V_B, at_rest)


def laser_scan(message: Any, stamp: float, scanner: Scanner, V_B: FloatArray) -> LaserScan:
    """sensor_msgs/LaserScan as seen from the body's origin at the middle of the sweep, angles increasing in (-pi, pi].

    stamp: of the first ray, as the definition has it; the result's is that of the middle. V_B: (2,) velocity of the
    body meanwhile, m/s and rad/s. REP 117: inf, or more than range_max, is nothing met within range_max; -inf is
    something nearer than range_min, told as range_min; nan, and what is less than range_min (0 is what many drivers
    write for no answer; null is what rosbridge's JSON makes of nan and inf), says nothing and is nan.
    """
    ranges = np.array(field(message, "ranges"), dtype=float)  # None becomes nan
    least, greatest = float(field(message, "range_min")), float(field(message, "range_max"))
    first, step = float(field(message, "angle_min")), float(field(message, "angle_increment"))
    if not (math.isfinite(first) and math.isfinite(step) and step != 0.0 and 0.0 <= least < greatest < math.inf):
        raise ValueError(f"scan of angles {first} + i * {step} and ranges from {least} to {greatest}")
    too_near = np.isneginf(ranges)
    ranges[ranges < least] = math.nan
    ranges[ranges > greatest] = math.inf
    ranges[too_near] = least

    n = len(ranges)
    after_middle = (np.arange(n) - 0.5 * (n - 1)) * float(field(message, "time_increment"))
    reach = np.where(np.isfinite(ranges), ranges, greatest)
    direction = first + step * np.arange(n) + scanner.yaw
    x, y = scanner.x + reach * np.cos(direction), scanner.y + reach * np.sin(direction)
    turned = V_B[1] * after_middle
    ahead = V_B[0] * after_middle
    px, py = ahead + np.cos(turned) * x - np.sin(turned) * y, np.sin(turned) * x + np.cos(turned) * y
    angles = wrap_angle(np.arctan2(py, px))
    hit = np.isfinite(ranges)
    ranges[hit] = np.hypot(px, py)[hit]
    order = np.argsort(angles, kind="stable")
    order = order[np.diff(angles[order], prepend=-math.inf) > 1e-9]
    middle = stamp - (float(after_middle[0]) if n else 0.0)
    return LaserScan(middle, angles[order], ranges[order], greatest, scanner.sigma)


def apriltag_detections(message: Any, camera_info: Any, stamp: float, camera: Camera) -> TagDetections:
    """apriltag_msgs/AprilTagDetectionArray: corners in the rectified image, so sensor_msgs/CameraInfo's P applies.

    The optical frame is REP 103's: z forward, x right, y down. Standard deviations are those of camera.corner_sigma
    pixels at every corner. Tags whose pose cannot be found are left out.
    """
    P = np.array(_either(camera_info, "p", "P"), dtype=float)
    if P.size != 12 or P[0] <= 0.0 or P[5] <= 0.0:
        raise ValueError("camera_info holds no calibration (its P is zero)")
    found = list(field(message, "detections"))
    ids = np.array([field(one, "id") for one in found], dtype=np.int64)
    pixels = np.array([_corners(field(one, "corners")) for one in found], dtype=float).reshape(-1, 4, 2)
    focal = P[[0, 5]]
    corners = (pixels - P[[2, 6]]) / focal
    sizes = np.full(len(ids), camera.tag_size)
    try:
        p_CT, covariance = square_centers(corners, sizes)
    except np.linalg.LinAlgError:
        raise ValueError(f"the corners of tags {ids.tolist()} are not those of squares") from None
    covariance = covariance * (camera.corner_sigma / focal.mean()) ** 2

    # Rows: the body's x and y as directions in the optical frame; pitch is downward.
    cy, sy, cp, sp = math.cos(camera.yaw), math.sin(camera.yaw), math.cos(camera.pitch), math.sin(camera.pitch)
    R_BC = np.array([[sy, -cy * sp, cy * cp], [-cy, -sy * sp, sy * cp]])
    p_BT = p_CT @ R_BC.T + [camera.x, camera.y]
    covariance = R_BC @ covariance @ R_BC.T
    distance = np.hypot(p_BT[:, 0], p_BT[:, 1])
    good = np.isfinite(p_CT).all(axis=1) & (p_CT[:, 2] > 0.0) & (distance > 0.0)
    p_BT, covariance, distance = p_BT[good], covariance[good], distance[good]
    along = p_BT / distance[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    return TagDetections(
        stamp=stamp,
        ids=ids[good],
        range=distance,
        bearing=np.arctan2(p_BT[:, 1], p_BT[:, 0]),
        sigma_range=np.sqrt(np.einsum("ni,nij,nj->n", along, covariance, along)),
        sigma_bearing=np.sqrt(np.einsum("ni,nij,nj->n", across, covariance, across)) / distance,
    )


def _corners(corners: Any) -> list[float]:
    """Eight numbers, of apriltag_msgs' float64[8] or of a list of points."""
    return [float(v) for c in corners for v in ((c,) if isinstance(c, int | float) else (field(c, "x"), field(c, "y")))]


def _either(message: Any, name: str, old: str) -> Any:
    """A field by its ROS 2 name, or its ROS 1 name."""
    try:
        return field(message, name)
    except ValueError:
        return field(message, old)


def plain_detections(message: Any, stamp: float) -> TagDetections:
    """sensor_msgs/PointCloud2 of one point a tag, with the fields of COLUMNS: for a detector of one's own.

    id: the tag's code. range: m from base_link to the tag's centre, in the plane of the floor. bearing: rad from
    base_link's x axis, counter-clockwise. sigma_range, sigma_bearing: standard deviations, m and rad. The datatypes are
    the sender's choice. Over rosbridge `data` is base64, as its protocol has it.
    """
    formats = {str(field(one, "name")): one for one in field(message, "fields")}
    if missing := [name for name in COLUMNS if name not in formats]:
        raise ValueError(f"detections without the field {missing[0]}; they need {', '.join(COLUMNS)}")
    order = ">" if field(message, "is_bigendian") else "<"
    layout = np.dtype(
        {
            "names": list(COLUMNS),
            "formats": [order + _DATATYPES[int(field(formats[name], "datatype"))] for name in COLUMNS],
            "offsets": [int(field(formats[name], "offset")) for name in COLUMNS],
            "itemsize": int(field(message, "point_step")),
        }
    )
    data = field(message, "data")
    count = int(field(message, "width")) * int(field(message, "height"))
    points = np.frombuffer(base64.b64decode(data) if isinstance(data, str) else bytes(data), layout, count)
    ids = points["id"].astype(np.int64)
    columns = {name: points[name].astype(float) for name in COLUMNS[1:]}
    values = np.array(list(columns.values()))
    if not (np.isfinite(values).all() and (values[[0, 2, 3]] > 0.0).all()):
        raise ValueError("detections that are not finite, or whose range or sigmas are not above 0")
    return TagDetections(stamp, ids, **columns | {"bearing": wrap_angle(columns["bearing"])})


def hazards(kind: str, message: Any, stamp: float, before: Hazards) -> Hazards:
    """The base's alarms after a message of the type `kind`, one of HAZARDS; before: those so far.

    kobuki_ros_interfaces' events tell one sensor's change; turtlebot3_msgs/SensorState and irobot_create_msgs/
    HazardDetectionVector tell all. Of the latter BUMP and STALL are the bumper, CLIFF and WHEEL_DROP themselves; the
    side is in a detection's frame_id.
    """
    return HAZARDS[kind](message, replace(before, stamp=stamp))


def _kobuki_event(name: str, sensor: str, bits: tuple[int, ...], message: Any, before: Hazards) -> Hazards:
    bit = bits[int(field(message, sensor))]
    old = getattr(before, name)
    return replace(before, **{name: old | bit if int(field(message, "state")) else old & ~bit})


def _turtlebot3(message: Any, before: Hazards) -> Hazards:
    return replace(before, bumper=int(field(message, "bumper")), cliff=int(field(message, "cliff")))


def _create3(message: Any, before: Hazards) -> Hazards:
    bits = {"bumper": 0, "cliff": 0, "wheel_drop": 0}
    names = {1: "bumper", 2: "cliff", 3: "bumper", 4: "wheel_drop"}
    for one in field(message, "detections"):
        if name := names.get(int(field(one, "type"))):
            frame = str(field(one, "header.frame_id")).rsplit("/", 1)[-1]
            bits[name] |= LEFT if "left" in frame else RIGHT if "right" in frame else CENTRE
    return replace(before, **bits)


_SIDES = (LEFT, CENTRE, RIGHT)
# By the type of the message. BumperEvent.bumper and CliffEvent.sensor: 0 left, 1 centre, 2 right; WheelDropEvent.wheel:
# 0 left, 1 right.
HAZARDS = {
    "kobuki_ros_interfaces/msg/BumperEvent": lambda m, h: _kobuki_event(
        "bumper", "bumper", (LEFT, CENTRE, RIGHT), m, h
    ),
    "kobuki_ros_interfaces/msg/CliffEvent": lambda m, h: _kobuki_event("cliff", "sensor", _SIDES, m, h),
    "kobuki_ros_interfaces/msg/WheelDropEvent": lambda m, h: _kobuki_event("wheel_drop", "wheel", (LEFT, RIGHT), m, h),
    "turtlebot3_msgs/msg/SensorState": _turtlebot3,
    "irobot_create_msgs/msg/HazardDetectionVector": _create3,
}


def twist(speed: float, turn_rate: float) -> dict[str, dict[str, float]]:
    """geometry_msgs/Twist, as a dictionary: forward speed, m/s, and turn rate, rad/s."""
    return {
        "linear": {"x": float(speed), "y": 0.0, "z": 0.0},
        "angular": {"x": 0.0, "y": 0.0, "z": float(turn_rate)},
    }


def velocity(kind: str, speed: float, turn_rate: float, stamp: float, frame: str = "base_link") -> dict[str, Any]:
    """The command as a dictionary of the type `kind`, geometry_msgs/msg/Twist or TwistStamped in a frame of the body.

    stamp: s of the robot's ROS clock.
    """
    command = twist(speed, turn_rate)
    if kind == "geometry_msgs/msg/Twist":
        return command
    return {"header": {"stamp": ros_time(stamp), "frame_id": frame}, "twist": command}


def ros_time(stamp: float) -> dict[str, int]:
    """builtin_interfaces/Time of s since the ROS clock's epoch."""
    seconds = math.floor(stamp)
    return {"sec": seconds, "nanosec": int(1e9 * (stamp - seconds))}
