"""The driver against an emulated base: it moves when it may, and stops whatever happens."""

import itertools
import math
import os
import signal
import subprocess
import sys
import time

import pytest

from tfg_drake.hardware.kobuki import payloads as p
from tfg_drake.hardware.kobuki.driver import KobukiDriver
from tfg_drake.hardware.kobuki.link import KobukiError

STOP = p.BaseControl(0, 0)
# The wheels must be told to stop within 0.6 s; the rest is for a machine that has other things to do.
WITHIN = 0.6 + 0.4


def wait_for(condition, timeout=10.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def drive(driver, speed, turn_rate, seconds):
    """Commands a velocity for some time; returns when the last command was given."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        driver.command(speed, turn_rate)
        time.sleep(0.02)
    return time.monotonic()


def moves(emulator):
    return bool(emulator.commands) and emulator.commands[-1][1] != STOP


def assert_stops(emulator, begin):
    """The base is told to stop soon after `begin`, and to nothing else afterwards."""
    # Looked at until it has been standing for a while, and no longer than it may move.
    stopped = math.inf
    while time.monotonic() < min(stopped, begin + WITHIN) + 0.3:
        time.sleep(0.02)
        after = [(received, command) for received, command in list(emulator.commands) if received > begin]
        stopped = max((received for received, command in after if command != STOP), default=begin)
    assert stopped - begin < WITHIN
    assert after[-1][1] == STOP


@pytest.fixture
def driver(usb):
    with KobukiDriver(str(usb.path)) as driver:
        driver.wait_connected()
        yield driver


@pytest.fixture
def driving(usb, driver):
    """A driver whose base drives ahead."""
    driver.enable()
    drive(driver, 0.2, 0.0, 0.3)
    assert moves(usb.emulator)
    return driver


def test_what_it_reports(usb, driver):
    report = driver.report()
    assert (report.state, report.connection, report.detail) == ("disabled", 1, "")
    assert (report.firmware, report.hardware) == ("1.1.4", "1.0.4")
    assert report.unique_id == "000000010000000200000003"
    assert (report.battery, report.charging, report.bad_frames) == (16.5, False, 0)
    usb.emulator.base.cliff = 4
    wait_for(lambda: driver.report().hazards.cliff == 4)


def test_no_motion_before_it_is_enabled(usb, driver):
    drive(driver, 0.2, 0.5, 0.3)
    assert {command for _, command in usb.emulator.commands} == {STOP}
    # What was said before does not count either.
    driver.enable()
    wait_for(lambda: driver.report().state == "enabled")
    assert {command for _, command in usb.emulator.commands} == {STOP}
    drive(driver, 0.2, 0.5, 0.2)
    assert moves(usb.emulator)


def test_odometry_follows_the_base(usb, driving):
    drive(driving, 0.2, 0.6, 1.0)
    drive(driving, 0.0, 0.0, 0.8)
    wait_for(lambda: driving.report().odometry.at_rest)
    odometry, report = driving.report().odometry, driving.report()
    # The emulator's base moves from the origin of W, where dead reckoning began.
    assert pytest.approx(usb.emulator.base.pose, abs=3e-3) == odometry.X_OB
    assert math.hypot(*odometry.X_OB[:2]) > 0.2
    assert abs(odometry.stamp - time.monotonic()) < 1.0
    assert report.hazards.stamp == odometry.stamp


def test_limits(usb, driving):
    drive(driving, 9.0, 0.0, 1.0)
    speeds = [command.speed for _, command in usb.emulator.commands]
    assert max(speeds) == 300
    # 0.5 m/s^2 at 50 Hz, give or take what is cut off.
    assert max(abs(b - a) for a, b in itertools.pairwise(speeds)) <= 11


def test_lights_and_tunes(usb):
    with KobukiDriver(str(usb.path)) as driver:
        driver.wait_connected()
        wait_for(lambda: usb.emulator.base.outputs == 0x3F0)
        assert usb.emulator.base.sounds == [0]
        driver.enable()
        wait_for(lambda: usb.emulator.base.outputs == 0x2F0)
    wait_for(lambda: usb.emulator.base.outputs == 0x0F0)
    assert usb.emulator.base.sounds == [0, 1]


def test_it_stops_without_commands(usb, driving):
    assert_stops(usb.emulator, drive(driving, 0.2, 0.0, 0.1))
    drive(driving, 0.2, 0.0, 0.2)
    assert moves(usb.emulator)


def test_a_flood_of_commands_does_not_keep_it_from_its_work(usb, driving):
    begin = time.monotonic()
    while time.monotonic() < begin + 0.5:
        driving.command(0.2, 0.0)
    times = [received for received, _ in usb.emulator.commands if received > begin]
    assert len(times) > 5
    assert moves(usb.emulator)
    assert_stops(usb.emulator, time.monotonic())


def test_it_stops_at_nan(usb, driving):
    begin = time.monotonic()
    drive(driving, math.nan, 0.0, 0.2)
    assert_stops(usb.emulator, begin)
    drive(driving, 0.2, math.inf, 0.2)
    assert not moves(usb.emulator)


def test_it_stops_when_the_base_is_silent(usb, driving):
    usb.emulator.silent = True
    begin = time.monotonic()
    drive(driving, 0.2, 0.0, 0.6)
    assert_stops(usb.emulator, begin)
    wait_for(lambda: driving.report().state == "disconnected")
    complaint = f"{usb.path}: the base fell silent; switch it on and check the cable"
    assert driving.report().detail == complaint
    assert driving.report().odometry is None


def test_it_stops_at_sigterm(usb, driving):
    begin = time.monotonic()
    os.kill(driving.process_id, signal.SIGTERM)
    assert_stops(usb.emulator, begin)
    with pytest.raises(KobukiError, match="process has ended"):
        driving.report()
    with pytest.raises(KobukiError, match="process has ended"):
        driving.command(0.1, 0.0)


def test_it_stops_at_the_end(usb, driving):
    begin = time.monotonic()
    driving.close()
    assert_stops(usb.emulator, begin)


PARENT = """
import sys, time
from tfg_drake.hardware.kobuki.driver import KobukiDriver
driver = KobukiDriver(sys.argv[1])
driver.wait_connected()
driver.enable()
while True:
    driver.command(0.2, 0.0)
    time.sleep(0.02)
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_it_stops_when_its_parent_is(usb, how):
    parent = subprocess.Popen([sys.executable, "-c", PARENT, str(usb.path)])
    try:
        wait_for(lambda: moves(usb.emulator))
        begin = time.monotonic()
        parent.send_signal(how)
        assert_stops(usb.emulator, begin)
    finally:
        parent.kill()
        parent.wait()
    # The driver has gone, too, and said so.
    wait_for(lambda: usb.emulator.base.sounds == [0, 1])


def test_corrupt_frames(usb, driving):
    usb.emulator.corrupt = 0.05
    begin = drive(driving, 0.2, 0.6, 1.5)
    assert_stops(usb.emulator, begin)
    report = driving.report()
    assert report.bad_frames > 0
    assert report.state == "enabled"
    wait_for(lambda: driving.report().odometry.at_rest)
    assert pytest.approx(usb.emulator.base.pose, abs=3e-3) == driving.report().odometry.X_OB


def test_a_pulled_cable_put_back(usb, driving):
    before = driving.report().odometry.X_OB
    usb.unplug()
    wait_for(lambda: driving.report().state == "disconnected")
    assert driving.report().odometry is None
    assert "plug the base in" in driving.report().detail or "put the cable back" in driving.report().detail
    with pytest.raises(KobukiError, match=r"kobuki: "):
        driving.enable()
    emulator = usb.plug()
    end = time.monotonic() + 10.0
    while driving.report().state == "disconnected":
        assert time.monotonic() < end
        driving.command(0.2, 0.0)
        time.sleep(0.02)
    assert (driving.report().state, driving.report().connection) == ("disabled", 2)
    drive(driving, 0.2, 0.0, 0.3)
    assert {command for _, command in emulator.commands} == {STOP}
    assert driving.report().odometry.X_OB[0] >= before[0]
    driving.enable()
    drive(driving, 0.2, 0.0, 0.3)
    assert moves(emulator)


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        ("missing", "no such device; plug the base in and switch it on, or name the port it has under"),
        ("silent", "no answer at 115200 baud; switch the base on, or name its port"),
        ("garbage", "what answers there is no Kobuki at 115200 baud; name the base's port"),
        ("firmware", "firmware 2.0.1 is not supported; flash the base with a version 1.x"),
        ("folder", "is a folder; name the base's serial port"),
    ],
    ids=lambda text: text if " " not in text else "",
)
def test_what_is_wrong_is_said_on_one_line(usb, tmp_path, fault, complaint):
    path = {"missing": tmp_path / "nothing", "folder": tmp_path}.get(fault, usb.path)
    usb.emulator.silent = fault == "silent"
    usb.emulator.corrupt = 1.0 if fault == "garbage" else 0.0
    if fault == "firmware":
        usb.emulator.base.firmware = (2, 0, 1)
    with KobukiDriver(str(path)) as driver, pytest.raises(KobukiError) as caught:
        driver.wait_connected()
    assert str(caught.value).startswith(f"{path}: {complaint}")
    assert "\n" not in str(caught.value)
    assert not moves(usb.emulator)
