"""A planar laser scanner at the body's origin, looking ahead."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.config import ScanConfig
from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.messages import FloatArray, LaserScan


def ray_angles(config: ScanConfig) -> FloatArray:
    """Directions (m,) of the rays in the body frame, rad: increasing, symmetric about straight ahead."""
    half = math.floor(0.5 * config.field_of_view / config.resolution + 1e-9)
    return np.arange(-half, half + 1, dtype=np.float64) * config.resolution


def scan(
    walls: FloatArray,
    X_WB: FloatArray,
    stamp: float,
    angles: FloatArray,
    standard_normal: FloatArray,
    config: ScanConfig,
) -> LaserScan:
    """One scan of the walls (n, 4) from the true pose X_WB (3,).

    angles: (m,) rad in B. standard_normal: (m,) numbers. A return that noise carries beyond the range is inf, one
    nearer than the least range nan.
    """
    ranges = _measured(walls, X_WB, angles, standard_normal, config.range, config.noise, config.least_range)
    return LaserScan(stamp, angles, ranges, config.range, config.noise)


@njit(cache=True)
def _measured(
    walls: FloatArray,
    X_WB: FloatArray,
    angles: FloatArray,
    normal: FloatArray,
    range_max: float,
    noise: float,
    least_range: float,
) -> FloatArray:
    ranges = cast_rays(walls, X_WB[:2], angles + X_WB[2], range_max)
    for k in range(len(ranges)):
        ranges[k] = max(0.0, ranges[k] + noise * normal[k])
        if ranges[k] > range_max:
            ranges[k] = np.inf
        elif ranges[k] < least_range:
            ranges[k] = np.nan
    return ranges


def no_scan(config: ScanConfig) -> LaserScan:
    """What the scanner shows before its first scan: no ray, stamped -inf."""
    return LaserScan(-math.inf, np.zeros(0), np.zeros(0), config.range, config.noise)
