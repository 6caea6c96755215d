"""Distances between points, path edges and obstacle surfaces, in closed form (numba kernels).

A segment is a row (x0, y0, x1, y1), m, in any one frame. Zero-length segments are points.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.geometry.segment_grid import SegmentGrid, cell_range, rows_in_box, segment_grid
from tfg_drake.messages import BoolArray, FloatArray

# Upper bound of a distance's rounding error, as a share of it.
ROUNDING = 1e-9
# A line belongs to the cells within BORDER, m, of it; one less than STEEP, m, wide to all cells of its height.
BORDER = 1e-6
STEEP = 1e-3


@njit(cache=True)
def nearest_on_segment(x: float, y: float, x0: float, y0: float, x1: float, y1: float) -> tuple[float, float]:
    """The point of the segment (x0, y0)-(x1, y1) that is nearest to (x, y)."""
    dx, dy = x1 - x0, y1 - y0
    length_squared = dx * dx + dy * dy
    t = 0.0
    if length_squared > 0.0:
        t = min(1.0, max(0.0, ((x - x0) * dx + (y - y0) * dy) / length_squared))
    return x0 + t * dx, y0 + t * dy


@njit(cache=True)
def _square(x: float, y: float, x0: float, y0: float, x1: float, y1: float) -> float:
    """Squared distance (m^2) from the point (x, y) to the segment (x0, y0)-(x1, y1)."""
    nx, ny = nearest_on_segment(x, y, x0, y0, x1, y1)
    return (nx - x) ** 2 + (ny - y) ** 2


@njit(cache=True)
def point_segment_distance(x: float, y: float, x0: float, y0: float, x1: float, y1: float) -> float:
    """Distance (m) from the point (x, y) to the segment (x0, y0)-(x1, y1)."""
    return math.sqrt(_square(x, y, x0, y0, x1, y1))


@njit(cache=True)
def side_of(x: float, y: float, x0: float, y0: float, x1: float, y1: float) -> float:
    """More than 0 where (x, y) lies to the left of the line from (x0, y0) to (x1, y1), less to its right."""
    return (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)


@njit(cache=True)
def segments_cross(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float) -> bool:
    """Whether a-b and c-d cross at a point inside both. Touching and collinear pairs are left to point distances."""
    if (side_of(cx, cy, ax, ay, bx, by) > 0.0) == (side_of(dx, dy, ax, ay, bx, by) > 0.0):
        return False
    return (side_of(ax, ay, cx, cy, dx, dy) > 0.0) != (side_of(bx, by, cx, cy, dx, dy) > 0.0)


@njit(cache=True)
def _square_between(ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float) -> float:
    """Squared distance (m^2) between the segments a-b and c-d, 0 where they cross."""
    if segments_cross(ax, ay, bx, by, cx, cy, dx, dy):
        return 0.0
    return min(
        min(_square(ax, ay, cx, cy, dx, dy), _square(bx, by, cx, cy, dx, dy)),
        min(_square(cx, cy, ax, ay, bx, by), _square(dx, dy, ax, ay, bx, by)),
    )


@njit(cache=True)
def segment_segment_distance(
    ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float
) -> float:
    """Distance (m) between the segments a-b and c-d, 0 where they cross."""
    return math.sqrt(_square_between(ax, ay, bx, by, cx, cy, dx, dy))


@read_only_arguments
@njit(cache=True)
def point_distance(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Distance (n,), m, from each point (n, 2) to the nearest segment (m, 4); inf without segments."""
    distance = np.full(len(points), np.inf)
    for i in range(len(points)):
        for j in range(len(segments)):
            s = segments[j]
            distance[i] = min(distance[i], point_segment_distance(points[i, 0], points[i, 1], s[0], s[1], s[2], s[3]))
    return distance


