"""Keyframe graphs for the solvers: all keyframes in flat arrays, linearised by compiled kernels."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.keyframe import Linear, Measured, gradient_of, hessian, is_unknown, residual, rows_of, with_errors
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.surfaces import Pieces, Points, Ties, pieces_of, scatter

# Least damping, an information on every unknown, of a system that is not positive definite: a deviation of 100 m or
# rad.
LEAST_DAMPING = 1e-4
# The index of what is no unknown; also negative with the offset of any of its components.
NONE = -SHARED


class Keyframes(NamedTuple):
    """k keyframes in flat arrays.

    offsets: (k + 1,) keyframe j has the entries offsets[j]:offsets[j + 1] of rows, y_AL, anchor, on_error and pull.
    rows: of its landmarks in p_ML, walls: (k,) how many of them, the first, are walls. y_AL, anchor, pull: (., 2),
    p_MC: (., 2) the anchors in M, on_error: (., 2, 2), y_AD: (k, 3), unit: (k,), vector: (k, 13). starts: (k + 1,) the
    same of information, flattened; with the tags' errors where these are unknowns.
    """

    offsets: IntArray
    rows: IntArray
    walls: IntArray
    y_AL: FloatArray
    anchor: FloatArray
    p_MC: FloatArray
    on_error: FloatArray
    pull: FloatArray
    y_AD: FloatArray
    unit: IntArray
    vector: FloatArray
    starts: IntArray
    information: FloatArray


class Values(NamedTuple):
    """X_MN: (k + 1, 3), p_ML: (n, 2), shared: (13,), errors: (n, 2) of the tags' range and bearing, m and rad."""

    X_MN: FloatArray
    p_ML: FloatArray
    shared: FloatArray
    errors: FloatArray


class Unknowns(NamedTuple):
    """Index of the first unknown of each landmark (n,), of each node (k + 1,), of the parameters and of each tag's
    errors (n,); NONE for the origin, and for errors if tags have none."""

    landmark_at: IntArray
    node_at: IntArray
    shared_at: int
    error_at: IntArray


@dataclasses.dataclass(frozen=True)
class Factors:
    """All keyframes in flat arrays, the prior of the parameters, mean (13,) and information (13, 13), and the
    information (2,) on the errors of each tag, infinite if tags have none."""

    keyframes: Keyframes
    mean: FloatArray
    information: FloatArray
    of_errors: FloatArray
    pieces: Pieces
    ties: Ties

    @property
    def has_errors(self) -> bool:
        """Whether tags have constant errors."""
        return bool(np.isfinite(self.of_errors).all())

    def priors(self, values: Values, unknowns: Unknowns, gradient: FloatArray) -> float:
        """Add the gradient of the priors' cost; returns twice that cost."""
        off = values.shared - self.mean
        force = self.information @ off
        gradient[unknowns.shared_at : unknowns.shared_at + SHARED] += force
        if not self.has_errors:
            return float(off @ force)
        pull = values.errors * self.of_errors
        gradient[unknowns.error_at[:, None] + [0, 1]] += pull
        return float(off @ force) + float(np.sum(values.errors * pull))


def factors_of(graph: KeyframeGraph) -> Factors:
    """Return the factors of a graph of one keyframe or more."""
    counts = np.array([len(one.ids) for one in graph.keyframes])
    has_errors = graph.tag_error.any()
    information = [one.with_errors() if has_errors else one.without_errors for one in graph.keyframes]
    rows = rows_of(np.concatenate([one.ids for one in graph.keyframes]), graph.ids)[0]
    keyframes = Keyframes(
        offsets=np.append(0, np.cumsum(counts)),
        rows=rows,
        walls=np.array([one.walls for one in graph.keyframes]),
        y_AL=np.concatenate([one.y_AL for one in graph.keyframes]),
        anchor=np.concatenate([one.anchor for one in graph.keyframes]),
        p_MC=graph.anchor[rows],
        on_error=np.concatenate([one.on_error for one in graph.keyframes]),
        pull=np.concatenate([one.pull for one in graph.keyframes]),
        y_AD=np.array([one.y_AD for one in graph.keyframes]),
        unit=np.array([one.unit for one in graph.keyframes]),
        vector=np.array([one.vector for one in graph.keyframes]),
        starts=np.append(0, np.cumsum([one.size for one in information])),
        information=np.concatenate([one.ravel() for one in information]),
    )
    with np.errstate(divide="ignore"):
        errors = np.where(graph.tag_error > 0.0, graph.tag_error**-2.0, np.inf)
    of_prior = np.asarray(np.linalg.inv(graph.prior.covariance), dtype=float)
    points = Points(
        np.repeat(np.arange(len(graph.keyframes)), [len(one.points) for one in graph.keyframes]),
        np.vstack([one.points for one in graph.keyframes]),
        np.cumsum([is_unknown(one) for one in graph.keyframes]),
        np.array([one.scatter for one in graph.keyframes]),
    )
    pieces = pieces_of(points, graph.X_MN, len(graph.keyframes), graph.unevenness)
    return Factors(keyframes, graph.prior.mean, of_prior, errors, pieces, graph.ties)


