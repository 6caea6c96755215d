"""A TurtleBot's ROS graph through rosbridge: a WebSocket, so no ROS is needed on this computer.

The network is between the watchdog and the base: when it is cut, only the base's own command timeout stops the robot.
The connection is opened again with growing delays, and the robot stands until it is enabled anew.
"""

from __future__ import annotations

import array
import contextlib
import queue
import time
from collections.abc import Callable
from typing import Any

from tfg_drake.hardware.device import ANSWER_TIMEOUT, WAITING, DeviceError, imported
from tfg_drake.hardware.ros.graph_driver import Graph
from tfg_drake.hardware.ros.preset import Topic
from tfg_drake.hardware.sensor_reader import LONGEST_BACK_OFF, PATIENCE

# Types of which a slow connection delivers the newest message only.
STREAMS = ("nav_msgs/msg/Odometry", "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/CameraInfo")

Receive = Callable[[Any, float], None]


class RosbridgeGraph(Graph):
    """A client of a rosbridge server: rosapi does not tell who listens, and what is published is sent on reliably."""

    label = "rosbridge"

    def __init__(self, host: str, port: int) -> None:
        """Connects; raises DeviceError without roslibpy or a server."""
        self._roslibpy = roslibpy = imported("rosbridge", "roslibpy", "rosbridge")
        self._rosapi = True
        self._arrived: queue.Queue[tuple[Receive, Any, float]] = queue.Queue(WAITING)
        self._ros = roslibpy.Ros(host, port, transport="asyncio")
        # By default the delay would grow up to an hour.
        self._ros.factory.set_max_delay(LONGEST_BACK_OFF)
        try:
            self._ros.run(PATIENCE)
        except TimeoutError:
            self._ros.close()
            raise DeviceError(
                f"rosbridge: no server answers at ws://{host}:{port}: start it on the robot with "
                "`ros2 launch rosbridge_server rosbridge_websocket_launch.xml`, or give its host and port"
            ) from None

    def require(self, topic: Topic) -> None:
        """Nothing: JSON says it all."""

    @property
    def connected(self) -> bool:
        """True while connected."""
        return bool(self._ros.is_connected)

    def subscribe(self, topic: Topic, receive: Receive) -> None:
        """receive(message, arrival), by `spin`; arrival s of the host's clock."""
        # Length of the bridge's queue for a slow client: one message of a stream, more of events.
        length = 1 if topic.type in STREAMS else 10
        subscriber = self._roslibpy.Topic(self._ros, topic.name, topic.type, queue_length=length)

        def arrived(message: Any) -> None:
            with contextlib.suppress(queue.Full):  # messages beyond the queue's size are lost
                self._arrived.put_nowait((receive, message, time.monotonic()))

        subscriber.subscribe(arrived)

    def publisher(self, topic: Topic) -> Callable[[dict[str, Any]], None]:
        """Publishes a dictionary of fields; qos may be "latched"."""
        publisher = self._roslibpy.Topic(self._ros, topic.name, topic.type, queue_size=1, latch=topic.qos == "latched")
        publisher.advertise()

        def publish(values: dict[str, Any]) -> None:
            if self.connected:  # otherwise roslibpy would keep the message and send it late
                publisher.publish(_in_json(values))

        return publish

    def names(self) -> list[tuple[str, str]] | None:
        """(name, type) of every topic; None where the node rosapi, which knows them, does not run."""
        if not self._rosapi:
            return None
        topics = self._roslibpy.Service(self._ros, "/rosapi/topics", "rosapi/Topics")
        try:
            answer = topics.call(self._roslibpy.ServiceRequest(), timeout=ANSWER_TIMEOUT)
            return list(zip(answer["topics"], answer["types"], strict=True))
        except Exception:  # roslibpy raises its own kinds
            self._rosapi = False
            return None

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
