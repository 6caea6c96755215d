"""What can be made to happen to an emulated base."""

import json
import os

import pytest

from tfg_drake.hardware.kobuki.emulator_orders import order


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


def test_silence_and_corruption(emulator):
    order(emulator, "silent on")
    order(emulator, "corrupt 0.05")
    assert (emulator.silent, emulator.corrupt) == (True, 0.05)
    order(emulator, "silent off")
    order(emulator, "corrupt 0")
    assert (emulator.silent, emulator.corrupt) == (False, 0.0)


def test_muted_sensors(emulator):
    for line, muted in (("mute scan", {"scan"}), ("mute tags", {"scan", "tags"}), ("unmute scan", {"tags"})):
        order(emulator, line)
        assert emulator.muted == muted


def test_the_cable(emulator):
    for line in ("unplug", "unplug", "plug", "plug"):
        assert order(emulator, line) is None
        assert os.path.exists(emulator.device) == (line == "plug")


def test_report(emulator):
    report = json.loads(order(emulator, "report"))
    assert (report["pose"], report["contacts"], report["distance"]) == ([0.0, 0.0, 0.0], 0, 0.0)
    assert report["stamp"] > 0.0


@pytest.mark.parametrize(
    "line", ["silent", "corrupt", "corrupt x", "corrupt 2", "press bumper", "press button 3", "drop wheel centre", "?"]
)
def test_what_it_does_not_know(emulator, line):
    with pytest.raises(ValueError, match=r"^no order '.*'; docs/kobuki_emulator.md lists those that there are$"):
        order(emulator, line)


def test_an_empty_line(emulator):
    assert order(emulator, "\n") is None
