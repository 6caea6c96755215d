"""Random and extreme messages into all that reads a robot: none hangs, none raises, nothing implausible comes out.

Good messages are mutated: fields replaced by extreme values or other types, taken out, lengthened; of the Kobuki the
contents of frames whose checksums are right.
"""

import copy
import itertools
import json
import math
import os
import random
import socket
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tfg_drake.hardware.device import BaseState
from tfg_drake.hardware.kobuki import codec as p
from tfg_drake.hardware.kobuki.codec import HEADER, MAX_PAYLOAD, checksum, encode
from tfg_drake.hardware.kobuki.connection import Connection
from tfg_drake.hardware.plausible import Judge
from tfg_drake.hardware.ros.conversions import COLUMNS, ros_time
from tfg_drake.hardware.ros.intake import Intake
from tfg_drake.hardware.ros.preset import Topic, load_preset
from tfg_drake.hardware.socket_sensors import SocketDriver
from tfg_drake.messages import Hazards, LaserScan, Odometry, SaidPose, TagDetections

# Between two messages of a source, by the host's clock, s.
PERIOD = 0.02
NUMBERS = (math.nan, math.inf, -math.inf, 0.0, -0.0, -1.0, 1e300, -1e300, 1e200, 1e-300, 5e-324, 3.5, 1e9, 1e5, -7)
WHOLE = (0, -1, 1, 8, 255, 256, 2**31, -(2**31), 2**56, 2**63, -(2**63) - 1, 2**64, 10**400, -(10**400))
OTHERS = (None, "", "nan", "1e999", "x" * 1000, True, [], {}, [[1.0]], [None], {"x": 1.0}, b"\xff", "AAAA", [1] * 3000)
TYPES = {
    "scan": "sensor_msgs/msg/LaserScan",
    "odometry": "nav_msgs/msg/Odometry",
    "PointCloud2": "sensor_msgs/msg/PointCloud2",
    "apriltag": "apriltag_msgs/msg/AprilTagDetectionArray",
    "camera_info": "sensor_msgs/msg/CameraInfo",
    "battery": "sensor_msgs/msg/BatteryState",
    "initial_pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
}
PRESET = load_preset("turtlebot2")
# What the process of the base listens to.
BASE = ("odometry", "hazards", "battery")


def _header(stamp: float) -> dict[str, Any]:
    return {"stamp": ros_time(stamp + 1.7e9), "frame_id": "odom"}


def _odometry(stamp: float) -> dict[str, Any]:
    pose = {"position": {"x": 1.0, "y": 2.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}}
    twist = {"linear": {"x": 0.2}, "angular": {"z": 0.5}}
    return {"header": _header(stamp), "pose": {"pose": pose}, "twist": {"twist": twist}}


def _scan(stamp: float) -> dict[str, Any]:
    ranges = [1.0 + 0.01 * i for i in range(90)]
    angles = {"angle_min": -1.0, "angle_increment": 0.02, "time_increment": 1e-4, "range_min": 0.1, "range_max": 12.0}
    return {"header": _header(stamp), "ranges": ranges, **angles}


def _cloud(stamp: float) -> dict[str, Any]:
    layout = np.dtype([("id", "<u4")] + [(name, "<f8") for name in COLUMNS[1:]])
    data = np.array([(12, 2.5, 0.3, 0.02, 0.01), (4, 1.25, -0.4, 0.03, 0.01)], layout)
    fields = [{"name": n, "offset": layout.fields[n][1], "datatype": 6 if n == "id" else 8} for n in COLUMNS]
    sizes = {"height": 1, "width": 2, "point_step": layout.itemsize, "is_bigendian": False}
    return {"header": _header(stamp), "fields": fields, **sizes, "data": data.tobytes()}


def _corners(stamp: float) -> dict[str, Any]:
    corners = [296.0, 216.0, 344.0, 218.0, 345.0, 264.0, 296.0, 263.0]
    tags = [{"family": "tag36h11", "id": 5 + i, "corners": list(corners)} for i in range(3)]
    return {"header": _header(stamp), "detections": tags}


def _camera(stamp: float) -> dict[str, Any]:
    return {"header": _header(stamp), "p": [600.0, 0.0, 320.0, 0.0, 0.0, 600.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]}


