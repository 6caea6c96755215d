"""The simulated TurtleBot as a node of a real ROS 2 graph: `python ros2_turtlebot.py FILE_DESCRIPTOR`."""

import importlib
import sys
import time
from multiprocessing.connection import Connection

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from simulated_turtlebot import serve

TOPICS = {
    "odometry": ("/odom", "nav_msgs", "Odometry"),
    "scan": ("/scan", "sensor_msgs", "LaserScan"),
    "detections": ("/detections", "sensor_msgs", "PointCloud2"),
}


def fill(message, values):
    """Sets a message's fields from a dictionary."""
    for name, value in values.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        elif name == "fields":
            message.fields = [fill(kind("sensor_msgs", "PointField")(), one) for one in value]
        else:
            setattr(message, name, value)
    return message


def kind(package, name):
    """A message's class."""
    return getattr(importlib.import_module(f"{package}.msg"), name)


def main():
    """Runs until the test lets go."""
    rclpy.init()
    node = rclpy.create_node("turtlebot4")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    kinds = {key: kind(package, name) for key, (_, package, name) in TOPICS.items()}
    publishers = {
        key: node.create_publisher(kinds[key], topic, qos_profile_sensor_data) for key, (topic, *_) in TOPICS.items()
    }
    received = []
    node.create_subscription(kind("geometry_msgs", "TwistStamped"), "/cmd_vel", received.append, 10)

    def publish(key, message):
        publishers[key].publish(fill(kinds[key](), message))

    def spin(duration):
        end = time.monotonic() + duration
        while (left := end - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)
        twists = [one.twist for one in received]
        received.clear()
        return [{"linear": {"x": t.linear.x}, "angular": {"z": t.angular.z}} for t in twists]

    serve(Connection(int(sys.argv[1])), publish, spin)


main()
