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


def faults(cores, period=0.02):
    """The fault after each of some frames."""
    since, all_of = {}, []
    for i, one in enumerate(cores):
        since = alarms.lasting(since, one, period * i)
        all_of.append(alarms.fault(since, period * i))
    return all_of


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"overcurrent": 1}, "overcurrent of the left wheel: see what blocks the wheels, then enable the base"),
        ({"overcurrent": 3}, "overcurrent of both wheels"),
        ({"charger": 22}, "the base is charging by its adapter: pull the plug, then enable it"),
        ({"charger": 6}, "the base stands in its dock: put it on the floor, then enable it"),
        ({"battery": 130}, "the battery is down to 13.2 V: charge it, then enable the base"),
    ],
)
def test_what_lasts_stops_the_base_and_what_does_not_does_not(said, words):
    there = faults([core(**said)] * 15)
    assert there[:10] == [None] * 10
    assert all(fault.startswith(words) for fault in there[11:])
    assert faults(([core(**said)] * 8 + [core()]) * 10) == [None] * 90


def test_a_low_battery_is_no_reason_to_stand():
    assert faults([core(battery=138)] * 100) == [None] * 100
