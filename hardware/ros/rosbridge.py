"""A TurtleBot's ROS graph through rosbridge: a WebSocket, so no ROS is needed on this computer.

The network is between the watchdog and the base: when it is cut, only the base's own command timeout stops the robot.
The connection is opened again with growing delays, and the robot stands until it is enabled anew.
"""

from __future__ import annotations

import contextlib
import dataclasses
import queue
import time
from functools import partial
from typing import Any

from tfg_drake.hardware.device import Device, DeviceError, Message
from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.intake import Intake, mistyped
from tfg_drake.hardware.ros.preset import Preset, Topic
from tfg_drake.hardware.ros.stamps import SILENCE
from tfg_drake.hardware.watchdog import TICK

# How long to look for the robot, s, and for the node rosapi, which lists its topics.
PATIENCE = 10.0
ROSAPI_PATIENCE = 3.0


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


class RosbridgeDriver:
    """A client that subscribes to a preset's topics and publishes its command; see tfg_drake.hardware.device.Driver."""

    def __init__(self, preset: Preset, host: str, port: int) -> None:
        """Waits until odometry and scan arrive; raises DeviceError."""
        try:
            import roslibpy
        except ImportError:
            raise DeviceError("rosbridge: roslibpy is not installed: pip install 'tfg-drake[rosbridge]'") from None
        self.limits = preset.limits
        self._preset, self._intake = preset, Intake(preset)
        self._arrived: queue.SimpleQueue[tuple[str, Topic, Any, float]] = queue.SimpleQueue()
        self._ros = roslibpy.Ros(host, port, transport="asyncio")
        try:
            self._ros.run(PATIENCE)
        except TimeoutError:
            self._ros.close()
            raise DeviceError(
                f"rosbridge: no server answers at ws://{host}:{port}: start it on the robot with "
                "`ros2 launch rosbridge_server rosbridge_websocket_launch.xml`, or give its host and port"
            ) from None
        try:
            # Before we subscribe, because a subscription is a topic too.
            self._check_graph(roslibpy.Service(self._ros, "/rosapi/topics", "rosapi/Topics"), roslibpy.ServiceRequest())
            for key, topic in self._intake.topics():
                # The bridge keeps the newest message of a client that is slow.
                subscriber = roslibpy.Topic(self._ros, topic.name, topic.type, queue_length=1)
                subscriber.subscribe(partial(self._receive, key, topic))
            command = preset.topics.command
            self._publisher = roslibpy.Topic(self._ros, command.name, command.type, queue_size=1)
            self._publisher.advertise()
            self._wait()
        except DeviceError:
            self.close()
            raise

    def _receive(self, key: str, topic: Topic, message: Any) -> None:
        self._arrived.put((key, topic, message, time.monotonic()))

    def _check_graph(self, topics: Any, request: Any) -> None:
        try:
            answer = topics.call(request, timeout=ROSAPI_PATIENCE)
        except Exception:  # roslibpy raises its own kinds; without rosapi there is nothing to check
            return
        graph = list(zip(answer["topics"], answer["types"], strict=True))
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

    def spin(self, duration: float) -> None:
        """Takes in what arrives, for `duration` s."""
        end = time.monotonic() + duration
        with contextlib.suppress(queue.Empty):
            while (left := end - time.monotonic()) > 0.0:
                self._intake.receive(*self._arrived.get(timeout=left))

    def take(self) -> list[Message]:
        """The messages since the last call."""
        return self._intake.take()

    def fault(self) -> str | None:
        """Why the robot must stop until it is enabled anew, once; None when all is well."""
        return self._intake.fault()

    def send(self, speed: float, turn_rate: float) -> None:
        """Publishes a velocity, m/s and rad/s."""
        if not self._ros.is_connected:
            return  # roslibpy would keep it, and send it when it is old
        kind = self._preset.topics.command.type
        self._publisher.publish(
            conversions.velocity(kind, speed, turn_rate, self._intake.clock.robot(time.monotonic()))
        )

    def show(self, enabled: bool) -> None:
        """These robots have nothing to show it with."""

    def close(self) -> None:
        """Leaves the server."""
        with contextlib.suppress(Exception):
            self._ros.close()
        self._ros.terminate()
