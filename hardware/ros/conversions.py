"""ROS messages to ours and velocities to ROS: pure functions on messages of either transport.

A message is an object with attributes, as rclpy gives it, or a dictionary, as rosbridge does. REP 103: metres, radians,
seconds; x forward, y left, counter-clockwise. REP 105: odometry is the pose of base_link in odom, our X_OB. A message
that cannot be used raises ValueError with one line; numbers and sizes are bounded before anything is computed of them,
and whether what comes out is plausible is judged elsewhere. `stamp` is always the host's time, s: see intake.py.
"""

from __future__ import annotations

import base64
import math
import reprlib
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.geometry.sweep import Sweep, scan_of
from tfg_drake.hardware.device import BaseState
from tfg_drake.hardware.plausible import FARTHEST, IDS, MOST_RAYS, MOST_TAGS, SCAN_RANGE
from tfg_drake.hardware.ros.preset import Camera, Scanner
from tfg_drake.messages import FloatArray, Hazards, LaserScan, Odometry, SaidPose, TagDetections, replace
from tfg_drake.mission.operation import Side
from tfg_drake.slam.odometry_rules import FASTEST, FASTEST_TURN
from tfg_drake.vision.calibration import WIDEST_IMAGE, CameraCalibration
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.sighting import TagNoise, in_plane
from tfg_drake.vision.tag_position import LEAST_RANGE, tag_positions

# A robot is at rest if its odometry shows less motion than REST, m, rad or m/s, and than REST_TURN_RATE, rad/s.
REST, REST_TURN_RATE = 1e-5, 1e-3
# OFF_UNIT: greatest error of a quaternion's length, by rounding. A range above range_max less NO_RETURN, m, is no
# return: drivers write range_max for it.
OFF_UNIT, NO_RETURN = 0.05, 1e-3
# Least standard deviations of a pose stated by a person, m and rad.
LEAST_SAID = 0.05
# Columns of a plain detections message, see `plain_detections`.
COLUMNS = ("id", "range", "bearing", "sigma_range", "sigma_bearing")
# Numpy's types for the datatypes 1 to 8 of sensor_msgs/PointField.
_DATATYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
# Greatest number of fields, and of bytes of a point, in a PointCloud2.
_MOST_FIELDS, _LONGEST_POINT = 100, 4096
# Share of charge up to which a battery is low, and dangerously low. A charge above GREATEST_SHARE is in per cent.
LOW_CHARGE, DANGEROUS_CHARGE, GREATEST_SHARE = 0.15, 0.05, 1.5
# Value of sensor_msgs/BatteryState.power_supply_status while charging.
_CHARGING = 1
# Upper bound of a ROS stamp (the year 2242), s, and of the time between two rays of a sweep, s.
_LAST_STAMP, _RAY_TIME = 2**33, 1.0


def field(message: Any, path: str) -> Any:
    """The field at a dotted path, "pose.pose.position.x", of a message of either transport; ValueError without it."""
    value = message
    for name in path.split("."):
        try:
            value = value[name] if isinstance(value, Mapping) else getattr(value, name)
        except (KeyError, AttributeError):
            raise ValueError(f"no field {path}") from None
    return value


def number(message: Any, path: str, most: float = 1e9) -> float:
    """The number at a dotted path; ValueError where it is none, or its magnitude more than `most`."""
    return _bounded(field(message, path), path, most)


def _bounded(value: Any, name: str, most: float) -> float:
    try:
        result = float(value)
    except (TypeError, ValueError, OverflowError):
        result = math.nan
    if not abs(result) <= most:
        raise ValueError(f"{name} is {reprlib.repr(value)}, no number up to {most:g}")
    return result


def count(message: Any, path: str, most: int, least: int = 0) -> int:
    """The whole number at a dotted path; ValueError where it is none from `least` to `most`."""
    value = number(message, path, max(abs(least), most))
    if value < least or value != int(value):
        raise ValueError(f"{path} is {value:g}, no whole number from {least} to {most}")
    return int(value)


