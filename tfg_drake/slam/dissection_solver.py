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
from tfg_drake.slam.keyframe_kernels import Unknowns, Values, assemble, batch_gradient
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.solver import Factors, factors_of


@dataclasses.dataclass(frozen=True)
class DissectedSystem:
    """See `solver.System`."""

    dissection: Dissection
    elimination: Elimination
    gradient: FloatArray
    error: float
    places: FloatArray

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

    keeps_for = 0.05

    def __init__(self, graph: KeyframeGraph, *, landmarks: bool = True) -> None:
        """landmarks: whether they are unknowns."""
        self._graph = graph
        self.factors: Factors = factors_of(graph)
        n, k, rows = len(graph.ids), len(graph.keyframes), self.factors.keyframes.rows
        seen_by = np.repeat(np.arange(k), np.diff(self.factors.keyframes.offsets))
        # Landmarks, their errors, nodes 1 to k, the parameters.
        nodes = 2 * n + np.append(np.arange(k), np.arange(k - 1))
        variable = np.concatenate([rows, n + rows, nodes, np.full(k, 2 * n + k)])
        keyframe = np.concatenate([seen_by, seen_by, np.arange(k), np.arange(1, k), np.arange(k)])
        # A landmark's error is in the keyframes that the landmark is in, and the parameters are in all.
        cut = (variable < n) | ((variable >= 2 * n) & (variable < 2 * n + k))
        leaf = leaves(graph.X_MN[:-1, :2], variable[cut], keyframe[cut])
        width = np.repeat([2 * landmarks, 2 * self.factors.has_errors, 3, SHARED], [n, n, k, 1])
        self._dissection = dissected(leaf, variable, keyframe, width)
        landmark_at, error_at, node_at, shared_at = np.split(self._dissection.at, [n, 2 * n, 2 * n + k])
        self.unknowns = Unknowns(landmark_at, np.append(-1, node_at), int(shared_at[0]), error_at)

    def linearised(self, values: Values, damping: float) -> DissectedSystem:
        """See `solver.Solver`."""
        factors, u, size = self.factors, self.unknowns, self._dissection.size
        gradient, error = np.zeros(size), 0.0
        places = np.empty((len(factors.keyframes.rows), 2, 3))
        # A variable that is left out has no unknown, not even after its first.
        entry, has_prior = np.full(size + 1, -SHARED), np.ones(len(u.error_at), dtype=bool)

        def block(front: Front) -> FloatArray:
            """The information (f, f) that the keyframes of a leaf have on its unknowns, and priors in the first."""
            nonlocal error
            f = len(front.unknowns)
            whole, own = np.zeros((f, f)), np.zeros(f)
            entry[front.unknowns] = np.arange(f)
            at = Unknowns(entry[u.landmark_at], entry[u.node_at], int(entry[u.shared_at]), entry[u.error_at])
            entry[front.unknowns] = -SHARED
            error += assemble(front.keyframes, factors.keyframes, values, at, whole, own, places)
            gradient[front.unknowns] += own
            if front is first:
                whole[at.shared_at : at.shared_at + SHARED, at.shared_at : at.shared_at + SHARED] += factors.information
            rows = np.flatnonzero((at.error_at >= 0) & has_prior)
            if len(rows):
                has_prior[rows] = False
                i = at.error_at[rows][:, None] + [0, 1]
                whole[i, i] += factors.of_errors
            return whole

        first = next(front for front in self._dissection.fronts if not front.halves)
        elimination = eliminated(self._dissection, block, damping)
        error += factors.priors(values, u, gradient)
        return DissectedSystem(self._dissection, elimination, gradient, error, places)

    def log_determinant_given_landmarks(self, values: Values) -> float:
        """See `solver.Solver`."""
        return DissectionSolver(self._graph, landmarks=False).linearised(values, 0.0).log_determinant

    def gradient(self, values: Values) -> tuple[FloatArray, float]:
        """See `solver.Solver`."""
        gradient = np.zeros(self._dissection.size)
        error = batch_gradient(self.factors.keyframes, values, self.unknowns, gradient)
        return gradient, error + self.factors.priors(values, self.unknowns, gradient)
