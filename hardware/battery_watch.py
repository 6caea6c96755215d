"""What a robot's battery asks for in its operator's stead."""

from __future__ import annotations

from tfg_drake.hardware.device import BaseState, Device
from tfg_drake.hardware.remarks import Spells, battery, begun
from tfg_drake.mission.operation import Command

# By the name of the remark that is told with it.
REQUESTS: dict[str, Command] = {"battery low": "recall", "battery dangerous": "end"}


class BatteryWatch:
    """Calls the robot back where its battery is low and ends the mission where it is nearly empty; a robot that says
    nothing of its battery asks for nothing."""

    def __init__(self, base: Device) -> None:
        self._base = base
        self._spells: Spells = {}

    def requests(self) -> list[Command]:
        """What is asked for since the last call."""
        state = self._base.newest(BaseState)
        if state is None:
            return []
        self._spells, names = begun(self._spells, battery(state), state.stamp)
        return [REQUESTS[name] for name in names]
