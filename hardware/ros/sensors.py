"""Tags and scans of a ROS graph, and what the explorer says there; the base has a process of its own."""

from __future__ import annotations

import time
from typing import Any

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.ros import graph_driver
from tfg_drake.hardware.ros.announcer import Announcer
from tfg_drake.hardware.ros.graph_driver import Graph, GraphDriver
from tfg_drake.hardware.ros.preset import COMPRESSED_IMAGE, IMAGE, TYPES, Preset, Topic
from tfg_drake.hardware.watchdog import TICK
from tfg_drake.io.extras import pip_install
from tfg_drake.messages import LaserScan, TagDetections

# By what a topic is wanted for: its key in a preset's `topics`, and the kind of its messages.
KEYS = {"tags": ("detections", TagDetections), "scan": ("scan", LaserScan)}


def open_driver(
    host: str | None, port: int, topics: tuple[tuple[str, str | Topic], ...], preset: Preset, base: bool
) -> SensorDriver:
    """Joins a graph; raises DeviceError. host, port: of rosbridge, None and any for ROS 2. Else as of SensorDriver."""
    if host is None:
        from tfg_drake.hardware.ros.ros2 import Ros2Graph

        return SensorDriver(Ros2Graph("tfg_drake_sensors", preset.discovery), topics, preset, base)
    from tfg_drake.hardware.ros.rosbridge import RosbridgeGraph

    return SensorDriver(RosbridgeGraph(host, port), topics, preset, base)


class SensorDriver(GraphDriver):
    """Listens, and drives nothing; see tfg_drake.hardware.device.Driver. It publishes what the explorer knows, see
    tfg_drake.hardware.announcements.Publisher."""

    def __init__(
        self, graph: Graph, topics: tuple[tuple[str, str | Topic], ...], preset: Preset, base: bool = False
    ) -> None:
        """Waits until every topic is there and has sent a message; raises DeviceError.

        topics: (what for, topic), "tags" or "scan"; of one that is a name only, the graph has the type. preset: where
        the scanner and the camera are mounted, and the topic of the camera's calibration. base: the robot's base is on
        this graph, so its odometry tells the clock and how the robot moves, and somebody may say where that is.
        """
        super().__init__(graph, preset)
        self._announcer = Announcer(preset.publish, graph.publisher, lambda now: self._intake.clock.robot(now))
        self.sources: dict[type, str] = {}
        try:
            needed = []
            for use, named in topics:
                (key, kind), topic = KEYS[use], named if isinstance(named, Topic) else self._named(use, named)
                self.sources[kind] = f"{use} of {topic.name}"
                needed.append((key, topic))
            if any(topic.type.startswith("apriltag") for _, topic in needed):
                if preset.topics.camera_info is None:
                    raise DeviceError(f"{graph.label}: corners of tags say nothing without the preset's camera_info")
                needed.append(("camera_info", preset.topics.camera_info))
            needed += [
                ("camera_info", _beside(topic)) for _, topic in needed if topic.type in (IMAGE, COMPRESSED_IMAGE)
            ]
            if base:
                needed.append(("clock", preset.topics.odometry))
            for key, topic in needed:
                self._seek(topic, mend="; or give --tags none" if key in ("detections", "camera_info") else "")
            said = [("initial_pose", preset.topics.initial_pose)] if base else []  # nobody need ever say it
            self._listen([*needed, *said])
            self._wait({topic.name for _, topic in needed})
        except DeviceError:
            self.close()
            raise

    def _seek(self, topic: Topic, mend: str) -> None:
        """Waits until somebody publishes a topic of a type that is known here; raises DeviceError, which ends so."""
        try:
            self._graph.require(topic)
            self._find(topic)
        except DeviceError as error:
            raise DeviceError(f"{error}{mend}") from None

    def _named(self, use: str, name: str) -> Topic:
        """The topic of this name, of the type that the graph has it with; raises DeviceError."""
        graph, known = self._graph, TYPES[KEYS[use][0]]
        end = time.monotonic() + graph_driver.PATIENCE
        while not (types := graph.types(name)):
            if types is None:
                raise DeviceError(
                    f"{graph.label}: what {name} is cannot be told, because rosapi does not answer: start it on the "
                    "robot with `ros2 launch rosbridge_server rosbridge_websocket_launch.xml`"
                )
            if time.monotonic() > end:
                raise DeviceError(f"{graph.label}: nobody publishes {name}; {self._instead(known, name)}")
            graph.spin(10.0 * TICK)
        if not (fitting := [kind for kind in types if kind in known]):
            raise DeviceError(
                f"{graph.label}: {name} is {types[0]}; {use} come as {' or '.join(known)}: name a topic of that type"
            )
        return Topic(name, fitting[0])

    def publish(self, key: str, message: dict[str, Any]) -> None:
        """Publishes a message on the preset's topic for it."""
        self._announcer.publish(key, message)

    def remarks(self) -> list[str]:
        """Lines for the operator since the last call."""
        return [*super().remarks(), *self._announcer.remarks()]

    def close(self) -> None:
        """Leaves the graph."""
        self._announcer.close()
        super().close()


def _beside(image: Topic) -> Topic:
    """The camera_info of a topic of images, in the same namespace, as image_transport has it; raises DeviceError where
    there is nothing that sees."""
    try:
        import robotpy_apriltag  # noqa: F401
    except ImportError as error:
        raise DeviceError(
            f"{image.name}: {error.name} is not installed, tags cannot be found in images; get it with "
            f"{pip_install('camera')}"
        ) from None
    name = image.name.removesuffix("/compressed").rpartition("/")[0]
    return Topic(f"{name}/camera_info", TYPES["camera_info"][0])
