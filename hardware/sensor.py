"""A robot's tag sensor or laser scanner as a system."""

from __future__ import annotations

from typing import Any

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.hardware.robot_devices import HostClock
from tfg_drake.hardware.sensor_source import Source
from tfg_drake.messages import LaserScan, TagDetections, replace
from tfg_drake.systems.ports import MessageState


class HardwareSensor(LeafSystem):
    """Newest message of a sensor.

    .. pydrake_system::

        name: HardwareSensor
        output_ports:
        - <name>

    A LaserScan or TagDetections message, stamped in the station's time. Where the station is late, because it was busy,
    a message still appears at its time.
    """

    def __init__(self, name: str, source: Source | None, empty: LaserScan | TagDetections, clock: HostClock) -> None:
        """name: of the port. source: None of a sensor that the robot does not have. empty: the message before there is
        any, stamped -inf."""
        super().__init__()
        self._source, self._clock = source, clock
        self._kind: Any = type(empty)
        self.DeclareStateOutputPort(name, MessageState(self, empty, self._Update if source else None).index)

    def _Update(self, context: Context, before: Any) -> Any:
        now = context.get_time()
        assert self._source is not None
        taken = self._source.take(self._kind, self._clock.host(now, now))
        return replace(taken[-1], stamp=self._clock.station(taken[-1].stamp, now)) if taken else before
