"""Values and joint covariance of the whole keyframe graph: maximum a posteriori (the paper's sec. III), to rounding.

A `Solver` linearises and eliminates; everything else is here, whichever it is.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple, Protocol

import numpy as np

from tfg_drake.messages import FloatArray, IntArray, replace
from tfg_drake.slam.keyframe import rows_of
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.keyframe_kernels import Keyframes, log_of_chain
from tfg_drake.slam.map_update import entropy_of
from tfg_drake.slam.shared import SHARED, Shared

# Steps of one solve, at most, and the largest component (m, rad) of a step after which no other is needed.
MOST_STEPS = 20
SMALL_STEP = 2e-5
# A step that fails to lower the error is halved, so many times at most.
MOST_HALVINGS = 10
# So far values may move, m or rad, until the system is eliminated anew.
KEPT_FOR = 0.05
# Where no step can be made, every unknown is held to its place by this information, and a hundred times as much each
# time. The first holds what hangs on nothing by 100 m, or rad.
LEAST_DAMPING = 1e-4
DAMPING_GROWTH = 100.0
MOST_DAMPING = 1e10


@dataclasses.dataclass(frozen=True)
class Factors:
    """All keyframes in flat arrays, and the prior of the parameters, mean (8,) and information (8, 8)."""

    keyframes: Keyframes
    mean: FloatArray
    information: FloatArray


@dataclasses.dataclass(frozen=True)
class Values:
    """X_MN: (k + 1, 3), p_ML: (n, 2), shared: (8,)."""

    X_MN: FloatArray
    p_ML: FloatArray
    shared: FloatArray


class Places(NamedTuple):
    """The first unknown of each landmark (n,), of each node (k + 1,), -1 for the origin, and of the parameters."""

    landmark_at: IntArray
    node_at: IntArray
    shared_at: int

    def moved(self, values: Values, step: FloatArray) -> Values:
        """Values moved by a step (u,) of the unknowns."""
        X_MN = values.X_MN.copy()
        X_MN[1:] += step[self.node_at[1:, None] + [0, 1, 2]]
        p_ML = values.p_ML + step[self.landmark_at[:, None] + [0, 1]]
        return Values(X_MN, p_ML, values.shared + step[self.shared_at : self.shared_at + SHARED])

    def of(self, landmarks: IntArray, node: int) -> IntArray:
        """(2m + 11,) the unknowns of some landmarks, by their rows (m,), of a node and of the parameters."""
        some = (self.landmark_at[landmarks][:, None] + [0, 1]).ravel()
        return np.concatenate([some, self.node_at[node] + np.arange(3), self.shared_at + np.arange(SHARED)])


class System(Protocol):
    """A graph's system linearised at some values, and eliminated."""

    @property
    def gradient(self) -> FloatArray:
        """(u,) of the cost."""

    @property
    def error(self) -> float:
        """Twice the cost."""

    @property
    def poses(self) -> FloatArray:
        """(k, 14, 14) the Hessians' blocks of D, A and the parameters of each keyframe."""

    @property
    def log_determinant(self) -> float:
        """Of the information on all unknowns."""

    def step(self, gradient: FloatArray) -> FloatArray:
        """(u,) the step of Gauss and Newton for a gradient (u,)."""

    def covariance(self, at: IntArray) -> FloatArray:
        """(c, c) joint, of some unknowns (c,)."""


class Solver(Protocol):
    """A way to eliminate one graph."""

    places: Places

    def linearised(self, values: Values, damping: float) -> System:
        """The system at some values, with `damping` added to the information on each unknown.

        Raises numpy.linalg.LinAlgError where it is singular.
        """

    def gradient(self, values: Values) -> tuple[FloatArray, float]:
        """Gradient (u,) of the cost and twice the cost at some values."""


class Solution(NamedTuple):
    """The graph at its maximum a posteriori values; local: (m,) rows of the landmarks known jointly, covariance: (2m +
    11, 2m + 11) of these (row by row), of the node asked for and of the parameters."""

    graph: KeyframeGraph
    local: IntArray
    covariance: FloatArray


