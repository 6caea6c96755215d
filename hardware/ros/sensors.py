"""Tags and scans of a ROS graph whose base is not ours to drive: topics only, their types as the graph has them."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.ros.graph_driver import Graph, GraphDriver
from tfg_drake.hardware.ros.intake import Intake, seen_instead
from tfg_drake.hardware.ros.preset import TYPES, Preset, Topic
from tfg_drake.hardware.watchdog import TICK, Limits

# How long to look for the topics, and for their first messages, s.
PATIENCE = 10.0
# By what a topic is wanted for: its key in a preset's `topics`.
KEYS = {"tags": "detections", "scan": "scan"}


class SearchableGraph(Graph, Protocol):
    """A transport, used by one thread; label is its name."""

    label: str

    def names(self) -> list[tuple[str, str]] | None:
        """(name, type) of every topic; None where that cannot be told."""

    def types(self, name: str) -> list[str] | None:
        """The types that a topic is published with; None where that cannot be told."""

    def subscribe(self, topic: Topic, receive: Callable[[Any, float], None]) -> None:
        """receive(message, arrival), by `spin`; arrival s of the host's clock."""


@dataclasses.dataclass(frozen=True)
class SensorConfig:
    """What the process is told. topics: (what for, name), "tags" or "scan". host: of rosbridge, None for ROS 2.

    preset: where the scanner and the camera are mounted, and the topic of the camera's calibration.
    """

    topics: tuple[tuple[str, str], ...]
    preset: Preset
    host: str | None = None
    port: int = 9090

    def open(self) -> SensorDriver:
        """The driver; raises DeviceError."""
        if self.host is None:
            from tfg_drake.hardware.ros.ros2 import Ros2Graph

            return SensorDriver(Ros2Graph(discovery=self.preset.discovery), self.topics, self.preset)
        from tfg_drake.hardware.ros.rosbridge import RosbridgeGraph

        return SensorDriver(RosbridgeGraph(self.host, self.port), self.topics, self.preset)


class SensorDriver(GraphDriver):
    """Listens, and drives nothing; see tfg_drake.hardware.device.Driver."""

    limits = Limits()

    _graph: SearchableGraph

    def __init__(self, graph: SearchableGraph, topics: tuple[tuple[str, str], ...], preset: Preset) -> None:
        """Waits until every topic is there and has sent a message; raises DeviceError."""
        self._graph = graph
        try:
            found = [self._find(use, name) for use, name in topics]
            if any(topic.type.startswith("apriltag") for _, topic in found):
                if preset.topics.camera_info is None:
                    raise DeviceError(f"{graph.label}: corners of tags say nothing without the preset's camera_info")
                found.append(("camera_info", preset.topics.camera_info))
            self._intake = Intake(preset, found)
            for key, topic in found:
                graph.subscribe(topic, partial(self._intake.receive, key, topic))
            self._wait({topic.name for _, topic in found})
        except DeviceError:
            self.close()
            raise

    def _find(self, use: str, name: str) -> tuple[str, Topic]:
        graph, known = self._graph, TYPES[KEYS[use]]
        end = time.monotonic() + PATIENCE
        while not (types := graph.types(name)):
            if types is None:
                raise DeviceError(
                    f"{graph.label}: what {name} is cannot be told, because rosapi does not answer: start it on the "
                    "robot with `ros2 launch rosbridge_server rosbridge_websocket_launch.xml`"
                )
            if time.monotonic() > end:
                raise DeviceError(f"{graph.label}: nobody publishes {name}; {self._instead(name, known)}")
            graph.spin(10 * TICK)
        if not (fitting := [kind for kind in types if kind in known]):
            raise DeviceError(
                f"{graph.label}: {name} is {types[0]}; {use} come as {' or '.join(known)}: name a topic of that type"
            )
        return KEYS[use], Topic(name, fitting[0])

    def _instead(self, name: str, known: tuple[str, ...]) -> str:
        return seen_instead(known, self._graph.names() or [], {name})

    def _wait(self, names: set[str]) -> None:
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and not (self._intake.clock.ready and names <= self._intake.arrived):
            self._graph.spin(TICK)
        if silent := sorted(names - self._intake.arrived):
            raise DeviceError(f"{self._graph.label}: nothing arrives on {silent[0]} in {PATIENCE:.0f} s: start it")
        if not self._intake.clock.ready:
            raise DeviceError(f"{self._graph.label}: too little arrives in {PATIENCE:.0f} s: it needs 2 Hz or more")
        if line := self._intake.clock.skew():
            raise DeviceError(f"{self._graph.label}: {line}")

    def send(self, speed: float, turn_rate: float) -> None:
        """There is nothing to drive."""

    def show(self, enabled: bool) -> None:
        """A sensor has nothing to show."""