@njit(cache=True)
def _keyframe(
    k: int, keyframes: Keyframes, values: Values, unknowns: Unknowns
) -> tuple[IntArray, Linear, FloatArray, FloatArray, FloatArray]:
    """The unknowns (u,) of keyframe k, negative where one has none: of its landmarks, D, A, the parameters and the
    tags' errors, if these are unknowns. And the arguments of `gradient_of`."""
    some = slice(keyframes.offsets[k], keyframes.offsets[k + 1])
    rows, walls, unit = keyframes.rows[some], keyframes.walls[k], keyframes.unit[k]
    measured = Measured(walls, keyframes.y_AL[some], keyframes.anchor[some], keyframes.y_AD[k], unit)
    A_to_D = values.X_MN[k], values.X_MN[k + 1]
    linear = residual(values.p_ML[rows], keyframes.p_MC[some], measured, *A_to_D, values.shared)
    n, vector, parameters = len(rows), keyframes.vector[k].copy(), values.shared.copy()
    has_errors = n > 0 and unknowns.error_at[rows[0]] >= 0
    if has_errors:
        errors = values.errors[rows].copy().reshape(2 * n)
        linear = with_errors(linear, errors)
        vector = np.append(vector, keyframes.pull[some].copy().reshape(2 * n))
        parameters = np.append(parameters, errors)
    at = np.empty(2 * n + 6 + len(parameters), dtype=np.int64)
    of_landmarks, of_errors = at[: 2 * n].reshape(n, 2), at[2 * n + 6 + SHARED :]
    for i in range(2):
        of_landmarks[:, i] = unknowns.landmark_at[rows] + i
        if has_errors:
            of_errors[i::2] = unknowns.error_at[rows] + i
    at[2 * n : 2 * n + 3] = unknowns.node_at[k + 1] + np.arange(3)
    at[2 * n + 3 : 2 * n + 6] = unknowns.node_at[k] + np.arange(3)
    at[2 * n + 6 : 2 * n + 6 + SHARED] = unknowns.shared_at + np.arange(SHARED)
    size = len(linear[0])
    information = keyframes.information[keyframes.starts[k] : keyframes.starts[k + 1]].reshape(size, size)
    return at, linear, information, vector, parameters


@njit(cache=True)
def assemble(
    which: IntArray,
    keyframes: Keyframes,
    values: Values,
    unknowns: Unknowns,
    block: FloatArray,
    gradient: FloatArray,
    places: FloatArray,
) -> float:
    """Add the Hessians and gradients of some of k keyframes, which (q,), to a block (u, u), if it has rows, and
    gradient (u,) of unknowns, and set the Hessian and the gradient on each of their tags among places (., 2, 3), if it
    has rows. Returns twice the cost.
    """
    total = 0.0
    for k in which:
        at, linear, information, vector, parameters = _keyframe(k, keyframes, values, unknowns)
        g, cost = gradient_of(linear, information, vector, parameters)
        H = hessian(linear, information) if len(block) else block
        scatter(H, g, at, block, gradient)
        total += cost
        begin = keyframes.offsets[k]
        for i in range(keyframes.offsets[k + 1] - begin if len(places) else 0):
            places[begin + i, :, :2] = H[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
            places[begin + i, :, 2] = g[2 * i : 2 * i + 2]
    return total
