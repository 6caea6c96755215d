"""The system that tells ROS what the explorer knows: RViz shows it, Nav2 drives by it."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import Context, DiagramBuilder, LeafSystem, System

from tfg_drake.hardware.device import Device
from tfg_drake.hardware.robot_devices import HostClock
from tfg_drake.hardware.ros import map_messages
from tfg_drake.hardware.ros.preset import Frames
from tfg_drake.messages import replace
from tfg_drake.pictures.layers import of_choice, of_map
from tfg_drake.systems.ports import PERIOD, MessageInputs, MessageState, connect_by_name

_SHOWN = ("map", "landmarks", "tfg", "roadmap", "goal", "path", "grid")


class MapPublisher(LeafSystem):
    """Publishes through a device.

    .. pydrake_system::

        name: MapPublisher
        input_ports:
        - pose
        - odometry
        - map
        - landmarks
        - tfg
        - roadmap
        - goal
        - path
        - grid

    Every port is optional and has its own part: pose and tf go out at every period, /map and the markers when the stage
    has changed, the markers with a new choice of goal too, the path with every new one. The state holds the messages
    that were published. Simulator publishes before it updates, so the unrestricted update at the same instant sees
    exactly what was published. Stamps of what has none are those of the pose.
    """

    def __init__(self, device: Device, frames: Frames, clock: HostClock) -> None:
        """clock: the station's."""
        super().__init__()
        self.set_name("map_publisher")
        self._device, self._frames, self._clock = device, frames, clock
        self._Get = MessageInputs(self, "pose", "odometry", *_SHOWN).optional
        # Copying the context costs nothing: a message's deep copy is the message itself.
        self._published = MessageState(self, dict.fromkeys(_SHOWN), lambda context, _: self._Now(context))
        self.DeclarePeriodicPublishEvent(PERIOD, 0.0, self._Publish)

    @staticmethod
    def AddToBuilder(
        builder: DiagramBuilder,
        station: System,
        explorer: System,
        device: Device,
        frames: Frames,
        clock: HostClock,
    ) -> MapPublisher:
        """Adds one, connected to a station and an explorer by port name."""
        publisher = builder.AddNamedSystem("map_publisher", MapPublisher(device, frames, clock))
        connect_by_name(builder, publisher, explorer, station, odometry="base.odometry")
        return publisher

    def _Publish(self, context: Context) -> None:
        pose = self._Get(context, "pose")
        if pose is None:
            return
        now = context.get_time()
        pose = replace(pose, stamp=self._clock.host(pose.stamp, now))
        self._device.publish("pose", map_messages.pose(pose, self._frames))
        if (odometry := self._Get(context, "odometry")) is not None:
            odometry = replace(odometry, stamp=self._clock.host(odometry.stamp, now))
            self._device.publish("tf", map_messages.map_to_odom(pose, odometry, self._frames))
        self._PublishMap(context, pose.stamp)

    def _PublishMap(self, context: Context, stamp: float) -> None:
        now, before = self._Now(context), self._published(context)
        changed = {name for name, message in now.items() if message is not before[name]}
        frames, publish = self._frames, self._device.publish
        if "tfg" in changed:
            publish("map", map_messages.tfg_grid(now["tfg"], stamp, frames))
        # A grid changes with every scan; it is published once a stage.
        if "grid" in changed and (before["grid"] is None or before["grid"].stage != now["grid"].stage):
            publish("map", map_messages.grid_of_cells(now["grid"], stamp, frames))
        if changed & {"map", "landmarks", "tfg", "goal"}:
            shown = [*of_map(now["map"], now["tfg"], now["landmarks"]), *of_choice(now["goal"], now["roadmap"])]
            publish("markers", map_messages.markers(stamp, frames, shown))
        if "path" in changed:
            publish("path", map_messages.path(now["path"], stamp, frames))

    def _Now(self, context: Context) -> dict[str, Any]:
        return {name: self._Get(context, name) for name in _SHOWN}
