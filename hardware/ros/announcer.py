"""Publishes the explorer's messages on the topics of a preset, over either transport."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.ros.conversions import ros_time
from tfg_drake.hardware.ros.preset import PUBLISHED, Publish, Topic

Send = Callable[[dict[str, Any]], None]


class Announcer:
    """Publishes messages by their key in `publish`; a topic is advertised with its first message. Thread-safe."""

    def __init__(
        self, names: Publish, advertise: Callable[[Topic], Send], robot_clock: Callable[[float], float]
    ) -> None:
        """advertise: a topic, which may raise DeviceError. robot_clock: ROS time, s, at the host's time, s."""
        self._names, self._advertise, self._robot_clock = names, advertise, robot_clock
        self._senders: dict[str, Send | None] = {}
        self._remarks: list[str] = []
        self._lock = threading.Lock()
        self._closed = False

    def publish(self, key: str, message: dict[str, Any]) -> None:
        """Sends a message, its stamps brought to ROS time. A topic that cannot be advertised is said once, then left
        out: the robot drives without it."""
        with self._lock:
            if self._closed:
                return
            if key not in self._senders:
                self._senders[key] = self._sender(key)
            if (send := self._senders[key]) is not None:
                send(with_ros_stamps(message, self._robot_clock))

    def _sender(self, key: str) -> Send | None:
        kind, latched = PUBLISHED[key]
        topic = Topic(getattr(self._names, key), kind, "latched" if latched else "reliable")
        try:
            return self._advertise(topic)
        except DeviceError as error:
            self._remarks.append(f"{topic.name} is not published: {error}")
            return None

    def remarks(self) -> list[str]:
        """Lines for the operator since the last call."""
        with self._lock:
            remarks, self._remarks = self._remarks, []
        return remarks

    def close(self) -> None:
        """Sends nothing more, so that the graph may be left."""
        with self._lock:
            self._closed = True


def with_ros_stamps(message: dict[str, Any], robot: Callable[[float], float]) -> dict[str, Any]:
    """The message, its headers' stamps brought from the host's clock (s) to ROS time by robot(stamp), s."""
    changed = dict(message)
    for key, value in message.items():
        if key == "header":
            changed[key] = value | {"stamp": ros_time(robot(value["stamp"]))}
        elif isinstance(value, list) and value and isinstance(value[0], dict) and "header" in value[0]:
            changed[key] = [with_ros_stamps(one, robot) for one in value]
    return changed
