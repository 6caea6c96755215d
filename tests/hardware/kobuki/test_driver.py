"""The driver against an emulated base: it moves when it may, and stops whatever happens."""

import contextlib
import errno
import itertools
import math
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from tfg_drake.hardware.device import BaseState, DeviceError
from tfg_drake.hardware.kobuki import codec as p
from tfg_drake.hardware.kobuki import driver as module
from tfg_drake.hardware.kobuki.driver import KobukiDriver, connect
from tfg_drake.hardware.watchdog import Limits
from tfg_drake.messages import Hazards, Odometry

STOP = p.BaseControl(0, 0)
# The wheels must be told to stop within 0.6 s, which test_watchdog.py tests on a clock of its own; here a machine that
# has other things to do is at most MARGIN later in one of ten times, and never later than LOADED.
WITHIN, MARGIN, LOADED = 0.6, 0.4, 5.0
# What else may lock the base on such a machine.
SILENT = "no odometry for more than 0.5 s"


def wait_for(condition, timeout=60.0):
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def drive(device, speed, turn_rate, seconds):
    """Commands a velocity for some time; returns when the last command was given."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        device.command(speed, turn_rate)
        time.sleep(0.02)
    return time.monotonic()


def moves(emulator):
    return bool(emulator.commands) and emulator.commands[-1][1] != STOP


def go(emulator, device, speed=0.2):
    """Commands a speed until the base is told so, and enables it if it is locked: odometry pauses on a busy machine."""

    def goes():
        if device.locked:
            with contextlib.suppress(DeviceError):
                device.enable()
        drive(device, speed, 0.0, 0.3)
        return moves(emulator) and emulator.commands[-1][1].speed * speed > 0

    wait_for(goes)


def told_since(emulator, begin):
    """What the wheels have been told since `begin`."""
    return {command for received, command in list(emulator.commands) if received > begin}


def assert_stops(emulator, begin):
    """The base is told to stop soon after `begin`, and to nothing else from then on. Returns how soon."""
    stopped = math.inf
    # Looked at until it has been standing for a while, and no longer than it may move.
    while time.monotonic() < min(stopped, begin + LOADED) + 0.4:
        time.sleep(0.02)
        stopped = math.inf
        for received, command in list(emulator.commands):
            stopped = min(stopped, received) if command == STOP else math.inf
    assert stopped - begin < LOADED
    return stopped - begin


@pytest.fixture
def device(emulator):
    with connect(emulator.device) as device:
        wait_for(lambda: all(device.newest(kind) for kind in (Odometry, Hazards, BaseState)))
        yield device


@pytest.fixture
def driving(emulator, device):
    """A device whose base drives ahead."""
    go(emulator, device)
    return device


def test_what_the_base_says_of_itself(emulator, device):
    assert device.locked == "not enabled yet"
    state = device.newest(BaseState)
    assert (state.firmware, state.hardware, state.unique_id) == ("1.1.4", "1.0.4", "000000010000000200000003")
    assert (state.battery, state.battery_level, state.charger, state.charging) == (16.5, "good", "", False)
    assert (state.overcurrent, state.buttons, state.lost) == (0, 0, 0.0)
    emulator.base.cliff = 4
    wait_for(lambda: device.newest(Hazards).cliff == 4)


def test_wheels_that_do_not_turn_as_they_are_told_lock_the_base(emulator, driving):
    emulator.base.stuck.add("encoders")
    wait_for(lambda: drive(driving, 0.2, 0.0, 0.2) and driving.locked)
    assert driving.locked.startswith("the wheels were told to turn and do not")
    emulator.base.stuck.discard("encoders")
    go(emulator, driving)
    drive(driving, 0.2, 0.0, 1.5)
    assert driving.locked in (None, SILENT)


def test_what_the_base_says_against_driving_stops_it_until_it_is_over_and_enabled_anew(emulator, driving):
    """test_watchdog.py has all that it may say."""
    words, before = "overcurrent of the right wheel: see what blocks the wheels", emulator.base.overcurrent
    begin = time.monotonic()
    emulator.base.overcurrent = 2
    assert_stops(emulator, begin)
    wait_for(lambda: (driving.locked or "").startswith(words))
    with pytest.raises(DeviceError, match=words):
        driving.enable()
    emulator.base.overcurrent = before
    time.sleep(0.2)
    assert driving.locked.startswith(words)
    go(emulator, driving)


def test_a_base_in_its_dock_is_not_enabled(emulator, device):
    emulator.base.charger = 2
    wait_for(lambda: device.newest(BaseState).charger == "dock")
    wait_for(lambda: "dock" in device.locked)
    assert not device.newest(BaseState).charging
    with pytest.raises(DeviceError, match="the robot is not enabled: the base stands in its dock"):
        device.enable()


def test_no_press_of_a_button_is_lost(emulator, device):
    pressed = [1, 0, 4, 6, 0]
    for buttons in pressed:
        emulator.base.buttons = buttons
        wait_for(lambda buttons=buttons: device.newest(BaseState).buttons == buttons)
    states = device.take(BaseState, math.inf)
    assert [buttons for buttons, _ in itertools.groupby(state.buttons for state in states)] == [0, *pressed]


def test_no_motion_before_it_is_enabled(emulator, device):
    drive(device, 0.2, 0.5, 0.3)
    assert told_since(emulator, 0.0) == {STOP}
    # What was said before does not count either.
    device.enable()
    time.sleep(0.1)
    assert told_since(emulator, 0.0) == {STOP}
    go(emulator, device)


def test_odometry_follows_the_base(emulator, driving):
    wait_for(lambda: drive(driving, 0.2, 0.6, 0.5) and math.hypot(*emulator.base.pose[:2]) > 0.25)
    drive(driving, 0.0, 0.0, 0.8)
    wait_for(lambda: driving.newest(Odometry).at_rest)
    odometry = driving.newest(Odometry)
    # The emulator's base moves from the origin of W, where dead reckoning began.
    assert pytest.approx(emulator.base.pose, abs=3e-3) == odometry.X_OB
    assert math.hypot(*odometry.X_OB[:2]) > 0.2
    assert abs(odometry.stamp - time.monotonic()) < 10.0
    stamps = [one.stamp for one in driving.take(Odometry, math.inf)]
    assert (np.diff(stamps) > 0.0).all()
    assert np.median(np.diff(stamps)) == pytest.approx(0.02, abs=1e-3)


def test_limits(emulator, driving):
    wait_for(lambda: drive(driving, 9.0, 0.0, 0.5) and emulator.commands[-1][1].speed >= 300)
    speeds = [command.speed for _, command in emulator.commands]
    assert max(speeds) == 300
    # 0.5 m/s^2 at ticks of 20 ms, the odd one late.
    assert max(abs(b - a) for a, b in itertools.pairwise(speeds)) <= 21


def test_lights_and_tunes(emulator):
    with connect(emulator.device) as device:
        wait_for(lambda: emulator.base.outputs == 0x3F0)
        assert emulator.base.sounds == [0]
        device.enable()
        wait_for(lambda: emulator.base.outputs == 0x2F0)
    wait_for(lambda: emulator.base.outputs == 0x0F0)
    assert emulator.base.sounds == [0, 1]


def test_it_stops_without_commands(emulator, driving):
    took = []
    while not took or (took[-1] >= WITHIN + MARGIN and len(took) < 10):
        go(emulator, driving)
        took.append(assert_stops(emulator, drive(driving, 0.2, 0.0, 0.1)))
        assert driving.locked in (None, SILENT)
    assert took[-1] < WITHIN + MARGIN
    # It goes on by itself.
    wait_for(lambda: (drive(driving, 0.2, 0.0, 0.2) and moves(emulator)) or driving.locked == SILENT)


def test_a_flood_of_commands_does_not_keep_it_from_its_work(emulator, driving):
    begin = time.monotonic()
    sent = 0
    while time.monotonic() < begin + (0.5 if sent > 5 else 60.0):
        for _ in range(100):
            with contextlib.suppress(DeviceError):
                driving.command(0.2, 0.0)
        sent = sum(received > begin and command != STOP for received, command in list(emulator.commands)[-50:])
    assert sent > 5
    assert_stops(emulator, time.monotonic())


def test_it_stops_at_nan(emulator, driving):
    begin = time.monotonic()
    drive(driving, math.nan, 0.0, 0.2)
    assert_stops(emulator, begin)
    drive(driving, 0.2, math.inf, 0.2)
    assert not moves(emulator)


@pytest.mark.parametrize(
    ("hazard", "words"),
    [
        ("wheel_drop", "a wheel hangs: put the robot on its wheels, then enable it"),
        ("cliff", "a cliff: carry the robot away from it, then enable it"),
    ],
)
def test_after_a_wheel_drop_or_a_cliff_it_must_be_enabled_anew(emulator, driving, hazard, words):
    setattr(emulator.base, hazard, 2)
    begin = time.monotonic()
    drive(driving, -0.2, 0.5, 0.5)
    assert_stops(emulator, begin)
    wait_for(lambda: getattr(driving.newest(Hazards), hazard))
    assert driving.locked in (words, SILENT)
    with pytest.raises(DeviceError, match=words):
        driving.enable()
    over = time.monotonic()
    setattr(emulator.base, hazard, 0)
    wait_for(lambda: not getattr(driving.newest(Hazards), hazard))
    drive(driving, 0.2, 0.0, 0.5)
    assert told_since(emulator, over) == {STOP}
    assert driving.locked == words
    go(emulator, driving)


def test_a_gyro_that_jumps_locks_the_base_and_is_not_believed(emulator, driving):
    emulator.base.turned += 0.5 * math.pi
    wait_for(lambda: drive(driving, 0.2, 0.0, 0.1) and driving.locked)
    assert "its gyro turned by 90 degrees in 0.0" in driving.locked or driving.locked == SILENT
    go(emulator, driving)
    assert abs(driving.newest(Odometry).X_OB[2]) < 0.1


def test_a_gyro_that_is_held_against_the_wheels_while_the_base_is_driven(emulator, driving, monkeypatch):
    # Who turns it by hand while it stands does not lock it: at 2.5 rad/s of the base's own time.
    step = emulator.base.step

    def turned_by_hand():
        emulator.base.turned += 0.05
        step()

    drive(driving, 0.0, 0.0, 0.3)
    with monkeypatch.context() as patch:
        patch.setattr(emulator.base, "step", turned_by_hand)
        drive(driving, 0.0, 0.0, 1.0)
    assert driving.locked in (None, SILENT)
    # A dead gyro that flickers.
    emulator.base.stuck.add("gyro")

    def locked():
        emulator.base.turned += np.random.default_rng().choice([-2e-4, 2e-4])
        return drive(driving, 0.0, 1.0, 0.02) and driving.locked

    go(emulator, driving)
    wait_for(locked)
    assert driving.locked.startswith("the gyro does not turn with the wheels") or driving.locked == SILENT


def test_a_pressed_bumper_allows_to_back(emulator, driving):
    emulator.base.bumper = 2
    begin = time.monotonic()
    drive(driving, 0.2, 0.0, 0.5)
    assert_stops(emulator, begin)
    go(emulator, driving, -0.2)


def test_it_stops_when_the_base_is_silent(emulator, driving):
    emulator.silent = True
    begin = time.monotonic()
    drive(driving, 0.2, 0.0, 0.6)
    assert_stops(emulator, begin)
    complaint = f"{emulator.device}: the base fell silent; switch it on and check the cable"
    wait_for(lambda: driving.locked == complaint)


# Who ends in order and who does not.
ENDS = [signal.SIGTERM, *(pytest.param(one, marks=pytest.mark.slow) for one in (signal.SIGINT, signal.SIGHUP))]


@pytest.mark.parametrize("how", [*ENDS, signal.SIGKILL])
def test_it_stops_when_its_process_ends(emulator, driving, how):
    begin = time.monotonic()
    os.kill(driving._process.pid, how)
    assert_stops(emulator, begin)
    wait_for(lambda: driving.locked == "the robot's process has ended")
    with pytest.raises(DeviceError, match="process has ended"):
        driving.command(0.1, 0.0)
    # The port is free again.
    with connect(emulator.device) as another:
        go(emulator, another)


def test_it_stops_when_its_process_freezes(emulator, driving):
    took = []
    while not took or (took[-1] >= WITHIN + MARGIN and len(took) < 10):
        go(emulator, driving)
        begin = time.monotonic()
        os.kill(driving._process.pid, signal.SIGSTOP)
        try:
            took.append(assert_stops(emulator, begin))
        finally:
            os.kill(driving._process.pid, signal.SIGCONT)
    assert took[-1] < WITHIN + MARGIN


def test_a_frozen_process_ends_nothing_and_moves_nothing_when_it_runs_again(emulator, driving):
    os.kill(driving._process.pid, signal.SIGSTOP)
    drive(driving, 0.2, 0.0, 4.0)  # more commands than its pipe holds
    assert driving.locked == "the robot's process does not answer"
    with pytest.raises(DeviceError, match=r"^the robot is not enabled: the robot's process does not answer$"):
        driving.enable()
    begin = time.monotonic()
    os.kill(driving._process.pid, signal.SIGCONT)
    drive(driving, 0.2, 0.0, 1.0)
    # The command that it was about to send when it froze still goes out.
    assert told_since(emulator, begin + 0.1) == {STOP}
    assert driving.locked
    go(emulator, driving)


@pytest.mark.parametrize(("how", "what"), [(signal.SIGKILL, "has ended"), (signal.SIGSTOP, "does not answer")])
def test_it_stops_without_its_guardian(emulator, driving, how, what):
    children = f"/proc/{driving._process.pid}/task/{driving._process.pid}/children"
    with open(children) as file:
        (guardian,) = file.read().split()
    begin = time.monotonic()
    os.kill(int(guardian), how)
    drive(driving, 0.2, 0.0, 0.8)
    assert_stops(emulator, begin)
    wait_for(lambda: f"in an emergency {what}; enable the base again" in (driving.locked or ""))


def test_it_goes_on_where_no_guardian_could_be_started_for_a_while(emulator, monkeypatch):
    driver, guardian, failures = KobukiDriver(emulator.device, Limits()), module.Guardian, 2

    def poor(port):
        nonlocal failures
        if failures:
            failures -= 1
            raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
        return guardian(port)

    def tell():
        driver.spin(0.02)
        driver.send(0.1, 0.0)
        return driver.fault() or ""

    monkeypatch.setattr(module, "Guardian", poor)
    try:
        os.kill(driver._guardian._process.pid, signal.SIGKILL)
        lacks = "no process can be started to stop it in an emergency: Too many open files; end other programs"
        wait_for(lambda: tell() == f"{emulator.device}: {lacks}")
        assert emulator.commands[-1][1] == STOP
        wait_for(lambda: not tell() and moves(emulator))
        assert not failures
    finally:
        driver.close()


def test_it_stops_at_the_end(emulator, driving):
    begin = time.monotonic()
    driving.close()
    assert_stops(emulator, begin)


PARENT = """
import sys, time
from tfg_drake.hardware.kobuki.driver import connect
device = connect(sys.argv[1])
device.enable()
while True:
    device.command(0.2, 0.0)
    time.sleep(0.02)
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.slow)])
def test_it_stops_when_its_parent_is(emulator, how):
    parent = subprocess.Popen([sys.executable, "-c", PARENT, emulator.device])
    try:
        wait_for(lambda: moves(emulator))
        begin = time.monotonic()
        parent.send_signal(how)
        assert_stops(emulator, begin)
    finally:
        parent.kill()
        parent.wait()
    # The driver has gone, too, and said so.
    wait_for(lambda: emulator.base.sounds == [0, 1])


