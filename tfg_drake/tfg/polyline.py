"""Packed polylines: arc length, nearest points, samples and coverage.

Polyline i of a packed set has the vertices[offsets[i]:offsets[i + 1]]. The side a surface was seen from is the left
of its polyline, and its normal points there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from tfg_drake.geometry.distance import point_segment_distance
from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.geometry.segment_grid import rows_in_box, segment_grid
from tfg_drake.messages import BoolArray, FloatArray, IntArray

# Length by which a segment covers points beyond its ends, m, so that a polyline has no gap at its corners.
END_REACH = 0.03
# Cosine of the greatest angle between two pieces of one face.
SAME_FACE = 0.9


def pack(polylines: Sequence[FloatArray]) -> tuple[IntArray, FloatArray]:
    """Return offsets (n + 1,) and vertices (v, 2) of n polylines (v_i, 2)."""
    offsets = np.zeros(len(polylines) + 1, dtype=np.int64)
    np.cumsum([len(p) for p in polylines], out=offsets[1:])
    return offsets, np.concatenate([np.zeros((0, 2)), *polylines])


def segments_of(offsets: IntArray, vertices: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return all pieces (m, 4) of packed polylines, in order, and the polyline (m,) of each."""
    owner = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    inner = owner[1:] == owner[:-1]
    return np.concatenate([vertices[:-1], vertices[1:]], axis=1).compress(inner, axis=0), owner[:-1][inner]


def arc_length(polyline: FloatArray) -> FloatArray:
    """Return the arc length (v,), m, at each vertex of a polyline (v, 2)."""
    step = np.diff(polyline, axis=0)
    return np.concatenate([np.zeros(1), np.cumsum(np.hypot(step[:, 0], step[:, 1]))])


@read_only_arguments
@njit(cache=True)
def sub_polyline(polyline: FloatArray, start: float, stop: float) -> FloatArray:
    """Return the part of a polyline (v, 2) between two arc lengths start < stop, m."""
    s = np.zeros(len(polyline))
    for i in range(1, len(polyline)):
        s[i] = s[i - 1] + np.hypot(polyline[i, 0] - polyline[i - 1, 0], polyline[i, 1] - polyline[i - 1, 1])
    first = np.searchsorted(s, start + 1e-9, side="right")
    last = max(first, np.searchsorted(s, stop - 1e-9))
    part = np.empty((last - first + 2, 2))
    part[1:-1] = polyline[first:last]
    ends = np.array([start, stop])
    for axis in range(2):
        part[0, axis], part[-1, axis] = np.interp(ends, s, polyline[:, axis].copy())
    return part


