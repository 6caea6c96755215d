"""A depth image as a planar scan, the nearest thing in each direction within a band of heights; and what a depth camera
makes of perfect depth: noise that grows with the square of it, alike in neighbouring pixels."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.geometry.sweep import from_place, in_order
from tfg_drake.messages import BoolArray, FloatArray, IntArray, LaserScan, message, replace
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.mount import CameraMount

# Pixels of one object differ by at most this many standard deviations; the nearest of many is too near by half of that.
SAME_THING = 5.0
# Pixels of a square this wide have a common error, as stereo compares windows.
_WINDOW = 5


@dataclasses.dataclass(frozen=True)
class DepthScanConfig:
    """Parameters of a depth camera and its scan.

    low, high: the band of heights above the floor, m: what the robot could run into. least_depth, most_depth: along the
    optical axis, m; nearer or farther the camera measures nothing. range_max: of the scan, m. sigma: of a range, m.
    most_silent: of the pixels in a direction, the share without an answer above which nothing is known there. noise:
    standard deviation of a pixel's depth at 1 m, m; it grows with the square of the depth.
    """

    low: float = 0.05
    high: float = 0.5
    least_depth: float = 0.45
    most_depth: float = 5.0
    range_max: float = 5.0
    sigma: float = 0.02
    most_silent: float = 0.25
    noise: float = 0.0

    def __post_init__(self) -> None:
        """Raises ValueError where the limits are none."""
        if not (self.low < self.high and 0.0 <= self.least_depth < self.most_depth and self.range_max > 0.0):
            raise ValueError(
                f"heights {self.low:g} to {self.high:g} m, depths {self.least_depth:g} to {self.most_depth:g} m, range "
                f"{self.range_max:g} m: must be increasing and above 0"
            )


@message
class DepthRays:
    """Directions of a depth camera's pixels, sorted, which do not change.

    shape: of its images, (h, w). order: (h w,) pixels, row by row; begins: (m,) first of each direction; angles: (m,)
    rad in the body frame, as seen from the camera, increasing. along, up: (h w,) m forward in the plane and upward, a
    metre of depth. p_BC: (3,). near_in_band, far_in_band: (h w,) whether the pixel looks into the band at the least
    depth, and where its ray ends.
    """

    shape: tuple[int, int]
    order: IntArray
    begins: IntArray
    angles: FloatArray
    along: FloatArray
    up: FloatArray
    p_BC: FloatArray
    near_in_band: BoolArray
    far_in_band: BoolArray


def depth_rays(calibration: CameraCalibration, mount: CameraMount, config: DepthScanConfig) -> DepthRays:
    """The rays of a depth camera, one direction a column of its image."""
    h, w = calibration.height, calibration.width
    pixels = np.stack(np.meshgrid(np.arange(w, dtype=float), np.arange(h, dtype=float)), axis=-1).reshape(-1, 2)
    if calibration.coefficients.any():
        from tfg_drake.vision import lens  # OpenCV, which ideal cameras can do without

        points = lens.undistorted(pixels, calibration)
    else:
        K = calibration.matrix
        points = (pixels - K[:2, 2]) / [K[0, 0], K[1, 1]]
    direction = np.column_stack([points, np.ones(len(points))]) @ mount.R_BC.T
    along = np.hypot(direction[:, 0], direction[:, 1])
    # About the optical axis, so that no camera sees the jump from -pi to pi; the left is positive.
    azimuth = wrap_angle(np.arctan2(direction[:, 1], direction[:, 0]) - mount.yaw)
    # Columns at the row that looks to the horizon, or nearest to it.
    level = np.argmin(np.abs(direction[:, 2]).reshape(h, w), axis=0)
    angles = azimuth.reshape(h, w)[level, np.arange(w)]
    angles = angles[in_order(angles)]
    edges = 0.5 * (angles[1:] + angles[:-1])
    column = np.searchsorted(edges, azimuth)
    order = np.argsort(column, kind="stable")
    _, begins = np.unique(column[order], return_index=True)
    up = direction[:, 2]
    farthest = np.minimum(config.most_depth, config.range_max / np.maximum(along, 1e-9))
    return DepthRays(
        shape=(h, w),
        order=order,
        begins=begins,
        angles=angles[np.unique(column)] + mount.yaw,
        along=along[order],
        up=up[order],
        p_BC=mount.p_BC,
        near_in_band=_in_band(mount.z + config.least_depth * up, config)[order],
        far_in_band=_in_band(mount.z + farthest * up, config)[order],
    )


def depth_scan(
    depth: NDArray[np.float32] | FloatArray, rays: DepthRays, stamp: float, config: DepthScanConfig
) -> LaserScan:
    """The scan of one depth image (h, w), m along the optical axis, as seen from the body's origin.

    0, nan and less than least_depth are no answer; inf and more than most_depth say that there is nothing up to there.
    A range is that of the nearest thing in the band, the mean of its pixels. Without one it is inf where a pixel sees
    the band free up to its end or range_max, and nan where none does. It is nan, too, where more than most_silent of
    the pixels that look into the band give no answer: then something may be in the blind zone. Raises ValueError where
    the image is not of the calibration's size.
    """
    if depth.shape != rays.shape:
        h, w = rays.shape
        raise ValueError(f"a depth image of shape {depth.shape}, the calibration is of ({h}, {w}); calibrate anew")
    d = np.asarray(depth, dtype=float).reshape(-1)[rays.order]
    silent = ~(d >= config.least_depth) | (d <= 0.0)
    nothing = d > config.most_depth
    with np.errstate(invalid="ignore"):
        ranges = d * rays.along
        hit = _in_band(rays.p_BC[2] + d * rays.up, config) & ~silent & ~nothing
    free = rays.far_in_band & ~silent & (nothing | (ranges > config.range_max))
    nearest = np.minimum.reduceat(np.where(hit & (ranges <= config.range_max), ranges, np.inf), rays.begins)
    if config.noise:
        nearest = _mean_of_nearest(nearest, np.where(hit, ranges, np.inf), rays.begins, config.noise)
    is_free = np.logical_or.reduceat(free, rays.begins)
    looking = np.add.reduceat(rays.near_in_band.astype(float), rays.begins)
    quiet = np.add.reduceat((silent & rays.near_in_band).astype(float), rays.begins)
    nearest[np.isinf(nearest) & ~is_free] = np.nan
    nearest[quiet > config.most_silent * looking] = np.nan
    seen = from_place(LaserScan(stamp, rays.angles, nearest, config.range_max, config.sigma), rays.p_BC[:2])
    angles = wrap_angle(seen.angles)
    order = in_order(angles)
    ranges = np.where(seen.ranges > config.range_max, math.inf, seen.ranges)
    return replace(seen, angles=angles[order], ranges=ranges[order])


def _mean_of_nearest(nearest: FloatArray, ranges: FloatArray, begins: IntArray, noise: float) -> FloatArray:
    """The ranges (m,), m, of what is nearest in each direction, by all its pixels. nearest: (m,) the nearest pixel of
    each. ranges: (h w,) of all pixels, inf where there is nothing."""
    known = np.where(np.isfinite(nearest), nearest, 0.0)
    last = known + SAME_THING * noise * known**2
    same = ranges <= np.repeat(last, np.diff(begins, append=len(ranges)))
    total, count = (np.add.reduceat(values, begins) for values in (np.where(same, ranges, 0.0), same.astype(float)))
    return np.where(count > 0.0, total / np.maximum(count, 1.0), nearest)


def _in_band(height: FloatArray, config: DepthScanConfig) -> BoolArray:
    return np.asarray((height >= config.low) & (height <= config.high))


def with_noise(depth: NDArray[np.float32], noise: float, seed: int) -> NDArray[np.float32]:
    """A depth image (h, w), m, 0 and inf as they are. noise: standard deviation at 1 m, m. seed: of the noise."""
    if noise == 0.0:
        return depth
    h, w = depth.shape
    drawn = np.random.default_rng(seed).standard_normal((-(-h // _WINDOW), -(-w // _WINDOW)), dtype=np.float32)
    error = np.repeat(np.repeat(np.float32(noise) * drawn, _WINDOW, axis=0), _WINDOW, axis=1)[:h, :w]
    measured = np.where(np.isfinite(depth), depth, np.float32(0.0))
    return np.where(measured > 0.0, np.maximum(measured + error * measured**2, np.float32(1e-3)), depth)
