"""Every fault stops the wheels of an emulated TurtleBot: those that both transports meet, on one of them."""

import math
import os
import signal
import time

import pytest

from tfg_drake.hardware.device import DeviceError

# The robot is told to stop within 0.6 s, which test_watchdog.py tests on a clock of its own; the rest is for a loaded
# machine, which is not so late ten times.
STOP, MARGIN, LOADED = 0.6, 0.4, 5.0
# What else may lock a robot on a loaded machine.
SILENT = "no odometry for more than 0.5 s"


@pytest.fixture(scope="module")
def transport(ros2):
    return ros2


def test_commands_that_stop(driving, transport):
    took = []
    while not took or (min(took) >= STOP + MARGIN and len(took) < 10):
        transport.go(driving)
        last = transport.drive(driving, 0.2, 0.0, 0.8)
        took.append(transport.stop_after(last))
        assert driving.locked in (None, SILENT)
    assert min(took) < STOP + MARGIN
    assert max(took) < LOADED
    # It goes on by itself.
    stood = transport.last_motion_told()
    transport.wait_for(
        lambda: (
            transport.drive(driving, 0.1, 0.0, -0.8)
            and (transport.last_motion_told() > stood or driving.locked == SILENT)
        )
    )


def test_a_command_that_is_not_a_number(driving, transport):
    last = time.monotonic()
    transport.drive(driving, 1.0, 0.1, math.nan)
    assert transport.stop_after(last) < LOADED


def test_enabling_is_refused_without_odometry(device, transport):
    transport.order("silent", ["odometry"])
    transport.wait_for(lambda: not transport.fresh(device))
    time.sleep(0.5)
    with pytest.raises(DeviceError, match=r"^the robot is not enabled: no odometry for more than 0\.5 s$"):
        device.enable()
    transport.order("silent", [])
    transport.wait_for(lambda: transport.fresh(device))


def test_a_parent_that_freezes_or_is_killed(transport):
    parent = transport.parent()
    try:
        frozen = time.monotonic()
        os.kill(parent.pid, signal.SIGSTOP)
        assert transport.stop_after(frozen) < LOADED
        os.kill(parent.pid, signal.SIGCONT)
        transport.wait_for(lambda: transport.last_motion_told() > frozen + 0.8)
    finally:
        killed = time.monotonic()
        parent.kill()
        parent.wait()
    assert transport.stop_after(killed) < LOADED


def test_close_stops_the_robot(transport):
    with transport.connect() as device:
        transport.go(device)
        closed = time.monotonic()
    assert transport.stop_after(closed) < LOADED
    assert device.locked == "closed"
    with pytest.raises(DeviceError, match=r"^closed$"):
        device.command(0.0, 0.0)