def test_corrupt_frames(emulator, driving):
    emulator.corrupt = 0.05
    begin = drive(driving, 0.2, 0.6, 1.5)
    assert_stops(emulator, begin)
    wait_for(lambda: driving.newest(BaseState).lost > 0.0)
    assert driving.locked in (None, SILENT)
    wait_for(lambda: driving.newest(Odometry).at_rest)
    assert pytest.approx(emulator.base.pose, abs=3e-3) == driving.newest(Odometry).X_OB


def test_a_pulled_cable_put_back(emulator, driving):
    before = driving.newest(Odometry)
    emulator.unplug()
    complaint = f"{emulator.device}: the connection broke; put the cable back and switch the base on"
    wait_for(lambda: driving.locked == complaint)
    with pytest.raises(DeviceError, match=f"^the robot is not enabled: {emulator.device}: "):
        driving.enable()
    plugged = time.monotonic()
    emulator.plug()
    end = plugged + 60.0
    while driving.newest(Odometry).stamp < plugged:
        assert time.monotonic() < end
        driving.command(0.2, 0.0)
        time.sleep(0.02)
    assert driving.locked == complaint
    drive(driving, 0.2, 0.0, 0.3)
    assert told_since(emulator, plugged) == {STOP}
    assert driving.newest(Odometry).X_OB[0] >= before.X_OB[0]
    go(emulator, driving)


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        ("missing", "no such device; plug the base in and switch it on, or name the port it has under"),
        ("silent", "no answer at 115200 baud; switch the base on, or name its port"),
        ("garbage", "what answers there is no Kobuki at 115200 baud; name the base's port"),
        ("firmware", "firmware 2.0.1 is not supported; flash the base with a version 1.x"),
        ("folder", "is a folder; name the serial port of the base"),
    ],
    ids=lambda text: text if " " not in text else "",
)
def test_what_is_wrong_is_said_on_one_line(emulator, tmp_path, fault, complaint):
    path = {"missing": tmp_path / "nothing", "folder": tmp_path}.get(fault, emulator.device)
    emulator.silent = fault == "silent"
    emulator.corrupt = 1.0 if fault == "garbage" else 0.0
    if fault == "firmware":
        emulator.base.firmware = (2, 0, 1)
    with pytest.raises(DeviceError) as caught:
        connect(str(path))
    assert str(caught.value).startswith(f"{path}: {complaint}")
    assert "\n" not in str(caught.value)
    assert not emulator.commands
