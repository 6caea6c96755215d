"""Polygons as segments that a robot does not fit between. A polygon is its corners (n, 2), m, in any one frame."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tfg_drake.geometry.distance import clearance
from tfg_drake.messages import FloatArray

# Edges within this distance, m, touch.
_TOUCH = 1e-6
# Greatest coordinate, m, at which a float64 resolves that.
_FARTHEST = 1e8


def outline(corners: FloatArray) -> FloatArray:
    """The edges (n, 4) of a polygon."""
    return np.hstack([corners, np.roll(corners, -1, axis=0)])


def fault(corners: FloatArray) -> str:
    """The reason why corners are not those of a polygon, "" if they are."""
    if len(corners) < 3:
        return f"has {len(corners)} corners"
    if np.abs(corners).max() > _FARTHEST:
        return f"has a corner more than {_FARTHEST:g} m from the origin"
    edges, (x, y) = outline(corners), corners.T
    for i in range(len(edges) - 2):
        # The last edge is a neighbour of the first.
        others = edges[i + 2 : len(edges) - (i == 0)]
        if (clearance(edges[i : i + 1], others, 1.0) < _TOUCH).any():
            return f"crosses or touches itself between corners {i} and {i + 1}"
    area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
    return "" if area > _TOUCH else "has no area"


def hatched(polygons: Sequence[FloatArray], spacing: float) -> FloatArray:
    """The edges of polygons and lines across them, (k, 4): nothing inside is farther than half the spacing, m, from
    one."""
    pieces = [np.zeros((0, 4))]
    for corners in polygons:
        (x, y), (x_next, y_next) = corners.T, np.roll(corners, -1, axis=0).T
        pieces.append(outline(corners))
        for row in range(math.ceil(y.min() / spacing), math.floor(y.max() / spacing) + 1):
            at = row * spacing
            crosses = (y > at) != (y_next > at)
            share = (at - y[crosses]) / (y_next - y)[crosses]
            ends = np.sort(x[crosses] + share * (x_next - x)[crosses]).reshape(-1, 2)
            pieces.append(np.insert(ends, [1, 2], at, axis=1))
    return np.vstack(pieces)
