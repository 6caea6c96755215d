"""The devices of one robot: its base, and where its tags and its scans come from."""

from __future__ import annotations

import dataclasses

from tfg_drake.config import HardwareConfig, RobotConfig
from tfg_drake.hardware.device import Device, DeviceError
from tfg_drake.hardware.ros import ros2, rosbridge
from tfg_drake.hardware.ros.preset import PresetError, load_preset
from tfg_drake.hardware.sensor import Source
from tfg_drake.hardware.watchdog import Limits


class RobotDevices:
    """base: a device. tags, scan: sources of TagDetections and LaserScan, the base itself where it has them."""

    def __init__(self, base: Device, tags: Source, scan: Source) -> None:
        self.base, self.tags, self.scan = base, tags, scan

    def close(self) -> None:
        """Stops the base, and closes all of them."""
        self.base.close()
        for source in (self.tags, self.scan):
            if source is not self.base:
                source.close()

    def __enter__(self) -> RobotDevices:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_devices(config: HardwareConfig, robot: RobotConfig) -> RobotDevices:
    """The devices of the robot that a configuration names; raises DeviceError.

    robot: its limits bound what is sent to the base, as a preset's own do.
    """
    limits = Limits(robot.max_speed, robot.max_turn_rate, robot.max_acceleration, robot.max_turn_acceleration)
    try:
        preset = load_preset(config.preset)
    except PresetError as error:
        raise DeviceError(str(error)) from None
    preset = dataclasses.replace(preset, limits=_lesser(preset.limits, limits))
    if config.robot == "ros2":
        base = ros2.connect(preset)
    else:
        host, _, port = config.bridge.rpartition(":")
        base = rosbridge.connect(preset, host, int(port))
    return RobotDevices(base, base, base)


def _lesser(one: Limits, other: Limits) -> Limits:
    pairs = zip(dataclasses.astuple(one), dataclasses.astuple(other), strict=True)
    return Limits(*(min(pair) for pair in pairs))
