"""A TurtleBot's ROS graph through rosbridge: a WebSocket, so no ROS is needed on this computer.

The network is between the watchdog and the base: when it is cut, only the base's own command timeout stops the robot.
The connection is opened again with growing delays, and the robot stands until it is enabled anew.
"""

from __future__ import annotations

import array
import contextlib
import dataclasses
import queue
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from tfg_drake.hardware.device import Device, DeviceError
from tfg_drake.hardware.ros.announcer import Announcer
from tfg_drake.hardware.ros.graph_driver import GraphBaseDriver
from tfg_drake.hardware.ros.intake import Intake, mistyped
from tfg_drake.hardware.ros.preset import Preset, Topic
from tfg_drake.hardware.ros.stamps import SILENCE
from tfg_drake.hardware.watchdog import TICK

# How long to look for the robot, s, and for the node rosapi, which lists its topics.
PATIENCE = 10.0
# Between two attempts to connect again, s.
LONGEST_RETRY = 2.0
# What of a slow connection only the newest is wanted.
STREAMS = ("nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/CameraInfo")
ROSAPI_PATIENCE = 3.0

Receive = Callable[[Any, float], None]


def connect(preset: Preset, host: str = "localhost", port: int = 9090) -> Device:
    """The robot of a preset behind the rosbridge server at host and port; raises DeviceError."""
    return Device(RosbridgeConfig(preset, host, port))


@dataclasses.dataclass(frozen=True)
class RosbridgeConfig:
    """What the robot's process is told."""

    preset: Preset
    host: str
    port: int

    def open(self) -> RosbridgeDriver:
        """The driver; raises DeviceError."""
        return RosbridgeDriver(self.preset, self.host, self.port)


class RosbridgeGraph:
    """A client of a rosbridge server, used by one thread: what driving a base and listening to a sensor share."""

    label = "rosbridge"

    def __init__(self, host: str, port: int) -> None:
        """Connects; raises DeviceError without roslibpy or a server."""
        try:
            import roslibpy
        except ImportError:
            raise DeviceError("rosbridge: roslibpy is not installed: pip install -e '.[rosbridge]'") from None
        self._roslibpy = roslibpy
        self._arrived: queue.SimpleQueue[tuple[Receive, Any, float]] = queue.SimpleQueue()
        self._ros = roslibpy.Ros(host, port, transport="asyncio")
        # It would wait longer each time, for up to an hour.
        self._ros.factory.set_max_delay(LONGEST_RETRY)
        try:
            self._ros.run(PATIENCE)
        except TimeoutError:
            self._ros.close()
            raise DeviceError(
                f"rosbridge: no server answers at ws://{host}:{port}: start it on the robot with "
                "`ros2 launch rosbridge_server rosbridge_websocket_launch.xml`, or give its host and port"
            ) from None

    @property
    def connected(self) -> bool:
        """Whether the server is there."""
        return bool(self._ros.is_connected)

    def subscribe(self, topic: Topic, receive: Receive) -> None:
        """receive(message, arrival), by `spin`; arrival s of the host's clock."""
        # The bridge keeps the newest messages for a client that is slow: one of what streams, more of what happens.
        length = 1 if topic.type in STREAMS else 10
        subscriber = self._roslibpy.Topic(self._ros, topic.name, topic.type, queue_length=length)
        subscriber.subscribe(lambda message: self._arrived.put((receive, message, time.monotonic())))

    def publisher(self, topic: Topic) -> Callable[[dict[str, Any]], None]:
        """Publishes a dictionary of fields; qos may be "latched"."""
        publisher = self._roslibpy.Topic(self._ros, topic.name, topic.type, queue_size=1, latch=topic.qos == "latched")
        publisher.advertise()

        def publish(values: dict[str, Any]) -> None:
            if self.connected:  # roslibpy would keep it, and send it when it is old
                publisher.publish(_in_json(values))

        return publish

    def names(self) -> list[tuple[str, str]] | None:
        """(name, type) of every topic; None where the node rosapi, which knows them, does not run."""
        topics = self._roslibpy.Service(self._ros, "/rosapi/topics", "rosapi/Topics")
        try:
            answer = topics.call(self._roslibpy.ServiceRequest(), timeout=ROSAPI_PATIENCE)
        except Exception:  # roslibpy raises its own kinds
            return None
        return list(zip(answer["topics"], answer["types"], strict=True))

    def types(self, name: str) -> list[str] | None:
        """The types that a topic has; None where rosapi does not run."""
        graph = self.names()
        return None if graph is None else [kind for one, kind in graph if one == name]

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""
        end = time.monotonic() + duration
        with contextlib.suppress(queue.Empty):
            while (left := end - time.monotonic()) > 0.0:
                receive, message, arrival = self._arrived.get(timeout=left)
                receive(message, arrival)

    def close(self) -> None:
        """Leaves the server."""
        with contextlib.suppress(Exception):
            self._ros.close()
        self._ros.terminate()


def _in_json(message: dict[str, Any]) -> dict[str, Any]:
    """Fields with lists for arrays, which JSON does not have."""
    return {key: value.tolist() if isinstance(value, array.array) else value for key, value in message.items()}


class RosbridgeDriver(GraphBaseDriver):
    """A client that subscribes to a preset's topics and publishes its command; see tfg_drake.hardware.device.Driver.

    It publishes what the explorer knows, too: see tfg_drake.hardware.announcements.Publisher.
    """

    _graph: RosbridgeGraph

    def __init__(self, preset: Preset, host: str, port: int) -> None:
        """Waits until odometry and scan arrive; raises DeviceError."""
        self.limits = preset.limits
        self._preset, self._intake = preset, Intake(preset)
        self._graph = RosbridgeGraph(host, port)
        self._announcer = Announcer(preset.publish, self._graph.publisher, self._intake.clock.robot)
        try:
            self._check_graph()  # before we subscribe, because a subscription is a topic too
            for key, topic in self._intake.topics():
                self._graph.subscribe(topic, partial(self._intake.receive, key, topic))
            self._send = self._graph.publisher(preset.topics.command)
            self._wait()
        except DeviceError:
            self.close()
            raise

    def _check_graph(self) -> None:
        if (graph := self._graph.names()) is None:
            return
        ours = [(topic, "publishes") for _, topic in self._intake.topics()]
        for topic, verb in [*ours, (self._preset.topics.command, "listens to")]:
            types = [kind for name, kind in graph if name == topic.name]
            if line := mistyped(topic, types):
                raise DeviceError(f"rosbridge: {line}")
            if not types:
                raise DeviceError(f"rosbridge: {self._intake.nobody(topic, graph, verb)}")

    def _wait(self) -> None:
        odometry, scan = self._preset.topics.odometry.name, self._preset.topics.scan.name
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end and not (self._intake.clock.ready and scan in self._intake.arrived):
            self.spin(TICK)
        for name in (odometry, scan):
            if name not in self._intake.arrived:
                raise DeviceError(f"rosbridge: nothing arrives on {name} in {PATIENCE:.0f} s: start its driver")
        if not self._intake.clock.ready:
            raise DeviceError(f"rosbridge: {odometry} falls silent for more than {SILENCE} s at times")
        if line := self._intake.clock.skew():
            raise DeviceError(f"rosbridge: {line}")
