"""What rosbridge lacks is said in one line; a connection that is lost comes back."""

import dataclasses
import socket
import sys

import pytest

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.ros import graph_driver
from tfg_drake.hardware.ros import rosbridge as transport
from tfg_drake.hardware.ros.preset import Topic
from tfg_drake.io.extras import pip_install


def complaint(preset, port):
    """What opening a preset's driver in this process says."""
    with pytest.raises(DeviceError) as error:
        graph_driver.opened(graph_driver.GraphBaseDriver, "localhost", port, preset)
    return str(error.value)


def changed(preset, **topics):
    return dataclasses.replace(preset, topics=dataclasses.replace(preset.topics, **topics))


def test_without_roslibpy(rosbridge, monkeypatch):
    monkeypatch.setitem(sys.modules, "roslibpy", None)
    assert complaint(rosbridge.preset, 9090) == (f"rosbridge: roslibpy is not installed: {pip_install('rosbridge')}")


def test_no_server(rosbridge, monkeypatch):
    monkeypatch.setattr(transport, "PATIENCE", 0.5)
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
    assert complaint(rosbridge.preset, port) == (
        f"rosbridge: no server answers at ws://localhost:{port}: start it on the robot with "
        "`ros2 launch rosbridge_server rosbridge_websocket_launch.xml`, or give its host and port"
    )


@pytest.mark.parametrize(
    ("topics", "line"),
    [
        (
            {"odometry": Topic("/robot7/odom", "nav_msgs/msg/Odometry")},
            "nobody publishes /robot7/odom (nav_msgs/msg/Odometry); seen instead: /odom",
        ),
        (
            {"command": Topic("/drive", "geometry_msgs/msg/TwistStamped")},
            "nobody listens to /drive (geometry_msgs/msg/TwistStamped); seen instead: /cmd_vel",
        ),
        (
            {"command": Topic("/cmd_vel", "geometry_msgs/msg/Twist")},
            "/cmd_vel is geometry_msgs/msg/TwistStamped, the preset has geometry_msgs/msg/Twist: set its type",
        ),
    ],
)
def test_topics_that_differ(rosbridge, topics, line, monkeypatch):
    monkeypatch.setattr(graph_driver, "PATIENCE", 1.0)
    assert complaint(changed(rosbridge.preset, **topics), rosbridge.port) == f"rosbridge: {line}"


def test_a_connection_that_is_lost(rosbridge):
    """The robot stands, and drives again when it is enabled anew."""
    with rosbridge.connect() as device:
        rosbridge.go(device)
        rosbridge.order("cut")
        rosbridge.wait_for(
            lambda: rosbridge.drive(device, 0.1, 0.0, 0.8) and device.locked == "no odometry for more than 0.5 s"
        )
        stood = rosbridge.last_motion_told()
        rosbridge.wait_for(lambda: rosbridge.fresh(device))
        rosbridge.drive(device, 0.3, 0.0, 0.8)
        assert rosbridge.last_motion_told() == stood
        rosbridge.go(device)
