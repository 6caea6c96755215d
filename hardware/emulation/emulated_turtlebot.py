"""A TurtleBot 4 that is not there: the simulator's dynamics and sensor models, in real time, in the form of ROS
messages (dictionaries of their fields), for whichever transport."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from tfg_drake.config import OdometryConfig, ScanConfig, TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.hardware.device import WAITING, DeviceError
from tfg_drake.hardware.emulation.emulated_robot import EmulatedRobot
from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.map_messages import Fields, pose_fields, transform
from tfg_drake.hardware.ros.preset import Preset, Topic
from tfg_drake.hardware.ros.ros2 import Ros2Graph
from tfg_drake.messages import FloatArray, LaserScan, Odometry, TagDetections
from tfg_drake.simulation import differential_drive as drive
from tfg_drake.simulation import odometry
from tfg_drake.systems.ports import COMMAND_PERIOD
from tfg_drake.world.world import World

# Odometry comes with every step, tags and a scan with every SENSE_EVERY-th.
SENSE_EVERY = 3


class EmulatedTurtlebot(EmulatedRobot):
    """Stepped by whoever owns it; every time is the host's monotonic clock, s.

    It has no watchdog of its own: it keeps the velocity it was last told, so a stop is the driver's doing.

    silent: the topics' keys that say nothing. faults: what is wrong with "tags" or "scan", see
    sensor_faults. clock: the robot's ROS clock minus the host's, s. commands: (time, speed,
    turn rate) as told, poses: (time, X_WB), the truth; the newest last.
    """

    def __init__(
        self,
        world: World,
        preset: Preset,
        tags: TagSensorConfig,
        scanner: ScanConfig,
        wheels: OdometryConfig,
        seed: int | None = None,
    ) -> None:
        """preset: the mount of its scanner, its frames. seed: of the sensors' noise, None for none."""
        # A TurtleBot 4's lidar sees all round; as it is mounted, a narrower field of view would not see ahead.
        super().__init__(world, None, tags, dataclasses.replace(scanner, field_of_view=2.0 * math.pi), seed)
        self._preset, self._wheels = preset, wheels
        self._run_errors = odometry.run_errors(self.noise(3), wheels)
        self._odometry = odometry.initial_state(world.start)
        self._steps = 0
        self._command = (0.0, 0.0)
        self.silent: set[str] = set()
        self.clock = time.time() - time.monotonic()
        self.commands: collections.deque[tuple[float, float, float]] = collections.deque(maxlen=WAITING)
        self.poses: collections.deque[tuple[float, FloatArray]] = collections.deque(maxlen=WAITING)
        for _ in range(SENSE_EVERY):
            self.step()  # compiles the kernels before real time begins

    def drive(self, command: Any) -> None:
        """Takes a geometry_msgs/TwistStamped in, of either transport."""
        twist = conversions.field(command, "twist")
        self._command = (float(conversions.field(twist, "linear.x")), float(conversions.field(twist, "angular.z")))
        self.commands.append((time.monotonic(), *self._command))

    def step(self) -> dict[str, Fields]:
        """One period on; the messages to publish, by their key in the preset's topics, and "tf"."""
        now = time.monotonic()
        self.move(self._command, COMMAND_PERIOD)
        self._steps += 1
        pose, X_WB = self.state[drive.X : drive.TURN_RATE + 1], self.pose.copy()
        self.poses.append((now, X_WB))
        self._odometry = odometry.integrate(
            self._odometry, self._steps * COMMAND_PERIOD, pose, self._run_errors, self.noise(2), self._wheels
        )
        frames, mount = self._preset.frames, self._preset.scanner
        stamp = conversions.ros_time(now + self.clock)
        wheels = odometry.message(self._odometry)
        messages = {
            "odometry": _odometry({"stamp": stamp, "frame_id": frames.odom}, frames.base, wheels),
            "tf": transform({"stamp": stamp, "frame_id": frames.odom}, frames.base, wheels.X_OB),
        }
        if self._steps % SENSE_EVERY == 0:
            X_WS = se2.compose(X_WB, np.array([mount.x, mount.y, mount.yaw]))
            if (scan := self.told_scan(X_WS, 0.0)) is not None:
                messages["scan"] = _scan({"stamp": stamp, "frame_id": "rplidar_link"}, scan)
            if (found := self.told_tags(X_WB, 0.0)) is not None:
                messages["detections"] = _cloud({"stamp": stamp, "frame_id": frames.base}, found)
        return {key: message for key, message in messages.items() if key not in self.silent}

    def run(
        self, publish: Callable[[str, Fields], None], spin: Callable[[float], None], go_on: Callable[[], bool]
    ) -> None:
        """Steps in real time while go_on(): publish(key, message), and spin(duration, s), which calls `drive`."""
        due = time.monotonic()
        while go_on():
            # On a loaded machine a step may be late, but the delay does not add up.
            due = max(due + COMMAND_PERIOD, time.monotonic() - 5.0 * COMMAND_PERIOD)
            for key, message in self.step().items():
                publish(key, message)
            spin(max(0.0, due - time.monotonic()))

    def report(self) -> dict[str, Any]:
        """The truth, as EmulatedRobot has it."""
        return self.truth(self.poses[-1][0])


