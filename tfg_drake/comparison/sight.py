"""From which of some poses a robot's sensors see points first."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.geometry.visibility import in_sight
from tfg_drake.messages import FloatArray, IntArray


@read_only_arguments
@njit(cache=True)
def seen_from(
    X_WB: FloatArray, points: FloatArray, normals: FloatArray, limits: FloatArray, walls: FloatArray
) -> IntArray:
    """Row (t,) of the first of poses (k, 3) that each of points (t, 2) is seen from past walls (m, 4), k where none is;
    see `tfg_drake.comparison.best_tour.ToSee`. A half field of view of pi or more sees all round."""
    first = np.full(len(points), len(X_WB))
    near, rows = np.empty_like(points), np.empty(len(points), dtype=np.int64)
    for k in range(len(X_WB)):
        x, y, c, s = X_WB[k, 0], X_WB[k, 1], math.cos(X_WB[k, 2]), math.sin(X_WB[k, 2])
        count = 0
        for j in range(len(points)):
            if first[j] < k:
                continue
            dx, dy = points[j, 0] - x, points[j, 1] - y
            d = math.hypot(dx, dy)
            if d > limits[j, 0] or dx * c + dy * s < d * math.cos(min(limits[j, 1], math.pi)) - 1e-12:
                continue
            if limits[j, 2] > -1.0 and -(dx * normals[j, 0] + dy * normals[j, 1]) < limits[j, 2] * d:
                continue
            near[count, 0], near[count, 1], rows[count] = points[j, 0], points[j, 1], j
            count += 1
        visible = in_sight(walls, X_WB[k, :2].copy(), near[:count], 1e-3)
        for i in range(count):
            if visible[i]:
                first[rows[i]] = k
    return first
