"""Star polygons: the free space seen from one point, packed one after the other into shared arrays."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.geometry.distance import segment_segment_distance, side_of
from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.geometry.segment_grid import SegmentGrid, rows_in_box, segment_grid
from tfg_drake.messages import BoolArray, FloatArray, IntArray

# Sine of the angle between ray and surface below which its front is not seen.
ALONG = 0.5
# Number of a star's edges that share a bounding box, and are skipped together.
RUN = 8
# Rounding error of a crossing beyond an edge's ends, m.
ROUNDING = 1e-9
# Spacing at which a line is looked up in the stars, m.
STEP = 0.25
# Number of points whose cover is counted in one pass.
_AT_ONCE = 1_000_000

# See `star_index`.
StarIndex = tuple[FloatArray, SegmentGrid, IntArray, FloatArray]


@njit(cache=True)
def _odd_crossings(x: float, y: float, vertices: FloatArray, before: int, start: int, stop: int) -> bool:
    """Whether a ray from (x, y) along the x axis crosses an odd number of the edges from one to the next of the
    vertices before, start, start + 1, ..., stop - 1."""
    odd = False
    xj, yj = vertices[before, 0], vertices[before, 1]
    for i in range(start, stop):
        xi, yi = vertices[i, 0], vertices[i, 1]
        if (yi > y) != (yj > y) and x < xi + (y - yi) / (yj - yi) * (xj - xi):
            odd = not odd
        xj, yj = xi, yi
    return odd


@njit(cache=True)
def _square_radii(star_offsets: IntArray, star_vertices: FloatArray, star_centers: FloatArray) -> FloatArray:
    radii = np.zeros(star_centers.shape[0])
    for j in range(star_centers.shape[0]):
        for v in range(star_offsets[j], star_offsets[j + 1]):
            dx = star_vertices[v, 0] - star_centers[j, 0]
            dy = star_vertices[v, 1] - star_centers[j, 1]
            radii[j] = max(radii[j], dx * dx + dy * dy)
    return radii


@njit(cache=True)
def _boxes(star_offsets: IntArray, star_vertices: FloatArray) -> FloatArray:
    """Diagonals (k, 4) of the stars' bounding boxes, for a segment_grid."""
    boxes = np.zeros((len(star_offsets) - 1, 4))
    for j in range(len(boxes)):
        start, stop = star_offsets[j], star_offsets[j + 1]
        for i in range(2 if stop > start else 0):
            low, high = star_vertices[start, i], star_vertices[start, i]
            for v in range(start + 1, stop):
                low, high = min(low, star_vertices[v, i]), max(high, star_vertices[v, i])
            boxes[j, i], boxes[j, 2 + i] = low, high
    return boxes


@njit(cache=True)
def _may_hold(box: FloatArray, x: float, y: float) -> bool:
    """Whether a point lies within a bounding box, one of `_boxes`."""
    return bool(box[0] <= x <= box[2] and box[1] <= y <= box[3])


@njit(cache=True)
def _runs_of_edges(star_offsets: IntArray, star_vertices: FloatArray) -> tuple[IntArray, FloatArray]:
    """Where the runs of RUN edges of each star begin, offsets (k + 1,), and for each (r, 3) the lowest, the highest and
    the rightmost of its edges' ends: y, y, x, m. A star's first edge leads from its last vertex to its first."""
    offsets = np.zeros(len(star_offsets), dtype=np.int64)
    for j in range(len(star_offsets) - 1):
        offsets[j + 1] = offsets[j] + (star_offsets[j + 1] - star_offsets[j] + RUN - 1) // RUN
    reach = np.empty((offsets[-1], 3))
    for j in range(len(star_offsets) - 1):
        previous = star_offsets[j + 1] - 1
        for r in range(offsets[j], offsets[j + 1]):
            low, high, right = star_vertices[previous, 1], star_vertices[previous, 1], star_vertices[previous, 0]
            first = star_offsets[j] + (r - offsets[j]) * RUN
            for i in range(first, min(first + RUN, star_offsets[j + 1])):
                low, high = min(low, star_vertices[i, 1]), max(high, star_vertices[i, 1])
                right = max(right, star_vertices[i, 0])
                previous = i
            reach[r, 0], reach[r, 1], reach[r, 2] = low, high, right + ROUNDING
    return offsets, reach


@njit(cache=True)
def _inside(
    x: float, y: float, j: int, star_offsets: IntArray, star_vertices: FloatArray, runs: IntArray, reach: FloatArray
) -> bool:
    """Whether a point lies inside star j, by the even-odd rule, a run of edges at a time: most lie below the point,
    above it or to its left. runs, reach: see `_runs_of_edges`."""
    inside = False
    for r in range(runs[j], runs[j + 1]):
        if reach[r, 0] > y or reach[r, 1] <= y or reach[r, 2] < x:
            continue
        first = star_offsets[j] + (r - runs[j]) * RUN
        before = first - 1 if r > runs[j] else star_offsets[j + 1] - 1
        inside ^= _odd_crossings(x, y, star_vertices, before, first, min(first + RUN, star_offsets[j + 1]))
    return inside