def _odometry(header: Fields, base: str, message: Odometry) -> Fields:
    v, w = message.V_B.tolist()
    return {
        "header": header,
        "child_frame_id": base,
        "pose": {"pose": pose_fields(message.X_OB)},
        "twist": {"twist": conversions.twist(v, w)},
    }


def _scan(header: Fields, scan: LaserScan) -> Fields:
    # A scan without rays is a message with an empty list of ranges.
    angles = scan.angles if len(scan.angles) > 1 else np.array([0.0, 1.0])
    return {
        "header": header,
        "angle_min": float(angles[0]),
        "angle_max": float(angles[-1]),
        "angle_increment": float(angles[1] - angles[0]),
        "time_increment": 0.0,
        "range_min": 0.05,
        "range_max": scan.range_max,
        "ranges": scan.ranges.tolist(),
    }


def _cloud(header: Fields, detections: TagDetections) -> Fields:
    """PointCloud2 that plain_detections reads."""
    names = conversions.COLUMNS
    points = np.column_stack([detections.ids, *(getattr(detections, name) for name in names[1:])]).astype("<f8")
    fields = [{"name": name, "offset": 8 * k, "datatype": 8, "count": 1} for k, name in enumerate(names)]
    return {
        "header": header,
        "height": 1,
        "width": len(points),
        "fields": fields,
        "is_bigendian": False,
        "point_step": 8 * len(names),
        "row_step": points.nbytes,
        "data": points.tobytes(),
        "is_dense": True,
    }


class Ros2Emulator:
    """The robot's topics, as its preset has them. topics: those that it publishes and, last, that it obeys."""

    def __init__(self, robot: EmulatedTurtlebot, preset: Preset) -> None:
        """Joins the graph; raises DeviceError without ROS."""
        self._robot = robot
        topics = preset.topics
        assert topics.detections is not None
        published = {"odometry": topics.odometry, "scan": topics.scan, "detections": topics.detections}
        transforms = Topic("/tf", "tf2_msgs/msg/TFMessage", "reliable")
        self._graph = Ros2Graph("turtlebot4", preset.discovery)
        with contextlib.suppress(DeviceError):  # only pictures need it
            self._graph.require(transforms)
            published = {"tf": transforms, **published}
        try:
            self._publishers = {key: self._graph.publisher(topic) for key, topic in published.items()}
            self._graph.subscribe(topics.command, lambda message, _: robot.drive(message))
        except DeviceError:
            self.close()
            raise
        self.topics = [*published.values(), topics.command]

    def run(self, go_on: Callable[[], bool]) -> None:
        """In real time, while go_on()."""
        self._robot.run(self._publish, self._graph.spin, go_on)

    def _publish(self, key: str, message: Fields) -> None:
        if (publish := self._publishers.get(key)) is not None:
            publish(message)

    def close(self) -> None:
        """Leaves the graph."""
        self._graph.close()
