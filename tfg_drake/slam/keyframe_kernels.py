"""All keyframes of a graph linearised in compiled loops."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.keyframe import linearised, residual
from tfg_drake.slam.shared import SHARED

# Unknowns of the newest pose and the parameters.
NEWEST = 3 + SHARED


class Keyframes(NamedTuple):
    """k keyframes in flat arrays.

    offsets: (k + 1,) keyframe j has the entries offsets[j]:offsets[j + 1] of rows and y_AL. rows: of its landmarks in
    p_ML. y_AL: (., 2), y_AD: (k, 3), unit: (k,), vector: (k, 8). starts: (k + 1,) the same of information, flattened.
    """

    offsets: IntArray
    rows: IntArray
    y_AL: FloatArray
    y_AD: FloatArray
    unit: IntArray
    vector: FloatArray
    starts: IntArray
    information: FloatArray


class Unknowns(NamedTuple):
    """Which unknown the first of a landmark (n,), of a node (k + 1,) and of the parameters is; negative for what is
    none."""

    landmark_at: IntArray
    node_at: IntArray
    shared_at: int


@njit(cache=True)
def assemble(
    which: IntArray,
    keyframes: Keyframes,
    X_MN: FloatArray,
    p_ML: FloatArray,
    shared: FloatArray,
    unknowns: Unknowns,
    block: FloatArray,
    gradient: FloatArray,
    poses: FloatArray,
) -> float:
    """Add the Hessians and gradients of some of k keyframes, which (q,), to a block (u, u) and gradient (u,) of unknowns;
    set their blocks (14, 14) of D, A and the parameters among poses (k, 14, 14). Returns twice the cost."""
    total = 0.0
    for k in which:
        some = slice(keyframes.offsets[k], keyframes.offsets[k + 1])
        rows = keyframes.rows[some]
        m = 2 * len(rows) + 3
        W = keyframes.information[keyframes.starts[k] : keyframes.starts[k + 1]].reshape(m + SHARED, m + SHARED)
        H, g, cost = linearised(
            rows,
            keyframes.y_AL[some],
            keyframes.y_AD[k],
            keyframes.unit[k],
            W,
            keyframes.vector[k],
            X_MN[k],
            X_MN[k + 1],
            p_ML,
            shared,
        )
        total += cost
        poses[k] = H[m - 3 :, m - 3 :]
        at = _of_keyframe(k, rows, unknowns)
        for i in range(len(at)):
            if at[i] >= 0:
                gradient[at[i]] += g[i]
                row = block[at[i]]
                for j in range(len(at)):
                    if at[j] >= 0:
                        row[at[j]] += H[i, j]
    return total


@njit(cache=True)
def batch_gradient(
    keyframes: Keyframes,
    X_MN: FloatArray,
    p_ML: FloatArray,
    shared: FloatArray,
    unknowns: Unknowns,
    gradient: FloatArray,
) -> float:
    """Add the gradient of the cost of k keyframes, and return twice that cost."""
    total = 0.0
    for k in range(len(keyframes.y_AD)):
        some = slice(keyframes.offsets[k], keyframes.offsets[k + 1])
        rows = keyframes.rows[some]
        error, on = residual(
            rows, keyframes.y_AL[some], keyframes.y_AD[k], keyframes.unit[k], X_MN[k], X_MN[k + 1], p_ML, shared
        )
        m = len(error) - SHARED
        W = keyframes.information[keyframes.starts[k] : keyframes.starts[k + 1]].reshape(m + SHARED, m + SHARED)
        weighted = W @ error
        total += error @ weighted + 2.0 * (keyframes.vector[k] @ shared)
        beyond, at = on.T @ weighted, _of_keyframe(k, rows, unknowns)
        scale = 1.0 + shared[keyframes.unit[k]]
        c, s = scale * math.cos(X_MN[k, 2]), scale * math.sin(X_MN[k, 2])
        for i in range(0, m - 1, 2):
            if at[i] >= 0:
                gradient[at[i]] += c * weighted[i] - s * weighted[i + 1]
                gradient[at[i] + 1] += s * weighted[i] + c * weighted[i + 1]
        if at[m - 1] >= 0:
            gradient[at[m - 1]] += weighted[m - 1]
        for i in range(NEWEST):
            if at[m + i] >= 0:
                gradient[at[m + i]] += beyond[i] + (keyframes.vector[k, i - 3] if i >= 3 else 0.0)
    return total


@njit(cache=True)
def _of_keyframe(k: int, rows: IntArray, unknowns: Unknowns) -> IntArray:
    """The unknowns (2n + 14,) of keyframe k: those of its landmarks, in rows (n,), D's, A's and the parameters';
    negative where one has none."""
    n = len(rows)
    at = np.empty(2 * n + 6 + SHARED, dtype=np.int64)
    for i in range(n):
        at[2 * i] = unknowns.landmark_at[rows[i]]
        at[2 * i + 1] = at[2 * i] + 1
    A, D = unknowns.node_at[k], unknowns.node_at[k + 1]
    for i in range(3):
        at[2 * n + i] = D + i
        at[2 * n + 3 + i] = A + i if A >= 0 else -1
    for i in range(SHARED):
        at[2 * n + 6 + i] = unknowns.shared_at + i if unknowns.shared_at >= 0 else -1
    return at


def log_of_chain(prior: FloatArray, poses: FloatArray) -> float:
    """log det of the information on all nodes and the parameters, given the landmarks: a chain, eliminated from its
    beginning.

    prior: (8, 8) information on the parameters. poses: (k, 14, 14) what keyframes add, as `assemble` has it.
    """
    total, newest = 0.0, np.zeros((NEWEST, NEWEST))
    newest[3:, 3:] = prior
    A, others = np.arange(3, 6), np.append(np.arange(3), np.arange(6, 6 + SHARED))
    for k, of_keyframe in enumerate(poses):
        M = of_keyframe.copy()
        M[3:, 3:] += newest
        newest = M[np.ix_(others, others)]
        # The first node is the origin.
        if k > 0:
            total += float(np.linalg.slogdet(M[3:6, 3:6])[1])
            newest -= M[np.ix_(others, A)] @ np.linalg.solve(M[3:6, 3:6], M[np.ix_(A, others)])
    return total + float(np.linalg.slogdet(newest)[1])
