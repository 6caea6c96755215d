"""Shared part of the drivers on a ROS graph, by any transport; see tfg_drake.hardware.device.Driver."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from tfg_drake.hardware.device import DeviceError, Driver, Message
from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.intake import Intake
from tfg_drake.hardware.ros.preset import Preset, Topic
from tfg_drake.hardware.ros.stamps import SILENCE
from tfg_drake.hardware.watchdog import TICK
from tfg_drake.messages import Hazards, Odometry

# How long to look for the topics, and for their first messages, s.
PATIENCE = 10.0


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


class GraphDriver(Driver):
    """Takes in what a graph has to say; a subclass says what of it."""

    _intake: Intake

    def __init__(self, graph: Graph, preset: Preset) -> None:
        """preset: of the robot that the graph is about, or whose mounts hold."""
        self._graph, self._preset = graph, preset

    def _find(self, topic: Topic, listened: bool = False) -> None:
        """Waits until somebody publishes a topic, or listens to it, as the preset has it; raises DeviceError."""
        graph = self._graph
        verb, ask = ("listens to", graph.listeners) if listened else ("publishes", graph.types)
        end = time.monotonic() + PATIENCE
        while not (types := ask(topic.name)):
            if types is None:
                return  # it will show when nothing arrives
            if time.monotonic() > end:
                instead = self._instead((topic.type,), topic.name)
                raise DeviceError(f"{graph.label}: nobody {verb} {topic.name} ({topic.type}); {instead}")
            graph.spin(10.0 * TICK)
        if topic.type not in types:
            raise DeviceError(f"{graph.label}: {topic.name} is {types[0]}, the preset has {topic.type}: set its type")
        if topic.qos == "reliable" and not listened and graph.best_effort(topic.name):
            raise DeviceError(
                f"{graph.label}: {topic.name} is published best effort, the preset has reliable: set its qos to "
                "sensor_data"
            )

    def _instead(self, kinds: tuple[str, ...], name: str) -> str:
        """Topics to name to who asked for one, `name`, that is not there: of its kinds if there are some."""
        ours = {name, self._preset.topics.command.name, "/rosout", "/parameter_events"}
        others = [(other, kind) for other, kind in self._graph.names() or [] if other not in ours]
        alike = [other for other, kind in others if kind in kinds]
        seen = (alike or [other for other, _ in others])[:5]
        return f"seen instead: {', '.join(seen) or 'no other topic (check ROS_DOMAIN_ID and the network)'}"

    def _listen(self, topics: list[tuple[str, Topic]]) -> None:
        """Takes in topics by their key, see Intake."""
        self._intake = Intake(self._preset, topics)
        for key, topic in topics:
            self._graph.subscribe(topic, partial(self._intake.receive, key, topic))

    def _wait(self, names: set[str]) -> None:
        """Waits until every topic of these names has sent a message, and the clock is learned; raises DeviceError."""
        intake, label = self._intake, self._graph.label
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and not (intake.clock.ready and names <= intake.arrived):
            self.spin(TICK)
        if silent := sorted(names - intake.arrived):
            raise DeviceError(f"{label}: nothing arrives on {silent[0]} in {PATIENCE:.0f} s: start its driver")
        if not intake.clock.ready:
            slow = f"{intake.clock_source} falls silent for more than {SILENCE} s at times"
            if intake.clock_source is None:
                slow = f"too little arrives in {PATIENCE:.0f} s: it needs 2 Hz or more"
            raise DeviceError(f"{label}: {slow}")
        if line := intake.clock.skew():
            raise DeviceError(f"{label}: {line}")

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""
        self._graph.spin(duration)

    def take(self) -> list[Message]:
        """The messages since the last call."""
        return self._intake.take()

    def fault(self) -> str | None:
        """Why the robot must stop until it is enabled anew, once; None when all is well."""
        return self._intake.fault()

    def remarks(self) -> list[str]:
        """Lines for the operator since the last call."""
        return self._intake.remarks()

    def close(self) -> None:
        """Leaves the graph."""
        self._graph.close()


class GraphBaseDriver(GraphDriver):
    """Drives a base by a preset's command and listens to its odometry, alarms and battery, and to nothing else: its
    process is the watchdog's, too."""

    def __init__(self, graph: Graph, preset: Preset) -> None:
        """Waits until odometry arrives; raises DeviceError."""
        super().__init__(graph, preset)
        self.limits = preset.limits
        topics, command = preset.topics, preset.topics.command
        alarms = ", ".join(topic.name for topic in topics.hazards)
        self.sources = {Odometry: f"odometry of {topics.odometry.name}", Hazards: f"alarms of {alarms}"}
        # It may be missing: a robot of the same kind whose battery nobody publishes can be driven all the same.
        battery = [("battery", topics.battery)] if topics.battery is not None else []
        try:
            heard = [("odometry", topics.odometry), *(("hazards", topic) for topic in topics.hazards)]
            for _, topic in heard:
                graph.require(topic)
            for _, topic in heard:
                self._find(topic)
            self._find(command, listened=True)
            self._listen([*heard, *battery])
            self._send = graph.publisher(command)
            self._wait({topics.odometry.name})
        except DeviceError:
            self.close()
            raise

    def fault(self) -> str | None:
        """Why the robot must stop until it is enabled anew, once, or as long as its battery says so."""
        return super().fault() or self._intake.alarm

    def send(self, speed: float, turn_rate: float) -> None:
        """Publishes a velocity, m/s and rad/s."""
        kind, now = self._preset.topics.command.type, self._intake.clock.robot(time.monotonic())
        self._send(conversions.velocity(kind, speed, turn_rate, now, self._preset.frames.base))
