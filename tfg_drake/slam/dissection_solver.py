"""The default solver: nested dissection, dense fronts eliminated by LAPACK.

One elimination serves the steps as long as values do not move far, and the values are exact: each gradient is taken
anew. The parameters, which all keyframes share, are eliminated last.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.dissection import (
    Dissection,
    Elimination,
    Front,
    covariance,
    dissected,
    eliminated,
    leaves,
    solution,
)
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.keyframe_kernels import Unknowns, assemble, batch_gradient
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.solver import Factors, Places, Values, factors_of


@dataclasses.dataclass(frozen=True)
class DissectedSystem:
    """See `solver.System`."""

    dissection: Dissection
    elimination: Elimination
    gradient: FloatArray
    error: float
    poses: FloatArray

    @property
    def log_determinant(self) -> float:
        """Of the information on all unknowns."""
        return self.elimination.log_determinant

    def step(self, gradient: FloatArray) -> FloatArray:
        """(u,) the step of Gauss and Newton for a gradient (u,)."""
        return solution(self.dissection, self.elimination, -gradient)

    def covariance(self, at: IntArray) -> FloatArray:
        """(c, c) joint, of some unknowns (c,)."""
        return covariance(self.dissection, self.elimination, at)


class DissectionSolver:
    """See `solver.Solver`."""

    def __init__(self, graph: KeyframeGraph) -> None:
        self._factors: Factors = factors_of(graph)
        n, k, rows = len(graph.ids), len(graph.keyframes), self._factors.keyframes.rows
        seen_by = np.repeat(np.arange(k), np.diff(self._factors.keyframes.offsets))
        # Landmarks, nodes 1 to k, the parameters.
        variable = np.concatenate([rows, n + np.arange(k), n + np.arange(k - 1), np.full(k, n + k)])
        keyframe = np.concatenate([seen_by, np.arange(k), np.arange(1, k), np.arange(k)])
        own = variable < n + k
        leaf = leaves(graph.X_MN[:-1, :2], variable[own], keyframe[own])
        width = np.repeat([2, 3, SHARED], [n, k, 1])
        self._dissection = dissected(leaf, variable, keyframe, width)
        at = self._dissection.at
        self.places = Places(at[:n], np.append(-1, at[n:-1]), int(at[-1]))

    def linearised(self, values: Values, damping: float) -> DissectedSystem:
        """See `solver.Solver`."""
        size, k = self._dissection.size, len(self._factors.keyframes.y_AD)
        gradient, poses, error = np.zeros(size), np.empty((k, 6 + SHARED, 6 + SHARED)), 0.0
        # A variable that is left out has no unknown, not even after its first.
        entry = np.full(size + 1, -SHARED)
        landmark_at, node_at, shared_at = self.places

        def block(front: Front) -> FloatArray:
            """The information (f, f) that the keyframes of a leaf have on its unknowns."""
            nonlocal error
            f = len(front.unknowns)
            whole, own = np.zeros((f, f)), np.zeros(f)
            entry[front.unknowns] = np.arange(f)
            at = Unknowns(entry[landmark_at], entry[node_at], int(entry[shared_at]))
            entry[front.unknowns] = -SHARED
            where = values.X_MN, values.p_ML, values.shared
            error += assemble(front.keyframes, self._factors.keyframes, *where, at, whole, own, poses)
            if front is first:
                whole[at.shared_at :, at.shared_at :] += self._factors.information
                own[at.shared_at :] += force
                error += float(off @ force)
            gradient[front.unknowns] += own
            return whole

        off = values.shared - self._factors.mean
        force = self._factors.information @ off
        first = next(front for front in self._dissection.fronts if not front.halves)
        elimination = eliminated(self._dissection, block, damping)
        return DissectedSystem(self._dissection, elimination, gradient, error, poses)

    def gradient(self, values: Values) -> tuple[FloatArray, float]:
        """See `solver.Solver`."""
        gradient = np.zeros(self._dissection.size)
        where = values.X_MN, values.p_ML, values.shared
        error = batch_gradient(self._factors.keyframes, *where, Unknowns(*self.places), gradient)
        off = values.shared - self._factors.mean
        force = self._factors.information @ off
        gradient[self.places.shared_at :][:SHARED] += force
        return gradient, error + float(off @ force)
