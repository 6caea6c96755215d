"""Panoramas: the scans of a turn in place merged into one 360-degree scan in the arrival frame A."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from scipy.ndimage import minimum_filter1d

from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.messages import BoolArray, FloatArray, IntArray, LaserScan, message, replace

# Bins of 0.5 degrees.
BINS = 720
# A scan farther outside the stamps of the turn's poses, s, is not part of the turn.
STAMP_TOLERANCE = 1e-3
# Rays within this many standard deviations of their bin's median range are on the same surface.
SAME_SURFACE = 4.0
# At most this number of neighbouring rays without a return, between rays with one, may have been lost.
MOST_LOST = 4
# Rays of a bin without a return were lost if at least the share LEAST_MET of its rays had one, as in bins on either
# side up to BESIDE away.
LEAST_MET, BESIDE = 0.4, 2
# A ray fell half on a near and half on a far surface if it differs from both neighbours by more than FLOATS, m, and
# they from theirs, unlike on an oblique surface, by less than the share ASLANT_SHARE of that.
FLOATS, ASLANT_SHARE = 0.1, 0.4
# A scan whose rays are more than COARSE bins apart is interpolated; WIDEST, rad, apart they are no scan. Nothing is
# known between two rays more than GAP times the usual step apart; they are on one surface if their ranges differ by
# less than ASLANT times the distance across.
COARSE, WIDEST, GAP, ASLANT = 1.2, 0.1, 1.5, 5.0


@message
class Panorama:
    """The view of a whole turn from the origin of A, one entry per bin of bearing, counter-clockwise.

    angles: (b,) rad from A's x axis in (0, 2 pi), increasing: the bearing of the bin's point, the bin's centre without
    one. ranges: (b,) m, inf if the bin is free up to range_max, nan if the turn never looked there. range_max: m.
    sigma: standard deviation of a single ray, m.
    """

    angles: FloatArray
    ranges: FloatArray
    range_max: float
    sigma: float

    @property
    def points(self) -> FloatArray:
        """The points p_AP (b, 2), m, not finite for bins without a point."""
        return np.asarray(self.ranges[:, None] * np.stack([np.cos(self.angles), np.sin(self.angles)], axis=1))

    def looked_at(self, bearing: FloatArray) -> BoolArray:
        """Return whether the turn looked in the directions of bearings (n,), rad in A."""
        return np.asarray(~np.isnan(self.ranges[self._bins_of(bearing)]))

    def least_range(self, points: FloatArray, beside: int) -> FloatArray:
        """Return the least range (n,), m, in the bins of points (n, 2), m in A, and in `beside` bins on either side:
        range_max for free bins, 0 where the turn never looked."""
        reach = np.nan_to_num(self.ranges, nan=0.0, posinf=self.range_max)
        least = minimum_filter1d(reach, 2 * beside + 1, mode="wrap")
        return np.asarray(least[self._bins_of(np.arctan2(points[:, 1], points[:, 0]))])

    def _bins_of(self, bearing: FloatArray) -> IntArray:
        """The bins (n,) that bearings (n,), rad in A, fall in."""
        bins = len(self.ranges)
        index = (np.mod(bearing, 2.0 * np.pi) * (bins / (2.0 * np.pi))).astype(np.int64)
        return np.minimum(index, bins - 1)


def _floating(ranges: FloatArray, rays: IntArray) -> BoolArray:
    """Return a mask of the rays of consecutive scans (n,) that lie alone between a nearer surface and a farther one,
    where nothing is. rays: (s,) number of rays of each scan."""
    result = np.zeros(len(ranges), dtype=np.bool_)
    with np.errstate(invalid="ignore"):
        step = np.diff(ranges)
        before, after, first, last = step[1:-2], step[2:-1], np.abs(step[:-3]), np.abs(step[3:])
        alone = (np.minimum(before, after) > FLOATS) | (np.maximum(before, after) < -FLOATS)
        result[2:-2] = alone & np.isfinite(before + after)
        result[2:-2] &= (first < ASLANT_SHARE * np.abs(before)) & (last < ASLANT_SHARE * np.abs(after))
    # The outermost two of a scan have no others on one side.
    end = np.cumsum(rays)
    result[np.concatenate([end - rays, end - rays + 1, end - 2, end - 1]).clip(0, len(ranges) - 1)] = False
    return result


@njit(cache=True)
def _merge(bearings: FloatArray, ranges: FloatArray, bins: int, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Return bearing and range of each bin, from rays with bearing (n,) in [0, 2 pi) and range (n,), inf if free."""
    width = 2.0 * np.pi / bins
    index = np.minimum((bearings / width).astype(np.int64), bins - 1)
    start = np.zeros(bins + 1, dtype=np.int64)
    for i in index:
        start[i + 1] += 1
    start = np.cumsum(start)
    filled, order, by_bin = start.copy(), np.empty(len(index), dtype=np.int64), np.empty(len(index))
    for i in range(len(index)):
        order[filled[index[i]]], by_bin[filled[index[i]]] = i, ranges[i]
        filled[index[i]] += 1
    angles = np.empty(bins)
    merged = np.full(bins, np.nan)
    met_by, mostly = np.zeros(bins, dtype=np.int64), np.zeros(bins, dtype=np.bool_)
    for b in range(bins):
        count = start[b + 1] - start[b]
        if count:
            by_bin[start[b] : start[b + 1]].sort()
            met_by[b] = np.searchsorted(by_bin[start[b] : start[b + 1]], np.inf)
            mostly[b] = met_by[b] > (count - 1) // 2
    for b in range(bins):
        rays = order[start[b] : start[b + 1]]
        angles[b] = (b + 0.5) * width
        if len(rays) == 0:
            continue
        lost = not mostly[b] and met_by[b] >= LEAST_MET * len(rays)
        for side in (-1, 1):
            beside = False
            for k in range(1, BESIDE + 1):
                beside = beside or mostly[(b + side * k) % bins]
            lost = lost and beside
        if not (mostly[b] or lost):
            merged[b] = np.inf
            continue
        # The lower median is the range of an actual ray. Where the bin straddles a jump edge it lies on one of the two
        # surfaces, and only rays of that surface are averaged: no point floats between the two.
        median = by_bin[start[b] + ((met_by[b] if lost else len(rays)) - 1) // 2]
        x, y, count = 0.0, 0.0, 0
        for i in rays:
            if abs(ranges[i] - median) <= tolerance:
                x += ranges[i] * np.cos(bearings[i])
                y += ranges[i] * np.sin(bearings[i])
                count += 1
        merged[b] = np.hypot(x, y) / count
        # Within the bin however rounding falls, so that bearings stay in order.
        angles[b] = min(max(np.arctan2(y, x) % (2.0 * np.pi), (b + 1e-6) * width), (b + 1 - 1e-6) * width)
    # Glass and black walls swallow single rays, which would be free ground through a wall.
    met = np.flatnonzero(np.isfinite(merged))
    for i in range(len(met)):
        between = np.arange(met[i - 1] + 1 - (bins if i == 0 else 0), met[i]) % bins
        if (start[between + 1] - start[between]).sum() <= MOST_LOST:
            merged[between] = np.nan
    return angles, merged


def _finer(scan: LaserScan) -> LaserScan:
    """Return a scan with rays interpolated to at least one per bin: on the chord if both neighbours hit one surface,
    otherwise at the range of the nearer one, nan if either is unknown. A single ray without a return may have been lost
    and counts as unknown."""
    angles, gap = scan.angles, np.diff(scan.angles, append=scan.angles[:1] + 2.0 * np.pi)
    usual, width = (float(np.median(gap)) if len(gap) else 0.0), 2.0 * np.pi / BINS
    if not COARSE * width < usual < WIDEST:
        return scan
    met = np.isfinite(scan.ranges)
    lost = np.isinf(scan.ranges) & np.roll(met, 1) & np.roll(met, -1)
    before = np.where(lost | _floating(scan.ranges, np.array([len(angles)])), np.nan, scan.ranges)
    after, parts = np.roll(before, -1), math.ceil(2.0 * usual / width)
    turned = np.arange(parts)[:, None] / parts * gap
    with np.errstate(invalid="ignore"):
        chord = before * after * np.sin(gap) / (before * np.sin(turned) + after * np.sin(gap - turned))
        nearer = np.minimum(before, after)
        between = np.where(np.abs(after - before) < ASLANT * gap * nearer, chord, nearer)
    between[0], between[1:, gap > GAP * usual] = before, np.nan
    at = wrap_angle(angles + turned).ravel()
    order = np.argsort(at, kind="stable")
    return replace(scan, angles=at[order], ranges=between.ravel()[order])


def build_panorama(scans: Sequence[LaserScan], stamps: FloatArray, X_AB: FloatArray) -> Panorama:
    """Return the panorama of a turn.

    scans: taken during the turn; those outside the stamps are ignored. stamps: (t,) s, increasing, and X_AB: (t, 3),
    the turn's poses in the arrival frame A, between which a scan's pose is interpolated. Each bin holds the mean point
    of the rays that hit the surface at the bin's median range.

    Raises ValueError without any pose or scan.
    """
    if not len(stamps):
        raise ValueError("A panorama needs at least one pose of the turn.")
    if not scans:
        raise ValueError("A panorama needs at least one scan.")
    range_max, sigma = scans[0].range_max, scans[0].sigma
    first, last = stamps[0] - STAMP_TOLERANCE, stamps[-1] + STAMP_TOLERANCE
    scans = [_finer(scan) for scan in scans if first <= scan.stamp <= last]
    at = np.array([scan.stamp for scan in scans])
    heading = np.unwrap(X_AB[:, 2])
    poses = np.stack([np.interp(at, stamps, of) for of in (X_AB[:, 0], X_AB[:, 1], heading)])
    rays = np.array([len(scan.angles) for scan in scans], dtype=np.int64)
    x, y, turned = np.repeat(poses, rays, axis=1)
    angles = np.concatenate([np.zeros(0), *(scan.angles for scan in scans)])
    ranges = np.concatenate([np.zeros(0), *(scan.ranges for scan in scans)])
    looked = ~np.isnan(ranges) & ~_floating(ranges, rays)
    x, y, angles, ranges = x[looked], y[looked], angles[looked] + turned[looked], ranges[looked]
    hit = np.isfinite(ranges)
    reach = np.where(hit, ranges, range_max)
    px, py = x + reach * np.cos(angles), y + reach * np.sin(angles)
    bearings, ranges = np.arctan2(py, px) % (2.0 * np.pi), np.where(hit, np.hypot(px, py), np.inf)
    return Panorama(*_merge(bearings, ranges, BINS, max(SAME_SURFACE * sigma, 1e-6)), range_max, sigma)
