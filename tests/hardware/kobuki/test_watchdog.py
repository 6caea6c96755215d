"""The rules of what a base may be told, by themselves."""

import dataclasses
import math

import pytest

from tfg_drake.hardware.kobuki import payloads as p
from tfg_drake.hardware.kobuki.link import Request
from tfg_drake.hardware.kobuki.watchdog import COMMAND_TIMEOUT, FEEDBACK_TIMEOUT, allowed_velocity
from tfg_drake.hardware.watchdog import Limits

CORE = p.CoreSensors(0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 165, 0)
NOW = 100.0


def allowed(speed=0.2, turn_rate=0.5, before=(0.2, 0.5), age=0.0, silence=0.0, **core):
    wanted = Request(NOW - age, speed=speed, turn_rate=turn_rate)
    return allowed_velocity(before, wanted, NOW, NOW - silence, dataclasses.replace(CORE, **core), Limits(), 0.02)


def test_a_fresh_command_is_followed():
    assert allowed() == (0.2, 0.5)
    assert allowed(age=0.9 * COMMAND_TIMEOUT, silence=0.9 * FEEDBACK_TIMEOUT) == (0.2, 0.5)


@pytest.mark.parametrize(
    "what",
    [
        {"age": COMMAND_TIMEOUT + 0.01},
        {"silence": FEEDBACK_TIMEOUT + 0.01},
        {"speed": math.nan},
        {"turn_rate": math.nan},
        {"speed": math.inf},
        {"turn_rate": -math.inf},
        {"wheel_drop": 1},
    ],
)
def test_it_stops_at_once(what):
    assert allowed(**what) == (0.0, 0.0)
    assert COMMAND_TIMEOUT + 0.04 < 0.6


def test_it_stops_without_a_command_and_without_a_frame():
    assert allowed_velocity((0.2, 0.0), None, NOW, NOW, CORE, Limits(), 0.02) == (0.0, 0.0)
    assert allowed_velocity((0.2, 0.0), Request(NOW), NOW, NOW, None, Limits(), 0.02) == (0.0, 0.0)


@pytest.mark.parametrize("hazard", [{"bumper": 2}, {"cliff": 1}])
def test_a_hazard_ahead_allows_only_to_back_away(hazard):
    assert allowed(**hazard) == (0.0, 0.5)
    assert allowed(speed=-0.2, before=(-0.2, 0.5), **hazard) == (-0.2, 0.5)


def test_limits():
    assert allowed(9.0, -9.0, before=(0.3, -1.5)) == (0.3, -1.5)
    assert allowed(9.0, -9.0, before=(0.0, 0.0)) == pytest.approx((0.01, -0.07))
    assert allowed(0.0, 0.0, before=(0.3, 1.5)) == pytest.approx((0.29, 1.43))
