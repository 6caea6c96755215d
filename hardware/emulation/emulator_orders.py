"""Orders to a running emulator of a Kobuki, as lines of text; see docs/kobuki_emulator.md."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING

from tfg_drake.hardware.emulation.sensor_faults import sensor_fault

if TYPE_CHECKING:
    from tfg_drake.hardware.emulation.emulator import Emulator

# Bits of CoreSensors. A wheel without a side is both.
_SIDES = {"left": 4, "centre": 2, "right": 1}
_WHEELS = {"left": 2, "right": 1, "": 3}
_BUTTONS = {"0": 1, "1": 2, "2": 4}
_OVERCURRENT = {"none": 0, "left": 1, "right": 2, "both": 3}
# Of the charger: in the dock, charging.
DOCKED = 6


def order(emulator: Emulator, line: str) -> str | None:
    """Does what a line says; the answer, where it asks for one. Raises ValueError where it says nothing known."""
    base, words = emulator.base, line.split()
    try:
        match words:
            case []:
                pass
            case ["silent", "on" | "off" as state]:
                emulator.silent = state == "on"
            case ["tags" | "scan" as sensor, "well"]:
                emulator.faults.pop(sensor, None)
            case ["tags" | "scan" as sensor, name, *numbers] if all(math.isfinite(float(one)) for one in numbers):
                emulator.faults[sensor] = sensor_fault(sensor, name, [float(one) for one in numbers])
            case ["corrupt" | "lost" | "late" as what, share] if 0.0 <= float(share) <= 1.0:
                setattr(emulator, what, float(share))
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
            case ["battery", volts] if 0.0 <= float(volts) <= 25.5:
                base.battery = round(10.0 * float(volts))
            case ["dock" | "undock" as verb]:
                base.charger = DOCKED if verb == "dock" else 0
            case ["overcurrent", wheel]:
                base.overcurrent = _OVERCURRENT[wheel]
            case ["clock", ahead] if math.isfinite(float(ahead)):
                base.clock += float(ahead)
            case ["stick", "gyro" | "encoders" as sensor]:
                base.stuck.add(sensor)
            case ["free", "gyro" | "encoders" as sensor]:
                base.stuck.discard(sensor)
            case ["report"]:
                return json.dumps(emulator.report())
            case _:
                raise ValueError
    except (KeyError, ValueError):
        raise ValueError(f"no order {line.strip()!r}; docs/kobuki_emulator.md lists those that there are") from None
    return None


def _changed(bits: int, which: int, on: bool) -> int:
    return bits | which if on else bits & ~which
