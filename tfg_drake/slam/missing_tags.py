"""Tags that are not seen where the map has them, though nothing hides them: they fell off, or were taken away.

Where the scan meets a surface at a tag's place, not aslant and from the side that the tag has been seen from, the
frame should show it. How often frames do, all tags taken together, tells how many in a row must fail to.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray, LaserScan, TagDetections, message, replace
from tfg_drake.slam.keyframe_graph import rows_of
from tfg_drake.slam.range_scale import surface

# From farther away, m, and nearer than this, rad, to where no tag has been seen yet, detectors miss tags, and so they
# do on surfaces whose incidence has a larger tangent than this.
NEAR = 4.0
INSIDE = 0.1
STEEPEST = 1.2
# Cosine of the angle to the mean direction that a tag has been seen from, within which it is seen again, and of the
# angle of that direction to the surface's normal: else the tag is on its other side.
NEAR_BY = math.cos(math.radians(60.0))
SAME_SIDE = math.cos(math.radians(80.0))
# The surface that the scan meets is the tag's where its distance differs by no more than this, m.
SAME_SURFACE = 0.1
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
    rows, known = rows_of(frame.ids, watch.ids)
    rows = rows[known]
    if not len(rows):
        return watch
    shown = np.zeros(len(watch.ids), dtype=np.bool_)
    shown[rows] = True
    seen_from, widest = watch.seen_from.copy(), max(watch.widest, float(np.abs(frame.bearing).max()))
    to_camera = X_MC[:2] - p_ML[rows]
    seen_from[rows] += to_camera / np.maximum(np.hypot(*to_camera.T), 1e-6)[:, None]
    expected = _expected(p_ML, seen_from, X_MC, yaw, widest, scan.angles, scan.ranges)
    return replace(
        watch,
        seen_from=seen_from,
        failed=np.where(shown, 0, watch.failed + expected),
        widest=widest,
        all_expected=watch.all_expected + int(np.count_nonzero(expected)),
        all_seen=watch.all_seen + int(np.count_nonzero(expected & shown)),
    )


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
def _expected(
    p_ML: FloatArray,
    seen_from: FloatArray,
    X_MC: FloatArray,
    yaw: float,
    widest: float,
    angles: FloatArray,
    ranges: FloatArray,
) -> BoolArray:
    """(k,) which tags a frame should show."""
    expected = np.zeros(len(p_ML), dtype=np.bool_)
    for i in range(len(p_ML)):
        x, y = X_MC[0] - p_ML[i, 0], X_MC[1] - p_ML[i, 1]
        distance = math.hypot(x, y)
        if not 0.0 < distance < NEAR:
            continue
        bearing = math.atan2(-y, -x) - X_MC[2]
        bearing = math.atan2(math.sin(bearing), math.cos(bearing))
        from_x, from_y = seen_from[i, 0], seen_from[i, 1]
        often = math.hypot(from_x, from_y)
        if abs(bearing) > widest - INSIDE or not from_x * x + from_y * y > NEAR_BY * often * distance:
            continue
        met, slant = surface(bearing + yaw, angles, ranges)
        straight = X_MC[2] + bearing + math.atan(slant)
        side = -from_x * math.cos(straight) - from_y * math.sin(straight)
        is_there = abs(slant) < STEEPEST and abs(met - distance) < SAME_SURFACE
        expected[i] = is_there and side > SAME_SIDE * often
    return expected
