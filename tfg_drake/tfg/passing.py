"""Who passes by: what stands where an earlier goal saw free ground has come there since, and is no part of a building.

The robot's way past it is the scan's affair, see `tfg_drake.planning.path`. What was there when a place was first seen
is mapped like a wall, until it is seen past (`tfg_drake.tfg.surfaces`).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tfg_drake.geometry.distance import point_segment_distance
from tfg_drake.geometry.se2 import transform
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, replace
from tfg_drake.tfg.overlap import saw
from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.polyline import taken
from tfg_drake.tfg.surfaces import Surfaces

# Some of it stands this deep in what was seen to be free, m, all of it at least that deep, and it is this wide, m: a
# post may have been missed.
DEPTH = 0.2
SHALLOW = 0.06
LEAST_WIDTH = 0.15
# Goals farther away than this, m, are not asked.
REACH = 6.0
# Every so many bins are looked at first: two metres away somebody covers 28 of them.
STRIDE = 4
# Neighbouring points farther apart than this, m, or with more bins between them that met nothing, are not of one body.
SAME_BODY = 0.3
GAP = 2


def without_passers(
    panorama: Panorama,
    surfaces: Surfaces,
    tag_ids: IntArray,
    tag_goal: IntArray,
    stars: tuple[IntArray, FloatArray, FloatArray],
    star_goal: IntArray,
    estimate: MapEstimate,
) -> Panorama:
    """The newest goal's panorama, which is as good as not having looked where somebody stood; itself if nobody did.

    Those goals are asked that have seen a landmark which the newest has seen, too, so that both are known relative to
    each other, and that saw the ground where the robot is. surfaces, tag_ids, tag_goal: as in
    `tfg_drake.tfg.overlap.standing`, before the newest goal. stars: of the goals star_goal (k,), in the map frame.
    """
    here = estimate.X_MA[-1]
    goal, ids = saw(surfaces, tag_ids, tag_goal)
    tied = np.zeros(len(estimate.X_MA), dtype=np.bool_)
    tied[goal[np.isin(ids, estimate.observation.ids)]] = True
    rows = np.flatnonzero(tied[star_goal] & (np.hypot(*(stars[2] - here[:2]).T) <= REACH))
    if not len(rows):
        return panorama
    offsets, vertices = taken(rows, stars[0], stars[1])
    met = replace(panorama, ranges=np.where(np.isfinite(panorama.ranges), panorama.ranges, np.nan))
    passing = _passing(transform(here, met.points), here[:2], offsets, vertices)
    return replace(panorama, ranges=np.where(passing, np.nan, panorama.ranges)) if passing.any() else panorama


@njit(cache=True)
def _passing(points: FloatArray, p_MA: FloatArray, star_offsets: IntArray, star_vertices: FloatArray) -> BoolArray:
    """Which of a panorama's points (b, 2), nan where there is none, are of bodies that stand in the free ground
    of a star that holds p_MA (2,)."""
    bins, k = len(points), len(star_offsets) - 1
    boxes = np.empty((k, 4))
    for j in range(k):
        star = star_vertices[star_offsets[j] : star_offsets[j + 1]]
        boxes[j, 0], boxes[j, 1] = star[:, 0].min(), star[:, 0].max()
        boxes[j, 2], boxes[j, 3] = star[:, 1].min(), star[:, 1].max()
        if not _deep(p_MA[0], p_MA[1], star, 0.0):
            boxes[j, 0] = np.inf
    result = np.zeros(bins, dtype=np.bool_)
    asked = np.zeros(bins, dtype=np.bool_)
    for b in range(0, bins, STRIDE):
        if asked[b] or not _in_the_open(points[b], boxes, star_offsets, star_vertices, DEPTH):
            continue
        asked[b] = True
        ends = np.array([b, b])
        for side in range(2):
            step, skipped = 2 * side - 1, 0
            while ends[1] - ends[0] + skipped < bins - 1 and skipped <= GAP:
                at, following = ends[side] % bins, (ends[side] + step * (1 + skipped)) % bins
                if np.isnan(points[following, 0]):
                    skipped += 1
                    continue
                apart = np.hypot(points[following, 0] - points[at, 0], points[following, 1] - points[at, 1])
                if not apart < SAME_BODY or not _in_the_open(
                    points[following], boxes, star_offsets, star_vertices, SHALLOW
                ):
                    break
                ends[side] += step * (1 + skipped)
                asked[following] = True
                skipped = 0
        first, last = points[ends[0] % bins], points[ends[1] % bins]
        if np.hypot(last[0] - first[0], last[1] - first[1]) >= LEAST_WIDTH:
            for i in range(ends[0], ends[1] + 1):
                result[i % bins] = True
    return result


@njit(cache=True)
def _in_the_open(
    point: FloatArray, boxes: FloatArray, star_offsets: IntArray, star_vertices: FloatArray, depth: float
) -> bool:
    """Whether a point lies so deep (m) inside a star; boxes: (k, 4) x and y that such points lie between."""
    x, y = point[0], point[1]
    for j in range(len(boxes)):
        if not (boxes[j, 0] + depth <= x <= boxes[j, 1] - depth and boxes[j, 2] + depth <= y <= boxes[j, 3] - depth):
            continue
        if _deep(x, y, star_vertices[star_offsets[j] : star_offsets[j + 1]], depth):
            return True
    return False


@njit(cache=True)
def _deep(x: float, y: float, star: FloatArray, depth: float) -> bool:
    """Whether a point lies inside a polygon (v, 2), and at least depth (m) from its outline."""
    odd, xj, yj = False, star[-1, 0], star[-1, 1]
    for i in range(len(star)):
        xi, yi = star[i, 0], star[i, 1]
        if (yi > y) != (yj > y) and x < xi + (y - yi) / (yj - yi) * (xj - xi):
            odd = not odd
        xj, yj = xi, yi
    if not odd:
        return False
    for i in range(len(star) if depth > 0.0 else 0):
        if point_segment_distance(x, y, star[i - 1, 0], star[i - 1, 1], star[i, 0], star[i, 1]) < depth:
            return False
    return True
