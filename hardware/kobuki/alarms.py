"""Alarms of battery, charger and wheels' current from the Kobuki's core sensors, and why it must stand."""

from __future__ import annotations

from collections.abc import Mapping

from tfg_drake.hardware.kobuki.codec import CoreSensors

# Below these the vendor calls the battery low, and dangerously so, V.
LOW, DANGEROUS = 14.0, 13.2
# What must last so long before it stops the base, s: a wheel that starts and one garbled frame are no alarm.
LASTING = 0.2


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


def lasting(before: Mapping[str, float], core: CoreSensors, now: float) -> dict[str, float]:
    """Why the base must not drive, and since when each reason lasts without a break, s.

    before: the same one frame earlier. now: when this frame came, s.
    """
    reasons = []
    if wheels := {1: "the right wheel", 4: "the left wheel", 5: "both wheels"}.get(overcurrent(core)):
        reasons.append(f"overcurrent of {wheels}: see what blocks the wheels, then enable the base")
    if charger(core) == "adapter":
        reasons.append("the base is charging by its adapter: pull the plug, then enable it")
    elif charger(core) == "dock":
        reasons.append("the base stands in its dock: put it on the floor, then enable it")
    if battery_level(core) == "dangerous":
        reasons.append(f"the battery is down to {DANGEROUS:g} V: charge it, then enable the base")
    return {reason: before.get(reason, now) for reason in reasons}


def fault(since: Mapping[str, float], now: float) -> str | None:
    """A reason that has lasted for LASTING by `now`, s, so that the base must stand; None where none has."""
    return next((reason for reason, begun in since.items() if now - begun >= LASTING), None)
