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
from tfg_drake.slam.keyframe_kernels import Keyframes, Unknowns, Values
from tfg_drake.slam.map_update import entropy_of
from tfg_drake.slam.shared import SHARED, Shared
from tfg_drake.slam.tag_error import learnt, suspected

# Steps of one solve, at most, and the largest component (m, rad) of a step after which no other is needed.
MOST_STEPS = 20
SMALL_STEP = 2e-5
# A step that fails to lower the error is halved, so many times at most.
MOST_HALVINGS = 10
# Where no step can be made, every unknown is held to its place by this information, and a hundred times as much each
# time. The first holds what hangs on nothing by 100 m, or rad.
LEAST_DAMPING = 1e-4
DAMPING_GROWTH = 100.0
MOST_DAMPING = 1e10


@dataclasses.dataclass(frozen=True)
class Factors:
    """All keyframes in flat arrays, the prior of the parameters, mean (8,) and information (8, 8), and the information
    (2,) on the errors of each tag, infinite where tags have none."""

    keyframes: Keyframes
    mean: FloatArray
    information: FloatArray
    of_errors: FloatArray

    @property
    def has_errors(self) -> bool:
        """Whether tags have errors."""
        return bool(np.isfinite(self.of_errors).all())

    def priors(self, values: Values, unknowns: Unknowns, gradient: FloatArray) -> float:
        """Add the gradient of the priors' cost; twice that cost."""
        off = values.shared - self.mean
        force = self.information @ off
        gradient[unknowns.shared_at : unknowns.shared_at + SHARED] += force
        if not self.has_errors:
            return float(off @ force)
        pull = values.errors * self.of_errors
        gradient[unknowns.error_at[:, None] + [0, 1]] += pull
        return float(off @ force) + float(np.sum(values.errors * pull))


def moved(values: Values, unknowns: Unknowns, step: FloatArray) -> Values:
    """Values moved by a step (u,) of the unknowns."""
    X_MN, errors = values.X_MN.copy(), values.errors
    X_MN[1:] += step[unknowns.node_at[1:, None] + [0, 1, 2]]
    if np.any(unknowns.error_at >= 0):
        errors = errors + step[unknowns.error_at[:, None] + [0, 1]]
    shared = values.shared + step[unknowns.shared_at : unknowns.shared_at + SHARED]
    return Values(X_MN, values.p_ML + step[unknowns.landmark_at[:, None] + [0, 1]], shared, errors)


class System(Protocol):
    """A graph's system linearised at some values, and eliminated."""

    @property
    def gradient(self) -> FloatArray:
        """(u,) of the cost."""

    @property
    def error(self) -> float:
        """Twice the cost."""

    @property
    def places(self) -> FloatArray | None:
        """(., 2, 3) Hessian and gradient of each keyframe on each of its tags."""

    @property
    def log_determinant(self) -> float:
        """Of the information on all unknowns."""

    def step(self, gradient: FloatArray) -> FloatArray:
        """(u,) the step of Gauss and Newton for a gradient (u,)."""

    def covariance(self, at: IntArray) -> FloatArray:
        """(c, c) joint, of some unknowns (c,)."""


class Solver(Protocol):
    """A way to eliminate one graph."""

    factors: Factors
    unknowns: Unknowns
    # So far values may move, m or rad, until the system is eliminated anew.
    keeps_for: float

    def linearised(self, values: Values, damping: float) -> System:
        """The system at some values, with `damping` added to the information on each unknown.

        Raises numpy.linalg.LinAlgError where it is singular.
        """

    def log_determinant_given_landmarks(self, values: Values) -> float:
        """Of the information on all unknowns but the landmarks, given these."""

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
    of_errors = [one.by_errors().ravel() for one in graph.keyframes] if graph.tag_error.any() else [np.empty(0)]
    ids = np.concatenate([one.ids for one in graph.keyframes])
    keyframes = Keyframes(
        offsets=np.append(0, np.cumsum(counts)),
        rows=rows_of(ids, graph.ids)[0],
        y_AL=np.concatenate([one.y_AL for one in graph.keyframes]),
        on_error=np.concatenate([one.on_error for one in graph.keyframes]),
        y_AD=np.array([one.y_AD for one in graph.keyframes]),
        unit=np.array([one.unit for one in graph.keyframes]),
        vector=np.array([one.vector for one in graph.keyframes]),
        starts=np.append(0, np.cumsum((2 * counts + 3 + SHARED) ** 2)),
        information=np.concatenate([one.information.ravel() for one in graph.keyframes]),
        starts_of_errors=np.append(0, np.cumsum([len(one) for one in of_errors])),
        by_errors=np.concatenate(of_errors),
    )
    with np.errstate(divide="ignore"):
        errors = np.where(graph.tag_error > 0.0, graph.tag_error**-2.0, np.inf)
    information = np.asarray(np.linalg.inv(graph.prior.covariance), dtype=float)
    return Factors(keyframes, graph.prior.mean, information, errors)


