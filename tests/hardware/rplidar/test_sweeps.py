"""Sweeps of a robot that drives and turns among walls, its rays cast one by one: the scans are those of one instant."""

import dataclasses
import math

import numpy as np
import pytest

from tfg_drake.config import RobotScannerConfig
from tfg_drake.geometry.se2 import compose
from tfg_drake.geometry.sweep import scan_of
from tfg_drake.hardware.rplidar.codec import Node
from tfg_drake.hardware.rplidar.sweeps import SweepMaker

# A room: x and y of its walls. Rays a turn, and how long one takes, s.
LEFT, RIGHT, BELOW, ABOVE = -2.0, 3.0, -1.5, 2.0
RAYS, PERIOD = 360, 0.18
MOUNT = RobotScannerConfig(x=0.1, y=-0.05, yaw=2.0)
X_BS = np.array([MOUNT.x, MOUNT.y, MOUNT.yaw])


def pose(t, V_B):
    """X_WB at a time, of a robot that starts at the origin."""
    v, w = V_B
    turned = w * t
    chord = v * t * np.sinc(0.5 * turned / math.pi)
    return np.array([chord * math.cos(0.5 * turned), chord * math.sin(0.5 * turned), turned])


def cast(t, angle, V_B, flip=False):
    """The range of a ray, m, at an angle clockwise from where the scanner looks, as seen from its own top."""
    x, y, theta = compose(pose(t, V_B), X_BS)
    towards = theta + angle if flip else theta - angle
    c, s = math.cos(towards), math.sin(towards)
    along = [(RIGHT - x) / c if c > 0.0 else (LEFT - x) / c, (ABOVE - y) / s if s > 0.0 else (BELOW - y) / s]
    return min(along)


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("turn_rate", [0.0, 1.2, -1.2])
def test_scans_of_a_moving_robot(turn_rate, flip):
    mount = dataclasses.replace(MOUNT, flip=flip)
    V_B, maker, sweeps = np.array([0.3, turn_rate]), SweepMaker(mount, 1), []
    for k in range(6 * RAYS):
        t = PERIOD * k / RAYS
        angle = 2.0 * math.pi * (k % RAYS) / RAYS
        sweeps += maker.add([Node(k % RAYS == 0, angle, cast(t, angle, V_B, flip))], t)
    assert [sweep.stamp for sweep in sweeps] == pytest.approx(PERIOD * np.arange(1.5, 5.1, 0.5), abs=1e-9)
    for sweep in sweeps:
        scan = scan_of(sweep, V_B)
        x_W, y_W, theta = pose(sweep.stamp, V_B)
        x = x_W + scan.ranges * np.cos(scan.angles + theta)
        y = y_W + scan.ranges * np.sin(scan.angles + theta)
        off = np.min(np.abs([x - LEFT, x - RIGHT, y - BELOW, y - ABOVE]), axis=0)
        # The way is taken to be straight meanwhile.
        assert off.max() < 0.003
        # Nothing is seen twice, and what is missed is what the robot turned away from.
        gaps = np.diff(np.append(scan.angles, scan.angles[0] + 2.0 * math.pi))
        assert np.sort(gaps)[-2] < 0.04
        assert gaps.max() < 0.05 + PERIOD * abs(turn_rate)


def test_a_turn_without_its_first_ray():
    maker, sweeps = SweepMaker(MOUNT, 1), []
    for k in range(5 * RAYS):
        node = Node(k % RAYS == 0, 2.0 * math.pi * (k % RAYS) / RAYS, 1.0)
        if k != 3 * RAYS:
            sweeps += maker.add([node], PERIOD * k / RAYS)
    stamps = np.array([sweep.stamp for sweep in sweeps])
    np.testing.assert_allclose(np.diff(stamps), 0.5 * PERIOD, atol=0.003)


def test_ranges_that_say_nothing():
    nodes = [Node(k == 0, 2.0 * math.pi * k / RAYS, r) for k, r in enumerate([0.1, math.nan, 13.0, 2.0] * (RAYS // 4))]
    maker = SweepMaker(MOUNT, 1)
    for turn in range(3):
        sweeps = maker.add(nodes, PERIOD * turn)
    np.testing.assert_array_equal(sweeps[0].ranges[:4], [math.nan, math.nan, math.inf, 2.0])
    assert sweeps[0].range_max == 12.0
    maker = SweepMaker(MOUNT, 3)
    for turn in range(3):
        sweeps = maker.add(nodes, PERIOD * turn)
    np.testing.assert_array_equal(sweeps[0].ranges[:4], [math.nan, math.nan, 13.0, 2.0])
