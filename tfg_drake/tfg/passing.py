"""Dynamic obstacles: points of a panorama deep inside the free space of an earlier view are not mapped.

They are usually people, who came after the earlier view and are not part of the building. Paths around them are planned
by the scan alone, see `tfg_drake.planning.path`. A body that was present when a place was first seen is mapped as a
surface until it is seen past (`tfg_drake.tfg.surfaces`).

A body that is still at the same place later, and was not seen past in between, is static: a closed door, or furniture.
It is mapped, and cut out of the free space of the earlier views.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from tfg_drake.geometry.distance import point_distance, point_segment_distance
from tfg_drake.geometry.se2 import inverse, transform, wrap_angle
from tfg_drake.geometry.star import inside_any
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, is_tag, replace
from tfg_drake.slam.walls import wall_ends
from tfg_drake.table import taken
from tfg_drake.tfg.drift import NEIGHBOURHOOD, drift_from_robot, known_jointly
from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.polyline import pack
from tfg_drake.tfg.stars import Stars

# A dynamic body has points DEPTH, m, deep in free space, over LEAST_WIDTH, m, as an earlier view may have missed a
# post, and over LEAST_VIEW, m, across the line of sight of that view. Points beside them belong to it if they are
# SHALLOW, m, deep.
DEPTH = 0.2
LEAST_WIDTH = 0.15
LEAST_VIEW = 0.1
SHALLOW = 0.06
# Earlier views within this distance, m, are compared.
REACH = 8.0
# A landmark is well known if its position relative to the robot has at most this standard deviation, m.
WELL_KNOWN = 0.05
# Every STRIDE-th bin is tested first: a person two metres away covers 28 of them.
STRIDE = 4
# Neighbouring points within SAME_BODY, m, with at most GAP bins between them, belong to one body.
SAME_BODY = 0.3
GAP = 2
# A body is static if the share SAME_SHARE of it is within SAME_PLACE, m, of points that were left out STAYS, s, before:
# people who stand and talk are seen past sooner or later.
STAYS = 20.0
SAME_PLACE = 0.1
SAME_SHARE = 0.5
# Assumed depth of a static body: its width, at most MOST_DEPTH, m. The star in front of it reaches at least
# LEAST_REACH, m.
MOST_DEPTH = 0.5
LEAST_REACH = 0.1


@dataclasses.dataclass(frozen=True)
class StaticPanorama:
    """A panorama without dynamic bodies.

    panorama: nan where a dynamic body stood, as if the turn had not looked there. left_out: (n, 2) m in A, the points
    of these bodies. bodies: (k, 2) m in A each, the bodies that have become static and stay in the panorama.
    """

    panorama: Panorama
    left_out: FloatArray
    bodies: list[FloatArray]


def without_dynamic(
    panorama: Panorama,
    stars: Stars,
    estimate: MapEstimate,
    before: FloatArray,
) -> StaticPanorama:
    """Return the newest view's panorama without dynamic bodies.

    It is compared with the earlier views around which landmarks are well known relative to the robot. stars: of the
    earlier views, in the map frame. before: (n, 2) m in M, the points that were left out at least STAYS ago.
    """
    unchanged = StaticPanorama(panorama, np.zeros((0, 2)), [])
    here = estimate.X_MA[-1]
    rows = np.flatnonzero(np.hypot(*(stars.centers - here[:2]).T) <= REACH)
    rows = rows[_well_known(stars.centers[rows], estimate)]
    if not len(rows):
        return unchanged
    offsets, vertices = taken(rows, *stars.polygons)
    met = replace(panorama, ranges=np.where(np.isfinite(panorama.ranges), panorama.ranges, np.nan))
    points = met.points
    passing = _passing(transform(here, points), offsets, vertices, stars.centers[rows])
    if not passing.any():
        return unchanged
    bodies = []
    if len(before):
        tree = cKDTree(transform(inverse(here), before))
        for body in _bodies(np.flatnonzero(passing), points):
            if np.mean(tree.query(points[body])[0] <= SAME_PLACE) >= SAME_SHARE:
                passing[body] = False
                bodies.append(points[body])
    return StaticPanorama(
        replace(panorama, ranges=np.where(passing, np.nan, panorama.ranges)),
        points[passing & np.isfinite(points[:, 0])],
        bodies,
    )


def _bodies(bins: IntArray, points: FloatArray) -> list[IntArray]:
    """The bins split into bodies: runs of neighbouring points, of a panorama's points (b, 2), within SAME_BODY."""
    bins = bins[np.isfinite(points[bins, 0])]
    apart = np.hypot(*np.diff(points[bins], axis=0).T) > SAME_BODY
    return np.split(bins, np.flatnonzero(apart) + 1)


def seen_past(p_AP: FloatArray, panorama: Panorama) -> BoolArray:
    """Return a mask (n,) of the points (n, 2), m in A, that the panorama saw DEPTH past, in their bin and its
    neighbours."""
    return np.asarray(panorama.least_range(p_AP, 1) > np.hypot(*p_AP.T) + DEPTH)


def without_bodies(
    star_offsets: IntArray, star_vertices: FloatArray, X_MA: FloatArray, p_MP: list[FloatArray]
) -> tuple[IntArray, FloatArray]:
    """Return the stars, offsets (k + 1,) and vertices (v, 2) in the frames of their views X_MA (k, 3), without the
    space that bodies (n, 2), m in M, occupy or hide."""
    stars = np.split(star_vertices.copy(), star_offsets[1:-1])
    for body in p_MP:
        stars = [_without(star, transform(inverse(X), body)) for star, X in zip(stars, X_MA, strict=True)]
    return pack(stars)


