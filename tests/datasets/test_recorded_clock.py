"""Time that goes on, whatever clocks were set to."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.datasets.recorded_clock import steady, together
from tfg_drake.datasets.recording import DatasetError

TRUE = 0.05 * np.arange(400)
NONE = np.empty(0)


def delayed(seed, stamps=TRUE):
    """When messages arrive, of which none overtakes another."""
    return np.maximum.accumulate(stamps + 3.0 + 0.002 * np.random.default_rng(seed).exponential(size=len(stamps)))


@given(st.integers(0, 99), st.booleans())
def test_a_clock_that_was_not_set_is_believed(seed, recorded):
    stamps = TRUE + 1e-3 * np.random.default_rng(seed).uniform(size=len(TRUE))
    # A pause, and then a recorder that was busy for two s.
    stamps[200:] += 20.0
    arrivals = delayed(seed, stamps)
    arrivals[300:] = np.maximum(arrivals[300:], arrivals[300] + 2.0)
    times, notes = steady(stamps, arrivals if recorded else NONE, "scans")
    np.testing.assert_array_equal(times, stamps)
    assert notes == ()


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.parametrize("jump", [-0.3, -2.0, -40.0, -1.7e9, 5000.0, 1e7])
def test_a_clock_that_is_set_goes_on(jump, recorded):
    stamps, at = TRUE.copy(), 150
    stamps[at:] += jump
    times, (note,) = steady(stamps, delayed(1) if recorded else NONE, "scans")
    np.testing.assert_allclose(times, TRUE, atol=5e-3)
    assert (note.kind, note.time_s) == ("clock", pytest.approx(TRUE[at], abs=5e-3))
    assert note.text == f"the clock of scans jumps by {jump:.1f} s; time goes on"


def test_so_does_one_of_which_a_single_stamp_is_wrong():
    stamps = TRUE.copy()
    stamps[150] = 0.0
    times, notes = steady(stamps, delayed(2), "odometry")
    np.testing.assert_allclose(times, TRUE, atol=5e-3)
    assert [one.kind for one in notes] == ["clock"] * 2


@pytest.mark.parametrize("late", [1, 3, 8])
def test_messages_that_are_late_are_no_jump(late):
    order = np.concatenate([np.arange(100), np.arange(101, 101 + late), [100], np.arange(101 + late, 400)])
    arrivals = delayed(3)
    for told in (arrivals, NONE):
        times, notes = steady(TRUE[order], told, "odometry")
        np.testing.assert_array_equal(times, TRUE[order])
        assert notes == ()


def test_stamps_that_are_cut_off_are_those_of_the_recorder():
    times, (note,) = steady(np.floor(TRUE), delayed(4), "scans")
    apart = times - TRUE
    assert np.ptp(apart) < 0.03
    assert note.text == "stamps of scans are cut off; those of the recorder serve"


def test_a_clock_that_is_set_all_the_time_is_none():
    stamps = np.random.default_rng(0).uniform(0.0, 1e6, 400)
    times, (note,) = steady(stamps, delayed(5), "scans")
    np.testing.assert_allclose(np.diff(times), 0.05, atol=0.03)
    assert note.text.endswith("times; the recorder's serves")
    with pytest.raises(DatasetError, match=r"^the clock of scans jumps \d+ times; record once more"):
        steady(stamps, NONE, "scans")


@pytest.mark.parametrize("speed", [1.0, 0.6])
def test_scans_by_another_clock_are_joined_by_the_recorders(speed):
    scans, at_scans = speed * TRUE - 1.7e9, delayed(6)
    joined, (note,) = together((TRUE, scans), (delayed(7), at_scans))
    np.testing.assert_allclose(joined, TRUE, atol=0.03)
    assert note.kind == "clock"
    with pytest.raises(DatasetError, match=r"odometry is stamped 0\.0 to 20\.0 s, scans are -1.*: two clocks; record"):
        together((TRUE, scans), (NONE, NONE))


def test_scans_that_are_a_little_late_are_by_the_same_clock():
    joined, notes = together((TRUE, TRUE), (delayed(8), delayed(9) + 0.2))
    assert joined is TRUE
    assert notes == ()
    assert math.isclose(together((TRUE, TRUE + 3.0), (NONE, NONE))[0][0], 3.0)
