"""The GTSAM solver of the keyframe graph: GTSAM linearises, eliminates and marginalises.

GTSAM has no factor for a keyframe, so each is a `gtsam.CustomFactor`, whose error is a square root of the keyframe's
information times its residual. All unknowns are vectors, so covariances have the same coordinates as the messages.
"""

from __future__ import annotations

import math

import gtsam
import numpy as np
import scipy.linalg
from gtsam.symbol_shorthand import L, S, X

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.keyframe import Keyframe, residual
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.solver import LEAST_DAMPING, Values, factors_of
from tfg_drake.slam.surfaces import Pieces, add_pieces

# Eigenvalues of a keyframe's information below this share of the largest are taken as zero.
LEAST_SHARE = 1e-13
# The optimiser stops at a step that lowers the error by less than this share.
LEAST_DECREASE = 1e-10


def map_graph(graph: KeyframeGraph) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return a keyframe graph as GTSAM factors and values.

    graph: `exploration.look("estimator_state").graph` of a mission, `load_run(folder).map.graph` of a run.

    The keys: L(row), (2,) landmark graph.ids[row], m; walls as in `messages.MapEstimate`. X(j), (3,) the pose
    graph.X_MN[j] where keyframe j - 1 ends and keyframe j begins, m and rad, for j from 1 on; X_MN[0] is the map's
    origin and no variable. S(0), (13,) the shared parameters in the order of `tfg_drake.slam.shared`. All are vectors,
    in the map frame M.
    Factor 0 is the prior of S(0), factor j + 1 keyframe j; the pieces of surface that tie poses follow. All but the
    prior are `CustomFactor`s, which GTSAM cannot serialise. They omit the constant errors of tags (graph.tag_error).

    The values are the map. Of a run they are the optimum if tags have no constant errors. Of a mission under way they
    are those of the last solve, with later landmarks at their first estimate, and that stops before the optimum:
    `gtsam.LevenbergMarquardtOptimizer(*map_graph(graph))` finds it.
    """
    return named_graph(graph, [L(row) for row in range(len(graph.ids))])


def named_graph(graph: KeyframeGraph, names: list[int]) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
    """Return the same as `map_graph`, with given keys (n,) for the landmarks."""
    factors = gtsam.NonlinearFactorGraph()
    prior = gtsam.noiseModel.Gaussian.Covariance(graph.prior.covariance)
    factors.add(gtsam.PriorFactorVector(S(0), graph.prior.mean, prior))
    for j, one in enumerate(graph.keyframes):
        rows = np.searchsorted(graph.ids, one.ids)
        keys = [*(names[row] for row in rows.tolist()), X(j + 1), *([X(j)] if j else []), S(0)]
        factors.add(_factor(one, graph.anchor[rows], keys, from_origin=j == 0))
    pieces = factors_of(graph).pieces
    for first, last, frame in zip(pieces.looks[:-1], pieces.looks[1:], pieces.frame, strict=True):
        factors.add(_piece(frame, pieces.keyframe[first:last], pieces.moments[first:last]))
    where = gtsam.Values()
    for name, p_ML in zip(names, graph.p_ML, strict=True):
        where.insert(name, p_ML)
    for j, X_MN in enumerate(graph.X_MN[1:], 1):
        where.insert(X(j), X_MN)
    where.insert(S(0), graph.shared.mean)
    return factors, where


def _factor(one: Keyframe, p_MC: FloatArray, keys: list[int], *, from_origin: bool) -> gtsam.CustomFactor:
    """A keyframe as a factor with error R e + d, where W = R^T R without its null space and R^T d = (0, v): half its
    square is the cost up to a constant. p_MC: (n, 2) the anchors of its landmarks."""
    W = one.without_errors
    diagonal = np.sqrt(np.maximum(np.diag(W), np.finfo(float).tiny))
    value, direction = np.linalg.eigh(W / np.outer(diagonal, diagonal))
    some = value > LEAST_SHARE * value[-1]
    root = np.sqrt(value[some])
    R = root[:, None] * direction[:, some].T * diagonal
    forced = np.append(np.zeros(len(diagonal) - SHARED), one.vector)
    d = direction[:, some].T @ (forced / diagonal) / root
    n = len(one.ids)

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[FloatArray] | None) -> FloatArray:
        p_ML = np.array([values.atVector(key) for key in keys[:n]]).reshape(n, 2)
        D, shared = values.atVector(keys[n]), values.atVector(keys[-1])
        A = np.zeros(3) if from_origin else values.atVector(keys[n + 1])
        e, on, by_landmark = residual(p_ML, p_MC, one.measured, A, D, shared)
        if jacobians is not None:
            for i in range(n):
                jacobians[i] = R[:, 2 * i : 2 * i + 2] @ by_landmark[i]
            jacobians[n] = R[:, 2 * n : 2 * n + 3] @ scipy.linalg.block_diag(by_landmark[n], 1.0)
            if not from_origin:
                jacobians[n + 1] = R @ on[:, :3]
            jacobians[len(keys) - 1] = R @ on[:, 3:]
        return np.asarray(R @ e + d)

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(len(d)), keys, error)


def _piece(frame: FloatArray, keyframe: IntArray, moments: FloatArray) -> gtsam.CustomFactor:
    """A piece of surface, see `surfaces.Pieces`, as a factor: a square root of the Hessian H of the poses that it ties,
    its offset and slope eliminated, and r with H^(1/2) r = g, the gradient; the cost beyond |r|^2 is one more error."""
    free, m = keyframe > 0, len(keyframe)
    piece = Pieces(frame[None], np.array([0, m]), np.arange(m), moments)
    keys = [X(k) for k in keyframe[free].tolist()]
    node_at = np.where(free, 3 * (np.cumsum(free) - 1), -1)
    size = 3 * len(keys)

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[FloatArray] | None) -> FloatArray:
        X_MN, H, g = np.zeros((m, 3)), np.zeros((size, size)), np.zeros(size)
        X_MN[free] = [values.atVector(key) for key in keys]
        cost = add_pieces(np.zeros(1, np.int64), piece, X_MN, node_at, H, g)
        value, direction = np.linalg.eigh(H)
        some = value > LEAST_SHARE * value[-1]
        root = np.sqrt(value[some])
        r = np.zeros(size + 1)
        r[:size][some] = direction[:, some].T @ g / root
        r[size] = math.sqrt(max(cost - float(r @ r), 0.0))
        if jacobians is not None:
            R = np.zeros((size + 1, size))
            R[:size][some] = root[:, None] * direction[:, some].T
            for i in range(len(keys)):
                jacobians[i] = R[:, 3 * i : 3 * i + 3]
        return r

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(size + 1), keys, error)


def solution(graph: KeyframeGraph, local: IntArray, node: int) -> tuple[Values, FloatArray, float]:
    """As `map_solver.solution`, by GTSAM (`explorer.solver=gtsam`), which takes six to seven times as long. Raises
    ValueError if tags have constant errors, which `map_graph` omits."""
    if graph.tag_error.any():
        raise ValueError("GTSAM alone solves no graph whose tags have constant errors: take the default solver.")
    factors, start = map_graph(graph)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(LEAST_DECREASE)
    found = gtsam.LevenbergMarquardtOptimizer(factors, start, parameters).optimize()
    linear = factors.linearize(found)
    try:
        marginals = gtsam.Marginals(linear, found)
    except RuntimeError:  # A part of the map is unconstrained: LEAST_DAMPING holds all unknowns.
        for key in found.keys():  # noqa: SIM118 it is no dictionary
            width = len(found.atVector(key))
            linear.push_back(gtsam.HessianFactor(key, LEAST_DAMPING * np.eye(width), np.zeros(width), 0.0))
        marginals = gtsam.Marginals(linear, found)
    n, m = len(graph.ids), 2 * len(local)
    # In the order of the keys: landmarks, parameters, pose.
    asked = [*(L(row) for row in local.tolist()), S(0), X(node)]
    joint = marginals.jointMarginalCovariance(asked).fullMatrix()
    at = np.concatenate([np.arange(m), m + SHARED + np.arange(3), m + np.arange(SHARED)])
    log_information = 0.0
    if len(local) < n:
        of_others = linear.hessian()[0][2 * n :, 2 * n :]
        log_information = 2.0 * linear.eliminateSequential().logDeterminant() - np.linalg.slogdet(of_others)[1]
    X_MN = [graph.X_MN[0], *(found.atVector(X(j)) for j in range(1, len(graph.X_MN)))]
    p_ML = np.array([found.atVector(L(row)) for row in range(n)]).reshape(n, 2)
    values = Values(np.array(X_MN), p_ML, found.atVector(S(0)), np.zeros((n, 2)))
    return values, np.asarray(joint[np.ix_(at, at)]), float(log_information)