@njit(cache=True)
def star_index(star_offsets: IntArray, star_vertices: FloatArray) -> StarIndex:
    """An index of the stars that a point may lie in: their bounding boxes, the segment_grid of these, and the runs
    of their edges. Star polygons as in `inside_any`."""
    boxes = _boxes(star_offsets, star_vertices)
    runs, reach = _runs_of_edges(star_offsets, star_vertices)
    return boxes, segment_grid(boxes), runs, reach


@njit(cache=True)
def in_a_star(
    x: float, y: float, star_offsets: IntArray, star_vertices: FloatArray, index: StarIndex, near: IntArray
) -> bool:
    """Whether a point lies inside at least one star polygon. near: for rows, as many as the index's grid has."""
    boxes, grid, runs, reach = index
    for k in range(rows_in_box(grid, x, x, y, y, near)):
        j = near[k]
        if _may_hold(boxes[j], x, y) and _inside(x, y, j, star_offsets, star_vertices, runs, reach):
            return True
    return False


@njit(cache=True)
def line_in_stars(
    ax: float,
    ay: float,
    bx: float,
    by: float,
    star_offsets: IntArray,
    star_vertices: FloatArray,
    index: StarIndex,
    near: IntArray,
) -> bool:
    """Whether a line from a to b lies inside star polygons, looked up every STEP; near: see `in_a_star`."""
    steps = max(1, math.ceil(math.hypot(bx - ax, by - ay) / STEP))
    for k in range(steps):
        t = (k + 0.5) / steps
        x, y = (1 - t) * ax + t * bx, (1 - t) * ay + t * by
        if not in_a_star(x, y, star_offsets, star_vertices, index, near):
            return False
    return True


@read_only_arguments
@njit(cache=True)
def lines_in_stars(lines: FloatArray, star_offsets: IntArray, star_vertices: FloatArray) -> BoolArray:
    """As line_in_stars, of lines (n, 4), (n,); star polygons as in `inside_any`."""
    index = star_index(star_offsets, star_vertices)
    near, inside = np.empty(len(index[1][4]), dtype=np.int64), np.empty(len(lines), dtype=np.bool_)
    for i in range(len(lines)):
        ax, ay, bx, by = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
        inside[i] = line_in_stars(ax, ay, bx, by, star_offsets, star_vertices, index, near)
    return inside


@read_only_arguments
@njit(cache=True)
def lines_in_one_star(lines: FloatArray, star_offsets: IntArray, star_vertices: FloatArray) -> BoolArray:
    """Which lines (n, 4), from a to b, lie inside one star polygon, looked up every STEP: some view saw all along them,
    (n,). Star polygons as in `inside_any`."""
    boxes, grid, runs, reach = star_index(star_offsets, star_vertices)
    near, seen = np.empty(len(grid[4]), dtype=np.int64), np.zeros(len(lines), dtype=np.bool_)
    for i in range(len(lines)):
        ax, ay, bx, by = lines[i, 0], lines[i, 1], lines[i, 2], lines[i, 3]
        steps = max(1, math.ceil(math.hypot(bx - ax, by - ay) / STEP))
        for k in range(rows_in_box(grid, min(ax, bx), max(ax, bx), min(ay, by), max(ay, by), near)):
            j, inside = near[k], 0
            while inside <= steps:
                t = inside / steps
                x, y = (1 - t) * ax + t * bx, (1 - t) * ay + t * by
                if not (_may_hold(boxes[j], x, y) and _inside(x, y, j, star_offsets, star_vertices, runs, reach)):
                    break
                inside += 1
            if inside > steps:
                seen[i] = True
                break
    return seen


def inside_any(points: FloatArray, star_offsets: IntArray, star_vertices: FloatArray) -> BoolArray:
    """Which points (n, 2) lie inside at least one star polygon, (n,).

    Star j has the vertices star_vertices[star_offsets[j]:star_offsets[j + 1]]; star_offsets is (k + 1,), star_vertices
    (v, 2), in the frame of the points, m. A point exactly on an edge may fall on either side.
    """
    return np.asarray(lines_in_stars(np.hstack([points, points]), star_offsets, star_vertices))


@read_only_arguments
@njit(cache=True)
def inspected(
    points: FloatArray,
    normals: FloatArray,
    star_offsets: IntArray,
    star_vertices: FloatArray,
    star_centers: FloatArray,
    max_range: float,
    max_incidence: float,
) -> BoolArray:
    """Which points (n, 2) just in front of a surface with unit normals (n, 2) some star's centre saw well, (n,).

    Seen well means inside the star, within max_range (m) of its centre, star_centers (k, 2), and with at most
    max_incidence (rad) between the normal and the line of sight. Star polygons as in `inside_any`.
    """
    boxes, grid, runs, star_reach = star_index(star_offsets, star_vertices)
    near = np.empty(len(grid[4]), dtype=np.int64)
    least_cosine = np.cos(max_incidence)
    result = np.zeros(points.shape[0], dtype=np.bool_)
    for i in range(points.shape[0]):
        x, y = points[i, 0], points[i, 1]
        for k in range(rows_in_box(grid, x, x, y, y, near)):
            j = near[k]
            dx, dy = star_centers[j, 0] - x, star_centers[j, 1] - y
            square = dx * dx + dy * dy
            if square > max_range * max_range or not _may_hold(boxes[j], x, y):
                continue
            if dx * normals[i, 0] + dy * normals[i, 1] < least_cosine * np.sqrt(square):
                continue
            if _inside(x, y, j, star_offsets, star_vertices, runs, star_reach):
                result[i] = True
                break
    return result


