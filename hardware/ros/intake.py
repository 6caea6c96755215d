"""Stamps and converts the messages that either transport receives.

ROS stamps serve for order and age only. The offset of the robot's ROS clock to the host's monotonic clock is the least
arrival minus stamp of recent odometry messages (the least delayed ones; recent, as clocks drift apart). Without
odometry it is that of the sensors: their stamps are then late by the least delay of any of them.
"""

from __future__ import annotations

import math
import re
import time
from typing import TYPE_CHECKING, Any

import numpy as np

from tfg_drake.hardware.camera_sensor import tell
from tfg_drake.hardware.device import Inbox, Message
from tfg_drake.hardware.plausible import AHEAD
from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.preset import COMPRESSED_IMAGE, IMAGE, Preset, Topic
from tfg_drake.hardware.sensor_reader import OLDEST, SILENT
from tfg_drake.hardware.watchdog import SILENCE
from tfg_drake.messages import Hazards, Odometry
from tfg_drake.slam.odometry_rules import WatchedOdometry, watch
from tfg_drake.vision.calibration import CameraCalibration

if TYPE_CHECKING:
    from tfg_drake.hardware.ros.images import ImageTags


# Duration of odometry, s, from which the clock offset is estimated before any message is passed on.
LEARN = SILENCE
# The clock offset is the least delay over the last SPAN to 2 SPAN, s; it changes by at most SLEW, s/s, so that stamps
# keep their order.
SPAN = 10.0
SLEW = 1e-3
# Greatest difference MAX_SKEW of the robot's clock from the host's, s; an image may be OLDEST old on arrival. A stamp
# more than JUMP, s, in the future, or before the previous one, is a jump of the clock.
JUMP = MAX_SKEW = AHEAD


class ClockJump(Exception):
    """The robot's clock was set, or a topic's is another one."""


class StampClock:
    """Brings ROS stamps to the host's monotonic clock."""

    def __init__(self, source: str | None = None) -> None:
        """source: the topic to estimate the offset from, whose messages arrive at once; None to estimate it from all
        topics, which may be slow."""
        self.source, self._offset = source, 0.0
        # Longest silence, s, after which a connection is new and the offset is estimated again.
        self._silence = SILENT if source is None else SILENCE
        self._reset()

    def _reset(self) -> None:
        self._least: dict[str, float] = {}
        self._last: dict[str, float] = {}
        self._began = self._heard = self._span_began = math.nan
        self._span = self._span_before = math.inf

    @property
    def ready(self) -> bool:
        """True if it is learned."""
        return self._heard - self._began >= LEARN

    def _learn(self, stamp: float, arrival: float) -> None:
        dt, delay = arrival - self._heard, arrival - stamp
        if not dt <= self._silence:  # also before the first message, when dt is nan
            self._reset()
            self._began = self._span_began = arrival
        if arrival - self._span_began > SPAN:
            self._span_began, self._span_before, self._span = arrival, self._span, math.inf
        self._span = min(self._span, delay)
        least = min(self._span, self._span_before)
        if not self.ready:
            self._offset = least
        elif delay > self._offset - JUMP:
            self._offset += min(SLEW * dt, max(-SLEW * dt, least - self._offset))
        self._heard = arrival

    def host(self, topic: str, stamp: float, arrival: float) -> float | None:
        """The host's time, s, of a stamp that arrived at `arrival`; None where the clock is not learned yet, or the
        message is late: not newer than the one before it. Raises ClockJump, and starts to learn anew."""
        if self.source in (None, topic):
            self._learn(stamp, arrival)
        self._least[topic] = min(self._least.get(topic, math.inf), arrival - stamp)
        last = self._last.get(topic, -math.inf)
        if self.ready and (stamp < last - JUMP or stamp + self._offset > arrival + JUMP):
            self._reset()
            raise ClockJump(f"the clock of {topic} has jumped")
        self._last[topic] = max(last, stamp)
        return stamp + self._offset if self.ready and stamp > last else None

    def robot(self, now: float) -> float:
        """The ROS time, s, at the host's time `now`, as last learned."""
        return now - self._offset

    def skew(self) -> str | None:
        """Why the clocks differ too much to begin, in one line; None when they agree."""
        wall = time.time() - time.monotonic()
        for topic, least in self._least.items():
            behind = wall + least
            allowed = MAX_SKEW if behind < 0.0 or topic == self.source else OLDEST
            if abs(behind) > allowed:
                side = "behind" if behind > 0.0 else "ahead of"
                return (
                    f"{topic} is stamped {abs(behind):.2f} s {side} this computer's clock ({allowed} s are allowed); "
                    "synchronise both, with chrony for example"
                )
        return None


