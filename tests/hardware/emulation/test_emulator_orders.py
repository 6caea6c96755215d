"""What can be made to happen to an emulated base."""

import json
import os

import numpy as np
import pytest

from tfg_drake.hardware.emulation.emulator import order
from tfg_drake.messages import LaserScan


def test_bits(emulator):
    base = emulator.base
    for line, expected in [
        ("press bumper left", (4, 0, 0, 0)),
        ("press bumper right\n", (5, 0, 0, 0)),
        ("release bumper left", (1, 0, 0, 0)),
        ("press button 0", (1, 0, 0, 1)),
        ("press button 2", (1, 0, 0, 5)),
        ("release button 0", (1, 0, 0, 4)),
        ("open cliff centre", (1, 2, 0, 4)),
        ("drop wheel", (1, 2, 3, 4)),
        ("raise wheel right", (1, 2, 2, 4)),
        ("drop wheel left", (1, 2, 2, 4)),
        ("close cliff centre", (1, 0, 2, 4)),
    ]:
        assert order(emulator, line) is None
        assert (base.bumper, base.cliff, base.wheel_drop, base.buttons) == expected
    core = base.feedback()[0]
    assert (core.bumper, core.cliff, core.wheel_drop, core.buttons) == (1, 0, 2, 4)


def test_silence_and_what_happens_to_frames(emulator):
    for line in ("silent on", "corrupt 0.05", "lost 0.6", "late 0.1"):
        order(emulator, line)
    assert (emulator.silent, emulator.corrupt, emulator.lost, emulator.late) == (True, 0.05, 0.6, 0.1)
    for line in ("silent off", "corrupt 0", "lost 0", "late 0"):
        order(emulator, line)
    assert (emulator.silent, emulator.corrupt, emulator.lost, emulator.late) == (False, 0.0, 0.0, 0.0)


def test_a_base_that_is_carried_notices_nothing(emulator):
    def wheels_and_gyro():
        core, inertia, *_ = emulator.base.feedback()
        return core.left_encoder, core.right_encoder, inertia.angle

    before = wheels_and_gyro()
    assert order(emulator, "carry 3,-1.5,0.5") is None
    np.testing.assert_array_equal(emulator.base.pose, [3.0, -1.5, 0.5])
    assert wheels_and_gyro() == before
    for line in ("carry 3,1", "carry 3,nan,0", "carry here", "carry"):
        with pytest.raises(ValueError, match="no order"):
            order(emulator, line)


def test_faults_of_the_sensors(emulator):
    seen = LaserScan(1.0, np.zeros(1), np.ones(1), 10.0, 0.015)
    order(emulator, "scan silent")
    assert emulator.base.faults["scan"](seen) is None
    order(emulator, "scan drop 1")
    assert np.isnan(emulator.base.faults["scan"](seen).ranges).all()
    order(emulator, "tags range 1e200")
    assert set(emulator.base.faults) == {"scan", "tags"}
    order(emulator, "scan well")
    order(emulator, "scan well")
    assert set(emulator.base.faults) == {"tags"}


def test_the_bases_power_and_clock(emulator):
    base = emulator.base
    for line in ("battery 13.0", "dock", "overcurrent both", "clock -2", "stick gyro", "stick encoders"):
        assert order(emulator, line) is None
    core = base.feedback()[0]
    assert (core.battery, core.charger, core.overcurrent) == (130, 6, 3)
    assert (base.clock, base.stuck) == (-2.0, {"gyro", "encoders"})
    for line in ("undock", "overcurrent none", "clock 2", "free gyro", "free encoders"):
        order(emulator, line)
    assert (base.charger, base.overcurrent, base.clock, base.stuck) == (0, 0, 0.0, set())


def test_the_cable(emulator):
    for line in ("unplug", "unplug", "plug", "plug"):
        assert order(emulator, line) is None
        assert os.path.exists(emulator.device) == (line == "plug")


def test_report(emulator):
    report = json.loads(order(emulator, "report"))
    assert (report["pose"], report["contacts"], report["distance"]) == ([0.0, 0.0, 0.0], 0, 0.0)
    assert report["stamp"] > 0.0


@pytest.mark.parametrize(
    "line",
    [
        *("silent", "corrupt", "corrupt x", "corrupt 2", "press bumper", "press button 3", "drop wheel centre", "?"),
        *("lost 2", "battery 30", "clock inf", "overcurrent", "scan", "scan loud", "scan drop 2", "tags range inf"),
    ],
)
def test_what_it_does_not_know(emulator, line):
    with pytest.raises(ValueError, match=r"^no order '.*'; docs/kobuki_emulator.md lists those that there are$"):
        order(emulator, line)


def test_an_empty_line(emulator):
    assert order(emulator, "\n") is None
