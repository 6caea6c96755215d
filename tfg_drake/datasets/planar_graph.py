"""A planar graph of poses and landmarks: its factors in arrays, linearised, grown, solved.

The unknowns are one vector: the poses (x, y, theta) and the landmarks (x, y).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from tfg_drake.datasets.least_squares import MOST_STEPS, Rows, minimise
from tfg_drake.datasets.recording import OnProgress
from tfg_drake.geometry import se2
from tfg_drake.geometry.turned import turned
from tfg_drake.messages import FloatArray, IntArray

# Poses that a graph grows by before it is solved again.
POSES_AT_ONCE = 50


@dataclass(frozen=True)
class _Factors:
    """Arrays with a row a factor."""

    def take(self, rows: IntArray | slice) -> Self:
        """Some of the factors."""
        return replace(self, **{field.name: getattr(self, field.name)[rows] for field in fields(self)})


@dataclass(frozen=True)
class Motions(_Factors):
    """Measured poses of one pose in another.

    first, second: (m,) their rows. X_ij: (m, 3), the second in the first. whitener: (m, 3, 3) of the error of X_ij.
    """

    first: IntArray
    second: IntArray
    X_ij: FloatArray
    whitener: FloatArray

    def later(self) -> IntArray:
        """(m,) the later of the two poses."""
        return np.maximum(self.first, self.second)


@dataclass(frozen=True)
class Sightings(_Factors):
    """Landmarks seen from poses.

    pose, landmark: (s,) their rows. p_BL: (s, 2) m, where the landmark seems to be in the body. whitener: (s, 2, 2) of
    the error of p_BL.
    """

    pose: IntArray
    landmark: IntArray
    p_BL: FloatArray
    whitener: FloatArray


@dataclass(frozen=True)
class PlanarGraph:
    """k poses, n landmarks and what ties them.

    motions: by their later, then their earlier pose. sightings: by their pose. held: rows of poses that stay where they
    are.
    """

    poses: int
    landmarks: int
    motions: Motions
    sightings: Sightings
    held: IntArray

    def parts(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses (k, 3) and landmarks (n, 2) as views of a vector of the unknowns."""
        X_MB, p_ML = np.split(x, [3 * self.poses])
        return X_MB.reshape(-1, 3), p_ML.reshape(-1, 2)

    def unknowns(self, X_MB: FloatArray, p_ML: FloatArray) -> FloatArray:
        """The vector of these poses (k, 3) and landmarks (n, 2)."""
        return np.concatenate([X_MB.ravel(), p_ML.ravel()])

    def linearise(self, x: FloatArray) -> list[Rows]:
        """All residuals and their Jacobians."""
        return [self._motion_rows(x), self._sighting_rows(x)]

    def _motion_rows(self, x: FloatArray) -> Rows:
        X_MB, _ = self.parts(x)
        ties = self.motions
        p, on_first, on_p = _in_body(X_MB[ties.first], X_MB[ties.second, :2])
        turn = X_MB[ties.second, 2] - X_MB[ties.first, 2]
        error = np.column_stack([p - ties.X_ij[:, :2], se2.wrap_angle(turn - ties.X_ij[:, 2])])
        jacobian = np.zeros((len(error), 3, 6))
        jacobian[:, :2, :3], jacobian[:, :2, 3:5] = on_first, on_p
        jacobian[:, 2, 2], jacobian[:, 2, 5] = -1.0, 1.0
        columns = [_at(ties.first, 3), _at(ties.second, 3)]
        return Rows(np.einsum("mij,mj->mi", ties.whitener, error), np.hstack(columns), ties.whitener @ jacobian)

    def _sighting_rows(self, x: FloatArray) -> Rows:
        X_MB, p_ML = self.parts(x)
        seen = self.sightings
        p_BL, on_pose, on_landmark = _in_body(X_MB[seen.pose], p_ML[seen.landmark])
        columns = [_at(seen.pose, 3), 3 * self.poses + _at(seen.landmark, 2)]
        jacobian = seen.whitener @ np.concatenate([on_pose, on_landmark], axis=2)
        return Rows(np.einsum("sij,sj->si", seen.whitener, p_BL - seen.p_BL), np.hstack(columns), jacobian)

    def solved(self, x: FloatArray, most_steps: int = MOST_STEPS) -> tuple[FloatArray, float]:
        """The unknowns of least cost that steps from x lead to, and that cost."""
        counts = [3] * self.poses + [2] * self.landmarks
        blocks = np.repeat(np.arange(len(counts)), counts)
        return minimise(self.linearise, x, _at(self.held, 3).ravel(), blocks, most_steps)

    def grown(self, x: FloatArray, report: OnProgress) -> FloatArray:
        """The unknowns near the solution, pose by pose added by the motion that ties it to the latest before it, each
        landmark where it is seen first: dead reckoning alone would go far astray.

        x: the poses to begin from, at least the first; nan where a pose is to be added.
        """
        ties, seen = self.motions, self.sightings
        later = ties.later()
        tie = np.zeros(self.poses, dtype=np.int64)
        tie[later] = np.arange(len(later))
        first_seen = np.full(self.landmarks, len(seen.pose))
        np.minimum.at(first_seen, seen.landmark, np.arange(len(seen.landmark)))
        x = x.copy()
        for begin in range(0, self.poses, POSES_AT_ONCE):
            end = min(begin + POSES_AT_ONCE, self.poses)
            X_MB, p_ML = self.parts(x)
            for i in np.flatnonzero(np.isnan(X_MB[begin:end, 0])) + begin:
                first, second, X_ij = ties.first[tie[i]], ties.second[tie[i]], ties.X_ij[tie[i]]
                X_MB[i] = (
                    se2.compose(X_MB[first], X_ij) if second == i else se2.compose(X_MB[second], se2.inverse(X_ij))
                )
            before, so_far = np.searchsorted(seen.pose, [begin, end])
            new = np.flatnonzero((first_seen >= before) & (first_seen < so_far))
            at = first_seen[new]
            p_ML[new] = X_MB[seen.pose[at], :2] + turned(seen.p_BL[at], X_MB[seen.pose[at], 2])
            motions, sightings = ties.take(slice(np.searchsorted(later, end))), seen.take(slice(so_far))
            x, _ = replace(self, motions=motions, sightings=sightings).solved(x, most_steps=1)
            report(end / self.poses)
        return x


def _in_body(X_MB: FloatArray, p_M: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """p_B (n, 2) of points p_M (n, 2) as poses (n, 3) see them; its Jacobians on pose (n, 2, 3) and point (n, 2, 2)."""
    c, s = np.cos(X_MB[:, 2]), np.sin(X_MB[:, 2])
    R_BM = np.stack([c, s, -s, c], axis=1).reshape(-1, 2, 2)
    p_B = np.einsum("nij,nj->ni", R_BM, p_M - X_MB[:, :2])
    turned = np.column_stack([p_B[:, 1], -p_B[:, 0]])
    return p_B, np.concatenate([-R_BM, turned[:, :, None]], axis=2), R_BM


def _at(rows: IntArray, width: int) -> IntArray:
    """(m, width) the unknowns of rows (m,) of that width."""
    return np.asarray(width * rows[:, None] + np.arange(width))
