"""A TurtleBot's ROS 2 graph through rclpy, which comes with a sourced ROS and is imported only here, when opened."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import sys
import time
from functools import partial
from typing import Any

from tfg_drake.hardware.device import Device, DeviceError, Message
from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.intake import Intake, mistyped
from tfg_drake.hardware.ros.preset import Preset, Topic
from tfg_drake.hardware.ros.stamps import SILENCE
from tfg_drake.hardware.watchdog import TICK

# How long to look for the robot, s.
PATIENCE = 10.0


def connect(preset: Preset) -> Device:
    """The robot of a preset over ROS 2; raises DeviceError."""
    return Device(Ros2Config(preset))


@dataclasses.dataclass(frozen=True)
class Ros2Config:
    """What the robot's process is told."""

    preset: Preset

    def open(self) -> Ros2Driver:
        """The driver; raises DeviceError."""
        return Ros2Driver(self.preset)


def _message_type(topic: Topic) -> Any:
    package, _, name = topic.type.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except ImportError:
        raise DeviceError(
            f"ros2: {topic.name} needs the package {package}, which this ROS lacks: install "
            f"ros-$ROS_DISTRO-{package.replace('_', '-')} and source ROS again, or take the topic out of the preset"
        ) from None


class Ros2Driver:
    """A node that subscribes to a preset's topics and publishes its command; see tfg_drake.hardware.device.Driver."""

    def __init__(self, preset: Preset) -> None:
        """Waits until odometry and scan arrive; raises DeviceError."""
        try:
            import rclpy
            from rclpy.context import Context
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
            from rclpy.signals import SignalHandlerOptions
        except ImportError as error:
            raise DeviceError(
                f"ros2: rclpy cannot be imported by {sys.executable} ({error}): run `source /opt/ros/jazzy/setup.bash` "
                "first and use the Python of that ROS, or connect through rosbridge"
            ) from None
        self.limits = preset.limits
        self._preset, self._intake = preset, Intake(preset)
        qos = {
            "sensor_data": qos_profile_sensor_data,
            "reliable": QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE),
        }
        topics = preset.topics
        types = {topic.name: _message_type(topic) for topic in (topics.command, *self._topics())}
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._node = rclpy.create_node("tfg_drake", context=self._context)
        self._executor.add_node(self._node)
        for key, topic in self._intake.topics():
            callback = partial(self._receive, key, topic)
            self._node.create_subscription(types[topic.name], topic.name, callback, qos[topic.qos])
        self._command_type = types[topics.command.name]
        self._publisher = self._node.create_publisher(self._command_type, topics.command.name, qos[topics.command.qos])
        try:
            self._wait()
        except DeviceError:
            self.close()
            raise

    def _topics(self) -> list[Topic]:
        return [topic for _, topic in self._intake.topics()]

    def _receive(self, key: str, topic: Topic, message: Any) -> None:
        self._intake.receive(key, topic, message, time.monotonic())

    def _wait(self) -> None:
        needed = {self._preset.topics.odometry.name, self._preset.topics.scan.name}
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            self.spin(TICK)
            ends = self._ends()
            for topic, types, _ in ends:
                if line := mistyped(topic, types):
                    raise DeviceError(f"ros2: {line}")
            if line := self._unreliable():
                raise DeviceError(f"ros2: {line}")
            if self._intake.clock.ready and needed <= self._intake.arrived and all(types for _, types, _ in ends):
                break
        for topic, types, verb in self._ends():
            if not types:
                graph = [(name, kind) for name, kinds in self._node.get_topic_names_and_types() for kind in kinds]
                raise DeviceError(f"ros2: {self._intake.nobody(topic, graph, verb)}")
        if silent := sorted(needed - self._intake.arrived):
            raise DeviceError(f"ros2: nothing arrives on {silent[0]} in {PATIENCE:.0f} s: start its driver")
        if not self._intake.clock.ready:
            raise DeviceError(
                f"ros2: {self._preset.topics.odometry.name} falls silent for more than {SILENCE} s at times"
            )
        if line := self._intake.clock.skew():
            raise DeviceError(f"ros2: {line}")

    def _ends(self) -> list[tuple[Topic, list[str], str]]:
        """Every topic, the types that its other end has, and what that does."""
        node, command = self._node, self._preset.topics.command
        inputs = [(topic, node.get_publishers_info_by_topic(topic.name), "publishes") for topic in self._topics()]
        outputs = [(command, node.get_subscriptions_info_by_topic(command.name), "listens to")]
        return [(topic, sorted({end.topic_type for end in ends}), verb) for topic, ends, verb in inputs + outputs]

    def _unreliable(self) -> str | None:
        """The complaint that a topic is asked for as reliable and published best effort only: nothing would arrive."""
        from rclpy.qos import ReliabilityPolicy

        for topic in self._topics():
            ends = self._node.get_publishers_info_by_topic(topic.name)
            best_effort = [end.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for end in ends]
            if topic.qos == "reliable" and ends and all(best_effort):
                return f"{topic.name} is published best effort, the preset has reliable: set its qos to sensor_data"
        return None

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def take(self) -> list[Message]:
        """The messages since the last call."""
        return self._intake.take()

    def fault(self) -> str | None:
        """Why the robot must stop until it is enabled anew, once; None when all is well."""
        return self._intake.fault()

    def send(self, speed: float, turn_rate: float) -> None:
        """Publishes a velocity, m/s and rad/s."""
        kind = self._preset.topics.command.type
        command = conversions.velocity(kind, speed, turn_rate, self._intake.clock.robot(time.monotonic()))
        self._publisher.publish(_filled(self._command_type(), command))

    def show(self, enabled: bool) -> None:
        """These robots have nothing to show it with."""

    def close(self) -> None:
        """Leaves the graph."""
        with contextlib.suppress(Exception):
            self._executor.shutdown()
            self._node.destroy_node()
        self._context.try_shutdown()


def _filled(message: Any, values: dict[str, Any]) -> Any:
    for name, value in values.items():
        if isinstance(value, dict):
            _filled(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message
