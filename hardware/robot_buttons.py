"""The operator's buttons on the robot itself."""

from __future__ import annotations

import math

from tfg_drake.hardware.device import BaseState, Device
from tfg_drake.mission.operation import Command

# Of a Kobuki B0, B1 and B2, by their bits.
BUTTONS: dict[int, Command] = {1: "stop", 2: "pause", 4: "enable"}


class RobotButtons:
    """Requests by the robot's buttons; a robot that reports no buttons has none."""

    def __init__(self, base: Device) -> None:
        self._base = base
        self._pressed = 0

    def requests(self) -> list[Command]:
        """The requests since the last call."""
        requests = []
        for state in self._base.take(BaseState, math.inf):
            pressed, self._pressed = state.buttons & ~self._pressed, state.buttons
            requests += [request for bit, request in BUTTONS.items() if pressed & bit]
        return requests
