"""Which devices a configuration opens, and with what preset, without any."""

import math
import time

import pytest

from tests.cameras import pinhole
from tfg_drake.config import HardwareConfig, RobotCameraConfig, RobotConfig
from tfg_drake.hardware import robot_devices
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.robot_devices import HostClock, open_devices
from tfg_drake.hardware.ros.preset import load_preset
from tfg_drake.hardware.sensor_source import CamerasSource, SourceSpec, SweepSource
from tfg_drake.hardware.watchdog import Limits
from tfg_drake.vision.calibration import save_calibration

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

    def sources(specs, preset, graph, hardware):
        given["specs"], given["sensors"], given["graph"], given["hardware"] = specs, preset, graph, hardware
        own = [] if graph is None else ["scan", "base", *(["tags"] if preset.topics.detections else [])]
        return dict.fromkeys((*specs, *own), given["source"])

    def base(config, preset, limits, graph):
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
    assert (devices.publisher, devices.frames) == (None, None)
    assert opened["graph"] is None


@pytest.mark.parametrize(
    ("config", "graph"),
    [
        (HardwareConfig(robot="ros2", tags="ros2:/other"), SourceSpec("ros2")),
        (HardwareConfig(robot="rosbridge", bridge="10.0.0.7:9091"), SourceSpec("rosbridge", "10.0.0.7", 9091)),
    ],
)
def test_a_base_on_ros_has_its_sensors_and_what_publishes_in_another_process(opened, config, graph):
    devices = open_devices(config, RobotConfig())
    assert opened["graph"] == graph
    assert devices.base is opened["base"]
    assert [devices.tags, devices.scan, devices.publisher] == [opened["source"]] * 3
    assert devices.frames == load_preset("turtlebot4").frames
    devices.close()
    assert opened["base"].closed
    assert opened["source"].closed


def test_a_bridge_without_a_port(opened):
    with pytest.raises(
        DeviceError, match=r"^rosbridge: robot is no HOST:PORT; name the server such as localhost:9090$"
    ):
        open_devices(HardwareConfig(robot="rosbridge", bridge="robot"), RobotConfig())


def test_how_near_the_scanner_sees_is_the_presets_but_for_a_socket(opened):
    socket = "socket:127.0.0.1:5000"
    for scan, least in ((SCAN, 0.45), (socket, 0.0)):
        config = HardwareConfig(robot="kobuki", tags=TAGS, scan=scan)
        assert open_devices(config, RobotConfig()).least_range == least


def test_a_robot_without_ros_sees_as_its_own_sensors_do(opened, tmp_path):
    """Its scans are made of sweeps by the base's odometry; how wide and far it sees tags says the calibration."""
    pytest.importorskip("robotpy_apriltag", reason="robotpy-apriltag is not installed: pip install 'tfg-drake[camera]'")
    save_calibration(tmp_path / "camera.yaml", pinhole(640, 480, 500.0))
    config = HardwareConfig(robot="kobuki", tags="camera:0", scan="rplidar:/dev/ttyUSB0")
    config.camera.calibration = str(tmp_path / "camera.yaml")
    opened["base"].odometry_near = lambda stamp: None
    devices = open_devices(config, RobotConfig())
    assert opened["hardware"] is config
    assert isinstance(devices.scan, SweepSource)
    assert devices.least_range == 0.15
    assert devices.view.range == pytest.approx(0.16 * 500.0 / 24.0)
    assert devices.view.field_of_view == pytest.approx(2.0 * math.atan(319.5 / 500.0))
    config.scan = "realsense:"
    depth = open_devices(config, RobotConfig())
    assert (depth.scan, depth.least_range) == (opened["source"], 0.3)


