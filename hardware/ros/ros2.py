"""A TurtleBot's ROS 2 graph through rclpy, which comes with a sourced ROS and is imported only here, when opened."""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import time
from collections.abc import Callable
from typing import Any

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.ros.preset import Topic


class Ros2Graph:
    """A node of our own on the graph, see tfg_drake.hardware.ros.graph_driver.Graph."""

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

    def require(self, topic: Topic) -> None:
        """Raises DeviceError without the package of the topic's type."""
        _message_type(topic)

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

    def listeners(self, name: str) -> list[str]:
        """The types that a topic is listened to with; none when nobody does."""
        return sorted({end.topic_type for end in self.node.get_subscriptions_info_by_topic(name)})

    def best_effort(self, name: str) -> bool:
        """True if all publishers of a topic are best effort."""
        from rclpy.qos import ReliabilityPolicy

        ends = self.node.get_publishers_info_by_topic(name)
        return all(end.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT for end in ends)

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
            f"ros2: {topic.name} needs the package {package}, which this ROS lacks: install ros-$ROS_DISTRO-"
            f"{package.replace('_', '-')} and source ROS again, or take it out of a preset that names it"
        ) from None


def message_type(kind: str) -> Any:
    """The class of a type "package/msg/Name" or "package/Name"; raises ImportError without the package."""
    package, _, name = kind.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), name.removeprefix("msg/"))


def filled(message: Any, values: dict[str, Any]) -> Any:
    """The message, its fields set from a dictionary; those not in it stay as they are."""
    for name, value in values.items():
        if isinstance(value, dict):
            filled(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            # "sequence<geometry_msgs/Point>" or "sequence<geometry_msgs/Point, 3>".
            inner = message.get_fields_and_field_types()[name].partition("<")[2].rstrip(">").partition(",")[0]
            one = message_type(inner)
            setattr(message, name, [filled(one(), item) for item in value])
        else:
            setattr(message, name, value)
    return message