class Intake(Inbox):
    """Converts ROS messages of either transport; one thread may use it.

    clock: learned from the odometry, from all topics where there is none.
    """

    def __init__(self, preset: Preset, topics: list[tuple[str, Topic]] | None = None) -> None:
        """topics: see expect."""
        super().__init__()
        self._preset = preset
        self._V_B = np.zeros(2)
        self._watched = WatchedOdometry()
        self._hazards = Hazards(-math.inf, 0, 0, 0)
        # The newest camera_info, and the calibration that apriltag_msgs need.
        self._camera_info: Any = None
        self._camera: CameraCalibration | None = None
        # The tag detector for images.
        self._eyes: ImageTags | None = None
        self._families: list[str] = []
        self.arrived: set[str] = set()
        self.expect(topics or [])

    def expect(self, topics: list[tuple[str, Topic]]) -> None:
        """Topics that are to be received: of a base "odometry", "hazards" and "battery", of sensors "scan",
        "detections", "camera_info" and "initial_pose". Sensors' clock and the robot's velocity are learned from the
        odometry where they have "clock", else the clock from them all."""
        self.clock = StampClock(next((topic.name for key, topic in topics if key in ("odometry", "clock")), None))
        # Tags are detected in images.
        self._images = any(topic.type in (IMAGE, COMPRESSED_IMAGE) for _, topic in topics)

    def receive(self, key: str, topic: Topic, message: Any, arrival: float) -> None:
        """Takes a message in that arrived at `arrival` (host's monotonic clock, s). One that cannot be used is refused,
        whatever it holds."""
        self.arrived.add(topic.name)
        try:
            with np.errstate(all="ignore"):
                self._take_in(key, topic, message, arrival)
        except ClockJump as jump:
            if key in ("odometry", "hazards"):
                self._fault = str(jump)
            else:
                self.refusals.add(topic.name, "clock", f"{jump}; the clock is learned anew")
        except Exception as error:  # no message may end the driver of a robot
            self.refusals.add(topic.name, _kind(error), f"messages are not used: {error}")

    def _take_in(self, key: str, topic: Topic, message: Any, arrival: float) -> None:
        if key == "camera_info":
            self._camera_info = message
            self._camera = None if self._images else conversions.calibration(message)
        elif key == "battery":
            # Stamped with its arrival; its own stamp is not used.
            self._messages.append(conversions.battery(message, arrival))
        elif key == "initial_pose":
            self._messages.append(conversions.said_pose(message, arrival, self._preset.frames.map))
        elif key == "detections" and not topic.type.endswith("PointCloud2") and self._camera_info is None:
            pass  # not usable before the calibration, which comes with the camera's first image
        elif (stamp := self._host_stamp(key, topic, message, arrival)) is None:
            pass
        elif key == "clock":
            self._V_B = conversions.odometry(message, stamp).V_B
        elif (converted := self._convert(key, topic, message, stamp)) is not None:
            self._messages.append(converted)

    def _host_stamp(self, key: str, topic: Topic, message: Any, arrival: float) -> float | None:
        stamp = conversions.ros_stamp(message)
        if stamp is None:
            # An alarm without a stamp counts as of now; it comes once and must not be lost.
            return arrival if self.clock.ready or key == "hazards" else None
        return self.clock.host(topic.name, stamp, arrival)

    def _convert(self, key: str, topic: Topic, message: Any, stamp: float) -> Message | None:
        if key == "odometry":
            if self._watched.told is None:
                self._check_frame(topic, message)
            return self._continued(topic, conversions.odometry(message, stamp, self._watched.told))
        if key == "scan":
            return conversions.laser_scan(message, stamp, self._preset.scanner, self._V_B)
        if key == "hazards":
            self._hazards = conversions.hazards(topic.type, message, stamp, self._hazards)
            return self._hazards
        if topic.type == "sensor_msgs/msg/PointCloud2":
            return conversions.plain_detections(message, stamp)
        if self._images:
            return self._looked_at(topic, message, stamp)
        assert self._camera is not None
        self._families = sorted({*self._families, *conversions.families(message)})[:2]
        if len(self._families) > 1:
            why = f"tags are of {' and '.join(self._families)}: one id of both would be one tag; print all of one"
            self.refusals.add(topic.name, "family", why)
        return conversions.apriltag_detections(message, self._camera, stamp, self._preset.camera)

    def _looked_at(self, topic: Topic, message: Any, stamp: float) -> Message:
        if self._eyes is None:
            from tfg_drake.hardware.ros.images import ImageTags  # which needs OpenCV

            self._eyes = ImageTags(topic.type, topic.name, self._preset.camera)
        seen = self._eyes.sighting(message, self._camera_info, stamp)
        tell(self.refusals, topic.name, seen.remarks)
        return seen.detections

    def _continued(self, topic: Topic, told: Odometry) -> Odometry | None:
        """Return the odometry, continued from the last pose if the base has restarted its count."""
        self._watched, believed, note = watch(self._watched, told)
        if note is not None and note.kind == "jump":
            self._fault = f"{topic.name} was reset, its base was started anew; see that the robot stands where it was"
        return told if note is not None and note.kind == "speed" else believed  # such speeds are refused elsewhere

    def _check_frame(self, topic: Topic, message: Any) -> None:
        """Remarks on odometry in another frame than the preset's: our map -> odom would join nothing."""
        frame, expected = str(conversions.field(message, "header.frame_id")), self._preset.frames.odom
        if frame.lstrip("/") != expected:
            self.refusals.tell(
                f"{topic.name} is in the frame {frame[:100]}, the preset has {expected}: set its frames.odom"
            )


def _kind(error: Exception) -> str:
    """Return the kind of an error: its words without the parts that differ from message to message."""
    return re.sub(r"[^a-z_ ]+", "", str(error).partition(":")[0].partition("'")[0])
