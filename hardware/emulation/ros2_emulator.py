"""An emulated TurtleBot as a node of a ROS 2 graph: a stand-in for the robot that needs no robot."""

from __future__ import annotations

from collections.abc import Callable

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.emulation.emulated_turtlebot import EmulatedTurtlebot
from tfg_drake.hardware.ros.map_messages import Fields
from tfg_drake.hardware.ros.preset import Preset, Topic
from tfg_drake.hardware.ros.ros2 import Ros2Graph


class Ros2Emulator:
    """The robot's topics, as its preset has them. topics: those that it publishes and, last, that it obeys."""

    def __init__(self, robot: EmulatedTurtlebot, preset: Preset) -> None:
        """Joins the graph; raises DeviceError without ROS."""
        self._robot = robot
        topics = preset.topics
        assert topics.detections is not None
        published = {"odometry": topics.odometry, "scan": topics.scan, "detections": topics.detections}
        self._graph = Ros2Graph("turtlebot4", preset.discovery)
        try:
            self._publishers = {key: self._graph.publisher(topic) for key, topic in published.items()}
            self._graph.subscribe(topics.command, lambda message, _: robot.drive(message))
        except DeviceError:
            self.close()
            raise
        self.topics = [*published.values(), topics.command]
        transforms = Topic("/tf", "tf2_msgs/msg/TFMessage", "reliable")
        try:
            self._publishers["tf"] = self._graph.publisher(transforms)
            self.topics.insert(0, transforms)
        except DeviceError:
            pass  # only pictures need it

    def run(self, go_on: Callable[[], bool]) -> None:
        """In real time, while go_on()."""
        self._robot.run(self._publish, self._graph.spin, go_on)

    def _publish(self, key: str, message: Fields) -> None:
        if (publish := self._publishers.get(key)) is not None:
            publish(message)

    def close(self) -> None:
        """Leaves the graph."""
        self._graph.close()
