"""Which devices a configuration opens, and with what preset, without any."""

import pytest

from tfg_drake.config import HardwareConfig, RobotConfig
from tfg_drake.hardware import robot_devices
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.robot_devices import open_devices
from tfg_drake.hardware.ros.preset import load_preset
from tfg_drake.hardware.watchdog import Limits

TAGS, SCAN = "ros2:/detections", "ros2:/scan"


class Nothing:
    """What is opened; whether it was closed."""

    def __init__(self):
        self.closed = False

    def close(self):
        self.closed = True


@pytest.fixture
def opened(monkeypatch):
    """What the base and the sources were opened with."""
    given = {"source": Nothing(), "base": Nothing()}

    def sources(specs, preset):
        given["specs"], given["sensors"] = specs, preset
        return dict.fromkeys(specs, given["source"])

    def base(config, preset, limits):
        given["driven"], given["limits"] = preset, limits
        return given["base"]

    monkeypatch.setattr(robot_devices, "open_sources", sources)
    monkeypatch.setattr(robot_devices, "_open_base", base)
    return given


def test_sources_on_ros_have_the_calibration_and_the_mounts_of_the_robot(opened):
    devices = open_devices(HardwareConfig(robot="kobuki", tags=TAGS, scan=SCAN), RobotConfig())
    assert opened["specs"] == {"tags": TAGS, "scan": SCAN}
    assert opened["sensors"] == load_preset("turtlebot2")
    assert opened["sensors"].topics.camera_info is not None
    assert (devices.base, devices.tags, devices.scan) == (opened["base"], opened["source"], opened["source"])
    assert devices.frames is None


def test_a_base_on_ros_does_not_wait_for_tags_that_come_from_elsewhere(opened):
    devices = open_devices(HardwareConfig(robot="ros2", tags="ros2:/other"), RobotConfig())
    assert opened["sensors"].topics == load_preset("turtlebot4").topics
    assert opened["driven"].topics.detections is None
    assert (devices.tags, devices.scan) == (opened["source"], opened["base"])
    assert devices.frames == load_preset("turtlebot4").frames


def test_the_lowest_limit_holds(opened):
    robot = RobotConfig(max_speed=0.5, max_turn_rate=1.0)
    open_devices(HardwareConfig(robot="ros2", preset="turtlebot3"), robot)
    preset = load_preset("turtlebot3").limits
    assert opened["limits"].speed == min(0.3, preset.speed)
    assert opened["limits"].turn_rate == min(1.0, preset.turn_rate)
    assert opened["driven"].limits == opened["limits"]
    open_devices(HardwareConfig(robot="kobuki", tags=TAGS, scan=SCAN, max_speed=0.6), robot)
    assert opened["limits"] == Limits(0.5, 1.0, 0.5, 3.5)


def test_a_base_that_cannot_be_opened_leaves_no_source_open(opened, monkeypatch):
    def fail(*_):
        raise DeviceError("no base")

    monkeypatch.setattr(robot_devices, "_open_base", fail)
    with pytest.raises(DeviceError, match="no base"):
        open_devices(HardwareConfig(robot="kobuki", tags=TAGS, scan=SCAN), RobotConfig())
    assert opened["source"].closed


def test_an_unknown_preset(opened):
    with pytest.raises(DeviceError, match=r"^roomba: no such file or preset; name a YAML file or one of "):
        open_devices(HardwareConfig(robot="ros2", preset="roomba"), RobotConfig())