@njit(cache=True)
def nearest(
    points: FloatArray, offsets: IntArray, vertices: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Find the nearest place on packed polylines to each point (n, 2).

    Returns the polyline (n,), -1 for none, the arc length along it (n,), m, the distance (n,), m, inf for none, and the
    unit normal on the polyline's left (n, 2).
    """
    n = points.shape[0]
    owner = np.full(n, -1)
    along = np.zeros(n)
    distance = np.full(n, np.inf)
    normal = np.zeros((n, 2))
    for i in range(offsets.shape[0] - 1):
        s = 0.0
        for v in range(offsets[i], offsets[i + 1] - 1):
            x0, y0 = vertices[v, 0], vertices[v, 1]
            dx, dy = vertices[v + 1, 0] - x0, vertices[v + 1, 1] - y0
            length = np.hypot(dx, dy)
            if length == 0.0:
                continue
            for j in range(n):
                ex, ey = points[j, 0] - x0, points[j, 1] - y0
                t = min(1.0, max(0.0, (ex * dx + ey * dy) / (length * length)))
                d = np.hypot(ex - t * dx, ey - t * dy)
                if d < distance[j]:
                    owner[j], along[j], distance[j] = i, s + t * length, d
                    normal[j, 0], normal[j, 1] = -dy / length, dx / length
            s += length
    return owner, along, distance, normal


@read_only_arguments
@njit(cache=True)
def sample(
    offsets: IntArray, vertices: FloatArray, spacing: float
) -> tuple[FloatArray, FloatArray, IntArray, FloatArray, FloatArray]:
    """Cut every piece of packed polylines into equal lengths of at most spacing (m).

    Returns the middles (n, 2), the unit normals on the left (n, 2), the polyline each belongs to (n,), and the arc
    lengths at which each length starts and stops (n,), (n,), m.
    """
    count = 0
    for i in range(offsets.shape[0] - 1):
        for v in range(offsets[i], offsets[i + 1] - 1):
            length = np.hypot(vertices[v + 1, 0] - vertices[v, 0], vertices[v + 1, 1] - vertices[v, 1])
            count += int(np.ceil(length / spacing))
    points, normals = np.zeros((count, 2)), np.zeros((count, 2))
    owner, start, stop = np.zeros(count, dtype=np.int64), np.zeros(count), np.zeros(count)
    n = 0
    for i in range(offsets.shape[0] - 1):
        s = 0.0
        for v in range(offsets[i], offsets[i + 1] - 1):
            dx, dy = vertices[v + 1, 0] - vertices[v, 0], vertices[v + 1, 1] - vertices[v, 1]
            length = np.hypot(dx, dy)
            parts = int(np.ceil(length / spacing))
            for k in range(parts):
                t = (k + 0.5) / parts
                points[n, 0], points[n, 1] = vertices[v, 0] + t * dx, vertices[v, 1] + t * dy
                normals[n, 0], normals[n, 1] = -dy / length, dx / length
                owner[n], start[n], stop[n] = i, s + k * length / parts, s + (k + 1) * length / parts
                n += 1
            s += length
    return points, normals, owner, start, stop


@njit(cache=True)
def covered(points: FloatArray, normals: FloatArray, segments: FloatArray, distance: FloatArray) -> BoolArray:
    """Return a mask of the points (n, 2) with unit normals (n, 2) that lie within a distance (n,), m, of a segment
    (m, 4) seen from the same side.

    Distance is measured across the segment, which covers almost nothing beyond its ends. The two faces of a thin wall
    never cover each other: a segment counts only if its left normal is within 60 degrees of the point's.
    """
    result = np.zeros(points.shape[0], dtype=np.bool_)
    grid = segment_grid(segments)
    near = np.empty(len(grid[4]), dtype=np.int64)
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        reach = distance[i] + END_REACH
        for k in range(rows_in_box(grid, x - reach, x + reach, y - reach, y + reach, near)):
            j = near[k]
            x0, y0, x1, y1 = segments[j, 0], segments[j, 1], segments[j, 2], segments[j, 3]
            if min(x0, x1) > x + reach or max(x0, x1) < x - reach:
                continue
            if min(y0, y1) > y + reach or max(y0, y1) < y - reach:
                continue
            dx, dy = x1 - x0, y1 - y0
            length = np.hypot(dx, dy)
            if length == 0.0 or dx * normals[i, 1] - dy * normals[i, 0] < 0.5 * length:
                continue
            along = ((x - x0) * dx + (y - y0) * dy) / length
            if -END_REACH <= along <= length + END_REACH and abs((x - x0) * dy - (y - y0) * dx) <= distance[i] * length:
                result[i] = True
                break
    return result


@njit(cache=True)
def joined(
    points: FloatArray,
    outwards: FloatArray,
    is_last: BoolArray,
    owner: IntArray,
    segments: FloatArray,
    segment_owner: IntArray,
    distance: float,
) -> BoolArray:
    """Return a mask of the ends (n, 2) of polylines (n,) within distance (m) of a segment (m, 4) of another polyline
    (m,).

    outwards: (n, 2) unit vectors in which the polylines would continue beyond their ends. is_last: (n,) mask of last
    points. A segment of the same face that does not extend farther is a duplicate and joins nothing.
    """
    result = np.zeros(points.shape[0], dtype=np.bool_)
    grid = segment_grid(segments)
    near = np.empty(len(grid[4]), dtype=np.int64)
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        for k in range(rows_in_box(grid, x - distance, x + distance, y - distance, y + distance, near)):
            j = near[k]
            if segment_owner[j] == owner[i]:
                continue
            s = segments[j]
            if point_segment_distance(x, y, s[0], s[1], s[2], s[3]) > distance:
                continue
            first = (s[0] - x) * outwards[i, 0] + (s[1] - y) * outwards[i, 1]
            last = (s[2] - x) * outwards[i, 0] + (s[3] - y) * outwards[i, 1]
            ahead = last - first if is_last[i] else first - last
            same_face = ahead > SAME_FACE * np.hypot(s[2] - s[0], s[3] - s[1])
            if not same_face or max(first, last) > END_REACH:
                result[i] = True
                break
    return result


def uncovered_runs(
    owner: IntArray, is_covered: BoolArray, start: FloatArray, stop: FloatArray, least: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the stretches of consecutive uncovered samples (n,) of polylines, see `sample`: the polyline (r,), and
    start and stop (r,), (r,), m of arc length.

    Stretches shorter than least (m) are omitted.
    """
    bare = ~is_covered
    goes_on = bare[1:] & bare[:-1] & (owner[1:] == owner[:-1])
    first = np.flatnonzero(bare & ~np.append(False, goes_on)[: len(bare)])
    last = np.flatnonzero(bare & ~np.append(goes_on, False)[: len(bare)])
    long = stop[last] - start[first] >= least
    return owner[first[long]], start[first[long]], stop[last[long]]
