"""A TurtleBot's ROS 2 graph through rclpy, which comes with a sourced ROS and is imported only here, when opened."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from tfg_drake.hardware.device import Device, DeviceError
from tfg_drake.hardware.ros.announcer import Announcer
from tfg_drake.hardware.ros.graph_driver import GraphBaseDriver
from tfg_drake.hardware.ros.intake import Intake, mistyped
from tfg_drake.hardware.ros.preset import Preset, Topic
from tfg_drake.hardware.ros.ros2_messages import filled, message_type
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


class Ros2Graph:
    """A node of our own on the graph, used by one thread: what driving a base and listening to a sensor share."""

    label = "ros2"

    def __init__(self, name: str = "tfg_drake", discovery: str = "subnet") -> None:
        """Joins the graph as the node `name`; raises DeviceError without rclpy.

        discovery: a preset's. "localhost" holds for this process, unless its environment says otherwise.
        """
        if discovery == "localhost":
            os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        try:
            import rclpy
            from rclpy.context import Context
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
            from rclpy.signals import SignalHandlerOptions
        except ImportError as error:
            raise DeviceError(
                f"ros2: rclpy cannot be imported by {sys.executable} ({error}): run `source /opt/ros/jazzy/setup.bash` "
                "first and use the Python of that ROS, or connect through rosbridge"
            ) from None
        reliable = ReliabilityPolicy.RELIABLE
        self._qos = {
            "sensor_data": qos_profile_sensor_data,
            "reliable": QoSProfile(depth=5, reliability=reliable),
            "latched": QoSProfile(depth=1, reliability=reliable, durability=DurabilityPolicy.TRANSIENT_LOCAL),
        }
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._executor = SingleThreadedExecutor(context=self._context)
        self.node = rclpy.create_node(name, context=self._context)
        self._executor.add_node(self.node)

    def subscribe(self, topic: Topic, receive: Callable[[Any, float], None]) -> None:
        """receive(message, arrival), arrival s of the host's clock; raises DeviceError without the type's package."""
        kind = _message_type(topic)
        self.node.create_subscription(
            kind, topic.name, lambda message: receive(message, time.monotonic()), self._qos[topic.qos]
        )

    def publisher(self, topic: Topic) -> Callable[[dict[str, Any]], None]:
        """Publishes a dictionary of fields; qos may be "latched". Raises DeviceError without the type's package."""
        kind = _message_type(topic)
        publisher = self.node.create_publisher(kind, topic.name, self._qos[topic.qos])
        return lambda values: publisher.publish(filled(kind(), values))

    def types(self, name: str) -> list[str]:
        """The types that a topic is published with; none when nobody publishes it."""
        return sorted({end.topic_type for end in self.node.get_publishers_info_by_topic(name)})

    def names(self) -> list[tuple[str, str]]:
        """(name, type) of every topic."""
        return [(name, kind) for name, kinds in self.node.get_topic_names_and_types() for kind in kinds]

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def close(self) -> None:
        """Leaves the graph."""
        with contextlib.suppress(Exception):
            self._executor.shutdown()
            self.node.destroy_node()
        self._context.try_shutdown()


def _message_type(topic: Topic) -> Any:
    try:
        return message_type(topic.type)
    except ImportError:
        package = topic.type.partition("/")[0]
        raise DeviceError(
            f"ros2: {topic.name} needs the package {package}, which this ROS lacks: install "
            f"ros-$ROS_DISTRO-{package.replace('_', '-')} and source ROS again, or take the topic out of the preset"
        ) from None


class Ros2Driver(GraphBaseDriver):
    """A node that subscribes to a preset's topics and publishes its command; see tfg_drake.hardware.device.Driver.

    It publishes what the explorer knows, too: see tfg_drake.hardware.announcements.Publisher.
    """

    _graph: Ros2Graph

    def __init__(self, preset: Preset) -> None:
        """Waits until odometry and scan arrive; raises DeviceError."""
        self.limits = preset.limits
        self._preset, self._intake = preset, Intake(preset)
        self._graph = Ros2Graph(discovery=preset.discovery)
        self._announcer = Announcer(preset.publish, self._graph.publisher, self._intake.clock.robot)
        try:
            self._send = self._graph.publisher(preset.topics.command)
            for key, topic in self._intake.topics():
                self._graph.subscribe(topic, partial(self._intake.receive, key, topic))
            self._wait()
        except DeviceError:
            self.close()
            raise

    def _topics(self) -> list[Topic]:
        return [topic for _, topic in self._intake.topics()]

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
                raise DeviceError(f"ros2: {self._intake.nobody(topic, self._graph.names(), verb)}")
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
        command = self._preset.topics.command
        listeners = self._graph.node.get_subscriptions_info_by_topic(command.name)
        inputs = [(topic, self._graph.types(topic.name), "publishes") for topic in self._topics()]
        return [*inputs, (command, sorted({end.topic_type for end in listeners}), "listens to")]

    def _unreliable(self) -> str | None:
        """The complaint that a topic is asked for as reliable and published best effort only: nothing would arrive."""
        from rclpy.qos import ReliabilityPolicy

        for topic in self._topics():
            ends = self._graph.node.get_publishers_info_by_topic(topic.name)
            best_effort = [end.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for end in ends]
            if topic.qos == "reliable" and ends and all(best_effort):
                return f"{topic.name} is published best effort, the preset has reliable: set its qos to sensor_data"
        return None
