"""The devices of one robot: its base, and where its tags and its scans come from."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Sequence

from tfg_drake.config import HardwareConfig, RobotCameraConfig, RobotConfig
from tfg_drake.hardware.camera_sensor import known_view
from tfg_drake.hardware.device import Device, DeviceError
from tfg_drake.hardware.kobuki import driver as kobuki
from tfg_drake.hardware.realsense_sensor import LEAST_DEPTH
from tfg_drake.hardware.ros.graph_driver import connect
from tfg_drake.hardware.ros.preset import Frames, Preset, load_preset
from tfg_drake.hardware.rplidar.sweeps import LEAST_RANGE
from tfg_drake.hardware.sensor_source import (
    CamerasSource,
    SensorSource,
    Source,
    SourceSpec,
    SweepSource,
    open_sources,
    parse_source,
)
from tfg_drake.hardware.serial_port import check_port
from tfg_drake.hardware.watchdog import Limits
from tfg_drake.vision.camera_view import CameraView, joint_view

# Default preset of mounts and topics.
PRESET_OF = {"kobuki": "turtlebot2", "ros2": "turtlebot4", "rosbridge": "turtlebot4"}
# The base stands if the newest message is older, s. A slow computer detects tags in few frames; safety needs none.
STALE = {"odometry": 0.5, "scan": 0.4, "tags": 1.0}
# Least range of scanners connected to this machine, m; a socket's server states its own.
NEAREST = {"rplidar": LEAST_RANGE, "realsense": LEAST_DEPTH}
# The source of tags that stands for no tags, whatever the preset says.
NO_TAGS = "none"
# Cameras on this machine for tags: the source of each, and its configuration.
_Cameras = list[tuple[str, RobotCameraConfig]]

_log = logging.getLogger("tfg_drake.host_clock")


class HostClock:
    """Converts between the station's time and the host's: a simulator at real-time rate 1 keeps both in step.

    It starts at its first use; all systems of a station share one. Real time is no system's state."""

    def __init__(self) -> None:
        self._origin: float | None = None

    def host(self, stamp: float, now: float) -> float:
        """Return the host's monotonic time, s, at the station's time `stamp`, s; now: the station's time, s."""
        return self._started(now) + stamp

    def station(self, stamp: float, now: float) -> float:
        """Return the station's time, s, at the host's monotonic time `stamp`, s; now: the station's time, s."""
        return stamp - self._started(now)

    def _started(self, now: float) -> float:
        if self._origin is None:
            self._origin = time.monotonic() - now
            _log.info("the station's time 0 is %.6f s of the host's monotonic clock", self._origin)
        return self._origin


@dataclasses.dataclass(frozen=True)
class RobotDevices:
    """The devices of a robot. base: a device. tags, scan: sources of TagDetections and LaserScan; tags: None for a
    robot without tags. processes: those opened for them, the base's first.

    limits: of the velocity, in the base's driver. publisher, frames: publisher and frame names of a base on ROS, None
    for others. least_range: the scanner's, m. view: of the cameras on this machine, None without any. clock: of the
    station made from the devices. checked: the first turn is checked.
    """

    base: Device
    tags: Source | None
    scan: Source
    limits: Limits
    processes: Sequence[Device] = ()
    publisher: SensorSource | None = None
    frames: Frames | None = None
    least_range: float = 0.0
    view: CameraView | None = None
    clock: HostClock = dataclasses.field(default_factory=HostClock)
    checked: bool = True

    def take_remarks(self) -> list[str]:
        """Return the lines for the operator from the processes of base and sensors since the last call."""
        return [line for process in self.processes for line in process.take_remarks()]

    def close(self) -> None:
        """Stop the base and close all processes; once is enough."""
        for process in self.processes:
            process.close()


def check_devices(config: HardwareConfig) -> None:
    """Raise DeviceError for faults that show before anything is opened: an invalid preset, source or port."""
    *_, graph = _plan(config)
    if graph is None:
        check_port(config.port, kobuki.KOBUKI)


