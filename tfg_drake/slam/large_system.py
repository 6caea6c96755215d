"""The linear system of a large keyframe graph: eliminated by nested dissection.

One elimination serves the steps as long as values do not move far, and the values are exact: each gradient is taken
anew. Another, where the values have come to rest, tells the joint covariance of what is asked for.
"""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import scipy.linalg

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.dissection import Dissection, Front, covariance, dissected, eliminated, leaves, solution
from tfg_drake.slam.factors import Factors, Linear, Solved, Values, at_errors, error_of_errors
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.keyframe_kernels import InCells, Unknowns, assemble, assemble_tag_errors, batch_gradient
from tfg_drake.slam.small_system import DAMPING_GROWTH, LEAST_DAMPING, MOST_DAMPING

# So far values may move, m or rad, until the system is eliminated anew.
KEPT_FOR = 0.05


@dataclasses.dataclass(frozen=True)
class Parts:
    """Where the unknowns of a large graph are. landmark_at, error_at: (n,), node_at: (k + 1,), the first unknown of
    each, -1 for the origin and for what has none. leaf: (k,) of each keyframe."""

    landmark_at: IntArray
    node_at: IntArray
    error_at: IntArray
    leaf: IntArray
    dissection: Dissection

    keeps_for = KEPT_FOR

    def linearised(self, factors: Factors, values: Values) -> Linear:
        """The system at some values, eliminated. Where some part of the map hangs on nothing that a double can tell,
        all is held by as little as it takes."""
        damping = 0.0
        while True:
            batch = _Batch(factors, self, values)
            try:
                elimination = eliminated(self.dissection, batch.block, damping)
                break
            except scipy.linalg.LinAlgError:
                if damping > MOST_DAMPING:
                    raise
                damping = max(DAMPING_GROWTH * damping, LEAST_DAMPING)

        def solved(gradient: FloatArray) -> Solved:
            step = solution(self.dissection, elimination, -gradient)
            return Solved(step, partial(covariance, self.dissection, elimination), elimination.log_determinant)

        def log_determinant_of_rest() -> float:
            rest = _dissected(factors, len(self.landmark_at), self.leaf, landmarks=False)
            return eliminated(rest.dissection, _Batch(factors, rest, values).block).log_determinant

        error = batch.error + error_of_errors(factors, values.errors)
        return Linear(solved, batch.gradient, error, batch.poses, log_determinant_of_rest)

    def again(self, linear: Linear, factors: Factors, values: Values) -> Linear:
        """The same system with the gradient of other values or factors."""
        gradient, seen = np.zeros(self.dissection.size), at_errors(factors, values.errors)
        where = values.X_MN, values.p_ML, values.errors
        at = Unknowns(self.landmark_at, self.node_at, self.error_at)
        error = batch_gradient(seen.keyframes, factors.on_errors, *where, at, gradient)
        if factors.tag_error.any():
            gradient[self.error_at[:, None] + [0, 1]] += values.errors * factors.tag_error**-2
        error += error_of_errors(factors, values.errors)
        return dataclasses.replace(linear, gradient=gradient, error=error)


def parts_of(graph: KeyframeGraph, factors: Factors) -> Parts:
    """The parts of a graph."""
    n = len(graph.ids)
    variable, keyframe = _variables(factors, n)
    # A landmark's error is in the keyframes that the landmark is in.
    once = (variable < n) | (variable >= 2 * n)
    return _dissected(factors, n, leaves(graph.X_MN[:-1, :2], variable[once], keyframe[once]))


class _Batch:
    """The keyframes of one leaf after the other, linearised at some values: gradient (u,), weighted squared error, and
    the blocks of the poses (k, 6, 6) of those so far."""

    def __init__(self, factors: Factors, parts: Parts, values: Values) -> None:
        self.factors, self.parts, self.values = factors, parts, values
        self.seen = at_errors(factors, values.errors).keyframes
        self.gradient, self.error = np.zeros(parts.dissection.size), 0.0
        self.poses = np.empty((len(factors.keyframes.X_AD), 6, 6))
        # A variable that is left out has no unknown, not even after its first.
        self.entry = np.full(len(self.gradient) + 1, -2)
        self.no_prior = np.full(len(parts.error_at), bool(factors.tag_error.any()))

    def block(self, front: Front) -> FloatArray:
        """The information (f, f) that the keyframes of a leaf have on its unknowns."""
        parts, values, f = self.parts, self.values, len(front.unknowns)
        blocks, gradient, one = np.zeros(f * f), np.zeros(f), np.zeros(1, dtype=np.int64)
        self.entry[front.unknowns] = np.arange(f)
        at = Unknowns(self.entry[parts.landmark_at], self.entry[parts.node_at], self.entry[parts.error_at])
        self.entry[front.unknowns] = -2
        cells = InCells(np.zeros(f, dtype=np.int64), one, np.array([f]), one[:, None])
        where = values.X_MN, values.p_ML
        error, poses = assemble(front.keyframes, self.seen, *where, at, cells, blocks, gradient)
        if self.factors.tag_error.any():
            seen = self.seen, self.factors.on_errors
            assemble_tag_errors(front.keyframes, *seen, *where, values.errors, at, cells, blocks, gradient)
            rows = np.flatnonzero((at.error_at >= 0) & self.no_prior)
            own, prior = at.error_at[rows][:, None] + [0, 1], self.factors.tag_error**-2
            blocks[own * (f + 1)] += prior
            gradient[own] += prior * values.errors[rows]
            self.no_prior[rows] = False
        self.gradient[front.unknowns] += gradient
        self.error += error
        self.poses[front.keyframes] = poses
        return blocks.reshape(f, f)


def _variables(factors: Factors, n: int) -> tuple[IntArray, IntArray]:
    """Which variables each keyframe has, and which that is: n landmarks, their errors, and all nodes but the origin."""
    k = len(factors.keyframes.X_AD)
    seen_by, rows = np.repeat(np.arange(k), np.diff(factors.keyframes.offsets)), factors.keyframes.rows
    variable = np.concatenate([rows, n + rows, 2 * n + np.arange(k), 2 * n + np.arange(k - 1)])
    return variable, np.concatenate([seen_by, seen_by, np.arange(k), np.arange(1, k)])


def _dissected(factors: Factors, n: int, leaf: IntArray, *, landmarks: bool = True) -> Parts:
    """The parts of a graph of n landmarks by the leaf of each keyframe (k,), without landmarks if these are known."""
    errors = 2 if factors.tag_error.any() else 0
    width = np.repeat([2 if landmarks else 0, errors, 3], [n, n, len(leaf)])
    dissection = dissected(leaf, *_variables(factors, n), width)
    landmark_at, error_at, node_at = np.split(dissection.at, [n, 2 * n])
    return Parts(landmark_at, np.append(-1, node_at), error_at, leaf, dissection)
