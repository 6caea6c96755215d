"""Faults of an emulated robot's scans and tags: functions that change a message before it is sent."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, IntArray, LaserScan, TagDetections, replace

# A function that returns what is sent instead of a message, None for nothing.
Fault = Callable[[Any], Any]


def unchanged(message: Any) -> Any:
    """No fault."""
    return message


def sensor_fault(sensor: str, name: str, numbers: Sequence[float] = ()) -> Fault:
    """A fault of "scan" or "tags" by its name and its numbers, see docs/kobuki_emulator.md; ValueError without one."""
    try:
        fault: Fault = FAULTS[sensor][name](*numbers)
    except (LookupError, TypeError):
        raise ValueError(f"no fault {name!r} of {sensor} with {len(numbers)} numbers") from None
    return fault


def _every(scan: LaserScan, value: float) -> LaserScan:
    return replace(scan, ranges=np.full(len(scan.ranges), value))


def _without(scan: LaserScan, which: BoolArray) -> LaserScan:
    return replace(scan, ranges=np.where(which, math.nan, scan.ranges))


def _some(scan: LaserScan, which: slice) -> LaserScan:
    return replace(scan, angles=scan.angles[which], ranges=scan.ranges[which])


def _first(values: FloatArray | IntArray, value: float) -> Any:
    changed = values.copy()
    changed[:1] = int(value) if changed.dtype == np.int64 else value
    return changed


def _thin(number: float = 100.0) -> Fault:
    """A fault that keeps one ray in every `number`."""
    if number < 1.0:
        raise ValueError(f"no number of rays: {number}")
    return lambda scan: _some(scan, slice(None, None, int(number)))


def _missing(share: float) -> Fault:
    """A fault that makes a share of the rays, drawn anew for every scan, unknown."""
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"no share of rays: {share}")
    chance = np.random.default_rng(0)
    return lambda scan: _without(scan, chance.random(len(scan.ranges)) < share)


def _frozen() -> Fault:
    """A fault that repeats the first message for ever, with new stamps."""
    said: list[LaserScan] = []

    def say(scan: LaserScan) -> LaserScan:
        said.append(scan)
        del said[1:]
        return replace(said[0], stamp=scan.stamp)

    return say


def _random_ids() -> Fault:
    chance = np.random.default_rng(0)
    return lambda tags: replace(tags, ids=chance.integers(0, 2**31, len(tags.ids)))


def _certain(tags: TagDetections, value: float) -> TagDetections:
    sigma = np.full(len(tags.ids), value)
    return replace(tags, sigma_range=sigma, sigma_bearing=sigma)


# Constructors of the faults by sensor and name.
FAULTS: dict[str, dict[str, Callable[..., Fault]]] = {
    "scan": {
        "silent": lambda: lambda _: None,
        "nan": lambda: lambda scan: _every(scan, math.nan),
        "empty": lambda: lambda scan: _every(scan, math.inf),
        "zero": lambda: lambda scan: _every(scan, 0.0),
        "near": lambda: lambda scan: _every(scan, -math.inf),
        "none": lambda: lambda scan: _some(scan, slice(0)),
        "thin": _thin,
        "frozen": _frozen,
        "drop": _missing,
        "blind": lambda least: lambda scan: _without(scan, scan.ranges < least),
        "range_max": lambda value: lambda scan: replace(scan, range_max=value),
    },
    "tags": {
        "silent": lambda: lambda _: None,
        "range": lambda value: lambda tags: replace(tags, range=_first(tags.range, value)),
        "sigma": lambda value: lambda tags: _certain(tags, value),
        "id": lambda number: lambda tags: replace(tags, ids=_first(tags.ids, number)),
        "random": _random_ids,
    },
}
