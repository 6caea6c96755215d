"""tfg-drake kobuki, as a user calls it."""

import dataclasses
import itertools
import json
import math
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tfg_drake.diagrams.commands.kobuki import _place
from tfg_drake.hardware.emulation.emulator import Emulator, empty_plane
from tfg_drake.hardware.kobuki.codec import BaseControl


def test_emulate_prints_device_and_address_and_ends_with_the_truth():
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
        process.send_signal(signal.SIGINT)
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


@pytest.mark.slow
def test_emulate_with_sensors_of_its_own(tmp_path):
    """A scanner and a camera that drivers open as those of a robot, and what can happen to them."""
    pytest.importorskip("robotpy_apriltag", reason="robotpy-apriltag is not installed: pip install 'tfg-drake[camera]'")
    from tests.cameras import pinhole
    from tfg_drake.config import RobotCameraConfig, RobotScannerConfig
    from tfg_drake.hardware.camera_sensor import CameraDriver
    from tfg_drake.hardware.rplidar.driver import RplidarDriver
    from tfg_drake.vision.calibration import save_calibration
    from tfg_drake.vision.camera_sheet import focal_length
    from tfg_drake.vision.chessboard import board_corners
    from tfg_drake.vision.frames import frames

    command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "kobuki", "emulate", "--world", "house", "--sensors"]
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    process = subprocess.Popen(command, text=True, bufsize=1, **pipes)
    try:
        _, _, scanner, camera, board = (process.stdout.readline().strip() for _ in range(5))
        lidar = RplidarDriver(scanner.removeprefix("rplidar:"), RobotScannerConfig())
        swept = lidar.take()[0]
        assert 150 < np.isfinite(swept.ranges).sum() < 500
        save_calibration(tmp_path / "camera.yaml", pinhole(640, 480, focal_length(640, math.radians(65.0))))
        eyes = CameraDriver(camera.removeprefix("camera:"), RobotCameraConfig(str(tmp_path / "camera.yaml")))
        seen, said, end = [], [], time.monotonic() + 60.0
        while not seen and time.monotonic() < end:
            eyes.spin(0.1)
            seen += eyes.take()
        assert {94, 95} <= set(seen[0].ids.tolist())
        assert any(board_corners(frame.image, 9, 6) is not None for frame in itertools.islice(frames(board), 3))
        process.stdin.write("camera off\nlidar unplug\n")
        while len(said) < 2 and time.monotonic() < end:
            lidar.spin(0.05)
            eyes.spin(0.05)
            said += [*lidar.remarks(), *eyes.remarks()]
        assert sum("the connection is lost" in one or "no more images" in one for one in said) == 2
        lidar.close()
        eyes.close()
    finally:
        process.terminate()
        process.wait(timeout=60.0)
    assert (process.returncode, process.stderr.read()) == (0, "")


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


def test_the_world_of_a_map_file_has_tags(tmp_path):
    (tmp_path / "room.vectormap.txt").write_text("0,0,5,0\n5,0,5,4\n5,4,0,4\n0,4,0,0\n")
    scenario, world = _place(str(tmp_path / "room.vectormap.txt"))
    assert len(world.tag_ids) > 10
    assert scenario.world.walls == world.walls.tolist()
