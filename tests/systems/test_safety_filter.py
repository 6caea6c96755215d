"""The safety filter as a system: what it passes on, and what it says of a scanner that says nothing."""

import logging

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from tfg_drake.config import RobotConfig, SafetyConfig, ScanConfig
from tfg_drake.geometry.polygon import hatched
from tfg_drake.messages import Hazards, Odometry, PoseEstimate, replace
from tfg_drake.safety.scan_watch import EMPTY, FROZEN, HELD
from tfg_drake.simulation.laser_scanner import ray_angles, scan
from tfg_drake.systems.safety_filter import SafetyFilter

SCAN = ScanConfig()
ROOM = np.array([[9, -3, 9, 3], [9, 3, -4, 3], [-4, 3, -4, -3], [-4, -3, 9, -3]], dtype=float)


class Filter:
    """The filter of a robot that drives ahead at 0.3 m/s as it is told, by its odometry, in a room."""

    def __init__(self, keep_out=None):
        self.system = SafetyFilter(RobotConfig(), SafetyConfig(), SCAN, keep_out)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        self.random, self.x, self.step = np.random.default_rng(0), 0.0, 0
        self.fix("hazards", Hazards(0.0, 0, 0, 0))
        self.system.GetInputPort("velocity_commanded").FixValue(self.context, [0.3, 0.0])

    def fix(self, port, message):
        self.system.GetInputPort(port).FixValue(self.context, AbstractValue.Make(message))

    def seen(self, stamp):
        normal = self.random.normal(size=len(ray_angles(SCAN)))
        return scan(ROOM, np.array([self.x, 0.0, 0.0]), stamp, ray_angles(SCAN), normal, SCAN)

    def run(self, duration, spoil=lambda seen: seen):
        """Speeds, sixteen a second, while scans come as `spoil` leaves them."""
        speeds = []
        for _ in range(round(16 * duration)):
            now = self.step / 16
            speed = float(self.read("velocity")[0])
            self.x += speed / 16
            self.fix("odometry", Odometry(now, np.array([self.x, 0.0, 0.0]), np.array([speed, 0.0]), speed == 0.0))
            if self.step % 2 == 0:
                self.fix("scan", spoil(self.seen(now)))
            self.step += 1
            self.simulator.AdvanceTo(self.step / 16)
            speeds.append(speed)
        return speeds

    def read(self, port):
        return self.system.GetOutputPort(port).Eval(self.context)


@pytest.fixture
def driving():
    filtered = Filter()
    assert filtered.run(2.0)[-1] == pytest.approx(0.3)
    return filtered


def _empty(seen):
    return replace(seen, ranges=np.full(len(seen.ranges), np.inf))


class _Frozen:
    def __init__(self):
        self.first = None

    def __call__(self, seen):
        self.first = self.first or seen
        return replace(self.first, stamp=seen.stamp)


@pytest.mark.parametrize(("spoil", "line"), [(_empty, EMPTY), (_Frozen(), FROZEN)])
def test_a_scan_that_says_nothing_is_as_good_as_silent(driving, spoil, line, caplog):
    with caplog.at_level(logging.INFO, "tfg_drake.hardware"):
        speeds = driving.run(3.0, spoil)
        assert max(speeds[32:]) == 0.0
        # What is believed is old: a base that waits for scans waits.
        assert driving.read("scan_believed").stamp < driving.context.get_time() - 2.0
        assert caplog.text.count(line) == 1
        assert driving.run(2.0)[-1] == pytest.approx(0.3)
    assert caplog.text.count("the scan is believed again") == 1


def test_a_robot_does_not_drive_where_it_has_seen_nothing_and_says_so(caplog):
    blind = Filter()
    speeds = blind.run(6.0, lambda seen: replace(seen, ranges=np.full(len(seen.ranges), np.nan)))
    assert max(speeds) == 0.0
    assert caplog.text.count(HELD) == 1


def test_a_robot_with_something_in_its_way_says_so_once(caplog):
    stopped = Filter()
    stopped.x = 8.7
    assert stopped.run(6.0)[-1] == 0.0
    assert caplog.text.count("the base stands: something stands in its way") == 1
    assert HELD not in caplog.text


@pytest.mark.parametrize("known", [True, False])
def test_an_area_to_keep_out_of_is_a_wall_where_the_pose_is_known(known, caplog):
    """The robot began at (10, 5) of the map, looking along its y axis; the area is one 3 m ahead of it."""
    corners = np.array([[9.0, 8.0], [11.0, 8.0], [11.0, 9.0], [9.0, 9.0]])
    filtered = Filter(hatched([corners], RobotConfig().radius))
    for step in range(160):
        if known:
            pose, speed = np.array([10.0, 5.0 + filtered.x, 0.5 * np.pi]), np.array([filtered.read("velocity")[0], 0.0])
            none = np.zeros(0, dtype=int)
            filtered.fix("pose", PoseEstimate(step / 8, pose, np.zeros((3, 3)), speed, 1, none, np.zeros((0, 2))))
        filtered.run(1 / 8)
    stops = 3.0 - RobotConfig().radius - SafetyConfig().stop_distance
    assert filtered.x == pytest.approx(stops, abs=0.05) if known else filtered.x > 4.0
    assert filtered.x < stops + 0.005 or not known
    assert ("an area of explorer.keep_out is in its way" in caplog.text) == known