def _sequence(message: Any, path: str, most: int) -> Any:
    """The list at a dotted path; raises ValueError if it is none or longer than `most`."""
    values = field(message, path)
    if not hasattr(values, "__len__") or isinstance(values, Mapping):
        raise ValueError(f"{path} is no list")
    if len(values) > most:
        raise ValueError(f"{path} has {len(values)} entries; {most} are the most that is plausible")
    return values


def content(message: Any, most: int) -> bytes:
    """The bytes of `data`, which rosbridge sends as base64."""
    data = _sequence(message, "data", most)
    return base64.b64decode(data, validate=True) if isinstance(data, str) else bytes(data)


def ros_stamp(message: Any) -> float | None:
    """std_msgs/Header's stamp, s since the ROS clock's epoch; None of a message that has no header."""
    try:
        stamp = field(message, "header.stamp")
    except ValueError:
        return None
    seconds, nanoseconds = ("secs", "nsecs") if isinstance(stamp, Mapping) and "secs" in stamp else ("sec", "nanosec")
    return count(stamp, seconds, _LAST_STAMP) + 1e-9 * count(stamp, nanoseconds, 10**9)


def unit_quaternion(message: Any, path: str) -> tuple[float, float, float, float]:
    """The geometry_msgs/Quaternion (x, y, z, w) there, of length one; ValueError where it is not near that."""
    q = [number(message, f"{path}.{axis}") for axis in "xyzw"]
    length = math.hypot(*q)
    if abs(length - 1.0) > OFF_UNIT:
        raise ValueError(f"orientation {' '.join(f'{one:g}' for one in q)} is no unit quaternion")
    return q[0] / length, q[1] / length, q[2] / length, q[3] / length


def odometry(message: Any, stamp: float, before: Odometry | None = None) -> Odometry:
    """nav_msgs/Odometry: the pose is that of child_frame_id in frame_id, the twist is in child_frame_id.

    before: the previous message: by the difference of the poses the robot is at rest or, if the twist is zero as many
    drivers leave it, has its velocity.
    """
    px, py, yaw = _planar(message)
    speed, turn_rate = _told(message, "twist.twist.linear.x"), _told(message, "twist.twist.angular.z")
    at_rest = False
    if before is not None:
        dt, dx, dy = stamp - before.stamp, px - float(before.X_OB[0]), py - float(before.X_OB[1])
        turn = math.remainder(yaw - float(before.X_OB[2]), 2.0 * math.pi)
        stands = max(abs(dx), abs(dy)) < REST and abs(turn) < REST + REST_TURN_RATE * max(dt, 0.0)
        at_rest = stands and abs(speed) < REST and abs(turn_rate) < REST_TURN_RATE
        if not stands and speed == turn_rate == 0.0 and dt > 0.0:
            middle = yaw - 0.5 * turn
            ahead, turning = (math.cos(middle) * dx + math.sin(middle) * dy) / dt, turn / dt
            if abs(ahead) <= FASTEST and abs(turning) <= FASTEST_TURN:  # otherwise it is a jump
                speed, turn_rate = ahead, turning
    return Odometry(stamp, np.array([px, py, yaw]), np.array([speed, turn_rate]), at_rest)


def said_pose(message: Any, stamp: float, frame: str) -> SaidPose:
    """geometry_msgs/PoseWithCovarianceStamped in a frame, which must be this one, as RViz says where the robot is."""
    if (told := str(field(message, "header.frame_id"))).lstrip("/") != frame:
        raise ValueError(f"it is said in the frame {told[:100]}, the map is {frame}: set RViz's fixed frame")
    covariance = [_bounded(one, "pose.covariance", FARTHEST) for one in _sequence(message, "pose.covariance", 36)]
    x_x, y_y, *_, yaw_yaw = np.diag(np.reshape(covariance, (6, 6)))
    sigma = np.sqrt(np.maximum([max(x_x, y_y), yaw_yaw], LEAST_SAID**2))
    return SaidPose(stamp, X_WB=np.array(_planar(message)), sigma=sigma)


