"""What others on the robot's graph learn of the explorer, over both transports."""

import math
import subprocess
import sys
import time
from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from tests.hardware.fake_robot import SameClock
from tfg_drake.geometry import se2
from tfg_drake.hardware.device import Driver
from tfg_drake.hardware.ros import map_messages
from tfg_drake.hardware.ros.graph_driver import GraphBaseDriver, SensorDriver
from tfg_drake.hardware.ros.map_publisher import MapPublisher
from tfg_drake.hardware.socket_sensors import SocketDriver
from tfg_drake.messages import Odometry

PUBLISHED = {"/map", "/tfg/markers", "/tfg/path", "/tfg/pose"}


def publish(transport, room, duration):
    """Lets the explorer of room.py publish for `duration` s; the odometry is the robot's. Its messages."""
    odometry = transport.device.first(Odometry)
    messages = room.messages(odometry.stamp) | {"odometry": odometry}
    publisher = MapPublisher(transport.source, transport.preset.frames, SameClock())
    simulator = Simulator(publisher)
    for name, message in messages.items():
        publisher.GetInputPort(name).FixValue(simulator.get_mutable_context(), AbstractValue.Make(message))
    simulator.set_target_realtime_rate(1.0)
    simulator.AdvanceTo(duration)
    return messages


def yaw(orientation):
    return 2.0 * math.atan2(orientation["z"], orientation["w"])


def check(heard, room):
    """What everybody must be told, by topic."""
    grid = heard["/map"]
    info = grid["info"]
    cells = np.array(grid["data"]).reshape(info["height"], info["width"])

    def cell(x, y):
        origin = info["origin"]["position"]
        i, j = (math.floor((v - o) / info["resolution"]) for v, o in ((y, origin["y"]), (x, origin["x"])))
        return cells[i, j]

    assert (cell(-2.02, 0.3), cell(0.0, 0.0), cell(0.55, 0.0)) == (100, 0, -1)
    assert info["resolution"] == pytest.approx(0.05)
    assert grid["header"]["frame_id"] == "map"
    texts = [one["text"] for one in heard["/tfg/markers"]["markers"] if one.get("text")]
    assert texts == ["7", "12"]
    places = [one["pose"]["position"] for one in heard["/tfg/path"]["poses"]]
    np.testing.assert_allclose([(p["x"], p["y"]) for p in places], room.path().points)
    pose = heard["/tfg/pose"]["pose"]
    X_MB = room.pose(0.0).X_MB
    np.testing.assert_allclose([*list(pose["pose"]["position"].values())[:2], yaw(pose["pose"]["orientation"])], X_MB)
    assert np.array(pose["covariance"]).reshape(6, 6)[0, 5] == room.pose(0.0).covariance[0, 2]


def seconds(header):
    return header["stamp"]["sec"] + 1e-9 * header["stamp"]["nanosec"]


def test_a_late_listener_of_ros_2(ros2, room):
    ros2.wait_for(lambda: ros2.fresh(ros2.device))
    messages = publish(ros2, room, 0.5)
    ours, theirs = Pipe()
    listener = Path(__file__).with_name("listener.py")
    process = subprocess.Popen([sys.executable, str(listener), str(theirs.fileno()), "60"], pass_fds=[theirs.fileno()])
    while not ours.poll(0.1):
        # The map is not said again.
        ros2.source.publish("pose", map_messages.pose(messages["pose"], ros2.preset.frames))
    heard = ours.recv()
    assert process.wait(60.0) == 0
    assert set(heard) == PUBLISHED | {"/odom"}
    check(heard, room)
    # The estimate's stamp is the odometry's, of the robot's clock.
    now = time.time()
    assert 0.0 < now - seconds(heard["/tfg/pose"]["header"]) < 120.0
    offset = time.time() - time.monotonic()
    assert seconds(heard["/tfg/pose"]["header"]) == pytest.approx(messages["pose"].stamp + offset, abs=0.1)


def test_rosbridge(rosbridge, room):
    rosbridge.wait_for(lambda: rosbridge.fresh(rosbridge.device))
    messages = publish(rosbridge, room, 0.5)
    rosbridge.wait_for(lambda: {*PUBLISHED, "/tf"} <= rosbridge.order("heard").keys())
    heard = rosbridge.order("heard")
    check({topic: one["msg"] for topic, one in heard.items() if topic in PUBLISHED}, room)
    assert {topic: one["type"] for topic, one in heard.items() if topic != "/cmd_vel"} == {
        "/map": "nav_msgs/msg/OccupancyGrid",
        "/tfg/markers": "visualization_msgs/msg/MarkerArray",
        "/tfg/path": "nav_msgs/msg/Path",
        "/tfg/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
        "/tf": "tf2_msgs/msg/TFMessage",
    }
    assert [heard[topic]["latch"] for topic in ("/map", "/tfg/markers", "/tfg/path", "/tf")] == [True] * 3 + [False]
    # map -> odom -> base_link is the estimate.
    (one,) = heard["/tf"]["msg"]["transforms"]
    assert (one["header"]["frame_id"], one["child_frame_id"]) == ("map", "odom")
    at = one["transform"]
    X_MO = np.array([at["translation"]["x"], at["translation"]["y"], yaw(at["rotation"])])
    X_MB = se2.compose(X_MO, messages["odometry"].X_OB)
    np.testing.assert_allclose(X_MB, messages["pose"].X_MB, atol=1e-9)


@pytest.mark.slow
def test_the_process_of_the_watchdog_publishes_nothing():
    assert SensorDriver.publish is not Driver.publish
    assert GraphBaseDriver.publish is SocketDriver.publish is Driver.publish
