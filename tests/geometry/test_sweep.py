"""A scanner that turns while the robot moves: the scan that it would have taken at one instant."""

import math

import numpy as np

from tfg_drake.geometry.se2 import compose
from tfg_drake.geometry.sweep import Sweep, scan_of
from tfg_drake.hardware.sensor_source import SweepSource
from tfg_drake.messages import Odometry

V_B, X, Y = np.array([0.3, 1.2]), 0.1, -0.05


def swept(V_B=V_B):
    """A sweep clockwise in 0.18 s inside a circle of 3 m radius round where the robot is in the middle of it."""
    angles = -2.0 * math.pi * np.arange(360) / 360
    after = 0.18 * (np.arange(360) / 360 - 0.5)
    ranges = np.empty(360)
    for k in range(360):
        turned = V_B[1] * after[k]
        x, y, theta = compose(np.array([V_B[0] * after[k], 0.0, turned]), np.array([X, Y, angles[k]]))
        b = x * math.cos(theta) + y * math.sin(theta)
        ranges[k] = -b + math.sqrt(b * b + 9.0 - x * x - y * y)
    ranges[[3, 5]] = math.inf, math.nan
    return Sweep(2.0, angles, ranges, after, X, Y, 12.0, 0.02)


def test_the_robots_motion_is_undone():
    scan = scan_of(swept(), V_B)
    known = np.isfinite(scan.ranges)
    np.testing.assert_allclose(scan.ranges[known], 3.0, atol=1e-9)
    assert known.sum() == 358
    assert np.isinf(scan.ranges).sum() == 1
    assert (np.diff(scan.angles) > 0.0).all()
    assert np.abs(scan_of(swept(), np.zeros(2)).ranges[known] - 3.0).max() > 0.02


def test_no_direction_is_seen_twice():
    """A robot that turns with the scanner sees the first directions once more at the end."""
    turning = np.array([0.0, -2.0])
    scan = scan_of(swept(turning), turning)
    assert len(scan.angles) == 360 - 20  # 0.36 rad of them
    assert np.diff(scan.angles).min() > 0.01
    np.testing.assert_allclose(scan.ranges[np.isfinite(scan.ranges)], 3.0, atol=1e-9)


class Sweeps:
    """One sweep."""

    def take(self, kind, until):
        return [swept()] if kind is Sweep and until >= 2.0 else []


def test_a_source_asks_how_the_robot_moved_then():
    asked = []
    odometry = Odometry(2.0, np.zeros(3), V_B)
    source = SweepSource(Sweeps(), lambda stamp: asked.append(stamp) or odometry)
    (scan,) = source.take(object, 2.0)
    assert asked == [2.0]
    np.testing.assert_array_equal(scan.ranges, scan_of(swept(), V_B).ranges)
    (still,) = SweepSource(Sweeps(), lambda stamp: None).take(object, 2.0)
    np.testing.assert_array_equal(still.ranges, scan_of(swept(), np.zeros(2)).ranges)