def _planar(message: Any) -> tuple[float, float, float]:
    """The x, y (m) and yaw (rad) of a pose with covariance."""
    x, y, z, w = unit_quaternion(message, "pose.pose.orientation")
    px, py = (number(message, f"pose.pose.position.{axis}", FARTHEST) for axis in "xy")
    return px, py, math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def _told(message: Any, path: str, otherwise: float = 0.0, most: float = 1e9) -> float:
    """Return a number, or `otherwise` for null and nan, which mean unknown; in a twist so does 0, the default."""
    value = field(message, path)
    return otherwise if value is None or value != value else number(message, path, most)


def laser_scan(message: Any, stamp: float, scanner: Scanner, V_B: FloatArray) -> LaserScan:
    """sensor_msgs/LaserScan as seen from the body's origin at the middle of the sweep, angles increasing in (-pi, pi].

    stamp: of the first ray, as defined, by the scanner's clock; the result's is that of the middle, by the odometry's.
    V_B: (2,) velocity of the body during the sweep, m/s and rad/s. REP 117: inf, or a range above range_max less
    NO_RETURN, is no return within range_max; -inf is an obstacle nearer than range_min and becomes range_min; nan, or
    a range below range_min, is unknown and becomes nan. If the scanner's `unanswered` is "free", nan, 0 (which many
    drivers write without a return) and null (rosbridge's JSON for nan and inf) become inf.
    """
    ranges = np.array(_sequence(message, "ranges", MOST_RAYS), dtype=float)  # None becomes nan
    if ranges.ndim != 1:
        raise ValueError("ranges is no list of numbers")
    least, greatest = number(message, "range_min", SCAN_RANGE), number(message, "range_max", SCAN_RANGE)
    between, n = number(message, "time_increment", _RAY_TIME), len(ranges)
    if scanner.field_of_view > 0.0:
        first, step = -0.5 * scanner.field_of_view, scanner.field_of_view / max(n - 1, 1)
    else:
        first, step = (number(message, name, 4.0 * math.pi) for name in ("angle_min", "angle_increment"))
    if not (step != 0.0 and 0.0 <= least < greatest):
        raise ValueError(f"scan of angles {first} + i * {step} and ranges from {least} to {greatest}")
    if scanner.unanswered == "free":
        ranges[np.isnan(ranges) | (ranges == 0.0)] = math.inf
    too_near = np.isneginf(ranges)
    ranges[ranges < least] = math.nan
    ranges[ranges >= greatest - NO_RETURN] = math.inf
    ranges[too_near] = least

    after_middle = np.asarray((np.arange(n) - 0.5 * (n - 1)) * between, dtype=float)
    from_ahead = first + step * np.arange(n)
    directions = np.asarray(scanner.yaw + (from_ahead if scanner.flip == scanner.clockwise else -from_ahead), float)
    middle = stamp - scanner.clock_offset - (float(after_middle[0]) if n else 0.0)
    sweep = Sweep(middle, directions, ranges, after_middle, scanner.x, scanner.y, greatest, scanner.sigma)
    return scan_of(sweep, np.clip(V_B, (-FASTEST, -FASTEST_TURN), (FASTEST, FASTEST_TURN)))


def calibration(camera_info: Any) -> CameraCalibration:
    """sensor_msgs/CameraInfo of either ROS: what its P says of the rectified image."""
    P = list(_sequence(camera_info, "p" if has(camera_info, "p") else "P", 12))
    if len(P) != 12:
        raise ValueError("camera_info's P does not have twelve numbers")
    fx, cx, fy, cy = (_bounded(P[i], "camera_info's P", WIDEST_IMAGE) for i in (0, 2, 5, 6))
    if not (fx >= 1.0 and fy >= 1.0):
        raise ValueError("camera_info holds no calibration (its P is zero)")
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return CameraCalibration(0, 0, K, "plumb_bob", np.zeros(0))


