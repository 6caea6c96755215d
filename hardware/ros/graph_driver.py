"""What every driver on a ROS graph does alike, by whatever transport; see tfg_drake.hardware.device.Driver."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

from tfg_drake.hardware.device import Message
from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.announcer import Announcer
from tfg_drake.hardware.ros.intake import Intake
from tfg_drake.hardware.ros.preset import Preset


class Graph(Protocol):
    """A connection to a ROS graph, such as Ros2Graph or RosbridgeGraph."""

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""

    def close(self) -> None:
        """Leaves the graph."""


class GraphDriver:
    """Takes in what a graph has to say; a subclass connects it."""

    _graph: Graph
    _intake: Intake

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""
        self._graph.spin(duration)

    def take(self) -> list[Message]:
        """The messages since the last call."""
        return self._intake.take()

    def fault(self) -> str | None:
        """Why the robot must stop until it is enabled anew, once; None when all is well."""
        return self._intake.fault()

    def close(self) -> None:
        """Leaves the graph."""
        self._graph.close()


class GraphBaseDriver(GraphDriver):
    """Drives a base on a graph, and publishes what the explorer knows; a subclass connects it."""

    _preset: Preset
    _announcer: Announcer
    _send: Callable[[dict[str, Any]], None]

    def send(self, speed: float, turn_rate: float) -> None:
        """Publishes a velocity, m/s and rad/s."""
        kind, now = self._preset.topics.command.type, self._intake.clock.robot(time.monotonic())
        self._send(conversions.velocity(kind, speed, turn_rate, now, self._preset.frames.base))

    def publish(self, key: str, message: dict[str, Any]) -> None:
        """Publishes a message on the preset's topic for it."""
        self._announcer.publish(key, message)

    def show(self, enabled: bool) -> None:
        """These robots have nothing to show it with."""

    def close(self) -> None:
        """Leaves the graph."""
        self._announcer.close()
        super().close()
