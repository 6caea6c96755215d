"""The drivers on a ROS graph, by any transport: of the base, and of tags and scans, which also publishes what the
explorer says. Each has a process of its own; see tfg_drake.hardware.device.Driver."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol, TypeVar

from tfg_drake.hardware.device import Device, DeviceError, Driver, imported
from tfg_drake.hardware.process import TICK
from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.conversions import ros_time
from tfg_drake.hardware.ros.intake import Intake
from tfg_drake.hardware.ros.preset import COMPRESSED_IMAGE, IMAGE, PUBLISHED, TYPES, Preset, Topic
from tfg_drake.hardware.sensor_reader import PATIENCE
from tfg_drake.hardware.watchdog import SILENCE
from tfg_drake.messages import Hazards, LaserScan, Odometry, TagDetections

Send = Callable[[dict[str, Any]], None]
D = TypeVar("D", bound="GraphDriver")
# Key in a preset's `topics`, and kind of the messages, by the use of a topic.
KEYS = {"tags": ("detections", TagDetections), "scan": ("scan", LaserScan)}


class Graph(Protocol):
    """A connection to a ROS graph, such as Ros2Graph or RosbridgeGraph, used by one thread; what it says here holds for
    one that cannot tell. label: the transport's."""

    label: str

    def require(self, topic: Topic) -> None:
        """Raises DeviceError where messages of the topic's type cannot be read here."""

    def names(self) -> list[tuple[str, str]] | None:
        """(name, type) of every topic; None where that cannot be told."""

    def types(self, name: str) -> list[str] | None:
        """The types that a topic is published with; None where that cannot be told."""

    def listeners(self, name: str) -> list[str] | None:
        """The types that a topic is listened to with; None where that cannot be told."""
        return self.types(name)

    def best_effort(self, name: str) -> bool:
        """True if all publishers of a topic are best effort: a reliable subscriber gets nothing."""
        return False

    def subscribe(self, topic: Topic, receive: Callable[[Any, float], None]) -> None:
        """receive(message, arrival), by `spin`; arrival s of the host's clock."""

    def publisher(self, topic: Topic) -> Callable[[dict[str, Any]], None]:
        """Publishes a dictionary of fields; qos may be "latched". Raises DeviceError."""

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""

    def close(self) -> None:
        """Leaves the graph."""


def opened(kind: type[D], host: str, port: int, preset: Preset, *wanted: Any) -> D:
    """Return a driver on a graph, after joining that. host, port: of rosbridge, empty for ROS 2. wanted: further
    arguments of the driver. Raises DeviceError."""
    if not host:
        from tfg_drake.hardware.ros.ros2 import Ros2Graph

        return on_graph(kind, Ros2Graph(kind.node, preset.discovery), preset, *wanted)
    from tfg_drake.hardware.ros.rosbridge import RosbridgeGraph

    return on_graph(kind, RosbridgeGraph(host, port), preset, *wanted)


def on_graph(kind: type[D], graph: Graph, preset: Preset, *wanted: Any) -> D:
    """Return a driver on a graph; if that fails, leave the graph. Raises DeviceError."""
    try:
        return kind(graph, preset, *wanted)
    except DeviceError:
        graph.close()
        raise


def connect(preset: Preset, host: str = "", port: int = 0) -> Device:
    """The base of a preset's robot, in a process of its own; raises DeviceError. host, port: as of `opened`."""
    return Device(partial(opened, GraphBaseDriver, host, port, preset))


