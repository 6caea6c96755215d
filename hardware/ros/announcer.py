"""What the explorer knows, on the topics of a preset: what both transports do before they send it."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import Any

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.ros.conversions import ros_time
from tfg_drake.hardware.ros.preset import PUBLISHED, Publish, Topic

_log = logging.getLogger(__name__)

Send = Callable[[dict[str, Any]], None]


class Announcer:
    """Publishes messages by their key in `publish`; a topic is advertised with its first message.

    It does so in a thread of its own, because the watchdog must not wait until a large map is put into its message. Of
    what is said faster than it can be sent the newest is sent.
    """

    def __init__(
        self, names: Publish, advertise: Callable[[Topic], Send], robot_clock: Callable[[float], float]
    ) -> None:
        """advertise: a topic, which may raise DeviceError. robot_clock: ROS time, s, at the host's time, s."""
        self._names, self._advertise, self._robot_clock = names, advertise, robot_clock
        self._senders: dict[str, Send | None] = {}
        self._changed = threading.Condition()
        self._waiting: dict[str, dict[str, Any]] = {}
        self._closed = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def publish(self, key: str, message: dict[str, Any]) -> None:
        """Has a message sent, its stamps brought to ROS time. A topic that cannot be advertised is said once, then left
        out: the robot drives without it."""
        with self._changed:
            self._waiting[key] = message
            self._changed.notify()

    def close(self) -> None:
        """Sends nothing more."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed)
                waiting, self._waiting = self._waiting, {}
            for key, message in waiting.items():
                if self._closed:
                    return
                self._send(key, message)
            if self._closed:
                return

    def _send(self, key: str, message: dict[str, Any]) -> None:
        if key not in self._senders:
            kind, latched = PUBLISHED[key]
            topic = Topic(getattr(self._names, key), kind, "latched" if latched else "reliable")
            try:
                self._senders[key] = self._advertise(topic)
            except DeviceError as error:
                self._senders[key] = None
                _log.warning("%s is not published: %s", topic.name, error)
        if (send := self._senders[key]) is not None:
            send(with_ros_stamps(message, self._robot_clock))


def with_ros_stamps(message: dict[str, Any], robot: Callable[[float], float]) -> dict[str, Any]:
    """The message, its headers' stamps brought from the host's clock (s) to ROS time by robot(stamp), s."""
    changed = dict(message)
    for key, value in message.items():
        if key == "header":
            changed[key] = value | {"stamp": ros_time(robot(value["stamp"]))}
        elif isinstance(value, list) and value and isinstance(value[0], dict) and "header" in value[0]:
            changed[key] = [with_ros_stamps(one, robot) for one in value]
    return changed
