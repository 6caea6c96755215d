"""Battery, charger and wheels' current by the Kobuki's core sensors."""

from __future__ import annotations

from tfg_drake.hardware.kobuki.codec import CoreSensors

# Below these the vendor calls the battery low, and dangerously so, V.
LOW, DANGEROUS = 14.0, 13.2


def charger(core: CoreSensors) -> str:
    """External power: "dock", "adapter", or "" for none."""
    if not core.charger:
        return ""
    return "adapter" if core.charger & 16 else "dock"


def battery_level(core: CoreSensors) -> str:
    """ "low", "dangerous", or "good": also where it is charged, or the base does not say its voltage."""
    volts = 0.1 * core.battery
    if core.charger or not core.battery or volts > LOW + 1e-9:
        return "good"
    return "low" if volts > DANGEROUS + 1e-9 else "dangerous"


def overcurrent(core: CoreSensors) -> int:
    """Wheels that draw too much current, by the bits of Hazards: 1 right, 4 left. The base has 2 and 1."""
    return (core.overcurrent & 2) >> 1 | (core.overcurrent & 1) << 2
