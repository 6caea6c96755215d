"""Tags that are not seen where the map has them, though nothing hides them: they fell off, or were taken away.

Where the scan meets a surface all over a tag's place, not aslant and from the side that the tag has been seen from, the
frame should show it. How often frames do, all tags taken together, tells how many in a row must fail to.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray, LaserScan, TagDetections, message, replace
from tfg_drake.slam.keyframe import rows_of
from tfg_drake.slam.scan_ranges import surface

# From farther away, m, and nearer than this, rad, to where no tag has been seen yet, detectors miss tags, and so they
# do on surfaces whose incidence has a larger tangent than this.
NEAR = 4.0
INSIDE = 0.1
STEEPEST = 1.2
# Cosine of the angle to the mean direction that a tag has been seen from, within which it is seen again, and of the
# angle of that direction to the surface's normal: else the tag is on its other side.
NEAR_BY = math.cos(math.radians(60.0))
SAME_SIDE = math.cos(math.radians(80.0))
# The surface that the scan meets is the tag's where its distance differs by no more than this, m, at its middle and so
# far to either side of it, m: what hides a part of a tag hides it from the detector.
SAME_SURFACE = 0.1
HALF_WIDTH = 0.1
# A tag is missing where no fewer frames in a row fail to show it than this, and by chance as seldom as that.
LEAST_FRAMES = 5
LEAST_CHANCE = 1e-4


@message
class TagWatch:
    """Which tags of the map frames should have shown, and did not.

    ids: (k,) the map's. seen_from: (k, 2) sums of unit vectors from each tag to the camera in the frames that showed
    it, in M. failed: (k,) frames in a row that should have shown it. widest: rad, the greatest bearing of any sighting.
    all_expected: frames that should have shown a tag, of all tags together, all_seen: those that did.
    """

    ids: IntArray
    seen_from: FloatArray
    failed: IntArray
    widest: float
    all_expected: int
    all_seen: int


def no_watch() -> TagWatch:
    """Before the first view."""
    none = np.empty(0, dtype=np.int64)
    return TagWatch(none, np.empty((0, 2)), none, 0.0, 0, 0)


def watched(
    watch: TagWatch, p_ML: FloatArray, X_MC: FloatArray, yaw: float, frame: TagDetections, scan: LaserScan
) -> TagWatch:
    """The watch after one frame of a camera at X_MC (3,), by the scan of that instant.

    p_ML: (k, 2) of the map's tags, m in M. yaw: of the camera in the body frame, rad. A frame without a tag of the map
    says nothing: the camera may see none at all.
    """
    seen_from, failed, widest, expected, seen = _watched(
        watch.ids,
        watch.seen_from,
        watch.failed,
        watch.widest,
        p_ML,
        X_MC,
        yaw,
        frame.ids,
        frame.bearing,
        scan.angles,
        scan.ranges,
    )
    return TagWatch(watch.ids, seen_from, failed, widest, watch.all_expected + expected, watch.all_seen + seen)


def missing(watch: TagWatch) -> BoolArray:
    """(k,) which of the tags are not where the map has them."""
    share = (watch.all_seen + 1.0) / (watch.all_expected + 2.0)
    return np.asarray(watch.failed >= max(LEAST_FRAMES, math.log(LEAST_CHANCE) / math.log1p(-share)))


def renewed(watch: TagWatch, ids: IntArray) -> TagWatch:
    """The watch after a new view, with the map's tags (n,) as they are now: of what was missing it begins anew."""
    rows, known = rows_of(ids, watch.ids)
    seen_from, failed = np.zeros((len(ids), 2)), np.zeros(len(ids), dtype=np.int64)
    seen_from[known] = watch.seen_from[rows[known]]
    failed[known] = np.where(missing(watch), 0, watch.failed)[rows[known]]
    return replace(watch, ids=ids, seen_from=seen_from, failed=failed)


@njit(cache=True)
def _watched(
    ids: IntArray,
    seen_from: FloatArray,
    failed: IntArray,
    widest: float,
    p_ML: FloatArray,
    X_MC: FloatArray,
    yaw: float,
    frame_ids: IntArray,
    bearing: FloatArray,
    angles: FloatArray,
    ranges: FloatArray,
) -> tuple[FloatArray, IntArray, float, int, int]:
    """What a watch has as seen_from, failed and widest after a frame, and how many tags of the map the frame should
    have shown and has shown of these."""
    shown = np.zeros(len(ids), dtype=np.bool_)
    seen_from, failed = seen_from.copy(), failed.copy()
    for row, one in zip(np.searchsorted(ids, frame_ids), frame_ids):  # noqa: B905 numba knows no strict
        if row < len(ids) and ids[row] == one:
            x, y = X_MC[0] - p_ML[row, 0], X_MC[1] - p_ML[row, 1]
            distance = max(math.hypot(x, y), 1e-6)
            seen_from[row, 0] += x / distance
            seen_from[row, 1] += y / distance
            shown[row] = True
    if not shown.any():
        return seen_from, failed, widest, 0, 0
    widest = max(widest, np.abs(bearing).max())
    expected, seen = 0, 0
    for i in range(len(ids)):
        if _expected(p_ML[i], seen_from[i], X_MC, yaw, widest, angles, ranges):
            expected += 1
            seen += shown[i]
            failed[i] += 1
        if shown[i]:
            failed[i] = 0
    return seen_from, failed, widest, expected, seen


@njit(cache=True)
def _expected(
    p_ML: FloatArray,
    seen_from: FloatArray,
    X_MC: FloatArray,
    yaw: float,
    widest: float,
    angles: FloatArray,
    ranges: FloatArray,
) -> bool:
    """Whether a frame should show a tag, at p_ML (2,) and seen from (2,)."""
    x, y = X_MC[0] - p_ML[0], X_MC[1] - p_ML[1]
    distance = math.hypot(x, y)
    if not 0.0 < distance < NEAR:
        return False
    bearing = math.atan2(-y, -x) - X_MC[2]
    bearing = math.atan2(math.sin(bearing), math.cos(bearing))
    often = math.hypot(seen_from[0], seen_from[1])
    if abs(bearing) > widest - INSIDE or not seen_from[0] * x + seen_from[1] * y > NEAR_BY * often * distance:
        return False
    met, slant = surface(bearing + yaw, angles, ranges, math.inf)
    straight = X_MC[2] + bearing + math.atan(slant)
    side = -seen_from[0] * math.cos(straight) - seen_from[1] * math.sin(straight)
    is_there = abs(slant) < STEEPEST and abs(met - distance) < SAME_SURFACE
    if not (is_there and side > SAME_SIDE * often):
        return False
    half = math.atan(HALF_WIDTH / distance)
    left = surface(bearing + half + yaw, angles, ranges, math.inf)[0]
    right = surface(bearing - half + yaw, angles, ranges, math.inf)[0]
    most = SAME_SURFACE + HALF_WIDTH * abs(slant)
    return abs(left - distance) < most and abs(right - distance) < most