def apriltag_detections(message: Any, calibrated: CameraCalibration, stamp: float, camera: Camera) -> TagDetections:
    """apriltag_msgs/AprilTagDetectionArray: corners in the rectified image.

    The optical frame is REP 103's: z forward, x right, y down. Standard deviations are those of camera.corner_sigma
    pixels at every corner. Tags whose pose cannot be found are left out.
    """
    found = list(_sequence(message, "detections", MOST_TAGS))
    ids = np.array([_tag_id(field(one, "id")) for one in found], dtype=np.int64)
    pixels = np.array([_corners(one) for one in found]).reshape(-1, 4, 2)
    p_CT, unit = tag_positions(pixels, np.full(len(ids), camera.tag_size), calibrated)
    mount = CameraMount(camera.x, camera.y, yaw=camera.yaw, pitch=camera.pitch)
    sighting = in_plane(p_CT, unit, mount, TagNoise(pixels=camera.corner_sigma, place=0.0))
    good = sighting[0] > LEAST_RANGE
    return TagDetections(stamp, ids[good], *(column[good] for column in sighting))


def families(message: Any) -> set[str]:
    """The families of the tags of an apriltag_msgs/AprilTagDetectionArray that names them."""
    found = _sequence(message, "detections", MOST_TAGS)
    return {str(field(one, "family"))[:50] for one in found if has(one, "family")}


def _tag_id(value: Any) -> int:
    """Return an id within its bounds, -1 if it is no whole number; the plausibility check removes invalid ids."""
    return min(max(value, -IDS), IDS) if isinstance(value, int) else -1


def _corners(detection: Any) -> list[float]:
    """Return eight numbers from apriltag_msgs' float64[8] or a list of points; nan for impossible corners, so that one
    bad sighting costs no other."""
    corners = []
    for one in _sequence(detection, "corners", 8):
        point = (field(one, "x"), field(one, "y")) if has(one, "x") else (one,)
        corners += [float(v) if isinstance(v, int | float) and abs(v) <= WIDEST_IMAGE else math.nan for v in point]
    if len(corners) != 8:
        raise ValueError(f"a tag of {len(corners)} coordinates; four corners have 8")
    return corners


def has(message: Any, name: str) -> bool:
    """True if a message has a field."""
    return name in message if isinstance(message, Mapping) else hasattr(message, name)


def plain_detections(message: Any, stamp: float) -> TagDetections:
    """sensor_msgs/PointCloud2 of one point a tag, with the fields of COLUMNS: for a detector of one's own.

    id: the tag's code. range: m from base_link to the tag's centre, in the plane of the floor. bearing: rad from
    base_link's x axis, counter-clockwise. sigma_range, sigma_bearing: standard deviations, m and rad. The datatypes are
    the sender's choice. Over rosbridge `data` is base64, as its protocol has it.
    """
    formats = {str(field(one, "name")): one for one in _sequence(message, "fields", _MOST_FIELDS)}
    if missing := [name for name in COLUMNS if name not in formats]:
        raise ValueError(f"detections without the field {missing[0]}; they need {', '.join(COLUMNS)}")
    order = ">" if field(message, "is_bigendian") else "<"
    kinds = [count(formats[name], "datatype", len(_DATATYPES), 1) for name in COLUMNS]
    layout = np.dtype(
        {
            "names": list(COLUMNS),
            "formats": [order + _DATATYPES[number - 1] for number in kinds],
            "offsets": [count(formats[name], "offset", _LONGEST_POINT) for name in COLUMNS],
            "itemsize": count(message, "point_step", _LONGEST_POINT, 1),
        }
    )
    n = count(message, "width", MOST_TAGS) * count(message, "height", MOST_TAGS)
    if n > MOST_TAGS:
        raise ValueError(f"{n} points; {MOST_TAGS} are the most that is plausible")
    points = np.frombuffer(content(message, 2 * MOST_TAGS * _LONGEST_POINT), layout, n)
    columns = {name: points[name].astype(float) for name in COLUMNS}
    ids = columns.pop("id")
    bearing = columns["bearing"]
    # Invalid angles and ids are removed by the plausibility check.
    ids = np.where(np.isfinite(ids), np.clip(ids, -IDS, IDS), -1.0)
    turns = np.abs(bearing) <= 2.0 * math.pi
    columns["bearing"] = np.where(turns, wrap_angle(np.where(turns, bearing, 0.0)), bearing)
    return TagDetections(stamp, ids.astype(np.int64), **columns)