GOOD: dict[str, Callable[[float], dict[str, Any]]] = {
    "odometry": _odometry,
    "scan": _scan,
    "PointCloud2": _cloud,
    "apriltag": _corners,
    "camera_info": _camera,
    "battery": lambda stamp: {"header": _header(stamp), "voltage": 12.1, "percentage": 0.8, "power_supply_status": 2},
    "initial_pose": lambda _: {
        "header": {"frame_id": "map"},
        "pose": {**_odometry(0.0)["pose"], "covariance": [0.1] * 36},
    },
    "kobuki_ros_interfaces/msg/BumperEvent": lambda _: {"bumper": 1, "state": 1},
    "kobuki_ros_interfaces/msg/CliffEvent": lambda _: {"sensor": 2, "state": 1, "bottom": 9},
    "kobuki_ros_interfaces/msg/WheelDropEvent": lambda _: {"wheel": 0, "state": 1},
    "turtlebot3_msgs/msg/SensorState": lambda _: {"bumper": 1, "cliff": 0.0},
    "irobot_create_msgs/msg/HazardDetectionVector": lambda stamp: {
        "header": _header(stamp),
        "detections": [{"type": 1, "header": {"frame_id": "bump_left"}}],
    },
}


def mutated(message: Any, rng: random.Random) -> Any:
    """A copy with one to four of its places changed; arrays over the whole of their length at times."""
    message = copy.deepcopy(message)
    for _ in range(rng.choice((1, 1, 2, 4))):
        place, key = _place(message, rng)
        if place is None:
            return _value(rng)
        match rng.randrange(10):
            case 0 if isinstance(place, dict):
                del place[key]
            case 1 if isinstance(place, list):
                place[:] = [_value(rng) for _ in range(rng.randrange(200))]
            case 2 if isinstance(place, list):
                place *= rng.choice((0, 2, 1000))
            case 3 if isinstance(place, list):
                place[:] = [place[key]] * len(place)
            case _:
                place[key] = _value(rng)
    return message


def _place(message: Any, rng: random.Random) -> tuple[Any, Any]:
    """A random place in a tree: the dictionary or list that holds it, and its key there."""
    place = key = None
    while isinstance(message, dict | list) and message:
        place = message
        key = rng.choice(list(message)) if isinstance(message, dict) else rng.randrange(len(message))
        message = message[key]
        if rng.random() < 0.05:
            break
    return place, key


def _value(rng: random.Random) -> Any:
    kind = rng.random()
    if kind < 0.6:
        return rng.choice(NUMBERS)
    if kind < 0.75:
        return rng.choice(WHOLE)
    if kind < 0.9:
        return rng.uniform(-1.0, 1.0) * 10.0 ** rng.uniform(-30.0, 30.0)
    return copy.deepcopy(rng.choice(OTHERS))


def objects(value: Any) -> Any:
    """The message with attributes, as rclpy gives it."""
    if isinstance(value, dict):
        return SimpleNamespace(**{key: objects(item) for key, item in value.items()})
    return [objects(item) for item in value] if isinstance(value, list) else value


class Ros:
    """The intake of one topic: a dictionary or an object, at random; each comes with odometry that is good."""

    def __init__(self, key: str, seed: int) -> None:
        self._rng, self._key, self._now = random.Random(seed), key, 1000.0
        kind = TYPES.get(key, key)
        self._use = {"PointCloud2": "detections", "apriltag": "detections"}.get(key, key if key in TYPES else "hazards")
        self._topic, self._clock = Topic(f"/{self._use}", kind), Topic("/odom", TYPES["odometry"])
        self._camera = Topic("/camera", TYPES["camera_info"])
        self._tags = Topic("/tags", TYPES["apriltag"])
        topics = [(self._use, self._topic), ("detections", self._tags)]
        if self._use != "odometry":
            topics.append(("odometry" if self._use in BASE else "clock", self._clock))
        self._intake = Intake(PRESET, topics)
        for _ in range(50):
            self._steady()
        self._intake.take()

    def _steady(self) -> None:
        self._now += PERIOD
        key = "odometry" if self._use in BASE else "clock"
        self._intake.receive(key, self._topic if key == self._use else self._clock, _odometry(self._now), self._now)
        self._intake.receive("camera_info", self._camera, _camera(self._now), self._now)

    def message(self) -> Any:
        good = GOOD[self._key](self._now + 0.5 * PERIOD)
        message = mutated(good, self._rng)
        # A stamp that jumps has the clock learned anew, and meanwhile nothing is looked at.
        if isinstance(message, dict) and "header" in good and self._rng.random() < 0.97:
            message["header"] = good["header"]
        return objects(message) if self._rng.random() < 0.5 else message

    def receive(self, message: Any) -> None:
        arrival = self._now + 0.5 * PERIOD
        self._intake.receive(self._use, self._topic, message, arrival)
        if self._use == "camera_info":
            self._intake.receive("detections", self._tags, _corners(arrival), arrival)

    def take(self) -> list[Any]:
        taken = self._intake.take()
        self._steady()
        self._intake.fault()
        return taken

    def refused(self) -> int:
        return self._intake.refusals.counts.total()

    @property
    def now(self) -> float:
        return self._now