def _plan(config: HardwareConfig) -> tuple[Preset, dict[str, str], _Cameras, SourceSpec | None]:
    """Return the preset, the sources of tags and scan, the cameras on this machine, and the base's graph. Raises
    DeviceError."""
    preset = load_preset(config.preset or PRESET_OF[config.robot])
    cameras = _cameras(config)
    specs = {use: spec for use, spec in (("tags", config.tags), ("scan", config.scan)) if spec}
    if config.tags == NO_TAGS:
        del specs["tags"]
        preset = dataclasses.replace(preset, topics=dataclasses.replace(preset.topics, detections=None))
    if cameras:
        specs["tags"] = cameras[0][0]
    for spec in specs.values():
        parse_source(spec)
    if config.robot == "kobuki" and "scan" not in specs:
        give = "--scan rplidar:DEVICE, realsense:, socket:HOST:PORT or ros2:/TOPIC"
        raise DeviceError(f"{config.robot}: no source of scan, without which no robot drives; give {give}")
    return preset, specs, cameras, _graph(config)


def open_devices(config: HardwareConfig, robot: RobotConfig) -> RobotDevices:
    """Open the devices of a configuration's robot. Raises DeviceError, and then leaves none open.

    robot: its limits bound the velocities sent to the base, as those of a preset do.
    """
    preset, specs, cameras, graph = _plan(config)
    speed = min(robot.max_speed, config.max_speed)
    limits = Limits(speed, robot.max_turn_rate, robot.max_acceleration, robot.max_turn_acceleration)
    on_ros = graph is not None
    if on_ros:
        limits = Limits(*map(min, dataclasses.astuple(preset.limits), dataclasses.astuple(limits)))
        preset = dataclasses.replace(preset, limits=limits)
    view = joint_view([(camera.yaw, known_view(text, camera)) for text, camera in cameras]) if cameras else None
    base = _open_base(config, preset, limits, graph)
    opened: list[Device] = [base]
    try:
        # A source on ROS needs the preset's mounts and its camera's calibration, whatever the base is.
        sources = open_sources(specs, preset, graph, config)
        opened += dict.fromkeys(sources.values())
        tags: list[Source] = [sources["tags"]] if "tags" in sources else []
        for text, camera in cameras[1:]:
            further = open_sources({"tags": text}, preset, None, dataclasses.replace(config, camera=camera))["tags"]
            tags.append(further)
            opened.append(further)
    except DeviceError:
        for one in opened:
            one.close()
        raise
    scanner = config.scan.partition(":")[0]
    scan: Source = sources["scan"]
    return RobotDevices(
        base,
        CamerasSource(tags) if len(tags) > 1 else next(iter(tags), None),
        SweepSource(scan, base.odometry_near) if scanner == "rplidar" else scan,
        limits,
        opened,
        sources.get("base"),
        preset.frames if on_ros else None,
        NEAREST.get(scanner, 0.0 if scanner == "socket" else preset.scanner.least_range),
        view,
    )


def _cameras(config: HardwareConfig) -> _Cameras:
    """Return the cameras on this machine for tags, with their sources and configurations. Raises DeviceError."""
    if not config.tags.startswith("camera:"):
        return []
    # Only ",camera:" separates sources; other commas are part of an address.
    texts = config.tags.replace(",camera:", "\ncamera:").split("\n")
    known = [config.camera, *config.more_cameras]
    if len(texts) > len(known):
        raise DeviceError(
            f"{texts[len(known)]}: nothing is known of it; give hardware.more_cameras an entry for each camera but the "
            "first, in a scenario's file"
        )
    for text, camera in zip(texts, known, strict=False):
        if camera.family != config.camera.family:
            raise DeviceError(
                f"{text}: its tags are of {camera.family}, the first camera's of {config.camera.family}: one id would "
                "be two tags; print all of one family"
            )
    return list(zip(texts, known, strict=False))


def _graph(config: HardwareConfig) -> SourceSpec | None:
    """Return the base's ROS graph, None for a Kobuki on a serial port. Raises DeviceError."""
    if config.robot == "kobuki":
        return None
    if config.robot == "ros2":
        return SourceSpec("ros2")
    host, _, port = config.bridge.rpartition(":")
    if not host or not port.isdigit():
        raise DeviceError(f"rosbridge: {config.bridge} is no HOST:PORT; name the server such as localhost:9090")
    return SourceSpec("rosbridge", host, int(port))


def _open_base(config: HardwareConfig, preset: Preset, limits: Limits, graph: SourceSpec | None) -> Device:
    if graph is None:
        return kobuki.connect(config.port, limits)
    return connect(preset, graph.host, graph.port)