def solved(graph: KeyframeGraph, solver: Solver, local: IntArray, node: int) -> Solution:
    """The graph of one keyframe or more at its maximum a posteriori values, with what is known jointly.

    local: (m,) rows of the landmarks whose joint covariance is asked for, with that of a node.
    """
    nothing = np.zeros(graph.p_ML.shape)
    values, system = _converged(solver, Values(graph.X_MN.copy(), graph.p_ML.copy(), graph.shared.mean, nothing))
    u, m = solver.unknowns, 2 * len(local)
    at = np.concatenate(
        [
            (u.landmark_at[local][:, None] + [0, 1]).ravel(),
            u.node_at[node] + np.arange(3),
            u.shared_at + np.arange(SHARED),
            (u.error_at[local][:, None] + [0, 1]).ravel() if solver.factors.has_errors else np.empty(0, dtype=np.int64),
        ]
    )
    covariance = system.covariance(at)
    of_errors = np.diag(covariance)[m + 3 + SHARED :].reshape(-1, 2)
    covariance = covariance[: m + 3 + SHARED, : m + 3 + SHARED].copy()
    tag_error = graph.tag_error
    if solver.factors.has_errors:
        tag_error = learnt(graph.tag_error, values.errors[local], of_errors)
    elif system.places is not None:
        tag_error = suspected(*_tag_pulls(solver.factors.keyframes, values, system.places))
    X_MN, p_ML = values.X_MN.copy(), values.p_ML
    X_MN[:, 2] = np.arctan2(np.sin(X_MN[:, 2]), np.cos(X_MN[:, 2]))
    entropy = of_local = entropy_of(covariance[:m, :m])
    if len(local) < len(p_ML):
        log_information = system.log_determinant - solver.log_determinant_given_landmarks(values)
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
        tag_error=tag_error,
    )
    return Solution(graph, local, covariance)


def _converged(solver: Solver, values: Values) -> tuple[Values, System]:
    """Values at the maximum a posteriori, and the system linearised where the last step began."""
    moved_since = math.inf
    for number in range(MOST_STEPS):
        anew = moved_since >= solver.keeps_for or number == MOST_STEPS - 1
        if anew:
            system, moved_since = _linearised(solver, values), 0.0
            gradient, error = system.gradient, system.error
        else:
            gradient, error = solver.gradient(values)
        step = system.step(gradient)
        length = float(np.max(np.abs(step)))
        there, share = _lowered(solver, error, values, step)
        if share < 1.0 and not anew:
            # A barely constrained unknown follows the error of a reused factorisation: factorise again.
            moved_since = math.inf
            continue
        values, moved_since = there, moved_since + (length if share == 1.0 else math.inf)
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
        there = moved(values, solver.unknowns, share * step)
        if solver.gradient(there)[1] <= error + 1e-9 * (1.0 + abs(error)):
            break
        share *= 0.5
    return there, share


def _tag_pulls(keyframes: Keyframes, values: Values, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """How hard all keyframes pull at the errors (n, 2) of each tag where these are zero, and the variance (n, 2)
    of that where only noise does.

    Of two keyframes that see a tag from the same side the place of the tag takes all; poses are taken to be known.
    """
    keyframe = np.repeat(np.arange(len(keyframes.y_AD)), np.diff(keyframes.offsets))
    row, n = keyframes.rows, len(values.p_ML)
    heading, scale = values.X_MN[keyframe, 2], 1.0 + values.shared[keyframes.unit[keyframe]]
    c, s = np.cos(heading) / scale, np.sin(heading) / scale
    by_error = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1) @ keyframes.on_error
    own, force = places[:, :, :2], places[:, :, 2]
    pull, variance = np.zeros((n, 2)), np.zeros((n, 2))
    total, by_place = np.zeros((n, 2, 2)), np.zeros((n, 2, 2))
    np.add.at(total, row, own)
    np.add.at(by_place, row, own @ by_error)
    np.add.at(pull, row, np.einsum("eji,ej->ei", by_error, force))
    np.add.at(variance, row, np.einsum("eji,ejk,eki->ei", by_error, own, by_error))
    seen = np.flatnonzero(np.bincount(row, minlength=n))
    taken = np.einsum("nji,njk->nik", by_place[seen], np.linalg.solve(total[seen], by_place[seen]))
    variance[seen] = np.maximum(variance[seen] - np.einsum("nii->ni", taken), 0.0)
    return pull, variance