class Socket:
    """A client of a sensor socket, its lines handed to it."""

    def __init__(self, _: str, seed: int) -> None:
        self._rng = random.Random(seed)
        with socket.create_server(("127.0.0.1", 0)) as listener:
            thread = threading.Thread(target=self._serve, args=(listener,))
            thread.start()
            self._driver = SocketDriver(*listener.getsockname(), (LaserScan, TagDetections))
            thread.join()

    @staticmethod
    def _serve(listener: socket.socket) -> None:
        client, _ = listener.accept()
        with client:
            client.sendall(b"".join(json.dumps(line).encode() + b"\n" for line in lines(time.monotonic())))

    def message(self) -> bytes:
        return nonsense_line(self._rng)

    def receive(self, line: bytes) -> None:
        self._driver.read(line)

    def take(self) -> list[Any]:
        return self._driver.take()

    def refused(self) -> int:
        return self._driver.refusals.counts.total()

    @property
    def now(self) -> float:
        return time.monotonic()


def lines(stamp: float) -> list[dict[str, Any]]:
    """What a sensor socket says, as good as it can be."""
    tags = {"type": "detections", "stamp": stamp, "ids": [7, 8], "range": [2.3, 1.0], "bearing": [-0.1, 0.4]}
    angles = [0.01 * i for i in range(-90, 90)]
    scan = {"type": "scan", "stamp": stamp, "angles": angles, "ranges": [3.2] * 178 + [None, 0], "range_max": 10.0}
    return [tags | {"sigma_range": [0.04, 0.03], "sigma_bearing": [0.01, 0.02]}, scan | {"sigma": 0.015}]


def nonsense_line(rng: random.Random) -> bytes:
    """A line of a sensor socket, mutated as a message or as bytes."""
    message = rng.choice(lines(time.monotonic()))
    if rng.random() < 0.8:
        message = mutated(message, rng)
    line = json.dumps(message, default=str).encode()
    if rng.random() < 0.2:
        at = rng.randrange(len(line))
        line = rng.choice((line[:at], line[:at] + rng.randbytes(3) + line[at:], b"[" * 50_000, line * 2))
    return line.replace(b"\n", b" ")


