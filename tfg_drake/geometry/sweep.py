"""A scan that was measured ray by ray as the scanner turned, as it would be of one instant."""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.messages import FloatArray, IntArray, LaserScan, message, replace


@message
class Sweep:
    """One revolution of a scanner at p_BS = (x, y) in the body frame, m.

    stamp: s, of its middle. directions: (m,) rad from the body's x axis, as seen from the scanner, one after the other
    and not wrapped: they go all one way.
    ranges: (m,) m, inf where nothing was met within range_max, nan where nothing is known. after: (m,) s from the stamp
    to each ray. sigma: standard deviation of a range, m.
    """

    stamp: float
    directions: FloatArray
    ranges: FloatArray
    after: FloatArray
    x: float
    y: float
    range_max: float
    sigma: float


def scan_of(sweep: Sweep, V_B: FloatArray) -> LaserScan:
    """The scan as seen from the body's origin at the sweep's stamp, angles increasing in (-pi, pi].

    V_B: (2,) velocity of the body meanwhile, m/s and rad/s. Where the robot turned with the scanner the first rays and
    the last look the same way: those that are farther than half a turn from the middle one are left out.
    """
    if len(sweep.directions):
        middle = 0.5 * (sweep.directions[0] + sweep.directions[-1])
        once = np.abs(sweep.directions + V_B[1] * sweep.after - middle) <= math.pi + 1e-9
        directions, ranges, after = sweep.directions[once], sweep.ranges[once], sweep.after[once]
        sweep = replace(sweep, directions=directions, ranges=ranges, after=after)
    hit = np.isfinite(sweep.ranges)
    reach = np.where(hit, sweep.ranges, sweep.range_max)
    x, y = sweep.x + reach * np.cos(sweep.directions), sweep.y + reach * np.sin(sweep.directions)
    ahead, turned = V_B[0] * sweep.after, V_B[1] * sweep.after
    px, py = ahead + np.cos(turned) * x - np.sin(turned) * y, np.sin(turned) * x + np.cos(turned) * y
    angles = wrap_angle(np.arctan2(py, px))
    ranges = np.where(hit, np.hypot(px, py), sweep.ranges)
    order = in_order(angles)
    return LaserScan(sweep.stamp, angles[order], ranges[order], sweep.range_max, sweep.sigma)


def from_place(scan: LaserScan, place: FloatArray) -> LaserScan:
    """A scan taken at one instant and at a place (2,), m in B, as seen from the body's origin."""
    if not place.any():
        return scan
    at_once, (x, y) = np.zeros(len(scan.angles)), place.tolist()
    return scan_of(Sweep(scan.stamp, scan.angles, scan.ranges, at_once, x, y, scan.range_max, scan.sigma), np.zeros(2))


def in_order(angles: FloatArray) -> IntArray:
    """Rows (m,) of angles (n,), rad, that are increasing, of equal ones the first."""
    order = np.argsort(angles, kind="stable")
    return np.asarray(order[np.diff(angles[order], prepend=-math.inf) > 1e-9])
