"""A planar graph of poses and landmarks: its measurements in arrays, linearised, grown, solved.

A landmark is a pose, too, whose heading stays 0 and is measured by nothing: so all measurements are of one kind. The
unknowns are one vector, (x, y, theta) of each.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tfg_drake.datasets.least_squares import MOST_STEPS, Rows, minimise
from tfg_drake.datasets.recording import OnProgress
from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray

# Poses and landmarks that a graph grows by before it is solved again.
AT_ONCE = 50


@dataclass(frozen=True)
class PlanarGraph:
    """n poses and landmarks in the order in which the graph grows, and m measured poses of one in another.

    landmark, held: (n,) which are landmarks, and which stay where they are. first, second: (m,) their rows, in the
    order of the later, then of the earlier. X_ij: (m, 3), the second in the first. whitener: (m, 3, 3) of the error of
    X_ij.
    """

    landmark: BoolArray
    held: BoolArray
    first: IntArray
    second: IntArray
    X_ij: FloatArray
    whitener: FloatArray

    def linearise(self, x: FloatArray) -> Rows:
        """All residuals and their Jacobians."""
        X_M = x.reshape(-1, 3)
        p, on_first, on_p = _in_body(X_M[self.first], X_M[self.second, :2])
        turn = X_M[self.second, 2] - X_M[self.first, 2]
        error = np.column_stack([p - self.X_ij[:, :2], se2.wrap_angle(turn - self.X_ij[:, 2])])
        jacobian = np.zeros((len(error), 3, 6))
        jacobian[:, :2, :3], jacobian[:, :2, 3:5] = on_first, on_p
        jacobian[:, 2, 2], jacobian[:, 2, 5] = -1.0, 1.0
        columns = 3 * np.repeat(np.column_stack([self.first, self.second]), 3, axis=1) + np.tile(np.arange(3), 2)
        return Rows(np.einsum("mij,mj->mi", self.whitener, error), columns, self.whitener @ jacobian)

    def solved(self, x: FloatArray, most_steps: int = MOST_STEPS) -> tuple[FloatArray, float]:
        """The unknowns of least cost that steps from x lead to, and that cost."""
        held = np.column_stack([self.held, self.held, self.held | self.landmark])
        return minimise(self.linearise, x, np.flatnonzero(held), np.repeat(np.arange(len(held)), 3), most_steps)

    def grown(self, x: FloatArray, report: OnProgress) -> FloatArray:
        """The unknowns near the solution, each added by the measurement that ties it to the latest pose before it:
        dead reckoning alone would go far astray.

        x: those to begin from, at least the first; nan where a pose or landmark is to be added.
        """
        later, from_pose = np.maximum(self.first, self.second), ~self.landmark[np.minimum(self.first, self.second)]
        tie = np.zeros(len(self.held), dtype=np.int64)
        tie[later[from_pose]] = np.flatnonzero(from_pose)
        x = x.copy()
        for begin in range(0, len(tie), AT_ONCE):
            end = min(begin + AT_ONCE, len(tie))
            X_M = x.reshape(-1, 3)
            for i in np.flatnonzero(np.isnan(X_M[begin:end, 0])) + begin:
                first, second, X_ij = self.first[tie[i]], self.second[tie[i]], self.X_ij[tie[i]]
                X_M[i] = se2.compose(X_M[first], X_ij) if second == i else se2.compose(X_M[second], se2.inverse(X_ij))
                X_M[i, 2] *= not self.landmark[i]
            m = np.searchsorted(later, end)
            measured = {name: getattr(self, name)[:m] for name in ("first", "second", "X_ij", "whitener")}
            x, _ = replace(self, **measured).solved(x, most_steps=1)
            report(end / len(tie))
        return x


def _in_body(X_MB: FloatArray, p_M: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """p_B (n, 2) of points p_M (n, 2) as poses (n, 3) see them; its Jacobians on pose (n, 2, 3) and point (n, 2, 2)."""
    c, s = np.cos(X_MB[:, 2]), np.sin(X_MB[:, 2])
    R_BM = np.stack([c, s, -s, c], axis=1).reshape(-1, 2, 2)
    p_B = np.einsum("nij,nj->ni", R_BM, p_M - X_MB[:, :2])
    turned = np.column_stack([p_B[:, 1], -p_B[:, 0]])
    return p_B, np.concatenate([-R_BM, turned[:, :, None]], axis=2), R_BM