def factors_of(graph: KeyframeGraph) -> Factors:
    """The factors of a graph of one keyframe or more."""
    counts = np.array([len(one.ids) for one in graph.keyframes])
    ids = np.concatenate([one.ids for one in graph.keyframes])
    keyframes = Keyframes(
        offsets=np.append(0, np.cumsum(counts)),
        rows=rows_of(ids, graph.ids)[0],
        y_AL=np.concatenate([one.y_AL for one in graph.keyframes]),
        y_AD=np.array([one.y_AD for one in graph.keyframes]),
        unit=np.array([one.unit for one in graph.keyframes]),
        vector=np.array([one.vector for one in graph.keyframes]),
        starts=np.append(0, np.cumsum((2 * counts + 3 + SHARED) ** 2)),
        information=np.concatenate([one.information.ravel() for one in graph.keyframes]),
    )
    return Factors(keyframes, graph.prior.mean, np.linalg.inv(graph.prior.covariance))


def solved(graph: KeyframeGraph, solver: Solver, local: IntArray, node: int) -> Solution:
    """The graph of one keyframe or more at its maximum a posteriori values, with what is known jointly.

    local: (m,) rows of the landmarks whose joint covariance is asked for, with that of a node.
    """
    values, system = _converged(solver, Values(graph.X_MN.copy(), graph.p_ML.copy(), graph.shared.mean))
    covariance = system.covariance(solver.places.of(local, node))
    X_MN, p_ML = values.X_MN.copy(), values.p_ML
    X_MN[:, 2] = np.arctan2(np.sin(X_MN[:, 2]), np.cos(X_MN[:, 2]))
    m = 2 * len(local)
    entropy = of_local = entropy_of(covariance[:m, :m])
    if len(local) < len(p_ML):
        log_information = system.log_determinant - log_of_chain(np.linalg.inv(graph.prior.covariance), system.poses)
        entropy = 0.5 * (2 * len(p_ML) * math.log(2.0 * math.pi * math.e) - log_information)
    each, rows = graph.landmark_covariance.copy(), np.arange(len(local))
    each[local] = covariance[:m, :m].reshape(m // 2, 2, m // 2, 2)[rows, :, rows, :]
    shared = Shared(values.shared, covariance[-SHARED:, -SHARED:].copy())
    graph = replace(
        graph,
        X_MN=X_MN,
        p_ML=p_ML,
        landmark_covariance=each,
        entropy=entropy,
        entropy_beyond=entropy - of_local,
        shared=shared,
    )
    return Solution(graph, local, covariance)


def _converged(solver: Solver, values: Values) -> tuple[Values, System]:
    """Values at the maximum a posteriori, and the system linearised where the last step began."""
    moved_since = math.inf
    for number in range(MOST_STEPS):
        anew = moved_since >= KEPT_FOR or number == MOST_STEPS - 1
        if anew:
            system, moved_since = _linearised(solver, values), 0.0
            gradient, error = system.gradient, system.error
        else:
            gradient, error = solver.gradient(values)
        step = system.step(gradient)
        length = float(np.max(np.abs(step)))
        moved, share = _lowered(solver, error, values, step)
        if share < 1.0 and not anew:
            # A barely constrained unknown follows the error of a reused factorisation: factorise again.
            moved_since = math.inf
            continue
        values, moved_since = moved, moved_since + (length if share == 1.0 else math.inf)
        if length < SMALL_STEP:
            if anew:
                break
            moved_since = math.inf
    return values, system


def _linearised(solver: Solver, values: Values) -> System:
    """The system at some values. Where some part of the map hangs on nothing that a double can tell, all is held by as
    little as it takes."""
    damping = 0.0
    while True:
        try:
            return solver.linearised(values, damping)
        except np.linalg.LinAlgError:
            if damping > MOST_DAMPING:
                raise
            damping = max(DAMPING_GROWTH * damping, LEAST_DAMPING)


def _lowered(solver: Solver, error: float, values: Values, step: FloatArray) -> tuple[Values, float]:
    """Values moved by a step (u,), or by the share of it that lowers the error, and that share."""
    share = 1.0
    for _ in range(MOST_HALVINGS if np.max(np.abs(step)) >= SMALL_STEP else 1):
        moved = solver.places.moved(values, share * step)
        if solver.gradient(moved)[1] <= error + 1e-9 * (1.0 + abs(error)):
            break
        share *= 0.5
    return moved, share
