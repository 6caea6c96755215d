"""The scale of the tag sensor's ranges, learnt from the laser scan: tags stand on the surfaces that the scan meets.

A range scale error is invisible to a map of bearings and ranges alone, scales all of it and dominates every other
error; a few turns beside a scan tell it to a part in a thousand. Measured range = (1 + r) * true range + noise, and
tags stand an unknown distance o before their surfaces, so that the range to the surface is longer by o over the cosine
of the incidence. Each tag has an error of its own beside, the same in all frames: however often a few tags were seen,
they tell no scale that those errors may make up.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray, LaserScan, TagDetections, message

# Prior standard deviations of the scale error r and of the offset o (m).
SCALE_SIGMA = 0.01
OFFSET_SIGMA = 0.02
# Standard deviation of a tag's own error in range, m: tags are printed, measured and hung to a centimetre.
TAG_SIGMA = 0.01
# Pairs that differ by more than this many standard deviations are of two different things.
GATE = 4.0
# A scale error is corrected when it is this many standard deviations from none.
SIGNIFICANT = 4.0
# Surfaces seen more slantwise than this are left out (tangent of 60 degrees): a bearing error becomes a range error.
STEEPEST = 1.75
# Neighbouring rays belong to one surface when their ranges differ by less than this share; the surface is the line
# through this many of them on either side.
SAME_SURFACE = 0.1
RAYS = 4


@message
class RangeScale:
    """Gaussian of (r, o) in information form. information: (2, 2), vector: (2,), pairs: how many went into it."""

    information: FloatArray
    vector: FloatArray
    pairs: int

    @property
    def mean(self) -> FloatArray:
        """(2,) of r and o (m)."""
        return np.array(_moments(self.information, self.vector)[:2])

    @property
    def sigma(self) -> float:
        """Standard deviation of r."""
        return float(_moments(self.information, self.vector)[2])


@message
class Compared:
    """In how many frames, (t,), each of the tags ids (t,), ascending, was compared with a scan."""

    ids: IntArray
    frames: IntArray


def none_compared() -> Compared:
    """Before the first pair."""
    none = np.zeros(0, dtype=np.int64)
    return Compared(none, none)


def unknown_scale() -> RangeScale:
    """Before the first pair: r = 0, o = 0 within their priors."""
    return RangeScale(np.diag([SCALE_SIGMA**-2, OFFSET_SIGMA**-2]), np.zeros(2), 0)


def compare(
    scale: RangeScale, before: Compared, detections: TagDetections, scan: LaserScan
) -> tuple[RangeScale, Compared]:
    """The scale, and what it comes from, after one frame of tags, ranges as measured, and the scan of the same
    instant."""
    if len(scan.angles) < 2 or not len(detections.ids):
        return scale, before
    ids = np.union1d(before.ids, detections.ids)
    frames, rows = np.zeros(len(ids), dtype=np.int64), np.searchsorted(ids, detections.ids)
    frames[np.searchsorted(ids, before.ids)] = before.frames
    information, vector, agree = _compare(
        scale.information,
        scale.vector,
        detections.range,
        detections.bearing,
        detections.sigma_range,
        detections.sigma_bearing,
        frames[rows],
        scan.angles,
        scan.ranges,
        scan.sigma,
    )
    if not agree.any():
        return scale, before
    frames[rows[agree]] += 1
    return RangeScale(information, vector, scale.pairs + int(np.count_nonzero(agree))), Compared(ids, frames)


@njit(cache=True)
def _moments(information: FloatArray, vector: FloatArray) -> tuple[float, float, float]:
    """The expected scale error and offset (m), and the standard deviation of the first."""
    a, b, c = information[0, 0], information[0, 1], information[1, 1]
    determinant = a * c - b * b
    r, o = (c * vector[0] - b * vector[1]) / determinant, (a * vector[1] - b * vector[0]) / determinant
    return r, o, math.sqrt(c / determinant)


@njit(cache=True)
def surface(bearing: float, angles: FloatArray, ranges: FloatArray) -> tuple[float, float]:
    """Distance (m) to the surface at a bearing (rad), and the tangent of the incidence; nan without a surface.

    One over the range is a sinusoid of the angle along a line, straight over a few rays, whose angles are evenly spaced
    or nearly so: those of a depth image are the closer together the farther from its middle.
    """
    first = np.searchsorted(angles, bearing) - RAYS
    if not (first >= 0 and first + 2 * RAYS <= len(ranges)):
        return math.nan, math.nan
    step = (angles[first + 2 * RAYS - 1] - angles[first]) / (2 * RAYS - 1)
    middle = 0.5 * (angles[first + RAYS - 1] + angles[first + RAYS])
    total, slope = 0.0, 0.0
    for i in range(first, first + 2 * RAYS):
        if not np.isfinite(ranges[i]) or ranges[i] <= 0.0:
            return math.nan, math.nan
        if i > first and not abs(ranges[i] - ranges[i - 1]) < SAME_SURFACE * ranges[i]:
            return math.nan, math.nan
        total += 1.0 / ranges[i]
        slope += (i - first - RAYS + 0.5) / ranges[i]
    slope /= RAYS * (4 * RAYS * RAYS - 1) / 6.0
    inverse = total / (2 * RAYS) + slope * (bearing - middle) / step
    return 1.0 / inverse, abs(slope) / (step * inverse)


@njit(cache=True)
def _compare(
    information: FloatArray,
    vector: FloatArray,
    range_: FloatArray,
    bearing: FloatArray,
    sigma_range: FloatArray,
    sigma_bearing: FloatArray,
    frames: IntArray,
    angles: FloatArray,
    ranges: FloatArray,
    sigma_scan: float,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The information (2, 2) and vector (2,) with the pairs of one frame and one scan that agree, and which those are.

    frames: (n,) of each tag, compared before. Of k frames with variance v each and an error of variance t in common the
    last adds 1 / (v / k + t) - 1 / (v / (k - 1) + t) to what they tell.
    """
    r, o, _ = _moments(information, vector)
    determinant = information[0, 0] * information[1, 1] - information[0, 1] ** 2
    more, more_vector, agree = information.copy(), vector.copy(), np.zeros(len(range_), dtype=np.bool_)
    for k in range(len(range_)):
        distance, slant = surface(bearing[k], angles, ranges)
        if not slant < STEEPEST:
            continue
        lever = -math.sqrt(1.0 + slant * slant)
        variance = sigma_range[k] ** 2 + (slant * distance * sigma_bearing[k]) ** 2 + sigma_scan**2 / RAYS
        predicted = information[1, 1] * distance**2 - 2.0 * information[0, 1] * distance * lever
        predicted += information[0, 0] * lever**2
        error = range_[k] - distance - r * distance - o * lever
        if error * error > GATE**2 * (variance + predicted / determinant):
            continue
        in_common = TAG_SIGMA**2 / variance
        variance *= (1.0 + frames[k] * in_common) * (1.0 + (frames[k] + 1) * in_common)
        more[0, 0] += distance * distance / variance
        more[0, 1] += distance * lever / variance
        more[1, 0] += distance * lever / variance
        more[1, 1] += lever * lever / variance
        more_vector[0] += distance * (range_[k] - distance) / variance
        more_vector[1] += lever * (range_[k] - distance) / variance
        agree[k] = True
    return more, more_vector, agree


def correction(scale: RangeScale) -> float:
    """The expected scale error r where it is beyond doubt, else 0.

    A correction that is itself in doubt would tie all tags of a view together by an error that their covariance does
    not know.
    """
    r, _, sigma = _moments(scale.information, scale.vector)
    return float(r) if scale.pairs and abs(r) >= SIGNIFICANT * sigma else 0.0


def corrected(detections: TagDetections, scale: RangeScale) -> TagDetections:
    """The detections with the scale's error taken out of their ranges."""
    r = correction(scale) if len(detections.ids) else 0.0
    if r == 0.0:
        return detections
    return TagDetections(
        stamp=detections.stamp,
        ids=detections.ids,
        range=detections.range / (1.0 + r),
        bearing=detections.bearing,
        sigma_range=detections.sigma_range,
        sigma_bearing=detections.sigma_bearing,
    )
