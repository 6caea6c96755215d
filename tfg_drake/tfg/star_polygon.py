"""The free space of one panorama, as a star polygon."""

from __future__ import annotations

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.segmentation import CORNER_TOLERANCE

# Distance of the polygon from the surfaces behind it, m.
SHRINK = 0.04
# The greatest number of vertices.
MOST_VERTICES = 150
# Range where the turn never looked, m.
UNSEEN = 0.02


@njit(cache=True)
def _simplify(reach: FloatArray, limit: FloatArray, angles: FloatArray, tolerance: float) -> BoolArray:
    """Which vertices to keep, greedily: no chord beyond the limit at any angle between, nor short by tolerance."""
    n = len(reach)
    c, s = np.cos(angles), np.sin(angles)
    x, y = reach * c, reach * s
    keep = np.zeros(n, dtype=np.bool_)
    i = 0
    while i < n:
        keep[i] = True
        best = i + 1
        for j in range(i + 2, min(n, i + n // 4)):
            dx, dy = x[j] - x[i], y[j] - y[i]
            length = np.hypot(dx, dy)
            cross = x[i] * dy - y[i] * dx
            fits = True
            for k in range(i + 1, j):
                across = c[k] * dy - s[k] * dx
                if across <= 1e-9 or cross > limit[k] * across:
                    fits = False
                    break
                if abs(dx * (y[k] - y[i]) - dy * (x[k] - x[i])) > tolerance * length:
                    fits = False
                    break
            if not fits:
                break
            best = j
        i = best
    return keep


def looked_round(star_offsets: IntArray, star_vertices: FloatArray, star_centers: FloatArray) -> BoolArray:
    """Return a mask (k,) of the star polygons, packed as in `tfg_drake.geometry.star`, that cover all directions."""
    star = np.repeat(np.arange(len(star_centers)), np.diff(star_offsets))
    d = star_vertices - star_centers.take(star, axis=0)
    all_round = np.ones(len(star_centers), dtype=np.bool_)
    all_round[star[np.hypot(d[:, 0], d[:, 1]) <= 1.5 * UNSEEN]] = False
    return all_round


def star_polygon(panorama: Panorama) -> FloatArray:
    """Return the star polygon of a panorama: vertices (v, 2) in A, m, counter-clockwise around the origin.

    It ends 4 cm of range in front of surfaces, at range_max without a return, and close to the origin where the turn
    never looked. It is simplified to about 150 vertices, and nowhere extends beyond a surface.
    """
    seen = np.where(np.isfinite(panorama.ranges), panorama.ranges, panorama.range_max + SHRINK)
    seen = np.where(np.isnan(panorama.ranges), UNSEEN + SHRINK, seen)
    reach = np.maximum(seen - SHRINK, UNSEEN)
    limit = np.maximum(seen - 0.5 * SHRINK, UNSEEN)
    # How far simplifying may pull it back from there, m, to begin with.
    tolerance = CORNER_TOLERANCE
    keep = _simplify(reach, limit, panorama.angles, tolerance)
    while keep.sum() > MOST_VERTICES and tolerance < 0.5:
        tolerance *= 1.5
        keep = _simplify(reach, limit, panorama.angles, tolerance)
    angles = panorama.angles[keep]
    return np.asarray(reach[keep, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1))
