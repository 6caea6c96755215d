"""Faults of an emulated robot's scans and tags: functions that change a message before it is sent."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from tfg_drake.messages import FloatArray, LaserScan, TagDetections, replace

# What is sent instead of a message; None for nothing.
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


def _silent() -> Fault:
    return lambda _: None


def _scan_of(value: float) -> Callable[[], Fault]:
    """Every range is this."""
    return lambda: lambda scan: replace(scan, ranges=np.full(len(scan.ranges), value))


def _missing(share: float) -> Fault:
    """This share of the rays, another one every time, says nothing."""
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"no share of rays: {share}")
    chance = np.random.default_rng(0)
    return lambda scan: _without(scan, chance.random(len(scan.ranges)) < share)


def _blind(least: float) -> Fault:
    """Loses ranges below `least`, m."""
    return lambda scan: _without(scan, scan.ranges < least)


def _without(scan: LaserScan, which: np.ndarray[Any, np.dtype[np.bool_]]) -> LaserScan:
    return replace(scan, ranges=np.where(which, math.nan, scan.ranges))


def _none() -> Fault:
    return lambda scan: replace(scan, angles=np.zeros(0), ranges=np.zeros(0))


def _thin(number: float = 100.0) -> Fault:
    """One ray in so many."""
    step = int(number)
    if step < 1:
        raise ValueError(f"no number of rays: {number}")
    return lambda scan: replace(scan, angles=scan.angles[::step], ranges=scan.ranges[::step])


def _frozen() -> Fault:
    """The first message for ever, with new stamps."""
    first: list[LaserScan] = []

    def say(scan: LaserScan) -> LaserScan:
        if not first:
            first.append(scan)
        return replace(first[0], stamp=scan.stamp)

    return say


def _range_max(value: float) -> Fault:
    return lambda scan: replace(scan, range_max=value)


def _tag_range(value: float) -> Fault:
    """The first tag is so far away, m."""
    return lambda tags: replace(tags, range=_first(tags.range, value))


def _tag_sigma(value: float) -> Fault:
    """Every tag is as certain as this, m and rad."""

    def say(tags: TagDetections) -> TagDetections:
        certain = np.full(len(tags.ids), value)
        return replace(tags, sigma_range=certain, sigma_bearing=certain)

    return say


def _tag_id(number: float) -> Fault:
    """The first tag has this id."""
    return lambda tags: replace(tags, ids=_first(tags.ids, int(number)))


def _random_ids() -> Fault:
    chance = np.random.default_rng(0)
    return lambda tags: replace(tags, ids=chance.integers(0, 2**31, len(tags.ids)))


def _first(values: FloatArray, value: float) -> FloatArray:
    changed = values.copy()
    changed[:1] = value
    return changed


# By sensor and name: what makes the fault of its numbers.
FAULTS: dict[str, dict[str, Callable[..., Fault]]] = {
    "scan": {
        "silent": _silent,
        "nan": _scan_of(math.nan),
        "empty": _scan_of(math.inf),
        "zero": _scan_of(0.0),
        "near": _scan_of(-math.inf),
        "none": _none,
        "thin": _thin,
        "frozen": _frozen,
        "drop": _missing,
        "blind": _blind,
        "range_max": _range_max,
    },
    "tags": {
        "silent": _silent,
        "range": _tag_range,
        "sigma": _tag_sigma,
        "id": _tag_id,
        "random": _random_ids,
    },
}
