"""Stamps of one recording, written in each unit, come back in seconds."""

import numpy as np
import pytest

from tfg_drake.io.clock_unit import UNITS, clock_unit, in_seconds


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("begin", [0.0, 100.0, 1.7e3, 1.3e9, 1.69e9])
@pytest.mark.parametrize("rate", [1.0, 5.0, 30.0, 100.0])
def test_the_unit_is_told_by_size_and_steps(unit, begin, rate):
    if unit != "s" and rate == 1.0 and begin < 1e9:
        rate = 2.0  # a step of 10^6 is 1 s of us or 1 ms of ns
    stamps = begin + np.arange(40) / rate
    found, notes = in_seconds(np.round(stamps / UNITS[unit]) if unit != "s" else stamps)
    np.testing.assert_allclose(found, stamps, atol=1e-3)
    assert notes == (() if unit == "s" else (f"stamps read as {unit}",))


@pytest.mark.parametrize(
    ("stamps", "unit"),
    [
        ([], "s"),
        ([17.25], "s"),
        ([1.69e18], "ns"),
        ([1.69e12], "ms"),
        (np.arange(20), "s"),  # a count
        ([0, 20, 30], "s"),
        (1.7e9 + 10.0 * np.arange(50), "s"),  # a picture every 10 s
        (33.3 * np.arange(50), "ms"),
        (np.repeat(1e8 * np.arange(5), 3), "ns"),
    ],
)
def test_what_stamps_count_in(stamps, unit):
    assert clock_unit(np.array(stamps, dtype=float)) == unit
