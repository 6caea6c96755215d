"""Battery, charger, wheels' current and buttons by the Kobuki's core sensors."""

from __future__ import annotations

import math

from tfg_drake.hardware.device import BaseState
from tfg_drake.hardware.kobuki.codec import CoreSensors

# Below these the vendor calls the battery low, and dangerously so, V.
LOW, DANGEROUS = 14.0, 13.2


def base_state(core: CoreSensors, stamp: float) -> BaseState:
    """The state at stamp, s, as far as every frame tells it.

    Overcurrent has the bits of Hazards, 1 right and 4 left; the base has 2 and 1.
    """
    volts, level = 0.1 * core.battery, "good"  # also while it is charged, or where the base does not say its voltage
    if core.battery and not core.charger and volts <= LOW + 1e-9:
        level = "low" if volts > DANGEROUS + 1e-9 else "dangerous"
    return BaseState(
        stamp=stamp,
        battery=round(volts, 1) if core.battery else math.nan,
        battery_level=level,
        charger="" if not core.charger else "adapter" if core.charger & 16 else "dock",
        charging=core.charger & 4 != 0,
        overcurrent=(core.overcurrent & 2) >> 1 | (core.overcurrent & 1) << 2,
        buttons=core.buttons & 7,
    )
