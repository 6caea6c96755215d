"""What the Kobuki says of battery, charger and current."""

import pytest

from tfg_drake.hardware.kobuki import alarms
from tfg_drake.hardware.kobuki.codec import CoreSensors


def core(charger=0, battery=165, overcurrent=0):
    return CoreSensors(0, 0, 0, 0, 0, 0, 0, 0, 0, charger, battery, overcurrent)


@pytest.mark.parametrize(
    ("tenths", "level"),
    [(165, "good"), (141, "good"), (140, "low"), (133, "low"), (132, "dangerous"), (110, "dangerous"), (0, "good")],
)
def test_the_battery_by_its_voltage(tenths, level):
    assert alarms.battery_level(core(battery=tenths)) == level
    assert alarms.battery_level(core(battery=tenths, charger=6)) == "good"


@pytest.mark.parametrize(("bits", "name"), [(0, ""), (2, "dock"), (6, "dock"), (18, "adapter"), (22, "adapter")])
def test_the_charger_by_its_bits(bits, name):
    assert alarms.charger(core(charger=bits)) == name


def test_overcurrent_by_the_bits_of_hazards():
    assert [alarms.overcurrent(core(overcurrent=bits)) for bits in range(4)] == [0, 4, 1, 5]
