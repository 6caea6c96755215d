"""Comparison of tag ranges with the laser scan, which calibrates the camera's range scale and mount.

Tags hang on the surfaces that the scan hits. A range scale error is unobservable in a map of bearings and ranges,
scales all of it and dominates every other error; with a scan a few turns determine it to a part in a thousand. All
comparisons share errors: tags hang an unknown distance in front of their surfaces, and the scan is read at a bearing
and from a place that depend on the mounts of camera and scanner. Each tag also has its own error, the same in all
frames. All these are eliminated, which leaves a measurement of the parameters with its covariance.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray, LaserScan, TagDetections, message, replace
from tfg_drake.slam.shared import (
    CAMERA_YAW,
    LEVER_X,
    LEVER_Y,
    RANGE_SCALE,
    SCANNER_X,
    SCANNER_Y,
    SCANNER_YAW,
    SHARED,
    Shared,
)

# The parameters in which a comparison is linear: those of the camera minus those of the scanner, and the distance of
# tags in front of their surfaces, m.
COMPARED = (RANGE_SCALE, CAMERA_YAW, LEVER_X, LEVER_Y)
OF_SCANNER = (SCANNER_YAW, SCANNER_X, SCANNER_Y)
# Prior standard deviation of the distance of tags in front of their surfaces, m.
BEFORE_SURFACE = 0.02
# Standard deviation of a tag's own error in range, m: tags are printed, measured and hung to a centimetre.
TAG_SIGMA = 0.01
# A pair is an outlier beyond this many standard deviations.
GATE = 4.0
# A scale error is reported if it exceeds REPORTED by SIGNIFICANT standard deviations: tags of another size, or another
# camera's calibration. An error so great that most pairs are outliers needs MANY of them that agree.
REPORTED, SIGNIFICANT = 0.03, 4.0
MANY = 100
# The outliers' histogram by the logarithm of the ranges' ratio: bins of BIN, up to MOST, a factor of 50, either way.
# They agree if half of all pairs lie within NEAR bins or within the share NEARLY of the reported error, whichever is
# more.
BIN, MOST = 0.02, 3.92
NEAR, NEARLY = 3, 0.25
# Greatest tangent of the incidence on a surface, of 60 degrees: on more oblique ones a bearing error becomes a range
# error.
STEEPEST = 1.75
# Neighbouring rays belong to one surface if their ranges differ by less than this share; the surface is the line
# through RAYS of them on either side.
SAME_SURFACE = 0.1
RAYS = 4
# The rays bend if the outer half of them is this many standard deviations nearer or farther than the inner half.
STRAIGHT = 3.0


@message
class ScanRanges:
    """Pairs of a sighting and the scan: sums of w (J, d, 1) (J, d, 1)^T over those that agree. J: (5,) derivative of
    the pair's difference on the compared parameters and the distance in front of the surface, d: the difference, m, at
    zero, w: its weight, 1/m^2.

    ids: (t,), ascending, of the tags compared. of_tag: (t, 7) the last row of the sum over each tag's pairs. total:
    (6, 6) the other rows and columns of the sum over all pairs. apart: (b,) histogram of the pairs that do not agree,
    by the logarithm of the tag's range over that of the surface, in bins of BIN from -MOST on. pairs: number that
    agree. reported: True once a `great_error` was reported.
    """

    ids: IntArray
    of_tag: FloatArray
    total: FloatArray
    apart: IntArray
    pairs: int
    reported: bool = False


def none_compared() -> ScanRanges:
    """Return the state before the first pair."""
    apart = np.zeros(round(2.0 * MOST / BIN), dtype=np.int64)
    return ScanRanges(np.zeros(0, dtype=np.int64), np.zeros((0, 7)), np.zeros((6, 6)), apart, 0)


def compared(before: ScanRanges, detections: TagDetections, scan: LaserScan, shared: Shared) -> ScanRanges:
    """Return the pairs with those of one frame of tags and the scan of the same instant; shared: the estimate of the
    parameters."""
    ids = np.union1d(before.ids, detections.ids)
    of_tag = np.zeros((len(ids), 7))
    of_tag[np.searchsorted(ids, before.ids)] = before.of_tag
    before, row = replace(before, ids=ids, of_tag=of_tag), np.searchsorted(ids, detections.ids)
    sums, rays = (before.of_tag, before.total, before.apart), (scan.angles, scan.ranges, scan.sigma)
    frame = detections.range, detections.bearing, detections.sigma_range, detections.sigma_bearing
    of_tag, total, apart, pairs = _with_pairs(sums, row, frame, rays, (shared.mean, shared.covariance))
    return replace(before, of_tag=of_tag, total=total, apart=apart, pairs=before.pairs + pairs)


def scan_information(ranges: ScanRanges, worth: float) -> tuple[FloatArray, FloatArray]:
    """Return the information (13, 13) of all pairs on the shared parameters, and the gradient (13,) at zero. worth: the
    information of one of many frames, as a share of that by the data sheet."""
    of_tag, weight = worth * ranges.of_tag[:, :6], worth * ranges.of_tag[:, 6]
    # Eliminate each tag's own error.
    M = worth * ranges.total - (of_tag / (weight + TAG_SIGMA**-2)[:, None]).T @ of_tag
    J, gradient = M[:5, :5], -M[:5, 5]
    # Eliminate the distance to the surface. The scanner's mount has the camera's derivatives with the opposite sign.
    share = J[:4, 4] / (J[4, 4] + BEFORE_SURFACE**-2)
    by = np.zeros((4, SHARED))
    by[np.arange(4), COMPARED] = 1.0
    by[np.arange(1, 4), OF_SCANNER] = -1.0
    information = by.T @ (J[:4, :4] - np.outer(share, J[4, :4])) @ by
    return 0.5 * (information + information.T), by.T @ (gradient[:4] - share * gradient[4])


@njit(cache=True)
def surface(bearing: float, angles: FloatArray, ranges: FloatArray, sigma: float) -> tuple[float, float]:
    """Return the distance (m) to the surface at a bearing (rad), and the tangent of the incidence, the angle farther to
    the left at which the surface is seen head-on; nan without a surface.

    Along a line one over the range is a sinusoid of the angle, nearly linear over a few rays with evenly spaced angles,
    or nearly so: those of a depth image are denser away from its middle. sigma: the scan's, m; rays that bend more than
    it explains have no surface.
    """
    first = np.searchsorted(angles, bearing) - RAYS
    if not (first >= 0 and first + 2 * RAYS <= len(ranges)):
        return math.nan, math.nan
    step = (angles[first + 2 * RAYS - 1] - angles[first]) / (2 * RAYS - 1)
    middle = 0.5 * (angles[first + RAYS - 1] + angles[first + RAYS])
    r, ray = ranges[first : first + 2 * RAYS], np.arange(2 * RAYS) - RAYS + 0.5
    if not (np.all((r > 0.0) & (r < np.inf)) and np.all(np.abs(r[1:] - r[:-1]) < SAME_SURFACE * r[1:])):
        return math.nan, math.nan
    total, slope = (1.0 / r).sum(), (ray / r).sum()
    bend = (np.where(np.abs(ray) > 0.5 * RAYS, 1.0, -1.0) / r).sum()
    # Rays on either side of a corner bend.
    if abs(bend) > STRAIGHT * sigma * math.sqrt(2.0 * RAYS) * (total / (2 * RAYS)) ** 2:
        return math.nan, math.nan
    slope /= RAYS * (4 * RAYS * RAYS - 1) / 6.0
    mean = total * math.sin(0.5 * step) / math.sin(RAYS * step)
    inverse = mean + slope * (bearing - middle) / step
    return 1.0 / inverse, slope / (step * inverse)


@njit(cache=True)
def _with_pairs(
    before: tuple[FloatArray, FloatArray, IntArray],
    tag: IntArray,
    frame: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    scan: tuple[FloatArray, FloatArray, float],
    known: tuple[FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray, IntArray, int]:
    """Return of_tag, total and apart with the sightings (n,) of a frame added, of the tags in rows tag (n,), and the
    number of these that agree with the scan. known: mean and covariance of the parameters."""
    of_tag, total, apart, pairs = before[0].copy(), before[1].copy(), before[2].copy(), 0
    (range_, bearing, sigma_range, sigma_bearing), (angles, ranges, sigma_scan) = frame, scan
    (shared, covariance), mean, sigma, row = known, np.zeros(5), np.full(5, BEFORE_SURFACE), np.ones(7)
    for a in range(4):
        mean[a], sigma[a] = shared[COMPARED[a]], math.sqrt(covariance[COMPARED[a], COMPARED[a]])
    for a in range(3):
        mean[1 + a] -= shared[OF_SCANNER[a]]
        sigma[1 + a] = math.hypot(sigma[1 + a], math.sqrt(covariance[OF_SCANNER[a], OF_SCANNER[a]]))
    for k in range(len(range_)):
        at = bearing[k] + mean[1]
        distance, slant = surface(at, angles, ranges, sigma_scan)
        if not abs(slant) < STEEPEST:
            continue
        row[0], row[1] = distance, -slant * distance
        row[2], row[3] = -math.cos(at), -math.sin(at)
        row[4] = -math.sqrt(1.0 + slant * slant)
        row[5] = range_[k] - distance
        variance = sigma_range[k] ** 2 + (slant * distance * sigma_bearing[k]) ** 2 + sigma_scan**2 / RAYS
        error, predicted = row[5], variance + TAG_SIGMA**2
        for a in range(5):
            predicted += (row[a] * sigma[a]) ** 2
            error -= row[a] * mean[a] if a != 1 else 0.0
        # Extrapolate the difference to parameters of zero.
        row[5] += row[1] * mean[1]
        if error * error > GATE**2 * predicted:
            longer = math.log(range_[k] / distance)
            if abs(longer) < MOST:
                apart[int((longer + MOST) / BIN)] += 1
            continue
        pairs += 1
        of_tag[tag[k]] += row / variance
        total += np.outer(row[:6], row[:6]) / variance
    return of_tag, total, apart, pairs


def great_error(ranges: ScanRanges, shared: Shared) -> float:
    """Return the relative excess of the tags' ranges over the scan's if it is significant and more than REPORTED, else
    0: the estimated one if most pairs agree, or one so great that most pairs disagree by nearly the same ratio."""
    r, sigma = float(shared.mean[RANGE_SCALE]), float(shared.sigma[RANGE_SCALE])
    apart = int(ranges.apart.sum())
    if ranges.pairs > apart and abs(r) > REPORTED + SIGNIFICANT * sigma:
        return r
    most = max(MANY, (ranges.pairs + apart) // 2)
    counted = np.append(0, np.cumsum(ranges.apart))
    width = np.searchsorted(counted, counted + most, side="right") - np.arange(len(counted))
    first = int(np.argmin(np.where(counted + most < counted[-1], width, len(counted))))
    middle = BIN * (first + 0.5 * width[first]) - MOST
    says_so = counted[first] + most < counted[-1] and width[first] <= max(NEAR, NEARLY * abs(middle) / BIN)
    share = math.expm1(middle)
    return share if says_so and abs(share) > REPORTED else 0.0
