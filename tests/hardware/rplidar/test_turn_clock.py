"""When turns began, of arrivals that are late."""

import numpy as np
import pytest

from tfg_drake.hardware.rplidar.sweeps import TurnClock

PERIOD = 0.18


def told(arrivals):
    clock = TurnClock()
    return [clock.mark(float(arrival)) for arrival in arrivals]


def test_even_turns():
    marks = told(PERIOD * np.arange(30))
    assert marks[0] is None
    for k, (began, period) in enumerate(marks[1:], 1):
        assert (began, period) == pytest.approx((k * PERIOD, PERIOD))


def test_bytes_that_wait_shift_nothing_much():
    """On a busy machine: most some milliseconds late, one in ten a tenth of a second."""
    rng = np.random.default_rng(0)
    true = PERIOD * np.arange(2000)
    late = np.where(rng.random(2000) < 0.1, 0.1, rng.exponential(0.01, 2000))
    arrivals = np.maximum.accumulate(true + late)
    errors = np.array([began - k * PERIOD for k, (began, _) in enumerate(told(arrivals)[30:], 30)])
    assert np.abs(errors).mean() < 0.004
    assert np.quantile(np.abs(errors), 0.99) < 0.015
    assert (arrivals - true).mean() > 0.015


def test_turns_that_arrive_at_once():
    """The process was held up: what it reads then began long before."""
    true = PERIOD * np.arange(60)
    arrivals = np.where((true > 6.0) & (true < 6.7), 6.7, true)
    marks = told(arrivals)
    for k, (began, period) in enumerate(marks[1:], 1):
        assert (began, period) == pytest.approx((k * PERIOD, PERIOD))


def test_a_turn_that_was_lost():
    """Its successors seem late, but not for long."""
    marks = told(PERIOD * np.array([*range(20), *range(21, 40)]))
    assert marks[20][0] == pytest.approx(20 * PERIOD)
    for k, mark in zip(range(27, 40), marks[26:], strict=True):
        assert mark == pytest.approx((k * PERIOD, PERIOD))


def test_a_motor_that_changes_its_speed():
    arrivals = np.concatenate([0.2 * np.arange(30), 5.8 + 0.15 * np.arange(1, 40)])
    assert told(arrivals)[-1] == pytest.approx((arrivals[-1], 0.15))
