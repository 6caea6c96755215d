"""Ray casting and line of sight past wall segments.

All points, angles and segments of a call are in one common frame, whichever the caller likes. A segment is a row
(x0, y0, x1, y1) in metres. Walls that share an end point leave no gap: a ray through the point hits.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.messages import BoolArray, FloatArray


@njit(cache=True)
def segments_within(segments: FloatArray, origin: FloatArray, distance: float) -> FloatArray:
    """The segments (k, 4) whose bounding box comes within distance (m) of origin (2,) on both axes, in their order."""
    near = np.empty_like(segments)
    count = 0
    x, y = origin[0], origin[1]
    for i in range(segments.shape[0]):
        x0, y0, x1, y1 = segments[i, 0], segments[i, 1], segments[i, 2], segments[i, 3]
        if min(x0, x1) > x + distance or max(x0, x1) < x - distance:
            continue
        if min(y0, y1) > y + distance or max(y0, y1) < y - distance:
            continue
        near[count, 0], near[count, 1], near[count, 2], near[count, 3] = x0, y0, x1, y1
        count += 1
    return near[:count]


@njit(cache=True)
def _distance_to_hit(ax: float, ay: float, bx: float, by: float, c: float, s: float) -> float:
    """Distance from the origin along the unit vector (c, s) to the segment from a to b, inf where it is missed."""
    # Which side of the ray each end lies on. A shared end point gives the same number for both of its walls, so no ray
    # slips between them.
    side_a = c * ay - s * ax
    side_b = c * by - s * bx
    if (side_a > 0.0 and side_b > 0.0) or (side_a < 0.0 and side_b < 0.0):
        return np.inf
    along_a = c * ax + s * ay
    along_b = c * bx + s * by
    if side_a == side_b:  # The segment lies on the ray's own line.
        if along_a < 0.0 and along_b < 0.0:
            return np.inf
        return max(0.0, min(along_a, along_b))
    along = along_a + (along_b - along_a) * (side_a / (side_a - side_b))
    return along if along >= 0.0 else np.inf


@njit(cache=True)
def cast_rays(segments: FloatArray, origin: FloatArray, angles: FloatArray, range_max: float) -> FloatArray:
    """Distance to the first segment along each ray.

    segments: (m, 4) m, m >= 0. origin: (2,) m. angles: (k,) rad, directions of the rays in the segments' frame.
    range_max: m. Returns (k,) m, inf where nothing is hit within range_max (inclusive).
    """
    ranges = np.full(angles.shape[0], np.inf)
    cosines, sines = np.cos(angles), np.sin(angles)
    near = segments_within(segments, origin, range_max)
    for i in range(near.shape[0]):
        ax, ay = near[i, 0] - origin[0], near[i, 1] - origin[1]
        bx, by = near[i, 2] - origin[0], near[i, 3] - origin[1]
        for j in range(angles.shape[0]):
            hit = _distance_to_hit(ax, ay, bx, by, cosines[j], sines[j])
            if hit <= range_max and hit < ranges[j]:
                ranges[j] = hit
    return ranges


def line_of_sight(segments: FloatArray, p_from: FloatArray, p_to: FloatArray, tolerance: float = 1e-3) -> BoolArray:
    """Whether each point can be seen from p_from; touching a segment counts as blocked.

    segments: (m, 4) m, m >= 0. p_from: (2,) m. p_to: (n, 2) m. tolerance: m, by which each line is shortened at the
    p_to end, so that the surface a point lies on does not hide it. Returns (n,) bool.
    """
    return np.asarray(_in_sight(segments, p_from, p_to, tolerance))


@njit(cache=True)
def in_sight(segments: FloatArray, p_from: FloatArray, p_to: FloatArray, tolerance: float) -> BoolArray:
    """As line_of_sight, for other kernels."""
    n = p_to.shape[0]
    visible = np.ones(n, dtype=np.bool_)
    farthest = 0.0
    for j in range(n):
        farthest = max(farthest, abs(p_to[j, 0] - p_from[0]), abs(p_to[j, 1] - p_from[1]))
    near = segments_within(segments, p_from, farthest)
    for j in range(n):
        dx, dy = p_to[j, 0] - p_from[0], p_to[j, 1] - p_from[1]
        distance = np.hypot(dx, dy)
        reach = distance - tolerance
        if reach <= 0.0:
            continue
        c, s = dx / distance, dy / distance
        for i in range(near.shape[0]):
            ax, ay = near[i, 0] - p_from[0], near[i, 1] - p_from[1]
            bx, by = near[i, 2] - p_from[0], near[i, 3] - p_from[1]
            if _distance_to_hit(ax, ay, bx, by, c, s) <= reach:
                visible[j] = False
                break
    return visible


_in_sight = read_only_arguments(in_sight)


def disc_distances(discs: FloatArray, origin: FloatArray, angles: FloatArray) -> FloatArray:
    """Distance (k,), m, to the first of the discs (n, 3), centre and radius in m, along each ray; inf where it meets
    none, 0 where it begins in one.

    origin: (2,) m. angles: (k,) rad, directions of the rays in the discs' frame.
    """
    x, y, radius = (discs - np.append(origin, 0.0)).T[:, :, None]
    c, s = np.cos(angles), np.sin(angles)
    # Half of the chord that a disc cuts out of a ray's line, squared, and how far along the ray its middle is.
    half, middle = radius**2 - (c * y - s * x) ** 2, c * x + s * y
    half = np.where(half >= 0.0, np.sqrt(np.maximum(half, 0.0)), -np.inf)
    distance = np.where(middle + half >= 0.0, np.maximum(middle - half, 0.0), np.inf)
    return np.asarray(distance.min(axis=0, initial=np.inf))


def surely_visible(segments: FloatArray, p_from: FloatArray, p_to: FloatArray, graze: float) -> BoolArray:
    """Which points p_to (n, 2) can be seen from p_from (2,), m, (n,), and not only just past one end of a segment: were
    they this much (m) to either side, both or neither could.

    segments: as in line_of_sight. What is seen through a slit between two ends counts.
    """
    d = p_to - p_from
    aside = graze / np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-9)[:, None] * np.stack([-d[:, 1], d[:, 0]], axis=1)
    left, right = line_of_sight(segments, p_from, p_to + aside), line_of_sight(segments, p_from, p_to - aside)
    return np.asarray(line_of_sight(segments, p_from, p_to) & (left == right))