@njit(cache=True)
def room_beside(
    ax: float,
    ay: float,
    bx: float,
    by: float,
    segments: FloatArray,
    grid: SegmentGrid,
    reach: float,
) -> float:
    """Distance (m) from the edge a-b to the nearest of segments (m, 4), 0 where it crosses one, and no more than reach
    (m): surfaces farther away are not looked at. grid: the segment_grid of the segments."""
    frame, columns, rows, offsets, index = grid
    left, right, low, high = min(ax, bx), max(ax, bx), min(ay, by), max(ay, by)
    best, square = reach, reach * reach
    ex, ey = bx - ax, by - ay
    length = math.sqrt(ex * ex + ey * ey)
    a0, a1 = cell_range(left - best, right + best, frame[0], frame[2], columns)
    b0, b1 = cell_range(low - best, high + best, frame[1], frame[2], rows)
    for a in range(a0, a1):
        # Cells of a column lie one after the other.
        for k in range(offsets[a * rows + b0], offsets[a * rows + b1]):
            j = index[k]
            cx, cy, dx, dy = segments[j, 0], segments[j, 1], segments[j, 2], segments[j, 3]
            # The gap between the two bounding boxes is a lower bound of the distance.
            if max(cx, dx) < left - best or min(cx, dx) > right + best:
                continue
            if max(cy, dy) < low - best or min(cy, dy) > high + best:
                continue
            # So is the distance from the edge's line.
            beside_c, beside_d = ex * (cy - ay) - ey * (cx - ax), ex * (dy - ay) - ey * (dx - ax)
            beyond = best * length * (1.0 + ROUNDING)
            if min(beside_c, beside_d) > beyond or max(beside_c, beside_d) < -beyond:
                continue
            apart = _square_between(ax, ay, bx, by, cx, cy, dx, dy)
            if apart < square:
                best, square = math.sqrt(apart), apart
                if apart == 0.0:
                    return 0.0
    return best


@read_only_arguments
@njit(cache=True)
def clearance(edges: FloatArray, segments: FloatArray, reach: float) -> FloatArray:
    """Distance (e,), m, from each edge (e, 4) to the nearest segment (m, 4), 0 where they cross, and no more than reach
    (m)."""
    distance, grid = np.empty(len(edges)), segment_grid(segments)
    for i in range(len(edges)):
        distance[i] = room_beside(edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3], segments, grid, reach)
    return distance


@njit(cache=True)
def crossed(
    ax: float,
    ay: float,
    bx: float,
    by: float,
    segments: FloatArray,
    grid: SegmentGrid,
    first: int,
) -> int:
    """A row of segments (m, 4) that the line a-b crosses, the first one if it does and is no less than 0; -1 if it
    crosses none. grid: the segment_grid of the segments; of that only the cells on the line are looked at."""
    if first >= 0:
        cx, cy, dx, dy = segments[first, 0], segments[first, 1], segments[first, 2], segments[first, 3]
        if segments_cross(ax, ay, bx, by, cx, cy, dx, dy):
            return first
    frame, columns, rows, offsets, index = grid
    left, right, low, high = min(ax, bx), max(ax, bx), min(ay, by), max(ay, by)
    a0, a1 = cell_range(left - BORDER, right + BORDER, frame[0], frame[2], columns)
    is_steep = right - left < STEEP
    slope = 0.0 if is_steep else (by - ay) / (bx - ax)
    for a in range(a0, a1):
        lower, upper = low, high
        if not is_steep:
            # The part of the line in this column.
            x0, x1 = max(left, frame[0] + a * frame[2]), min(right, frame[0] + (a + 1) * frame[2])
            y0, y1 = ay + (x0 - ax) * slope, ay + (x1 - ax) * slope
            lower, upper = max(low, min(y0, y1)), min(high, max(y0, y1))
        b0, b1 = cell_range(lower - BORDER, upper + BORDER, frame[1], frame[2], rows)
        for k in range(offsets[a * rows + b0], offsets[a * rows + b1]):
            j = index[k]
            cx, cy, dx, dy = segments[j, 0], segments[j, 1], segments[j, 2], segments[j, 3]
            if segments_cross(ax, ay, bx, by, cx, cy, dx, dy):
                return int(j)
    return -1


@read_only_arguments
@njit(cache=True)
def enter(edges: FloatArray, segments: FloatArray) -> BoolArray:
    """Which edges (e, 4) run through a segment (m, 4) from its front, on its left, to its back, (e,)."""
    result = np.zeros(len(edges), dtype=np.bool_)
    grid = segment_grid(segments)
    near = np.empty(len(grid[4]), dtype=np.int64)
    for i in range(len(edges)):
        ax, ay, bx, by = edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3]
        for k in range(rows_in_box(grid, min(ax, bx), max(ax, bx), min(ay, by), max(ay, by), near)):
            cx, cy, dx, dy = segments[near[k], 0], segments[near[k], 1], segments[near[k], 2], segments[near[k], 3]
            if side_of(ax, ay, cx, cy, dx, dy) > 0.0 and segments_cross(ax, ay, bx, by, cx, cy, dx, dy):
                result[i] = True
                break
    return result
