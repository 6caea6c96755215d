"""Remarks on a base for the operator, each once when its condition begins, with the robot's reaction; and the robot's
own requests, by its buttons and its low battery."""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
from collections.abc import Mapping, Sequence

from tfg_drake.hardware.device import BaseState, Button, Device
from tfg_drake.messages import Hazards
from tfg_drake.mission.operation import Command, Side
from tfg_drake.percent import percent

# A condition is reported again after a break of more than QUIET, s.
QUIET = 1.0
# A low battery is reported after LOW_LASTS, s, a dangerously low one after DANGEROUS_LASTS, s: the voltage sags while
# the wheels accelerate.
LOW_LASTS, DANGEROUS_LASTS = 5.0, 1.0
# Lost frames are reported once at least the share SHARE has been lost for LOSES, s.
LOSES, SHARE = 1.5, 0.1
BUTTONS: dict[int, Command] = {Button.B0: "stop", Button.B1: "pause", Button.B2: "enable"}
_CHARGERS = {
    "dock": "the base stands in its dock: put it on the floor, then enable it",
    "adapter": "the base is charging by its adapter: pull the plug, then enable it",
    "charger": "the base is charging: take it off its dock or its cable, then enable it",
}


@dataclasses.dataclass(frozen=True)
class Remark:
    """A line on a condition that holds now, reported once it has held for `after`, s."""

    line: str
    after: float = 0.0


@dataclasses.dataclass(frozen=True)
class Spell:
    """Interval in which a condition has held, from begin to last, s. told: it was reported."""

    begin: float
    last: float
    told: bool


# Spells by the name of the condition.
Spells = Mapping[str, Spell]


def begun(before: Spells, holds: Mapping[str, Remark], now: float) -> tuple[Spells, list[str]]:
    """Return the spells at `now`, s, and the names of those to report now. holds: the conditions that hold, by name.

    A reported spell goes on over a break of up to QUIET; an unreported one ends at once.
    """
    spells = {name: one for name, one in before.items() if name in holds or (one.told and now - one.last <= QUIET)}
    names = []
    for name, remark in holds.items():
        spell = spells.get(name, Spell(now, now, False))
        due = not spell.told and now - spell.begin >= remark.after
        if due:
            names.append(name)
        spells[name] = Spell(spell.begin, now, spell.told or due)
    return spells, names


def watched(
    before: Spells, hazards: Sequence[Hazards], state: BaseState | None, now: float
) -> tuple[Spells, list[str]]:
    """Return the spells of a base at `now`, s, and the lines to report.

    hazards: all since the last call. state: the newest, None if the base reports none.
    """
    holds = _hazards(hazards)
    if state is not None:
        holds |= battery(state)
        if state.lost >= SHARE:
            line = f"{percent(state.lost, 0):.0f} % of the base's frames are lost; the robot drives on; check the cable"
            holds["frames"] = Remark(line, LOSES)
    spells, names = begun(before, holds, now)
    return spells, [holds[name].line for name in names]


def where(bits: int) -> str:
    """Return the names of the sides in bits of Side, "none" for 0."""
    return ", ".join(str(side.name).lower() for side in (Side.LEFT, Side.CENTRE, Side.RIGHT) if bits & side) or "none"


def charge_left(state: BaseState) -> str:
    """Return the remaining charge in words."""
    return f"{percent(state.charge, 0):.0f} %" if math.isfinite(state.charge) else f"{state.battery:.1f} V"


def alarms(state: BaseState) -> dict[str, str]:
    """Return why a base in this state must not drive, by field of the state."""
    reasons = {}
    if state.overcurrent:
        sides = where(state.overcurrent)
        wheels = "both wheels" if "," in sides else f"the {sides} wheel"
        reasons["overcurrent"] = f"overcurrent of {wheels}: see what blocks the wheels, then enable the base"
    if state.charger:
        reasons["charger"] = _CHARGERS[state.charger]
    if state.battery_level == "dangerous":
        reasons["battery"] = f"the battery is down to {charge_left(state)}: charge it, then enable the base"
    return reasons


def battery(state: BaseState) -> dict[str, Remark]:
    """Return the remark on a battery by its name, "battery low" or "battery dangerous", or none."""
    left = charge_left(state)
    if state.battery_level == "low":
        line = f"the battery is low, {left}: the mission ends, at home if explorer.return_home is set"
        return {"battery low": Remark(line, LOW_LASTS)}
    if state.battery_level == "dangerous":
        line = f"the battery is nearly empty, {left}: the robot stops and the mission ends; charge it"
        return {"battery dangerous": Remark(line, DANGEROUS_LASTS)}
    return {}


def _hazards(hazards: Sequence[Hazards]) -> dict[str, Remark]:
    remarks = {}
    for name, field, reaction in (
        ("bumper", "bumper", "the robot backs away and looks for another way"),
        ("cliff", "cliff", "the robot stands; carry it away, then enable it"),
        ("wheel drop", "wheel_drop", "the robot stands; put it on its wheels, then enable it"),
    ):
        bits = functools.reduce(operator.or_, (getattr(one, field) for one in hazards), 0)
        if bits:
            remarks[name] = Remark(f"{name} {where(bits)}: {reaction}")
    return remarks


class RobotRequests:
    """Requests of the robot itself, by its buttons and its low battery; `empty` tells that the battery ends the
    mission. A robot that reports neither has none."""

    def __init__(self, base: Device) -> None:
        self._base = base
        self._pressed = 0
        self._spells: Spells = {}
        # Remarks made about the battery, by name.
        self._told: dict[str, str] = {}

    def requests(self) -> list[Command]:
        """Return the requests since the last call."""
        requests: list[Command] = []
        for state in self._base.take(BaseState, math.inf):
            pressed, self._pressed = state.buttons & ~self._pressed, state.buttons
            requests += [request for bit, request in BUTTONS.items() if pressed & bit]
            # QUIET later than the report to the operator, so that the log has the reason before the reaction.
            remarks = {name: Remark(one.line, one.after + QUIET) for name, one in battery(state).items()}
            self._spells, names = begun(self._spells, remarks, state.stamp)
            self._told |= {name: remarks[name].line for name in names}
            requests += ["recall"] if "battery low" in names else []
        return requests

    def empty(self, recalls: bool) -> str:
        """Return why the battery ends the mission, "" if it does not. recalls: the mission supports recalls, so that a
        low battery lets it end by itself."""
        line = self._told.get("battery dangerous") or ("" if recalls else self._told.get("battery low", ""))
        return line.partition(":")[0].replace("the", "The", 1)