class Kobuki:
    """One connection to a base, whose port is a pipe."""

    def __init__(self, _: str, seed: int) -> None:
        self._rng, self.now = random.Random(seed), 1000.0
        reader, self._writer = os.pipe()
        os.set_blocking(reader, False)
        port: Any = SimpleNamespace(read=lambda size: os.read(reader, size), close=lambda: os.close(reader))
        self._connection = Connection(port, self.now, None)

    def message(self) -> bytes:
        rng, stamp = self._rng, round(1000.0 * self.now) % 65536
        if rng.random() < 0.3:
            body = bytes([rng.randrange(1, 30), rng.randrange(20)]) + rng.randbytes(rng.randrange(20))
            body = bytes([len(body)]) + (body * 8)[: MAX_PAYLOAD - 1][: len(body)]
            return HEADER + body + bytes([checksum(body)])
        ticks = [rng.choice((0, 1, 65535, rng.randrange(65536), round(2.0 * self.now) % 65536)) for _ in range(2)]
        some = [rng.choice((0, 0, 255, rng.randrange(256))) for _ in range(8)]
        when = rng.choice((stamp, stamp, stamp, rng.randrange(65536), (stamp + 40_000) % 65536))
        core = p.CoreSensors(when, *some[:3], *ticks, rng.randrange(-128, 128), rng.randrange(-128, 128), *some[4:])
        angle = rng.choice((0, 18000, -32768, 32767, rng.randrange(-18000, 18001)))
        parts = [core, p.Inertia(angle, rng.choice((0, 32767, -32768, rng.randrange(-9000, 9000))))]
        more = (p.FirmwareVersion(*some[:3]), p.HardwareVersion(*some[:3]), p.UniqueId(2**32 - 1, 0, 5))
        return encode(*parts, *rng.sample(more, rng.randrange(3)))

    def receive(self, frame: bytes) -> None:
        os.write(self._writer, frame)
        self._connection.read(self.now)
        self._connection.fault()
        self._connection.trouble(self.now)

    def take(self) -> list[Any]:
        self.now += PERIOD
        return self._connection.take()

    def refused(self) -> int:
        return 0


SOURCES: dict[str, tuple[Callable[[str, int], Any], str]] = {
    **{f"ROS {name.rpartition('/')[2]}": (Ros, name) for name in GOOD},
    "sensor socket": (Socket, ""),
    "Kobuki's frames": (Kobuki, ""),
}


def sound(message: Any, now: float) -> bool:
    """Whether a message could be a robot's: not the judge's rules, but those of whoever uses it."""
    finite: Callable[..., bool] = lambda *values: all(math.isfinite(value) for value in values)  # noqa: E731
    if not (finite(message.stamp) and now - 60.0 < message.stamp < now + 0.5):
        return False
    if isinstance(message, Odometry):
        (x, y, theta), (v, w) = message.X_OB, message.V_B
        return finite(x, y, theta, v, w) and math.hypot(x, y) < 2e5 and abs(v) < 10.0 and abs(w) < 30.0
    if isinstance(message, Hazards):
        return all(bits in range(8) for bits in (message.bumper, message.cliff, message.wheel_drop))
    if isinstance(message, TagDetections):
        columns = (message.ids, message.range, message.bearing, message.sigma_range, message.sigma_bearing)
        rows = zip(*(column.tolist() for column in columns), strict=True)
        return len(message.ids) <= 10_000 and all(
            0 <= tag < 2**31 and 0.0 < r <= 100.0 and abs(b) < 3.15 and 1e-5 < sr < 20.0 and 1e-6 < sb < 2.0
            for tag, r, b, sr, sb in rows
        )
    if isinstance(message, LaserScan):
        angles, ranges = message.angles.tolist(), message.ranges.tolist()
        return (
            len(angles) == len(ranges) <= 100_000
            and all(abs(angle) < 3.15 for angle in angles)
            and all(after > before for before, after in itertools.pairwise(angles))
            and 0.0 < message.range_max <= 1000.0
            and 1e-5 < message.sigma < 2.0
            and all(r != r or r == math.inf or 0.0 < r < message.range_max + 10.0 for r in ranges)
        )
    if isinstance(message, SaidPose):
        return bool(np.all(np.abs(message.X_WB) < 2e5) and np.all((message.sigma >= 0.05) & (message.sigma < 500.0)))
    assert isinstance(message, BaseState)
    return all(value != value or 0.0 <= value < 1e5 for value in (message.battery, message.charge))


@pytest.mark.parametrize("messages", [300, pytest.param(50_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", SOURCES)
def test_nonsense_neither_raises_nor_comes_out(kind, messages):
    make, name = SOURCES[kind]
    source, judge = make(name, 1), Judge({})
    refused, believed = source.refused(), 0
    for _ in range(messages):
        message = source.message()
        now = source.now
        source.receive(message)
        out = [judge.judged(one, now) for one in source.take()]
        assert all(sound(one, now) for one in out if one is not None), message
        believed += sum(one is not None for one in out)
    # It saw both: what is refused, and what is left of it.
    assert believed > 0
    assert source.refused() - refused + judge.refusals.counts.total() > 0 or kind == "Kobuki's frames"