class GraphDriver(Intake, Driver):
    """Takes in messages of a graph; a subclass chooses the topics. node: its name on the graph."""

    node: str

    def __init__(self, graph: Graph, preset: Preset, *_wanted: Any) -> None:
        """preset: of the robot that the graph is about, or whose mounts hold."""
        super().__init__(preset)
        self._graph = graph

    def _find(self, topic: Topic, listened: bool = False) -> None:
        """Wait until a topic has a publisher, or a listener, as in the preset. Raises DeviceError, at once if its type
        cannot be read here."""
        graph = self._graph
        graph.require(topic)
        verb, ask = ("listens to", graph.listeners) if listened else ("publishes", graph.types)
        types = self._types(topic.name, ask, f"{verb} {topic.name} ({topic.type})", (topic.type,))
        if types is None:
            return  # a missing topic shows later, when nothing arrives
        if topic.type not in types:
            raise DeviceError(f"{graph.label}: {topic.name} is {types[0]}, the preset has {topic.type}: set its type")
        if topic.qos == "reliable" and not listened and graph.best_effort(topic.name):
            raise DeviceError(
                f"{graph.label}: {topic.name} is published best effort, the preset has reliable: set its qos to "
                "sensor_data"
            )

    def _types(
        self, name: str, ask: Callable[[str], list[str] | None], what: str, kinds: tuple[str, ...]
    ) -> list[str] | None:
        """Wait for the types of a topic and return them, None if they cannot be found out. what, kinds: words and types
        for the complaint. Raises DeviceError."""
        end = time.monotonic() + PATIENCE
        while not (types := ask(name)) and types is not None:
            if time.monotonic() > end:
                raise DeviceError(f"{self._graph.label}: nobody {what}; {self._instead(kinds, name)}")
            self._graph.spin(10.0 * TICK)
        return types

    def _instead(self, kinds: tuple[str, ...], name: str) -> str:
        """Return words on the topics to use instead of a missing one, `name`: those of its kinds if there are any."""
        ours = {name, self._preset.topics.command.name, "/rosout", "/parameter_events"}
        others = [(other, kind) for other, kind in self._graph.names() or [] if other not in ours]
        alike = [other for other, kind in others if kind in kinds]
        seen = (alike or [other for other, _ in others])[:5]
        return f"seen instead: {', '.join(seen) or 'no other topic (check ROS_DOMAIN_ID and the network)'}"

    def _listen(self, topics: list[tuple[str, Topic]]) -> None:
        """Takes in topics by their key, see Intake.expect."""
        self.expect(topics)
        for key, topic in topics:
            self._graph.subscribe(topic, partial(self.receive, key, topic))

    def _wait(self, names: set[str]) -> None:
        """Waits until every topic of these names has sent a message, and the clock is learned; raises DeviceError."""
        clock, label = self.clock, self._graph.label
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and not (clock.ready and names <= self.arrived):
            self.spin(TICK)
        if silent := sorted(names - self.arrived):
            raise DeviceError(f"{label}: nothing arrives on {silent[0]} in {PATIENCE:.0f} s: start its driver")
        if not clock.ready:
            slow = f"{clock.source} falls silent for more than {SILENCE} s at times"
            if clock.source is None:
                slow = f"too little arrives in {PATIENCE:.0f} s: it needs 2 Hz or more"
            raise DeviceError(f"{label}: {slow}")
        if line := clock.skew():
            raise DeviceError(f"{label}: {line}")

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""
        self._graph.spin(duration)

    def close(self) -> None:
        """Leaves the graph."""
        self._graph.close()


class GraphBaseDriver(GraphDriver):
    """Drives a base by a preset's command and listens to its odometry, alarms and battery, and to nothing else: its
    process is the watchdog's, too."""

    node = "tfg_drake"

    def __init__(self, graph: Graph, preset: Preset) -> None:
        """Waits until odometry arrives; raises DeviceError."""
        super().__init__(graph, preset)
        self.limits = preset.limits
        topics, command = preset.topics, preset.topics.command
        alarms = ", ".join(topic.name for topic in topics.hazards)
        self.sources = {Odometry: f"odometry of {topics.odometry.name}", Hazards: f"alarms of {alarms}"}
        # The battery's topic is optional: a robot without a publisher of it can be driven all the same.
        battery = [("battery", topics.battery)] if topics.battery is not None else []
        heard = [("odometry", topics.odometry), *(("hazards", topic) for topic in topics.hazards)]
        for _, topic in heard:
            graph.require(topic)
        for _, topic in heard:
            self._find(topic)
        self._find(command, listened=True)
        self._listen([*heard, *battery])
        self._send = graph.publisher(command)
        self._wait({topics.odometry.name})

    def send(self, speed: float, turn_rate: float) -> None:
        """Publishes a velocity, m/s and rad/s."""
        kind, now = self._preset.topics.command.type, self.clock.robot(time.monotonic())
        self._send(conversions.velocity(kind, speed, turn_rate, now, self._preset.frames.base))


def with_ros_stamps(message: dict[str, Any], robot: Callable[[float], float]) -> dict[str, Any]:
    """The message, its headers' stamps brought from the host's clock (s) to ROS time by robot(stamp), s."""
    changed = dict(message)
    for key, value in message.items():
        if key == "header":
            changed[key] = value | {"stamp": ros_time(robot(value["stamp"]))}
        elif isinstance(value, list) and value and isinstance(value[0], dict) and "header" in value[0]:
            changed[key] = [with_ros_stamps(one, robot) for one in value]
    return changed


