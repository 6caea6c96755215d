"""tfg-drake kobuki, as a user calls it."""

import dataclasses
import json
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tfg_drake.hardware.emulation.emulator import Emulator, empty_plane
from tfg_drake.hardware.kobuki.payloads import BaseControl


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_emulate_prints_device_and_address_and_ends_with_the_truth(how):
    command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "kobuki", "emulate", "--world", "corridor"]
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    process = subprocess.Popen(command, text=True, bufsize=1, **pipes)
    try:
        device, address = process.stdout.readline().strip(), process.stdout.readline().strip()
        with open(device, "rb", buffering=0) as port:
            assert b"\xaa\x55" in port.read(300)
        host, port = address.split(":")
        with socket.create_connection((host, int(port)), timeout=10.0) as client:
            assert client.recv(10).startswith(b'{"type":')
        process.stdin.write("stop\nunplug\nreport\n")
        truth = json.loads(process.stdout.readline())
        assert not Path(device).is_symlink()
        process.stdin.close()
        process.send_signal(how)
        process.wait(timeout=60.0)
        at_the_end = json.loads(process.stdout.readline())
        assert (process.returncode, process.stdout.read()) == (0, "")
        complaint = "no order 'stop'; docs/kobuki_emulator.md lists those that there are"
        assert process.stderr.read() == f"tfg-drake: {complaint}\n"
    finally:
        process.kill()
        process.wait()
    assert at_the_end.pop("stamp") >= truth.pop("stamp")
    assert at_the_end == truth


def test_an_unknown_world(call):
    code, out, err = call("kobuki", "emulate", "--world", "nowhere")
    assert (code, out) == (2, "")
    assert err.startswith("tfg-drake: nowhere: no such file or scenario; name a YAML file or one of corridor,")


CHECKED = """\
firmware    1.1.4
hardware    1.0.4
id          000000010000000200000003
battery     16.5 V
charger     none
overcurrent none
bumper      none
cliff       left, right
wheel drop  none
"""


def test_check(call):
    with Emulator() as emulator:
        emulator.base.cliff = 5
        assert call("kobuki", "check", "--port", emulator.device) == (0, CHECKED, "")
        assert {command for _, command in emulator.commands} == {BaseControl(0, 0)}
        assert emulator.base.pose.tolist() == [0.0, 0.0, 0.0]


def test_check_of_a_base_that_is_plugged_in_and_one_with_a_low_battery(call):
    with Emulator() as emulator:
        emulator.base.charger, emulator.base.overcurrent = 22, 1
        code, out, _ = call("kobuki", "check", "--port", emulator.device)
        assert code == 0
        assert "charger     adapter, charging\novercurrent left\n" in out
        emulator.base.charger, emulator.base.overcurrent, emulator.base.battery = 0, 0, 139
        assert "battery     13.9 V; charge it\n" in call("kobuki", "check", "--port", emulator.device)[1]


def test_check_does_not_drive_with_a_cable_in_it(call):
    with Emulator() as emulator:
        emulator.base.charger = 18
        code, _, err = call("kobuki", "check", "--port", emulator.device, "--drive")
        assert (code, emulator.base.distance) == (2, 0.0)
        assert "the base is charging by its adapter: pull the plug, then enable it" in err


def test_check_drives_20_cm(call):
    with Emulator() as emulator:
        code, out, err = call("kobuki", "check", "--port", emulator.device, "--drive")
        assert (code, err) == (0, "")
        assert emulator.base.pose == pytest.approx([0.2, 0.0, 0.0], abs=0.01)
    line = out.splitlines()[-1]
    assert re.fullmatch(r"drive       0\.\d{3} m ahead, [+-]0\.000 m to the left, [+-]0\.0 degrees", line)


def test_check_drives_into_nothing(call):
    world = dataclasses.replace(empty_plane(), walls=np.array([[0.25, -1.0, 0.25, 1.0]]))
    with Emulator(world) as emulator:
        code, _, err = call("kobuki", "check", "--port", emulator.device, "--drive")
        complaint = "the drive was stopped by bumper, cliff or wheel drop; make room ahead of the base"
        assert (code, err) == (2, f"tfg-drake: {complaint}\n")


def test_check_without_a_base(call, tmp_path):
    code, out, err = call("kobuki", "check", "--port", tmp_path / "kobuki")
    assert (code, out) == (2, "")
    assert err.startswith(f"tfg-drake: {tmp_path}/kobuki: no such device; plug the base in and switch it on, or name")


@pytest.mark.parametrize("command", ["check", "emulate"])
def test_help(call, command):
    code, out, _ = call("kobuki", command, "--help")
    assert code == 0
    assert "Usage: tfg-drake kobuki" in out
