"""What both transports do with what they receive: stamps and conversion."""

from __future__ import annotations

import logging
import math
from typing import Any

import numpy as np

from tfg_drake.geometry.se2 import compose, inverse
from tfg_drake.hardware.device import Message
from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.preset import Preset, Topic
from tfg_drake.hardware.ros.stamps import SENSOR_SILENCE, ClockJump, StampClock
from tfg_drake.messages import Hazards, Odometry, replace

_log = logging.getLogger(__name__)

# No base drives faster, m/s, and none leaps so far, m, between two messages: its odometry was reset.
FASTEST, LEAP = 1.5, 0.5


class Intake:
    """Converts ROS messages of either transport; one thread may use it."""

    def __init__(self, preset: Preset, sensors: list[tuple[str, Topic]] | None = None) -> None:
        """sensors: topics by key, "scan", "detections" or "camera_info", of a robot whose base is elsewhere: the clock
        is learned from them all, there being no odometry. None for all of the preset's."""
        self.clock = StampClock() if sensors is None else StampClock(SENSOR_SILENCE)
        self._preset, self._sensors = preset, sensors
        self._messages: list[Message] = []
        # The newest odometry, as it is passed on and as it was told, in frames O and R.
        self._odometry: Odometry | None = None
        self._odometry_told: Odometry | None = None
        self._X_OR = np.zeros(3)
        self._hazards = Hazards(-math.inf, 0, 0, 0)
        self._camera_info: Any = None
        self._fault: str | None = None
        self._refused: set[str] = set()
        self.arrived: set[str] = set()

    def topics(self) -> list[tuple[str, Topic]]:
        """What to subscribe to: (key for `receive`, topic)."""
        if self._sensors is not None:
            return self._sensors
        topics = self._preset.topics
        one_each = [(key, getattr(topics, key)) for key in ("odometry", "scan", "detections", "camera_info")]
        return [(key, t) for key, t in one_each if t is not None] + [("hazards", topic) for topic in topics.hazards]

    def receive(self, key: str, topic: Topic, message: Any, arrival: float) -> None:
        """Takes a message in that arrived at `arrival` (host's monotonic clock, s)."""
        self.arrived.add(topic.name)
        if key == "camera_info":
            self._camera_info = message
            return
        try:
            if (stamp := self._host_stamp(key, topic, message, arrival)) is not None:
                self._messages.append(self._convert(key, topic, message, stamp))
        except ClockJump as jump:
            self._fault = str(jump)
        except (ValueError, TypeError, LookupError) as error:
            if topic.name not in self._refused:
                _log.warning("%s: messages are not used: %s", topic.name, error)
            self._refused.add(topic.name)

    def _host_stamp(self, key: str, topic: Topic, message: Any, arrival: float) -> float | None:
        stamp = conversions.ros_stamp(message)
        if key == "odometry" and stamp is not None:
            return self.clock.odometry(topic.name, stamp, arrival)
        if self._sensors is not None and stamp is not None:
            return self.clock.learn(topic.name, stamp, arrival)
        if stamp is None:
            # An alarm without a stamp is of now, and comes once: it must not be lost.
            return arrival if self.clock.ready or key == "hazards" else None
        return self.clock.host(topic.name, stamp, arrival)

    def _convert(self, key: str, topic: Topic, message: Any, stamp: float) -> Message:
        if key == "odometry":
            if self._odometry is None:
                self._check_frame(topic, message)
            return self._continued(topic, conversions.odometry(message, stamp, self._odometry_told))
        if key == "scan":
            V_B = np.zeros(2) if self._odometry is None else self._odometry.V_B
            return conversions.laser_scan(message, stamp, self._preset.scanner, V_B)
        if key == "hazards":
            self._hazards = conversions.hazards(topic.type, message, stamp, self._hazards)
            return self._hazards
        if topic.type == "sensor_msgs/msg/PointCloud2":
            return conversions.plain_detections(message, stamp)
        if self._camera_info is None:
            raise ValueError("no camera_info yet")
        return conversions.apriltag_detections(message, self._camera_info, stamp, self._preset.camera)

    def _continued(self, topic: Topic, told: Odometry) -> Odometry:
        """The odometry, going on where it was when the base has begun to count anew."""
        before = self._odometry
        if before is not None and self._odometry_told is not None:
            reach = FASTEST * max(0.0, told.stamp - before.stamp) + LEAP
            if np.hypot(*(told.X_OB[:2] - self._odometry_told.X_OB[:2])) > reach:
                self._fault = (
                    f"{topic.name} was reset, its base was started anew; see that the robot stands where it was"
                )
                self._X_OR = compose(before.X_OB, inverse(told.X_OB))
        self._odometry_told = told
        self._odometry = replace(told, X_OB=compose(self._X_OR, told.X_OB))
        return self._odometry

    def _check_frame(self, topic: Topic, message: Any) -> None:
        """Where the odometry is in another frame than the preset says, our map -> odom would join nothing."""
        frame, expected = str(conversions.field(message, "header.frame_id")), self._preset.frames.odom
        if frame.lstrip("/") != expected:
            _log.warning("%s is in the frame %s, the preset has %s: set its frames.odom", topic.name, frame, expected)

    def take(self) -> list[Message]:
        """The messages since the last call."""
        taken, self._messages = self._messages, []
        return taken

    def fault(self) -> str | None:
        """Why the robot must stop, once."""
        fault, self._fault = self._fault, None
        return fault

    def nobody(self, topic: Topic, graph: list[tuple[str, str]], verb: str) -> str:
        """The complaint that a topic has no other end: nobody "publishes" or "listens to" it.

        graph: (name, type) of every topic there is.
        """
        ours = {one.name for _, one in self.topics()} | {self._preset.topics.command.name}
        return f"nobody {verb} {topic.name} ({topic.type}); {seen_instead((topic.type,), graph, ours)}"


def seen_instead(kinds: tuple[str, ...], graph: list[tuple[str, str]], ours: set[str]) -> str:
    """Topics of a graph (name, type) to name to who asked for one that is not there: of its kinds if there are some.

    ours: names that are there only because we asked for them.
    """
    others = [(name, kind) for name, kind in graph if name not in ours | {"/rosout", "/parameter_events"}]
    alike = [name for name, kind in others if kind in kinds]
    seen = (alike or [name for name, _ in others])[:5]
    return f"seen instead: {', '.join(seen) or 'no other topic (check ROS_DOMAIN_ID and the network)'}"


def mistyped(topic: Topic, types: list[str]) -> str | None:
    """The complaint that the graph has the topic, but with other types only; None when it has it not, or rightly."""
    if not types or topic.type in types:
        return None
    return f"{topic.name} is {types[0]}, the preset has {topic.type}: set its type"