class SensorDriver(GraphDriver):
    """Listens, and drives nothing; see tfg_drake.hardware.device.Driver. It publishes what the explorer knows."""

    node = "tfg_drake_sensors"

    def __init__(
        self, graph: Graph, preset: Preset, topics: tuple[tuple[str, str | Topic], ...], base: bool = False
    ) -> None:
        """Waits until every topic is there and has sent a message; raises DeviceError.

        topics: (what for, topic), "tags" or "scan"; of one that is a name only, the graph has the type. preset: where
        the scanner and the camera are mounted, and the topic of the camera's calibration. base: the robot's base is on
        this graph, so its odometry tells the clock and how the robot moves, and somebody may say where that is.
        """
        super().__init__(graph, preset)
        self._senders: dict[str, Send | None] = {}
        # Held while publishing, and while leaving the graph.
        self._lock, self._left = threading.Lock(), False
        self.sources: dict[type, str] = {}
        needed = []
        for use, named in topics:
            (key, kind), topic = KEYS[use], named if isinstance(named, Topic) else self._named(use, named)
            self.sources[kind] = f"{use} of {topic.name}"
            needed.append((key, topic))
        if any(topic.type.startswith("apriltag") for _, topic in needed):
            if preset.topics.camera_info is None:
                raise DeviceError(f"{graph.label}: corners of tags say nothing without the preset's camera_info")
            needed.append(("camera_info", preset.topics.camera_info))
        needed += [("camera_info", _beside(topic)) for _, topic in needed if topic.type in (IMAGE, COMPRESSED_IMAGE)]
        if base:
            needed.append(("clock", preset.topics.odometry))
        for key, topic in needed:
            try:
                self._find(topic)
            except DeviceError as error:
                mend = "; or give --tags none" if key in ("detections", "camera_info") else ""
                raise DeviceError(f"{error}{mend}") from None
        said = [("initial_pose", preset.topics.initial_pose)] if base else []  # need not be published
        self._listen([*needed, *said])
        self._wait({topic.name for _, topic in needed})

    def _named(self, use: str, name: str) -> Topic:
        """The topic of this name, of the type that the graph has it with; raises DeviceError."""
        graph, known = self._graph, TYPES[KEYS[use][0]]
        types = self._types(name, graph.types, f"publishes {name}", known)
        if types is None:
            raise DeviceError(
                f"{graph.label}: what {name} is cannot be told, because rosapi does not answer: start it on the "
                "robot with `ros2 launch rosbridge_server rosbridge_websocket_launch.xml`"
            )
        if not (fitting := [kind for kind in types if kind in known]):
            raise DeviceError(
                f"{graph.label}: {name} is {types[0]}; {use} come as {' or '.join(known)}: name a topic of that type"
            )
        return Topic(name, fitting[0])

    def publish(self, key: str, message: dict[str, Any]) -> None:
        """Publishes a message on the preset's topic for it, its stamps brought to ROS time; the topic is advertised
        with its first one. One that cannot be is said once, then left out: the robot drives without it."""
        with self._lock:
            if self._left:
                return
            if key not in self._senders:
                self._senders[key] = self._sender(key)
            if (send := self._senders[key]) is not None:
                send(with_ros_stamps(message, self.clock.robot))

    def _sender(self, key: str) -> Send | None:
        kind, latched = PUBLISHED[key]
        topic = Topic(getattr(self._preset.publish, key), kind, "latched" if latched else "reliable")
        try:
            return self._graph.publisher(topic)
        except DeviceError as error:
            self.refusals.tell(f"{topic.name} is not published: {error}")
            return None

    def close(self) -> None:
        """Leaves the graph."""
        with self._lock:
            self._left = True
        super().close()


def _beside(image: Topic) -> Topic:
    """The camera_info of a topic of images, in the same namespace, as image_transport has it; raises DeviceError where
    there is nothing that sees."""
    imported(f"tags in images of {image.name}", "robotpy_apriltag", "camera")
    name = image.name.removesuffix("/compressed").rpartition("/")[0]
    return Topic(f"{name}/camera_info", TYPES["camera_info"][0])
