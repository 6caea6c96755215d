"""Remarks on a base for the operator: each once, when it begins, with what the robot does about it; and what the robot
itself asks for, by its buttons and where its battery is low."""

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

# Break after which a condition is reported again, s.
QUIET = 1.0
# Duration after which a low, and a dangerously low, battery is reported, s, as its voltage sags while the wheels
# accelerate.
LOW_LASTS, DANGEROUS_LASTS = 5.0, 1.0
# Lost frames are reported after LOSES, s, with at least the share SHARE lost.
LOSES, SHARE = 1.5, 0.1
BUTTONS: dict[int, Command] = {Button.B0: "stop", Button.B1: "pause", Button.B2: "enable"}
_CHARGERS = {
    "dock": "the base stands in its dock: put it on the floor, then enable it",
    "adapter": "the base is charging by its adapter: pull the plug, then enable it",
    "charger": "the base is charging: take it off its dock or its cable, then enable it",
}


@dataclasses.dataclass(frozen=True)
class Remark:
    """A line for something that holds now, to be told once it has held for `after`, s."""

    line: str
    after: float = 0.0


@dataclasses.dataclass(frozen=True)
class Spell:
    """How long something has held: since when, when last, both s, and whether that was told."""

    begin: float
    last: float
    told: bool


# By the name of what holds.
Spells = Mapping[str, Spell]


def begun(before: Spells, holds: Mapping[str, Remark], now: float) -> tuple[Spells, list[str]]:
    """The spells at `now`, s, given those before and what holds now, by name; and what of it is to be told now.

    A spell that was told goes on over a break of up to QUIET; one that was not ends at once.
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
    """A look at a base at `now`, s, and the lines to be told.

    hazards: all since the last look. state: the newest, None of a base that says nothing of itself.
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
    """The sides that bits of Side stand for, "none" for 0."""
    return ", ".join(str(side.name).lower() for side in (Side.LEFT, Side.CENTRE, Side.RIGHT) if bits & side) or "none"


def charge_left(state: BaseState) -> str:
    """A battery's rest, in words."""
    return f"{percent(state.charge, 0):.0f} %" if math.isfinite(state.charge) else f"{state.battery:.1f} V"


def alarms(state: BaseState) -> dict[str, str]:
    """Why a base must not drive, by what it says of itself: by the field that tells so."""
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
    """The remark on a battery: "battery low", "battery dangerous" or none."""
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
    """Requests of the robot itself: by its buttons, and where its battery is low; it knows when that is nearly empty. A
    robot that reports neither has none."""

    def __init__(self, base: Device) -> None:
        self._base = base
        self._pressed = 0
        self._spells: Spells = {}
        # Remarks made about the battery, by name.
        self._told: dict[str, str] = {}

    def requests(self) -> list[Command]:
        """The requests since the last call."""
        requests: list[Command] = []
        for state in self._base.take(BaseState, math.inf):
            pressed, self._pressed = state.buttons & ~self._pressed, state.buttons
            requests += [request for bit, request in BUTTONS.items() if pressed & bit]
            # Later than the operator is told: the reason stands in the log before what the robot does about it.
            remarks = {name: Remark(one.line, one.after + QUIET) for name, one in battery(state).items()}
            self._spells, names = begun(self._spells, remarks, state.stamp)
            self._told |= {name: remarks[name].line for name in names}
            requests += ["recall"] if "battery low" in names else []
        return requests

    def empty(self, recalls: bool) -> str:
        """Why the battery ends the mission, "" as long as it does not. recalls: the mission knows what a recall is, so
        that it comes to its end by itself where the battery is but low."""
        line = self._told.get("battery dangerous") or ("" if recalls else self._told.get("battery low", ""))
        return line.partition(":")[0].replace("the", "The", 1)
