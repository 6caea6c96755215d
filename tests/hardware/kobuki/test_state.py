"""Battery, charger and current by the Kobuki's core sensors."""

import pytest

from tfg_drake.hardware.kobuki.codec import CoreSensors
from tfg_drake.hardware.kobuki.odometry import base_state


def core(charger=0, battery=165, overcurrent=0):
    return CoreSensors(0, 0, 0, 0, 0, 0, 0, 0, 0, charger, battery, overcurrent)


@pytest.mark.parametrize(
    ("tenths", "level"),
    [(165, "good"), (141, "good"), (140, "low"), (133, "low"), (132, "dangerous"), (110, "dangerous"), (0, "good")],
)
def test_the_battery_by_its_voltage(tenths, level):
    assert base_state(core(battery=tenths), 1.0).battery_level == level
    assert base_state(core(battery=tenths, charger=6), 1.0).battery_level == "good"


@pytest.mark.parametrize(("bits", "name"), [(0, ""), (2, "dock"), (6, "dock"), (18, "adapter"), (22, "adapter")])
def test_the_charger_by_its_bits(bits, name):
    assert base_state(core(charger=bits), 1.0).charger == name


def test_overcurrent_by_the_bits_of_hazards():
    assert [base_state(core(overcurrent=bits), 1.0).overcurrent for bits in range(4)] == [0, 4, 1, 5]
