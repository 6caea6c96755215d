"""What can happen to an emulated Kobuki while it runs, as lines of text; see docs/kobuki_emulator.md."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tfg_drake.hardware.kobuki.emulator import Emulator

# Bits of CoreSensors. A wheel without a side is both.
_SIDES = {"left": 4, "centre": 2, "right": 1}
_WHEELS = {"left": 2, "right": 1, "": 3}
_BUTTONS = {"0": 1, "1": 2, "2": 4}


def order(emulator: Emulator, line: str) -> str | None:
    """Does what a line says; the answer, where it asks for one. Raises ValueError where it says nothing known."""
    base, words = emulator.base, line.split()
    try:
        match words:
            case []:
                pass
            case ["silent", "on" | "off" as state]:
                emulator.silent = state == "on"
            case ["mute", "tags" | "scan" as sensor]:
                emulator.muted.add(sensor)
            case ["unmute", "tags" | "scan" as sensor]:
                emulator.muted.discard(sensor)
            case ["corrupt", share] if 0.0 <= float(share) <= 1.0:
                emulator.corrupt = float(share)
            case ["unplug"]:
                emulator.unplug()
            case ["plug"]:
                emulator.plug()
            case ["press" | "release" as verb, "bumper", side]:
                base.bumper = _changed(base.bumper, _SIDES[side], verb == "press")
            case ["press" | "release" as verb, "button", button]:
                base.buttons = _changed(base.buttons, _BUTTONS[button], verb == "press")
            case ["open" | "close" as verb, "cliff", side]:
                base.cliff = _changed(base.cliff, _SIDES[side], verb == "open")
            case ["drop" | "raise" as verb, "wheel", *side]:
                base.wheel_drop = _changed(base.wheel_drop, _WHEELS[" ".join(side)], verb == "drop")
            case ["report"]:
                return json.dumps(emulator.report())
            case _:
                raise ValueError
    except (KeyError, ValueError):
        raise ValueError(f"no order {line.strip()!r}; docs/kobuki_emulator.md lists those that there are") from None
    return None


def _changed(bits: int, which: int, on: bool) -> int:
    return bits | which if on else bits & ~which