@read_only_arguments
@njit(cache=True)
def looked_through(
    offsets: IntArray,
    vertices: FloatArray,
    surface_rank: FloatArray,
    star_offsets: IntArray,
    star_vertices: FloatArray,
    star_centers: FloatArray,
    star_rank: FloatArray,
    depth: float,
    reach: float,
) -> BoolArray:
    """Which surfaces (s,) the centre of a star of lower rank looked through, not at their front.

    Surface i is the polyline vertices[offsets[i]:offsets[i + 1]] with its front on the left; the centre lies behind
    each piece of it or looks along that (see ALONG), its first point is within reach (m) of the centre, and all of it
    at least depth (m) inside the star. surface_rank: (s,), star_rank: (k,). Star polygons as in `inside_any`.
    """
    boxes, _, runs, star_reach = star_index(star_offsets, star_vertices)
    radii = _square_radii(star_offsets, star_vertices, star_centers)
    grid = segment_grid(np.hstack((star_centers, star_centers)))
    near = np.empty(len(star_centers), dtype=np.int64)
    result = np.zeros(len(offsets) - 1, dtype=np.bool_)
    for i in range(len(offsets) - 1):
        polyline = vertices[offsets[i] : offsets[i + 1]]
        x, y = polyline[0, 0], polyline[0, 1]
        for k in range(rows_in_box(grid, x - reach, x + reach, y - reach, y + reach, near)):
            j = near[k]
            if star_rank[j] >= surface_rank[i]:
                continue
            cx, cy = star_centers[j, 0], star_centers[j, 1]
            if (x - cx) ** 2 + (y - cy) ** 2 > min(radii[j], reach * reach) or not _may_hold(boxes[j], x, y):
                continue
            if _shows_front(polyline, cx, cy):
                continue
            inside = True
            for v in range(len(polyline)):
                px, py = polyline[v, 0], polyline[v, 1]
                if not _inside(px, py, j, star_offsets, star_vertices, runs, star_reach):
                    inside = False
                    break
            if inside and _is_apart(polyline, star_vertices[star_offsets[j] : star_offsets[j + 1]], depth):
                result[i] = True
                break
    return result


@njit(cache=True)
def _shows_front(polyline: FloatArray, x: float, y: float) -> bool:
    """Whether a polyline (v, 2) shows (x, y) the front of any piece, and not only aslant (see ALONG)."""
    for v in range(len(polyline) - 1):
        ax, ay, bx, by = polyline[v, 0], polyline[v, 1], polyline[v + 1, 0], polyline[v + 1, 1]
        dx, dy = x - 0.5 * (ax + bx), y - 0.5 * (ay + by)
        if side_of(x, y, ax, ay, bx, by) >= ALONG * math.hypot(bx - ax, by - ay) * math.hypot(dx, dy):
            return True
    return False


@njit(cache=True)
def _is_apart(polyline: FloatArray, star: FloatArray, depth: float) -> bool:
    """Whether a polyline (v, 2) stays at least depth (m) away from the outline of a polygon (w, 2)."""
    for v in range(len(polyline) - 1):
        ax, ay, bx, by = polyline[v, 0], polyline[v, 1], polyline[v + 1, 0], polyline[v + 1, 1]
        previous = len(star) - 1
        for w in range(len(star)):
            cx, cy, dx, dy = star[previous, 0], star[previous, 1], star[w, 0], star[w, 1]
            if segment_segment_distance(ax, ay, bx, by, cx, cy, dx, dy) < depth:
                return False
            previous = w
    return True


def covered_area(star_offsets: IntArray, star_vertices: FloatArray, cell: float = 0.1) -> float:
    """Area of the union of the star polygons, m^2, by counting the cells (of this width, m) whose centres they hold."""
    if not len(star_vertices):
        return 0.0
    low, high = star_vertices.min(axis=0), star_vertices.max(axis=0)
    x, y = (np.arange(low[i] + 0.5 * cell, high[i], cell) for i in range(2))
    held = 0
    for some in np.array_split(y, 1 + len(x) * len(y) // _AT_ONCE):  # all at once are gigabytes in a large map
        points = np.stack(np.meshgrid(x, some), axis=-1).reshape(-1, 2)
        held += int(np.count_nonzero(inside_any(points, star_offsets, star_vertices)))
    return float(cell**2 * held)
