"""Fits points with normals, of a look or a scan, to the map's surfaces with similar normals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, LaserScan
from tfg_drake.slam.keyframe import Keyframe, moved_points
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.scan_points import scan_points
from tfg_drake.slam.shared import SCANNER_X, SCANNER_Y, SCANNER_YAW
from tfg_drake.slam.surfaces import POINT
from tfg_drake.slam.walls import ends_seen

# The map's points are averaged over cells with side CELL, m, and DIRECTIONS of their normals, if there are ENOUGH of
# them; and once more with shifted cells, in which what a border divided is whole.
CELL, DIRECTIONS, ENOUGH = 0.2, 12, 2
# A point is compared with at most MOST surfaces within NEAR, m, whose normals' cosine with its own exceeds SAME_WAY.
MOST, NEAR, SAME_WAY = 4, 0.3, 0.85
# Scale of the Cauchy weights: a third of the correspondence distance, but at least ROBUST, m. Points of one scan have
# common errors: information is divided by ALIKE.
ROBUST, ALIKE = 0.04, 5.0
# Spacing of the points that stand for a wall, m.
SPACING = 0.1
# A point within this distance of a surface, m, is on it.
ON = 0.06
# Deviations of a scan's pose that is interpolated between keyframes, m, m, rad; correspondence distances of the steps
# of its fit, m; greatest number of points in it.
BETWEEN, GATES, QUERY = np.array([0.03, 0.03, 0.01]), (0.3, 0.2, 0.15, 0.1), 200


class Surfaces:
    """Surfaces as points with normals, (p, 4), in M."""

    def __init__(self, points: FloatArray) -> None:
        self.points = np.vstack([thinned(points), thinned(points, 0.5 * CELL)])
        self.tree = cKDTree(self.points[:, :2])

    def fitted(
        self, query: FloatArray, X: FloatArray, information: FloatArray, gates: Sequence[float]
    ) -> tuple[FloatArray, FloatArray, float]:
        """Fit the frame of a query (q, 4) to the surfaces; returns its pose (3,) in M, its information (3, 3), and the
        share of the query's points on them. Gauss-Newton, point to plane, with Cauchy weights.

        X: (3,) the prior pose, with information (3, 3). gates: m, one per step.
        """
        there, total, share = X, information, 0.0
        for gate in gates if len(self.points) and len(query) else ():
            p = moved_points(there, query)
            n, e, met = self._beside(p, max(NEAR, gate))
            lever = p[:, :2] - there[:2]
            w = met / (1.0 + (e / max(gate / 3.0, ROBUST)) ** 2)
            w /= ALIKE * POINT**2 * np.maximum(w.sum(axis=1), 1.0)[:, None]
            J = np.concatenate([n, (n[..., 1] * lever[:, None, 0] - n[..., 0] * lever[:, None, 1])[..., None]], axis=2)
            weighted = (w[..., None] * J).reshape(-1, 3).T
            off = np.append(there[:2] - X[:2], se2.wrap_angle(there[2] - X[2]))
            total = weighted @ J.reshape(-1, 3) + information
            there = there - np.linalg.solve(total, weighted @ e.ravel() + information @ off)
            share = float(np.mean(np.any(met & (np.abs(e) < ON), axis=1)))
        return there, total, share

    def on(self, points: FloatArray, within: float) -> BoolArray:
        """Return a mask of the points (n, 4) in M that lie on the surfaces within a distance, m."""
        _, off, met = self._beside(points, NEAR)
        return np.asarray(np.any(met & (np.abs(off) < within), axis=1))

    def _beside(self, points: FloatArray, reach: float) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return, for points (q, 4) in M, the normals (q, k, 2) of surfaces near each, its distances (q, k), m, from
        them, and a mask of those that exist within this reach, m, with similar normals."""
        _, row = self.tree.query(points[:, :2], k=MOST, distance_upper_bound=reach)
        met = row < len(self.points)
        of = self.points[np.where(met, row, 0)]
        n = of[..., 2:]
        met &= np.einsum("qki,qi->qk", n, points[:, 2:]) > SAME_WAY
        return n, np.einsum("qki,qki->qk", n, points[:, None, :2] - of[..., :2]), met


def thinned(points: FloatArray, offset: float = 0.0) -> FloatArray:
    """Return the means (m, 4) of points (p, 4) of a cell with similar normals. offset: m, of the cells."""
    if not len(points):
        return points
    turned = np.arctan2(points[:, 3], points[:, 2]) * (DIRECTIONS / (2.0 * math.pi)) + offset / CELL
    cell = np.floor((points[:, :2] + offset) / CELL).astype(np.int64)
    key = np.column_stack([cell, np.floor(turned).astype(np.int64) % DIRECTIONS])
    x, y, turn = (key - key.min(axis=0)).T
    _, of, count = np.unique((x * (y.max() + 1) + y) * DIRECTIONS + turn, return_inverse=True, return_counts=True)
    mean = np.zeros((len(count), 4))
    np.add.at(mean, of.ravel(), points)
    mean = mean[count >= ENOUGH] / count[count >= ENOUGH, None]
    mean[:, 2:] /= np.hypot(mean[:, 2], mean[:, 3])[:, None]
    return np.asarray(mean)


def surface_points(one: Keyframe, shared: FloatArray) -> FloatArray:
    """Return points with normals (p, 4), in A, of all surfaces that a keyframe sees, with points along its walls."""
    return np.vstack([one.points[one.points[:, 2:].any(axis=1)], points_along(ends_seen(one, shared))])


def points_along(walls: FloatArray) -> FloatArray:
    """Return points (p, 4) along walls (s, 2, 2), with normals to the left."""
    length = np.array([math.dist(first, last) for first, last in walls])
    walls, length = walls[length > 0.0], length[length > 0.0]
    along, count = (walls[:, 1] - walls[:, 0]) / length[:, None], np.ceil(length / SPACING).astype(np.int64)
    of = np.repeat(np.arange(len(walls)), count)
    far = SPACING * (np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count))
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    return np.hstack([walls[of, 0] + far[:, None] * along[of], normal[of]])


def map_points(graph: KeyframeGraph, keyframes: Iterable[int] | None = None) -> FloatArray:
    """Return `surface_points` (p, 4), in M, of some keyframes of a graph, by default of all."""
    shared, which = graph.shared.mean, range(len(graph.keyframes)) if keyframes is None else keyframes
    parts = [moved_points(graph.X_MN[k], surface_points(graph.keyframes[k], shared)) for k in which]
    return np.vstack([np.empty((0, 4)), *parts])


def poses_by_surfaces(
    graph: KeyframeGraph, scans: Sequence[LaserScan], X_MB: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return poses (n, 3) of the body at n scans, X_MB (n, 3) from the keyframes, fitted to the surfaces that the
    keyframes have seen, and their covariances (n, 3, 3) given these surfaces."""
    shared = graph.shared.mean
    X_BS = shared[[SCANNER_X, SCANNER_Y, SCANNER_YAW]]
    surfaces = Surfaces(map_points(graph))
    before, poses, total = np.diag(BETWEEN**-2.0), X_MB.copy(), np.empty((len(scans), 3, 3))
    for k, scan in enumerate(scans):
        points = scan_points(scan)
        points = points[points[:, 2:].any(axis=1)]
        points = moved_points(X_BS, points[:: 1 + len(points) // QUERY])
        poses[k], total[k], _ = surfaces.fitted(points, X_MB[k], before, GATES)
    return poses, np.asarray(np.linalg.inv(total))
