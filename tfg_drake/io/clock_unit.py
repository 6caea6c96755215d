"""Stamps of files in seconds: which unit they count in is told by how large they are and how far apart."""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import FloatArray

UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# Seconds since 1970 in 2001 and in 2096; greatest time between two stamps of a recording, s.
_FIRST, _LAST, _APART = 1e9, 4e9, 1000.0
# Stamps since a start are in a unit if they are this many of it apart, or more, this many times: 100 images or 500 rows
# a second. A few stamps may as well be 10 s apart.
_STEPS = {"ns": (2e6, 1), "us": (2e3, 1), "ms": (10.0, 10)}


def clock_unit(stamps: FloatArray) -> str:
    """The unit, of UNITS, that stamps (n,) count in."""
    latest = float(np.max(np.abs(stamps), initial=0.0))
    apart = np.diff(np.unique(stamps))
    step = float(np.median(apart)) if len(apart) else 0.0
    for name, unit in UNITS.items():
        if _FIRST <= latest * unit <= _LAST and step * unit < _APART:
            return name
    return next((name for name, (least, times) in _STEPS.items() if step >= least and len(apart) >= times), "s")


def in_seconds(stamps: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Stamps (n,) in s, and a line that says what they were taken for, or none where that is s."""
    unit = clock_unit(stamps)
    return stamps * UNITS[unit], () if unit == "s" else (f"stamps read as {unit}",)
