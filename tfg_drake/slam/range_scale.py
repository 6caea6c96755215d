"""The scale of the tag sensor's ranges, learnt from the laser scan: tags stand on the surfaces that the scan meets.

A range scale error is invisible to a map of bearings and ranges alone, scales all of it and dominates every other
error; a few turns beside a scan tell it to a part in a thousand. Measured range = (1 + r) * true range + noise, and
tags stand an unknown distance o before their surfaces, so that the range to the surface is longer by o over the cosine
of the incidence. Each tag has an error of its own beside, the same in all frames: however often a few tags were seen,
a scale that those errors may make up is not beyond doubt.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray, LaserScan, TagDetections, message, replace

# Prior standard deviations of the scale error r and of the offset o (m).
SCALE_SIGMA = 0.01
OFFSET_SIGMA = 0.02
# Standard deviation of a tag's own error in range, m: tags are printed, measured and hung to a centimetre.
TAG_SIGMA = 0.01
# Pairs that differ by more than this many standard deviations are of two different things.
GATE = 4.0
# A scale error is corrected when it is this many standard deviations from none.
SIGNIFICANT = 4.0
# So large a share, where it is beyond doubt, is told: tags are of another size, or the calibration is of another
# camera. So many pairs must say so where they agree with no scale that may well be.
TOLD = 0.03
MANY = 100
# They are counted by the logarithm of range over range, in bins this wide, up to as much more or less as MOST, a factor
# of 50. Half of all pairs must lie this near together, whichever is the more: so many bins, or so large a share of what
# is told.
BIN, MOST = 0.02, 3.92
NEAR, NEARLY = 3, 0.25
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
    """What tags' own errors would do to the scale. ids: (t,), ascending. pull: (t, 2) derivative of vector on each.

    apart: (b,) how many of the pairs that do not agree have ranges whose logarithm is greater than that of the range to
    the surface by -MOST to -MOST + BIN, ... told: whether somebody was told of a `great_error`.
    """

    ids: IntArray
    pull: FloatArray
    apart: IntArray
    told: bool = False


def none_compared() -> Compared:
    """Before the first pair."""
    return Compared(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(round(2.0 * MOST / BIN), dtype=np.int64))


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
    information, vector, more, apart = _compare(
        scale.information,
        scale.vector,
        detections.range,
        detections.bearing,
        detections.sigma_range,
        detections.sigma_bearing,
        scan.angles,
        scan.ranges,
        scan.sigma,
    )
    if len(apart):
        before = replace(before, apart=before.apart + np.bincount(apart, minlength=len(before.apart)))
    pairs = int(np.count_nonzero(more[:, 0]))
    if not pairs:
        return scale, before
    ids, pull = _with_pull(before.ids, before.pull, detections.ids, more)
    return RangeScale(information, vector, scale.pairs + pairs), replace(before, ids=ids, pull=pull)


@njit(cache=True)
def _with_pull(ids: IntArray, pull: FloatArray, more_ids: IntArray, more: FloatArray) -> tuple[IntArray, FloatArray]:
    """The tags' ids (t,), ascending, and pull (t, 2) with that of some tags, (n,) and (n, 2)."""
    together = np.unique(np.concatenate((ids, more_ids)))
    added = np.zeros((len(together), 2))
    added[np.searchsorted(together, ids)] = pull
    for row, one in zip(np.searchsorted(together, more_ids), more):  # noqa: B905 numba knows no strict
        added[row] += one
    return together, added


@njit(cache=True)
def _moments(information: FloatArray, vector: FloatArray) -> tuple[float, float, float]:
    """The expected scale error and offset (m), and the standard deviation of the first."""
    a, b, c = information[0, 0], information[0, 1], information[1, 1]
    determinant = a * c - b * b
    r, o = (c * vector[0] - b * vector[1]) / determinant, (a * vector[1] - b * vector[0]) / determinant
    return r, o, math.sqrt(c / determinant)


