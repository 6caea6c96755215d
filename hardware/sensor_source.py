"""Sources of tags and scans: ROS, a socket, or a camera and a scanner of this machine's own.

Each connection has a process of its own: GTSAM holds the interpreter for seconds, and meanwhile no message may be lost
and no sender kept waiting; and the parsing of large messages must not share a process with the base's watchdog.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import threading
import urllib.parse
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeVar

import numpy as np

from tfg_drake.config import HardwareConfig
from tfg_drake.geometry.sweep import Sweep, scan_of
from tfg_drake.hardware.camera_sensor import CameraDriver
from tfg_drake.hardware.device import ANSWER_TIMEOUT, Device, DeviceError, OpenDriver
from tfg_drake.hardware.realsense_sensor import RealsenseDriver
from tfg_drake.hardware.ros.graph_driver import KEYS, SensorDriver, opened
from tfg_drake.hardware.ros.preset import Preset, Topic
from tfg_drake.hardware.rplidar.driver import RplidarDriver
from tfg_drake.hardware.sensor_reader import delays
from tfg_drake.hardware.socket_sensors import SocketDriver
from tfg_drake.messages import LaserScan, Odometry, TagDetections

T = TypeVar("T", LaserScan, Sweep, TagDetections)
# A process is polled every _LOOK_EVERY, s; it hangs after more than _SILENT_LOOKS silent polls: ten seconds.
_LOOK_EVERY, _SILENT_LOOKS = 0.1, 100
_FORMS = "ros2:/TOPIC, rosbridge:HOST:PORT/TOPIC, socket:HOST:PORT, camera:SOURCE, rplidar:DEVICE or realsense:"
# OWN: sensors connected to this machine, with the messages of each. _OWN_FORMS: how their sources are written.
OWN = {"camera": "tags", "rplidar": "scan", "realsense": "scan"}
_OWN_FORMS = {
    "camera": "camera:/dev/video0, camera:http://HOST/STREAM or camera:FILE",
    "rplidar": "rplidar:/dev/ttyUSB0",
}


class Source(Protocol):
    """Source of messages, such as a SensorSource."""

    def take(self, kind: type[T], until: float) -> list[T]:
        """Return the messages of a kind with stamps up to `until` (s of the host's monotonic clock), not taken yet."""


class CamerasSource:
    """Tags of several cameras as those of one: in order, one message a call, as its reader takes one at a time. If more
    arrive than are taken, the oldest are dropped, of all cameras alike."""

    def __init__(self, cameras: Sequence[Source]) -> None:
        self._cameras = cameras
        self._waiting: list[TagDetections] = []
        self._given = -math.inf

    def take(self, kind: type[Any], until: float) -> list[Any]:
        """Return the oldest message with a stamp up to `until` (s) that was not taken yet, if there is one."""
        arrived = [one for camera in self._cameras for one in camera.take(TagDetections, until)]
        # A message older than the last one given, delayed by its camera, is dropped.
        waiting = [one for one in (*self._waiting, *arrived) if one.stamp > self._given]
        waiting.sort(key=lambda one: one.stamp)
        self._waiting = waiting[-len(self._cameras) :]
        if not self._waiting:
            return []
        oldest = self._waiting.pop(0)
        self._given = oldest.stamp
        return [oldest]


class SweepSource:
    """Scans of a rotating scanner on a moving robot: its sweeps, corrected for the motion by the robot's odometry."""

    def __init__(self, sweeps: Source, odometry: Callable[[float], Odometry | None]) -> None:
        """odometry: returns the message nearest to a time, s, or None."""
        self._sweeps, self._odometry = sweeps, odometry

    def take(self, kind: type[Any], until: float) -> list[Any]:
        """Return the scans with stamps up to `until` (s) that were not taken yet, in order."""
        scans = []
        for sweep in self._sweeps.take(Sweep, until):
            odometry = self._odometry(sweep.stamp)
            scans.append(scan_of(sweep, np.zeros(2) if odometry is None else odometry.V_B))
        return scans


@dataclasses.dataclass(frozen=True)
class SourceSpec:
    """Sensor address. transport: "ros2", "rosbridge", "socket" or one of OWN. topic: on ROS. device: of OWN."""

    transport: str
    host: str = ""
    port: int = 0
    topic: str = ""
    device: str = ""

    def __str__(self) -> str:
        if self.transport in OWN:
            return f"{self.transport}:{self.device}"
        if self.transport == "ros2":
            return f"ros2:{self.topic}" if self.topic else "ros2"
        return f"{self.transport}:{self.host}:{self.port}{self.topic}"


def parse_source(text: str) -> SourceSpec:
    """Parse `ros2:/TOPIC`, `rosbridge:HOST:PORT/TOPIC`, `socket:HOST:PORT` or, for a sensor on this machine, its kind
    and device. Raises DeviceError.

    Of rosbridge the port (9090) and the host (localhost) may be left out: `rosbridge:HOST/TOPIC`, `rosbridge:/TOPIC`.
    """
    transport, colon, rest = text.partition(":")
    if transport in OWN and colon:
        if not rest and transport in _OWN_FORMS:
            raise DeviceError(f"{text}: names no device; name the source as {_OWN_FORMS[transport]}")
        return SourceSpec(transport, device=rest)
    if transport not in ("ros2", "rosbridge", "socket") or not rest:
        raise DeviceError(f"{text}: is no source; name one as {_FORMS}")
    if transport == "ros2":
        return SourceSpec(transport, topic=_topic(text, rest if rest.startswith("/") else f"/{rest}"))
    address, slash, topic = rest.partition("/")
    try:
        url = urllib.parse.urlsplit(f"//{address}")
        host, port = url.hostname or "", url.port
    except ValueError:
        raise DeviceError(f"{text}: {address} is no HOST:PORT; name the source as {_FORMS}") from None
    if transport == "rosbridge":
        usual = urllib.parse.urlsplit(f"//{HardwareConfig().bridge}")
        return SourceSpec(transport, host or usual.hostname or "", port or usual.port or 0, _topic(text, slash + topic))
    if not host or not port or slash:
        raise DeviceError(f"{text}: {rest} is no HOST:PORT; name the source as socket:HOST:PORT")
    return SourceSpec(transport, host, port)


def _topic(text: str, topic: str) -> str:
    if len(topic) < 2 or any(character.isspace() for character in topic):
        raise DeviceError(f"{text}: names no topic; name the source as {_FORMS}")
    return topic


class SensorSource(Device):
    """Tags or scans, or both, of one connection. Stamps are the host's monotonic clock, s.

    Its process is started again if it ends or hangs; meanwhile nothing arrives.
    """

    def __init__(self, name: str, open_driver: OpenDriver) -> None:
        """Wait until the wanted messages arrive. name: of the connection, in remarks. Raises DeviceError."""
        super().__init__(open_driver)
        self._name = name
        self._published: dict[str, dict[str, Any]] = {}
        self._closed = threading.Event()
        self._keeper = threading.Thread(target=self._keep, daemon=True)
        self._keeper.start()

    def publish(self, key: str, message: dict[str, Any]) -> None:
        """Publishes a message by its key in the preset's `publish`."""
        self._published[key] = message
        super().publish(key, message)

    def close(self) -> None:
        """End the connection; once is enough."""
        self._closed.set()
        # A process that is being started may take long to report a missing device; it is ended all the same.
        self._keeper.join(ANSWER_TIMEOUT)
        super().close()

    def _keep(self) -> None:
        """Start the process again if it ends or hangs, until `close`."""
        heard, silent = -1, 0
        while not self._closed.wait(_LOOK_EVERY):
            # Polls are counted, not seconds: if this thread is held up, so may be the one that reads the messages.
            heard, silent = self.heard, silent + 1 if self.heard == heard else 0
            if self.ended is not None or silent > _SILENT_LOOKS:
                self._remark("has ended" if self.ended is not None else "hangs", "; it is started again")
                self._start_again()
                heard, silent = -1, 0

    def _start_again(self) -> None:
        super().close()
        told = ""
        for delay in delays():
            if self._closed.wait(delay):
                return
            try:
                self._open()
            except DeviceError as error:
                if str(error) != told:
                    self._remark("does not begin", f": {error}")
                told = str(error)
                continue
            for key, message in self._published.copy().items():
                super().publish(key, message)
            self._remark("is back", "")
            return

    def _remark(self, what: str, more: str) -> None:
        with self._changed:
            self._remarks.append(f"the process that reads {self._name} {what}{more}")


def open_sources(
    specs: Mapping[str, str], preset: Preset, base: SourceSpec | None = None, hardware: HardwareConfig | None = None
) -> dict[str, SensorSource]:
    """Open the sources of "tags" and "scan", see `parse_source`. Raises DeviceError, and then leaves none open.

    preset: of the robot, for the mounts of scanner and camera on ROS; hardware: for those on this machine. An rplidar
    gives Sweep instead of LaserScan. base: the base's ROS graph; what specs do not name comes from the preset's topics
    there, and the source of "base" publishes the explorer's knowledge there. Sources on one server, or on ROS 2's
    graph, are one.
    """
    wanted: dict[SourceSpec, list[tuple[str, str | Topic]]] = {} if base is None else {base: []}
    place: dict[str, SourceSpec] = {} if base is None else {"base": base}
    for use, text in specs.items():
        spec = parse_source(text)
        if OWN.get(spec.transport, use) != use:
            raise DeviceError(f"{text}: is a source of {OWN[spec.transport]}; give --{OWN[spec.transport]} {text}")
        place[use] = dataclasses.replace(spec, topic="")
        wanted.setdefault(place[use], []).append((use, spec.topic))
    if base is not None:
        for use, topic in (("tags", preset.topics.detections), ("scan", preset.topics.scan)):
            if use not in specs and topic is not None:
                place[use] = base
                wanted[base].append((use, topic))
    sources: dict[SourceSpec, SensorSource] = {}
    try:
        for spec, topics in wanted.items():
            name = " and ".join((*(use for use, _ in topics), *(["the robot"] if not topics else [])))
            sources[spec] = SensorSource(f"{name} of {spec}", _opening(spec, topics, preset, spec == base, hardware))
    except DeviceError:
        for source in sources.values():
            source.close()
        raise
    return {use: sources[spec] for use, spec in place.items()}


def _opening(
    spec: SourceSpec,
    topics: list[tuple[str, str | Topic]],
    preset: Preset,
    base: bool,
    hardware: HardwareConfig | None,
) -> OpenDriver:
    own = hardware or HardwareConfig()
    if spec.transport == "camera":
        return functools.partial(CameraDriver, spec.device, own.camera)
    if spec.transport in OWN:
        driver = RplidarDriver if spec.transport == "rplidar" else RealsenseDriver
        return functools.partial(driver, spec.device, own.scanner)
    if spec.transport == "socket":
        return functools.partial(SocketDriver, spec.host, spec.port, tuple(KEYS[use][1] for use, _ in topics))
    return functools.partial(opened, SensorDriver, spec.host, spec.port, preset, tuple(topics), base)
