"""A planar laser scanner at the body's origin, looking ahead."""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.config import ScanConfig, ScanRealityConfig
from tfg_drake.geometry.se2 import compose
from tfg_drake.geometry.visibility import cast_rays, disc_distances
from tfg_drake.messages import FloatArray, LaserScan, replace

# Two neighbouring rays are on different surfaces, not on an oblique one, if they differ by more than EDGE, m, and by
# ABRUPT times as much as either does from its other neighbour.
EDGE, ABRUPT = 0.1, 2.0

# Number of rays of a sweep that are cast from one place, while the robot moves by millimetres.
BLOCK = 16


def ray_angles(config: ScanConfig) -> FloatArray:
    """Directions (m,) of the rays in the body frame, rad: increasing, symmetric about straight ahead."""
    half = math.floor(0.5 * config.field_of_view / config.resolution + 1e-9)
    return np.arange(-half, half + 1, dtype=np.float64) * config.resolution


def scan(
    walls: FloatArray,
    X_WS: FloatArray,
    stamp: float,
    angles: FloatArray,
    standard_normal: FloatArray,
    config: ScanConfig,
    stated: ScanConfig | None = None,
    discs: FloatArray | None = None,
) -> LaserScan:
    """One scan of the walls (n, 4) from the scanner's true pose X_WS (3,).

    angles: (m,) rad from straight ahead. standard_normal: (m,) numbers. config: what the scanner does; `stated`: its
    data sheet, config where there is none. discs: (d, 3) what else there is, centre and radius in m. A return that
    noise carries beyond the range is inf, one nearer than the least range nan.
    """
    headings = angles + X_WS[2]
    ranges = cast_rays(walls, X_WS[:2], headings, config.range)
    if discs is not None:
        ranges = np.minimum(ranges, disc_distances(discs, X_WS[:2], headings))
    ranges = np.maximum(0.0, ranges + config.noise * standard_normal)
    ranges[ranges < config.least_range] = np.nan
    ranges[ranges > config.range] = np.inf
    return LaserScan(stamp, angles, ranges, config.range, (stated or config).noise)


def swept(
    walls: FloatArray,
    robot: FloatArray,
    X_BS: FloatArray,
    sweep_time: float,
    stamp: float,
    angles: FloatArray,
    standard_normal: FloatArray,
    config: ScanConfig,
    stated: ScanConfig | None = None,
    discs: FloatArray | None = None,
) -> LaserScan:
    """One scan whose rays are taken one after the other while the robot moves on, stamped with the first of them as in
    ROS.

    robot: (5,) x, y, theta of X_WB, speed and turn rate, and stamp: s, both with the last ray. X_BS: (3,) where the
    scanner sits. sweep_time: s from the first ray to the last. Else as `scan`. BLOCK rays each are cast from one place,
    in their own directions.
    """
    at = sweep_time * (np.linspace(-1.0, 0.0, len(angles)))
    ranges = np.empty(len(angles))
    for block in np.array_split(np.arange(len(angles)), math.ceil(len(angles) / BLOCK)):
        since = float(at[block].mean())
        half = 0.5 * robot[4] * since
        chord = robot[3] * since * np.sinc(half / math.pi)
        X_WS = compose(compose(robot[:3], np.array([chord * math.cos(half), chord * math.sin(half), 2.0 * half])), X_BS)
        towards = angles[block] + robot[4] * (at[block] - since)
        ranges[block] = scan(walls, X_WS, stamp, towards, standard_normal[block], config, stated, discs).ranges
    return LaserScan(stamp - sweep_time, angles, ranges, config.range, (stated or config).noise)


def along_rays(white: FloatArray, angles: FloatArray, correlation_angle: float) -> FloatArray:
    """Standard normal numbers (m,) whose correlation falls to 1/e over an angle (rad) between rays, from white ones
    (m,): an autoregression of first order along the rays at angles (m,), rad."""
    correlated = white.copy()
    for k, kept in enumerate(np.exp(-np.diff(angles) / correlation_angle).tolist(), 1):
        correlated[k] = kept * correlated[k - 1] + math.sqrt(1.0 - kept * kept) * white[k]
    return correlated


def spoilt(scan: LaserScan, uniform: FloatArray, reality: ScanRealityConfig) -> LaserScan:
    """The scan with what glass, black walls and edges make of its rays, by one number (m,) between 0 and 1 for each:
    rays that meet nothing, and ranges between two surfaces one behind the other (mixed pixels)."""
    ranges, dropout, mixed = scan.ranges.copy(), reality.dropout_probability, reality.mixed_probability
    ahead, behind = scan.ranges[:-1], scan.ranges[1:]
    # Both must have met something.
    met = np.isfinite(ahead) & np.isfinite(behind)
    step = np.abs(np.subtract(behind, ahead, out=np.zeros(len(ahead)), where=met))
    beside = np.maximum(np.append(0.0, step[:-1]), np.append(step[1:], 0.0))
    edge = np.append((step > EDGE) & (step > ABRUPT * beside), False)
    share = (uniform - dropout) / mixed if mixed > 0.0 else np.full(len(ranges), -1.0)
    between = np.flatnonzero(edge & (share >= 0.0) & (share < 1.0))
    ranges[between] += share[between] * (scan.ranges[between + 1] - scan.ranges[between])
    ranges[uniform < dropout] = np.inf
    return replace(scan, ranges=ranges)


def no_scan(config: ScanConfig) -> LaserScan:
    """The scanner's output before its first scan: no ray, stamped -inf."""
    return LaserScan(-math.inf, np.zeros(0), np.zeros(0), config.range, config.noise)
