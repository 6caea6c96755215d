"""Surfaces in a panorama: adaptive-breakpoint segmentation, then corners by Douglas and Peucker's rule."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tfg_drake.geometry.distance import point_segment_distance
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.tfg.panorama import Panorama

# Neighbouring points are joined down to this angle between ray and surface, rad (Borges and Aldon's lambda), over at
# most JOIN_REACH, m, which the robot does not fit through.
JOIN_INCIDENCE = np.deg2rad(10.0)
JOIN_REACH = 0.3
# The same for two points in line with their neighbours, rad and m, whose distances from these are at least the share
# STRAIGHT_SHARE of the gap, as at grazing incidence.
STRAIGHT_INCIDENCE = np.deg2rad(3.0)
STRAIGHT_REACH = 0.8
STRAIGHT_SHARE = 0.4
# Greatest distance of a point from the straight line, m.
CORNER_TOLERANCE = 0.03
# Components of fewer points are noise, or too small to have a direction.
LEAST_POINTS = 3


class Components(NamedTuple):
    """Connected surfaces seen from the origin of A: polylines in A, m, each counter-clockwise round the origin, in
    order of bearing, packed as in `tfg_drake.tfg.polyline`.

    The side they were seen from is therefore their left. offsets: (c + 1,). vertices: (v, 2). closed: the only one runs
    all the way round; its last vertex is its first.
    """

    offsets: IntArray
    vertices: FloatArray
    closed: bool


@njit(cache=True)
def _off_line(p: FloatArray, i: int, j: int, k: int) -> float:
    """Distance of point k from the line through i and j."""
    dx, dy = p[j, 0] - p[i, 0], p[j, 1] - p[i, 1]
    length = np.hypot(dx, dy)
    ex, ey = p[k, 0] - p[i, 0], p[k, 1] - p[i, 1]
    if length == 0.0:
        return float(np.hypot(ex, ey))
    return float(abs(dx * ey - dy * ex) / length)


@njit(cache=True)
def find_links(points: FloatArray, ranges: FloatArray, angles: FloatArray, sigma: float, tolerance: float) -> BoolArray:
    """Return a mask (b,) of the bins that saw the same surface as the next one (the first follows the last).

    points: (b, 2) m, ranges: (b,) m, angles: (b,) rad of a panorama. sigma: noise of a range, m. tolerance: deviation
    of points of one straight surface from a line, m.
    """
    n = len(ranges)
    links = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        j = (i + 1) % n
        if not (np.isfinite(ranges[i]) and np.isfinite(ranges[j])):
            continue
        step = (angles[j] - angles[i]) % (2.0 * np.pi)
        gap = np.hypot(points[j, 0] - points[i, 0], points[j, 1] - points[i, 1])
        near = min(ranges[i], ranges[j])
        join = 3.0 * sigma + near * np.sin(step) / np.sin(JOIN_INCIDENCE - min(step, 0.5 * JOIN_INCIDENCE))
        if gap <= min(join, JOIN_REACH):
            links[i] = True
            continue
        # At grazing incidence the points of one wall lie far apart, but on one line.
        before, after = (i - 1) % n, (j + 1) % n
        if gap > STRAIGHT_REACH or not (np.isfinite(ranges[before]) and np.isfinite(ranges[after])):
            continue
        if gap > near * np.sin(step) / np.sin(STRAIGHT_INCIDENCE - min(step, 0.5 * STRAIGHT_INCIDENCE)):
            continue
        least = STRAIGHT_SHARE * gap
        links[i] = (
            np.hypot(points[i, 0] - points[before, 0], points[i, 1] - points[before, 1]) >= least
            and np.hypot(points[after, 0] - points[j, 0], points[after, 1] - points[j, 1]) >= least
            and _off_line(points, before, after, i) <= tolerance
            and _off_line(points, before, after, j) <= tolerance
        )
    return links


@njit(cache=True)
def find_corners(points: FloatArray, tolerance: float) -> BoolArray:
    """Return a mask (n,) of the points (n, 2) to keep so that the polyline stays within tolerance (m) of all of
    them."""
    n = len(points)
    keep = np.zeros(n, dtype=np.bool_)
    if n == 0:
        return keep
    keep[0] = keep[n - 1] = True
    stack = [(0, n - 1)]
    while len(stack) > 0:
        first, last = stack.pop()
        farthest, worst = -1, tolerance
        for k in range(first + 1, last):
            # Distance to the segment, not the line: a polyline may come back past its own start.
            a, b = points[first], points[last]
            off = point_segment_distance(points[k, 0], points[k, 1], a[0], a[1], b[0], b[1])
            if off > worst:
                farthest, worst = k, off
        if farthest >= 0:
            keep[farthest] = True
            stack.append((first, farthest))
            stack.append((farthest, last))
    return keep


def panorama_links(panorama: Panorama) -> BoolArray:
    """Return a mask (b,) of the bins of a panorama that saw the same surface as the next one."""
    return find_links(
        panorama.points, panorama.ranges, panorama.angles, panorama.sigma, CORNER_TOLERANCE + panorama.sigma
    )


def segment(panorama: Panorama, links: BoolArray) -> Components:
    """Return the surfaces of a panorama. links: (b,) from panorama_links."""
    return Components(*_runs(panorama.points, panorama.ranges, links, CORNER_TOLERANCE + panorama.sigma))


@njit(cache=True)
def _runs(
    points: FloatArray, ranges: FloatArray, links: BoolArray, tolerance: float
) -> tuple[IntArray, FloatArray, bool]:
    """The runs of linked points (b, 2) with their corners only, as in Components."""
    n = len(links)
    breaks = np.flatnonzero(~links)
    closed = len(breaks) == 0
    offsets, vertices, run = np.zeros(len(breaks) + 2, dtype=np.int64), np.empty((n + 1, 2)), np.empty((n + 1, 2))
    count = 0
    for k in range(1 if closed else len(breaks)):
        if closed:
            # A closed surface is cut at its farthest point, most likely a corner.
            first, length = np.argmax(ranges), n + 1
        else:
            last = breaks[k + 1] if k + 1 < len(breaks) else breaks[0] + n
            first, length = breaks[k] + 1, last - breaks[k]
        met = 0
        for i in range(length):
            at = (first + i) % n
            run[i] = points[at]
            met += math.isfinite(ranges[at])
        if length < LEAST_POINTS or met < length:
            continue
        count += 1
        offsets[count] = offsets[count - 1]
        keep = find_corners(run[:length], tolerance)
        for i in range(length):
            if keep[i]:
                vertices[offsets[count]] = run[i]
                offsets[count] += 1
    return offsets[: count + 1], vertices[: offsets[count]], closed