@njit(cache=True)
def surface(bearing: float, angles: FloatArray, ranges: FloatArray) -> tuple[float, float]:
    """Distance (m) to the surface at a bearing (rad), and the tangent of how much farther to the left it is looked at
    straight, the incidence; nan without a surface.

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
    return 1.0 / inverse, slope / (step * inverse)


@njit(cache=True)
def _compare(
    information: FloatArray,
    vector: FloatArray,
    range_: FloatArray,
    bearing: FloatArray,
    sigma_range: FloatArray,
    sigma_bearing: FloatArray,
    angles: FloatArray,
    ranges: FloatArray,
    sigma_scan: float,
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """The information (2, 2) and vector (2,) with the pairs of one frame and one scan that agree, the derivative
    (n, 2) of the vector on each tag's error in range, not zero where they agree, and of each other one its bin of
    Compared.apart, (a,)."""
    r, o, _ = _moments(information, vector)
    determinant = information[0, 0] * information[1, 1] - information[0, 1] ** 2
    more, more_vector, pull = information.copy(), vector.copy(), np.zeros((len(range_), 2))
    apart, others = np.empty(len(range_), dtype=np.int64), 0
    for k in range(len(range_)):
        distance, slant = surface(bearing[k], angles, ranges)
        if not abs(slant) < STEEPEST:
            continue
        lever = -math.sqrt(1.0 + slant * slant)
        variance = sigma_range[k] ** 2 + (slant * distance * sigma_bearing[k]) ** 2 + sigma_scan**2 / RAYS
        predicted = information[1, 1] * distance**2 - 2.0 * information[0, 1] * distance * lever
        predicted += information[0, 0] * lever**2
        error = range_[k] - distance - r * distance - o * lever
        if error * error > GATE**2 * (variance + predicted / determinant):
            longer = math.log(range_[k] / distance)
            if abs(longer) < MOST:
                apart[others] = int((longer + MOST) / BIN)
                others += 1
            continue
        more[0, 0] += distance * distance / variance
        more[0, 1] += distance * lever / variance
        more[1, 0] += distance * lever / variance
        more[1, 1] += lever * lever / variance
        pull[k, 0], pull[k, 1] = distance / variance, lever / variance
        more_vector += pull[k] * (range_[k] - distance)
    return more, more_vector, pull, apart[:others]


def correction(scale: RangeScale, compared: Compared) -> float:
    """The expected scale error r where it is beyond doubt, else 0.

    A correction that is itself in doubt would tie all tags of a view together by an error that their covariance does
    not know.
    """
    r, _, sigma = _moments(scale.information, scale.vector)
    if not scale.pairs or abs(r) < SIGNIFICANT * sigma:
        return 0.0
    by_tags = TAG_SIGMA * compared.pull @ np.linalg.inv(scale.information)[0]
    return float(r) if abs(r) >= SIGNIFICANT * math.hypot(sigma, *by_tags) else 0.0


def great_error(scale: RangeScale, compared: Compared) -> float:
    """The share by which the tags' ranges are longer than the scan's where that is more than TOLD and beyond doubt,
    else 0: one that is corrected, where most pairs agree, or one so great that most do not, and nearly alike."""
    r, _, sigma = _moments(scale.information, scale.vector)
    apart = int(compared.apart.sum())
    if scale.pairs > apart and abs(r) > TOLD + SIGNIFICANT * sigma:
        return float(r)
    most = max(MANY, (scale.pairs + apart) // 2)
    counted = np.append(0, np.cumsum(compared.apart))
    width = np.searchsorted(counted, counted + most, side="right") - np.arange(len(counted))
    first = int(np.argmin(np.where(counted + most < counted[-1], width, len(counted))))
    middle = BIN * (first + 0.5 * width[first]) - MOST
    says_so = counted[first] + most < counted[-1] and width[first] <= max(NEAR, NEARLY * abs(middle) / BIN)
    share = math.expm1(middle)
    return share if says_so and abs(share) > TOLD else 0.0


def corrected(detections: TagDetections, r: float) -> TagDetections:
    """The detections with a scale error r taken out of their ranges."""
    if r == 0.0 or not len(detections.ids):
        return detections
    return replace(detections, range=detections.range / (1.0 + r))
