"""The devices of one robot: its base, and where its tags and its scans come from."""

from __future__ import annotations

import dataclasses

from tfg_drake.config import HardwareConfig, RobotConfig
from tfg_drake.hardware.device import Device, DeviceError
from tfg_drake.hardware.host_clock import HostClock
from tfg_drake.hardware.kobuki import driver as kobuki
from tfg_drake.hardware.ros import ros2, rosbridge
from tfg_drake.hardware.ros.preset import Frames, Preset, PresetError, load_preset
from tfg_drake.hardware.sensor import Source
from tfg_drake.hardware.sensor_source import open_sources, parse_source
from tfg_drake.hardware.watchdog import Limits

# Whose mounts and topics hold where nobody says otherwise.
PRESET_OF = {"kobuki": "turtlebot2", "ros2": "turtlebot4", "rosbridge": "turtlebot4"}


@dataclasses.dataclass(frozen=True)
class RobotDevices:
    """base: a device. tags, scan: sources of TagDetections and LaserScan, the base itself where it has them.

    limits: what its driver bounds the velocity by. frames: of a base that publishes, on ROS; None of another one.
    clock: of the station that is made of them.
    """

    base: Device
    tags: Source
    scan: Source
    limits: Limits
    frames: Frames | None = None
    clock: HostClock = dataclasses.field(default_factory=HostClock)

    def take_remarks(self) -> list[str]:
        """Lines for the operator that the processes of base and sensors had to say since the last call."""
        sources = {id(source): source for source in (self.base, self.tags, self.scan)}
        return [line for source in sources.values() for line in source.take_remarks()]

    def close(self) -> None:
        """Stops the base, and closes all of them; once is enough."""
        self.base.close()
        for source in (self.tags, self.scan):
            if source is not self.base:
                source.close()


def open_devices(config: HardwareConfig, robot: RobotConfig) -> RobotDevices:
    """The devices of the robot that a configuration names; raises DeviceError, and leaves none open.

    robot: its limits bound what is sent to the base, as those of a preset do.
    """
    speed = min(robot.max_speed, config.max_speed)
    limits = Limits(speed, robot.max_turn_rate, robot.max_acceleration, robot.max_turn_acceleration)
    try:
        preset = load_preset(config.preset or PRESET_OF[config.robot])
    except PresetError as error:
        raise DeviceError(str(error)) from None
    specs = {use: spec for use, spec in (("tags", config.tags), ("scan", config.scan)) if spec}
    for use in specs:
        parse_source(specs[use])
    on_ros = config.robot != "kobuki"
    if on_ros:
        limits = _lesser(preset.limits, limits)
        preset = dataclasses.replace(preset, limits=limits)
    own = {"tags": on_ros and preset.topics.detections is not None, "scan": on_ros}
    for use in own:
        if use not in specs and not own[use]:
            raise DeviceError(f"{config.robot}: no source of {use}; give --{use} socket:HOST:PORT or ros2:/TOPIC")
    # A source on ROS needs the preset's mounts and its camera's calibration, whoever the base is.
    sources = open_sources(specs, preset)
    if "tags" in specs:
        topics = dataclasses.replace(preset.topics, detections=None, camera_info=None)
        preset = dataclasses.replace(preset, topics=topics)
    try:
        base = _open_base(config, preset, limits)
    except DeviceError:
        for source in sources.values():
            source.close()
        raise
    return RobotDevices(
        base, sources.get("tags", base), sources.get("scan", base), limits, preset.frames if on_ros else None
    )


def _open_base(config: HardwareConfig, preset: Preset, limits: Limits) -> Device:
    if config.robot == "kobuki":
        return kobuki.connect(config.port, limits)
    if config.robot == "ros2":
        return ros2.connect(preset)
    host, colon, port = config.bridge.rpartition(":")
    if not colon or not port.isdigit():
        raise DeviceError(f"rosbridge: {config.bridge} is no HOST:PORT; name the server such as localhost:9090")
    return rosbridge.connect(preset, host, int(port))


def _lesser(one: Limits, other: Limits) -> Limits:
    pairs = zip(dataclasses.astuple(one), dataclasses.astuple(other), strict=True)
    return Limits(*(min(pair) for pair in pairs))
