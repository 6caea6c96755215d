"""Tags and scans of a ROS graph whose base is not ours: their types are found, their clock is learned from them."""

import math
import time

import numpy as np
import pytest

from tfg_drake.config import TagSensorConfig
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.ros import graph_driver
from tfg_drake.hardware.ros.graph_driver import SensorDriver
from tfg_drake.hardware.ros.preset import load_preset
from tfg_drake.hardware.sensor_source import open_sources
from tfg_drake.messages import LaserScan, Odometry, SaidPose, TagDetections
from tfg_drake.simulation.tag_sensor import NOISE_PER_TAG, detect


@pytest.fixture(params=["ros2", "rosbridge"])
def transport(request):
    return request.getfixturevalue(request.param)


def named(transport, topic):
    """The topic as a source."""
    return f"ros2:{topic}" if transport.port is None else f"rosbridge:localhost:{transport.port}{topic}"


def test_tags_and_scans_of_one_graph(transport):
    names = {"tags": named(transport, "/detections"), "scan": named(transport, "/scan")}
    sources = open_sources(names, transport.preset)
    source = sources["tags"]
    try:
        assert sources["scan"] is source
        transport.wait_for(lambda: source.newest(TagDetections) and source.newest(LaserScan))
        seen, scan = source.newest(TagDetections), source.newest(LaserScan)
        stamps = [pose[0] for pose in transport.order("report")["poses"]]
        # Those of the robot, late by the way here, which is longer on a loaded machine.
        for message in (seen, scan):
            assert stamps[0] < message.stamp < stamps[-1] + 10.0
        world, X_WB = MakeWorld(LoadScenario("house").world), transport.order("report")["poses"][-1][1]
        expected = detect(world, X_WB, 0.0, np.zeros((len(world.tag_ids), NOISE_PER_TAG)), TagSensorConfig(range=5.0))
        assert seen.ids.tolist() == expected.ids.tolist()
        assert np.isfinite(scan.ranges).sum() > 300
        assert scan.sigma == transport.preset.scanner.sigma
        source.take(LaserScan, math.inf)
        taken = []
        transport.wait_for(lambda: taken.extend(source.take(LaserScan, math.inf)) or len(taken) > 6)
        assert (np.diff([one.stamp for one in taken]) > 0.0).all()
        assert source.newest(Odometry) is None
        with pytest.raises(DeviceError, match="no odometry"):
            source.enable()
    finally:
        source.close()


def complaint(transport, use, topic):
    with pytest.raises(DeviceError) as error:
        open_sources({use: named(transport, topic)}, transport.preset)
    return str(error.value)


def test_a_topic_of_another_type(transport):
    assert complaint(transport, "tags", "/scan") == (
        f"{transport.name}: /scan is sensor_msgs/msg/LaserScan; tags come as apriltag_msgs/msg/AprilTagDetectionArray "
        "or sensor_msgs/msg/PointCloud2 or sensor_msgs/msg/Image or sensor_msgs/msg/CompressedImage: name a topic of "
        "that type"
    )


class Graph:
    """A graph that holds what a test says; every call of spin is 0.1 s, in which each topic sends a message."""

    label = "ros2"

    def __init__(self, types, messages=(), rosapi=True):
        self._types, self._messages, self._rosapi = types, dict(messages), rosapi
        self._receivers, self.closed = {}, False
        self._now = time.monotonic()

    def names(self):
        return list(self._types.items())

    def types(self, name):
        if not self._rosapi:
            return None
        return [self._types[name]] if name in self._types else []

    def require(self, topic):
        pass

    def best_effort(self, name):
        return False

    def publisher(self, topic):
        raise AssertionError("nothing is to be published")

    def subscribe(self, topic, receive):
        self._receivers[topic.name] = receive

    def spin(self, duration):
        self._now += 0.1
        seconds = self._now - 0.02 + time.time() - time.monotonic()
        stamp = {"sec": math.floor(seconds), "nanosec": int(1e9 * (seconds % 1.0))}
        for name, receive in self._receivers.items():
            if name in self._messages:
                receive({"header": {"stamp": stamp}, **self._messages[name]}, self._now)

    def close(self):
        self.closed = True


APRILTAG = "apriltag_msgs/msg/AprilTagDetectionArray"
PRESET = load_preset("turtlebot4")
INFO = PRESET.topics.camera_info.name
CAMERA = {"p": [600.0, 0.0, 320.0, 0.0, 0.0, 600.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]}


def test_who_is_on_the_robots_graph_is_told_where_somebody_says_that_it_is():
    """Nobody need publish that; who has no base there does not listen."""
    odometry, said = PRESET.topics.odometry, PRESET.topics.initial_pose
    pose = {"position": {"x": 1.0, "y": 2.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    still = {"linear": {"x": 0.0}, "angular": {"z": 0.0}}
    messages = {odometry.name: {"pose": {"pose": pose}, "twist": {"twist": still}}}
    graph = Graph({odometry.name: odometry.type}, messages)
    driver = SensorDriver(graph, PRESET, (), base=True)
    told = {"header": {"frame_id": "map"}, "pose": {"pose": pose, "covariance": [0.25] * 36}}
    graph._receivers[said.name](told, time.monotonic())
    (one,) = [message for message in driver.take() if isinstance(message, SaidPose)]
    assert (one.X_WB.tolist(), one.sigma.tolist()) == ([1.0, 2.0, 0.0], [0.5, 0.5])
    graph = Graph({"/tags": "sensor_msgs/msg/PointCloud2"}, {"/tags": {}})
    SensorDriver(graph, PRESET, (("tags", "/tags"),))
    assert list(graph._receivers) == ["/tags"]


def test_corners_of_tags_bring_their_camera():
    # 16 cm wide and 2 m ahead of the camera: 48 pixels.
    corners = [296.0, 216.0, 344.0, 216.0, 344.0, 264.0, 296.0, 264.0]
    messages = {"/tags": {"detections": [{"id": 5, "corners": corners}]}, INFO: CAMERA}
    graph = Graph({"/tags": APRILTAG, INFO: "sensor_msgs/msg/CameraInfo"}, messages)
    driver = SensorDriver(graph, PRESET, (("tags", "/tags"),))
    newest = driver.take()[-1]
    assert newest.ids.tolist() == [5]
    assert newest.range == pytest.approx([2.0 + PRESET.camera.x])
    assert not graph.closed


@pytest.mark.parametrize(
    ("graph", "line"),
    [
        (
            Graph({"/other": "sensor_msgs/msg/PointCloud2", "/tags": "std_msgs/msg/String"}),
            "nobody publishes /here; seen instead: /other",
        ),
        (
            Graph({"/here": APRILTAG}),
            f"nobody publishes {INFO} (sensor_msgs/msg/CameraInfo); seen instead: /here; or give --tags none",
        ),
        (
            Graph({"/here": APRILTAG, INFO: "sensor_msgs/msg/CameraInfo"}, {INFO: CAMERA}),
            "nothing arrives on /here in 0 s: start its driver",
        ),
        (
            Graph({}, rosapi=False),
            "what /here is cannot be told, because rosapi does not answer: start it on the robot with "
            "`ros2 launch rosbridge_server rosbridge_websocket_launch.xml`",
        ),
    ],
)
def test_topics_that_are_not_there(graph, line, monkeypatch):
    monkeypatch.setattr(graph_driver, "PATIENCE", 0.2)
    with pytest.raises(DeviceError) as error:
        graph_driver.on_graph(SensorDriver, graph, PRESET, (("tags", "/here"),))
    assert str(error.value) == f"ros2: {line}"
    assert graph.closed
