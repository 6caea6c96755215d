"""Requests that the robot itself makes of the mission: by its buttons, and where its battery is low."""

from __future__ import annotations

import math

from tfg_drake.hardware.device import BaseState, Device
from tfg_drake.hardware.remarks import Remark, Spells, battery, begun
from tfg_drake.mission.operation import Command

# Of a Kobuki B0, B1 and B2, by their bits.
BUTTONS: dict[int, Command] = {1: "stop", 2: "pause", 4: "enable"}
# The operator is told this long before, s: the reason stands in the log before what the robot does about it.
TOLD_BEFORE = 1.0


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


class BatteryWatch:
    """Calls the robot back where its battery is low, and knows when it is nearly empty; a robot that says nothing of
    its battery asks for nothing."""

    def __init__(self, base: Device) -> None:
        self._base = base
        self._spells: Spells = {}
        # What of the battery was told so far, by the name of the remark.
        self._told: dict[str, str] = {}

    def requests(self) -> list[Command]:
        """The requests since the last call."""
        state = self._base.newest(BaseState)
        if state is None:
            return []
        remarks = {name: Remark(one.line, one.after + TOLD_BEFORE) for name, one in battery(state).items()}
        self._spells, names = begun(self._spells, remarks, state.stamp)
        self._told |= {name: remarks[name].line for name in names}
        return ["recall"] if "battery low" in names else []

    def empty(self, recalls: bool) -> str:
        """Why the battery ends the mission, "" as long as it does not. recalls: the mission knows what a recall is, so
        that it comes to its end by itself where the battery is but low."""
        line = self._told.get("battery dangerous") or ("" if recalls else self._told.get("battery low", ""))
        return line.partition(":")[0].replace("the", "The", 1)