def hazards(kind: str, message: Any, stamp: float, before: Hazards) -> Hazards:
    """Return the base's alarms after a message of the type `kind`, one of HAZARDS; before: those so far.

    kobuki_ros_interfaces' events report one sensor's change; turtlebot3_msgs/SensorState and irobot_create_msgs/
    HazardDetectionVector report all sensors. In the latter BUMP and STALL count as the bumper, CLIFF and WHEEL_DROP as
    such; the side is in a detection's frame_id.
    """
    return HAZARDS[kind](message, replace(before, stamp=stamp))


def _kobuki_event(name: str, sensor: str, bits: tuple[Side, ...], message: Any, before: Hazards) -> Hazards:
    bit = bits[count(message, sensor, len(bits) - 1)]
    old = getattr(before, name)
    return replace(before, **{name: int(old | bit if number(message, "state") else old & ~bit)})


def _turtlebot3(message: Any, before: Hazards) -> Hazards:
    return replace(before, bumper=int(number(message, "bumper")), cliff=int(number(message, "cliff")))


def _create3(message: Any, before: Hazards) -> Hazards:
    bits = {"bumper": 0, "cliff": 0, "wheel_drop": 0}
    names = {1: "bumper", 2: "cliff", 3: "bumper", 4: "wheel_drop"}
    for one in _sequence(message, "detections", MOST_TAGS):
        if name := names.get(count(one, "type", 255)):
            frame = str(field(one, "header.frame_id")).rsplit("/", 1)[-1]
            bits[name] |= Side.LEFT if "left" in frame else Side.RIGHT if "right" in frame else Side.CENTRE
    return replace(before, **{name: int(value) for name, value in bits.items()})


_SIDES = (Side.LEFT, Side.CENTRE, Side.RIGHT)
# Converters by type of message. BumperEvent.bumper and CliffEvent.sensor: 0 left, 1 centre, 2 right;
# WheelDropEvent.wheel: 0 left, 1 right.
HAZARDS: dict[str, Callable[[Any, Hazards], Hazards]] = {
    "kobuki_ros_interfaces/msg/BumperEvent": partial(_kobuki_event, "bumper", "bumper", _SIDES),
    "kobuki_ros_interfaces/msg/CliffEvent": partial(_kobuki_event, "cliff", "sensor", _SIDES),
    "kobuki_ros_interfaces/msg/WheelDropEvent": partial(_kobuki_event, "wheel_drop", "wheel", (Side.LEFT, Side.RIGHT)),
    "turtlebot3_msgs/msg/SensorState": _turtlebot3,
    "irobot_create_msgs/msg/HazardDetectionVector": _create3,
}


def battery(message: Any, stamp: float) -> BaseState:
    """sensor_msgs/BatteryState, by its percentage: a share from 0 to 1, or to 100 by some drivers. The voltage says
    little about an unknown battery. nan, null and values not above 0 mean unknown: drivers write any of them for
    that."""
    told = (_told(message, name, math.nan, 1e4) for name in ("voltage", "percentage"))
    volts, charge = (value if value > 0.0 else math.nan for value in told)
    charge = charge if charge <= GREATEST_SHARE else 0.01 * charge
    charging = count(message, "power_supply_status", 255) == _CHARGING
    level = "good" if charging or not charge <= LOW_CHARGE else "low" if charge > DANGEROUS_CHARGE else "dangerous"
    return BaseState(stamp, volts, charge, level, "charger" if charging else "", charging)


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
