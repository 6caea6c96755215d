"""Emulated TurtleBots in processes of their own, on each transport: they keep real time, so none is left running when
the tests of a file have ended."""

import contextlib
import functools
import os
import runpy
import subprocess
import sys
import time
from multiprocessing import Pipe
from pathlib import Path
from types import SimpleNamespace

import pytest

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.ros.graph_driver import connect
from tfg_drake.hardware.ros.preset import load_preset
from tfg_drake.hardware.sensor_source import SourceSpec, open_sources
from tfg_drake.messages import Odometry

HERE = Path(__file__).parent


class Transport:
    """An emulated TurtleBot on one transport, and the ways to it. Times are the host's monotonic clock, s."""

    preset = load_preset("emulated")

    def __init__(self, name):
        self.name = name
        self._connection, theirs = Pipe()
        command = [sys.executable, str(HERE / f"{name}_turtlebot.py"), str(theirs.fileno())]
        self._process = subprocess.Popen(command, pass_fds=[theirs.fileno()])
        theirs.close()
        assert self._connection.poll(180.0), "the emulated robot did not begin"
        self.port = self._connection.recv()

    @functools.cached_property
    def device(self):
        """The base, to share."""
        return self.connect()

    @functools.cached_property
    def source(self):
        """The tags and scans, and what publishes, to share."""
        return open_sources({}, self.preset, self.graph)["base"]

    @property
    def graph(self):
        """Where the robot is."""
        return SourceSpec("ros2") if self.port is None else SourceSpec("rosbridge", "localhost", self.port)

    def arguments(self):
        """Of connect, besides the preset."""
        return () if self.port is None else ("localhost", self.port)

    def connect(self, preset=None):
        """A device for the robot."""
        return connect(preset or self.preset, *self.arguments())

    def parent(self):
        """Another process that drives the robot for ever, once it does."""
        arguments = [str(value) for value in self.arguments()]
        process = subprocess.Popen([sys.executable, str(HERE / "driving_parent.py"), *arguments])
        began = time.monotonic()
        self.wait_for(lambda: self.last_motion_told() > began, 60.0)
        return process

    def order(self, name, value=None):
        """What the robot answers, see emulated.orders."""
        self._connection.send((name, value))
        return self._connection.recv()

    def last_motion_told(self):
        """When the robot was last told to move."""
        return self.order("moved")

    def stop_after(self, fault):
        """How long after the fault the robot was last told to move; it has been told to stand for half a second."""
        self.wait_for(lambda: time.monotonic() - self.order("stands", fault) > 0.5)
        last = self.last_motion_told()
        assert last > fault - 10.0, "it did not move before the fault"
        print(f"{self.name}: last motion {last - fault:.3f} s after the fault")
        return last - fault

    def go(self, device):
        """Turns the robot until it is told so, and enables it if it is locked: on a loaded machine odometry pauses."""
        began = time.monotonic()

        def moves():
            if device.locked:
                with contextlib.suppress(DeviceError):
                    device.enable()
            self.drive(device, 0.3, 0.0, 0.8)
            return self.last_motion_told() > began

        self.wait_for(moves)

    def close(self):
        """Ends the robot, and what was shared."""
        for shared in ("device", "source"):
            if shared in self.__dict__:
                self.__dict__[shared].close()
        self._connection.close()
        self._process.wait(10.0)

    @staticmethod
    def fresh(device):
        """Whether odometry arrives."""
        odometry = device.newest(Odometry)
        return odometry is not None and time.monotonic() - odometry.stamp < 0.3

    @staticmethod
    def wait_for(condition, timeout=60.0):
        """Waits until the condition holds."""
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, "in vain"
            time.sleep(0.02)

    @staticmethod
    def drive(device, duration, speed, turn_rate):
        """Commands at 50 Hz; when the last was given."""
        end = last = time.monotonic()
        end += duration
        while time.monotonic() < end:
            last = time.monotonic()
            device.command(speed, turn_rate)
            time.sleep(0.02)
        return last


@pytest.fixture(scope="session")
def ros_domain():
    """A graph of ROS 2 of our own, on this machine only."""
    pytest.importorskip(
        "rclpy", reason="rclpy is not installed: source ROS 2, or pip install 'tfg-drake[test]' on Linux, x86_64"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
        yield


@pytest.fixture(scope="module")
def ros2(ros_domain):
    """An emulated TurtleBot on ROS 2."""
    transport = Transport("ros2")
    yield transport
    transport.close()


@pytest.fixture(scope="module")
def rosbridge():
    """An emulated TurtleBot behind rosbridge."""
    pytest.importorskip("roslibpy", reason="roslibpy is not installed: pip install 'tfg-drake[rosbridge]'")
    transport = Transport("rosbridge")
    yield transport
    transport.close()


@pytest.fixture(scope="session")
def room():
    """The functions of room.py: messages of an explorer."""
    return SimpleNamespace(**runpy.run_path(str(HERE / "room.py")))


@pytest.fixture
def device(transport):
    """The device that the tests of a transport share."""
    return transport.device


@pytest.fixture
def source(transport):
    """The tags and scans that the tests of a transport share."""
    return transport.source


@pytest.fixture
def driving(device, transport):
    """The device, the robot turning."""
    transport.go(device)
    return device
