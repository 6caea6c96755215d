"""What ROS 2 lacks is said in one line, from a real graph with the emulated robot in it."""

import dataclasses
import sys

import pytest

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.ros import graph_driver, intake
from tfg_drake.hardware.ros.preset import Topic, load_preset


def complaint(preset):
    """What opening the driver of a preset's base in this process says."""
    with pytest.raises(DeviceError) as error:
        graph_driver.opened(graph_driver.GraphBaseDriver, "", 0, preset)
    return str(error.value)


def complaint_of_scan(preset):
    """What opening the driver of its scanner says."""
    with pytest.raises(DeviceError) as error:
        graph_driver.opened(graph_driver.SensorDriver, "", 0, preset, (("scan", preset.topics.scan),), True)
    return str(error.value)


def changed(preset, **topics):
    return dataclasses.replace(preset, topics=dataclasses.replace(preset.topics, **topics))


def test_without_ros(monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    line = complaint(load_preset("turtlebot4"))
    assert line.startswith(f"ros2: rclpy cannot be imported by {sys.executable} (")
    assert line.endswith(
        "): run `source /opt/ros/jazzy/setup.bash` first and use the Python of that ROS, or connect through rosbridge"
    )


def test_a_package_that_is_not_there(ros_domain):
    assert complaint(load_preset("turtlebot3")) == (
        "ros2: /sensor_state needs the package turtlebot3_msgs, which this ROS lacks: install "
        "ros-$ROS_DISTRO-turtlebot3-msgs and source ROS again, or take it out of a preset that names it"
    )


def test_the_line_comes_through_the_process(ros_domain):
    with pytest.raises(DeviceError, match=r"^ros2: /hazard_detection needs the package irobot_create_msgs"):
        graph_driver.connect(load_preset("turtlebot4"))


def test_nobody_publishes(ros2, monkeypatch):
    monkeypatch.setattr(graph_driver, "PATIENCE", 6.0)
    elsewhere = Topic("/robot7/odom", "nav_msgs/msg/Odometry")
    assert complaint(changed(ros2.preset, odometry=elsewhere)) == (
        "ros2: nobody publishes /robot7/odom (nav_msgs/msg/Odometry); seen instead: /odom"
    )
    elsewhere = Topic("/robot7/scan", "sensor_msgs/msg/LaserScan")
    assert complaint_of_scan(changed(ros2.preset, scan=elsewhere)) == (
        "ros2: nobody publishes /robot7/scan (sensor_msgs/msg/LaserScan); seen instead: /scan"
    )


def test_another_type(ros2):
    unstamped = Topic("/cmd_vel", "geometry_msgs/msg/Twist", "reliable")
    assert complaint(changed(ros2.preset, command=unstamped)) == (
        "ros2: /cmd_vel is geometry_msgs/msg/TwistStamped, the preset has geometry_msgs/msg/Twist: set its type"
    )
    cloud = Topic("/scan", "sensor_msgs/msg/PointCloud2")
    assert complaint_of_scan(changed(ros2.preset, scan=cloud)) == (
        "ros2: /scan is sensor_msgs/msg/LaserScan, the preset has sensor_msgs/msg/PointCloud2: set its type"
    )


def test_another_quality_of_service(ros2):
    reliable = dataclasses.replace(ros2.preset.topics.scan, qos="reliable")
    assert complaint_of_scan(changed(ros2.preset, scan=reliable)) == (
        "ros2: /scan is published best effort, the preset has reliable: set its qos to sensor_data"
    )


def test_another_clock(ros2, monkeypatch):
    monkeypatch.setattr(intake, "MAX_SKEW", -1.0)
    line = complaint(ros2.preset)
    assert line.startswith("ros2: /odom is stamped 0.0")
    assert line.endswith("synchronise both, with chrony for example")