def test_several_cameras(opened, tmp_path):
    """Each has a source, a calibration and a mount of its own; they see together."""
    pytest.importorskip("robotpy_apriltag", reason="robotpy-apriltag is not installed: pip install 'tfg-drake[camera]'")
    save_calibration(tmp_path / "camera.yaml", pinhole(640, 480, 500.0))
    cameras = [RobotCameraConfig(str(tmp_path / "camera.yaml"), yaw=yaw) for yaw in (0.5, -0.5)]
    config = HardwareConfig(robot="kobuki", tags="camera:0,camera:http://host/a,b", scan=SCAN, camera=cameras[0])
    with pytest.raises(DeviceError) as error:
        open_devices(config, RobotConfig())
    assert str(error.value) == (
        "camera:http://host/a,b: nothing is known of it; give hardware.more_cameras an entry for each camera but the "
        "first, in a scenario's file"
    )
    config.more_cameras = [RobotCameraConfig(str(tmp_path / "camera.yaml"), family="tag16h5")]
    with pytest.raises(DeviceError) as error:
        open_devices(config, RobotConfig())
    assert str(error.value) == (
        "camera:http://host/a,b: its tags are of tag16h5, the first camera's of tag36h11: one id would be two tags; "
        "print all of one family"
    )
    config.more_cameras = cameras[1:]
    devices = open_devices(config, RobotConfig())
    assert isinstance(devices.tags, CamerasSource)
    assert opened["specs"] == {"tags": "camera:http://host/a,b"}
    assert opened["hardware"].camera is cameras[1]
    assert devices.view.field_of_view == pytest.approx(2.0 * (0.5 + math.atan(319.5 / 500.0)))


def test_a_camera_without_a_calibration_opens_no_base(opened):
    config = HardwareConfig(robot="kobuki", tags="camera:0", scan="rplidar:/dev/ttyUSB0")
    with pytest.raises(DeviceError, match=r"^camera:0: (has no calibration|\w+ is not installed)"):
        open_devices(config, RobotConfig())
    assert "driven" not in opened


def test_a_base_without_sources(opened):
    with pytest.raises(DeviceError) as error:
        open_devices(HardwareConfig(robot="kobuki", tags=TAGS), RobotConfig())
    assert str(error.value) == (
        "kobuki: no source of scan, without which no robot drives; give --scan rplidar:DEVICE, realsense:, "
        "socket:HOST:PORT or ros2:/TOPIC"
    )


def test_a_robot_without_tags_has_no_source_of_them(opened):
    """A Kobuki that is given none, and one on ROS whose preset has none, or that is said to have none."""
    alone = open_devices(HardwareConfig(robot="kobuki", scan=SCAN), RobotConfig())
    assert (alone.tags, alone.scan, opened["specs"]) == (None, opened["source"], {"scan": SCAN})
    assert open_devices(HardwareConfig(robot="ros2"), RobotConfig()).tags is opened["source"]
    assert open_devices(HardwareConfig(robot="ros2", tags="none"), RobotConfig()).tags is None
    assert opened["specs"] == {}
    assert opened["sensors"].topics.detections is None
    with pytest.raises(DeviceError, match=r"^none: is no source; name one as "):
        open_devices(HardwareConfig(robot="ros2", tags="none", scan="none"), RobotConfig())
    alone.close()
    assert opened["source"].closed


def test_the_lowest_limit_holds(opened):
    robot = RobotConfig(max_speed=0.5, max_turn_rate=1.0)
    open_devices(HardwareConfig(robot="ros2", preset="turtlebot3"), robot)
    preset = load_preset("turtlebot3").limits
    assert opened["limits"].speed == min(0.3, preset.speed)
    assert opened["limits"].turn_rate == min(1.0, preset.turn_rate)
    assert opened["driven"].limits == opened["limits"]
    open_devices(HardwareConfig(robot="kobuki", tags=TAGS, scan=SCAN, max_speed=0.6), robot)
    assert opened["limits"] == Limits(0.5, 1.0, 0.5, 3.5)


def test_sources_that_cannot_be_opened_leave_no_base_open(opened, monkeypatch):
    def fail(*_):
        raise DeviceError("no source")

    monkeypatch.setattr(robot_devices, "open_sources", fail)
    with pytest.raises(DeviceError, match="no source"):
        open_devices(HardwareConfig(robot="kobuki", tags=TAGS, scan=SCAN), RobotConfig())
    assert opened["base"].closed


def test_an_unknown_preset(opened):
    with pytest.raises(DeviceError, match=r"^roomba: no such file or preset; name a YAML file or one of "):
        open_devices(HardwareConfig(robot="ros2", preset="roomba"), RobotConfig())


def test_a_resumed_station_goes_on_at_its_time_whatever_is_asked_first():
    clock = HostClock()
    clock.host(0.0, 20.0)  # Of a message from before.
    assert clock.station(time.monotonic(), 20.0) == pytest.approx(20.0, abs=1.0)