def _without(star: FloatArray, body: FloatArray) -> FloatArray:
    """A star polygon (v, 2) round the origin that ends in front of a body (n, 2)."""
    body = body[inside_any(body, np.array([0, len(star)]), star)]
    if not len(body):
        return star
    middle = float(np.arctan2(*body.mean(axis=0)[::-1]))
    towards = wrap_angle(np.arctan2(body[:, 1], body[:, 0]) - middle)
    sides = middle + np.array([towards.min(), towards.max()])
    width = float(np.hypot(*np.ptp(body, axis=0)))
    reach = max(float(np.hypot(*body.T).min()) - min(width, MOST_DEPTH), LEAST_REACH)
    bearing = wrap_angle(np.arctan2(star[:, 1], star[:, 0]) - middle)
    clear = star[(bearing < towards.min()) | (bearing > towards.max())]
    cut = np.vstack([clear, reach * np.stack([np.cos(sides), np.sin(sides)], axis=1)])
    return np.asarray(cut[np.argsort(np.arctan2(cut[:, 1], cut[:, 0]) % (2.0 * np.pi), kind="stable")])


def _well_known(places: FloatArray, estimate: MapEstimate) -> BoolArray:
    """Which places (n, 2), m in M, have tags near or walls in sight, all of them well known relative to the robot,
    (n,)."""
    (xx, xy), (_, yy) = drift_from_robot(estimate, estimate.local).transpose(1, 2, 0)
    badly = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy) > WELL_KNOWN**2
    p_ML, tags, walls = estimate.local_p_ML, is_tag(estimate.ids[estimate.local]), wall_ends(estimate)
    near, well = np.zeros((2, len(places)), dtype=np.bool_)
    well[:] = True
    for segments, unsure, reach in (
        (np.hstack([p_ML[tags], p_ML[tags]]), badly[tags], NEIGHBOURHOOD),
        (walls[estimate.local[~tags]].reshape(-1, 4), badly[~tags], REACH),
    ):
        near |= point_distance(places, segments) <= reach
        well &= point_distance(places, segments[unsure]) > reach
    return np.asarray(near & well & known_jointly(places, estimate))


@njit(cache=True)
def _passing(
    points: FloatArray, star_offsets: IntArray, star_vertices: FloatArray, star_centers: FloatArray
) -> BoolArray:
    """Which points (b, 2) of a panorama, nan where there is none, belong to bodies inside the free space of a star."""
    bins = len(points)
    result, asked = np.zeros(bins, dtype=np.bool_), np.empty(bins, dtype=np.bool_)
    ends, deepest = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    for j in range(len(star_offsets) - 1):
        star, center = star_vertices[star_offsets[j] : star_offsets[j + 1]], star_centers[j]
        left, right, low, high = star[:, 0].min(), star[:, 0].max(), star[:, 1].min(), star[:, 1].max()
        asked[:] = result
        for b in range(0, bins, STRIDE):
            x, y = points[b, 0], points[b, 1]
            if asked[b] or not (left + DEPTH <= x <= right - DEPTH and low + DEPTH <= y <= high - DEPTH):
                continue
            if not _deep(x, y, star, DEPTH):
                continue
            ends[:], deepest[:] = b, b
            for side in range(2):
                step, skipped = 2 * side - 1, 0
                while ends[1] - ends[0] + skipped < bins - 1 and skipped <= GAP:
                    at, following = ends[side] % bins, (ends[side] + step * (1 + skipped)) % bins
                    x, y = points[following, 0], points[following, 1]
                    if np.isnan(x):
                        skipped += 1
                        continue
                    if not np.hypot(x - points[at, 0], y - points[at, 1]) < SAME_BODY or not _deep(x, y, star, SHALLOW):
                        break
                    ends[side] += step * (1 + skipped)
                    asked[following], skipped = True, 0
                    if _deep(x, y, star, DEPTH):
                        deepest[side] = ends[side]
            if _shows(points, deepest[0], deepest[1], center):
                for i in range(ends[0], ends[1] + 1):
                    result[i % bins] = True
    return result


@njit(cache=True)
def _shows(points: FloatArray, begin: int, end: int, center: FloatArray) -> bool:
    """Whether what has the points from begin to end is LEAST_WIDTH wide, and wide enough seen from a center (2,) that
    it could not be missed there: a thin wall shows nothing of itself edge-on."""
    bins = len(points)
    first, last = points[begin % bins], points[end % bins]
    if np.hypot(last[0] - first[0], last[1] - first[1]) < LEAST_WIDTH:
        return False
    dx, dy = 0.5 * (first[0] + last[0]) - center[0], 0.5 * (first[1] + last[1]) - center[1]
    distance = max(np.hypot(dx, dy), 1e-9)
    least, most = np.inf, -np.inf
    for i in range(begin, end + 1):
        x, y = points[i % bins, 0] - center[0], points[i % bins, 1] - center[1]
        if not np.isnan(x):
            across = (dx * y - dy * x) / distance
            least, most = min(least, across), max(most, across)
    return bool(most - least >= LEAST_VIEW)


@njit(cache=True)
def _deep(x: float, y: float, star: FloatArray, depth: float) -> bool:
    """Return whether a point lies inside a polygon (v, 2), at least depth (m) from its outline."""
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
