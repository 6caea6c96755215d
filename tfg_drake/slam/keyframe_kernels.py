"""Keyframes linearised in batch: errors, gradients and Hessians of all of them in one compiled call.

A keyframe's error on its poses A and D and its landmarks is e = [R_A^T (L_i - t_A) - p_AL_i; A^-1 D - X_AD], weighted
by its information. Poses move additively, (x, y) in M and theta; so their covariances are those of `messages`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.odometry_model import wrap

# A fusion is iterated until no unknown moves by more than this, m or rad, but no more often than this.
SMALL_STEP = 1e-9
MOST_STEPS = 5
# A change of yaw small enough that no angle wraps, rad.
YAW_STEP = 1e-3


@njit(cache=True)
def _residual(
    rows: IntArray, p_AL: FloatArray, X_AD: FloatArray, A: FloatArray, D: FloatArray, p_ML: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The error (2n + 3,) and its Jacobian (2n + 3, 3) on A."""
    n = len(rows)
    c, s = math.cos(A[2]), math.sin(A[2])
    error, on_A = np.empty(2 * n + 3), np.zeros((2 * n + 3, 3))
    for i in range(n + 1):
        if i < n:
            dx, dy = p_ML[rows[i], 0] - A[0], p_ML[rows[i], 1] - A[1]
            seen_x, seen_y = p_AL[i, 0], p_AL[i, 1]
        else:
            dx, dy, seen_x, seen_y = D[0] - A[0], D[1] - A[1], X_AD[0], X_AD[1]
        x, y = c * dx + s * dy, -s * dx + c * dy
        error[2 * i], error[2 * i + 1] = x - seen_x, y - seen_y
        on_A[2 * i, 0], on_A[2 * i, 1], on_A[2 * i, 2] = -c, -s, y
        on_A[2 * i + 1, 0], on_A[2 * i + 1, 1], on_A[2 * i + 1, 2] = s, -c, -x
    error[2 * n + 2] = wrap(D[2] - A[2] - X_AD[2])
    on_A[2 * n + 2, 2] = -1.0
    return error, on_A


@njit(cache=True)
def _turned(into: FloatArray, i: int, j: int, a: float, b: float, c: float, s: float) -> None:
    """A pair of numbers (a, b) in A's axes, in M's axes, as rows i and i + 1 of column j."""
    into[i, j], into[i + 1, j] = c * a - s * b, s * a + c * b


@njit(cache=True)
def linearised(
    rows: IntArray,
    p_AL: FloatArray,
    X_AD: FloatArray,
    information: FloatArray,
    A: FloatArray,
    D: FloatArray,
    p_ML: FloatArray,
) -> tuple[FloatArray, FloatArray, float]:
    """Hessian (2n + 6, 2n + 6) and gradient (2n + 6,) of half a keyframe's weighted squared error, and that error.

    In the order of landmarks, D and A. The Jacobian on landmarks and D's position is a rotation, so that their block of
    the Hessian is the information, turned.
    """
    error, on_A = _residual(rows, p_AL, X_AD, A, D, p_ML)
    m = len(error)
    c, s = math.cos(A[2]), math.sin(A[2])
    weighted, weighted_A = information @ error, information @ on_A
    H, g = np.empty((m + 3, m + 3)), np.empty((m + 3, 1))
    half = np.empty((m, m))
    for i in range(0, m - 1, 2):
        for j in range(m):
            _turned(half, i, j, information[i, j], information[i + 1, j], c, s)
        for j in range(3):
            _turned(H, i, m + j, weighted_A[i, j], weighted_A[i + 1, j], c, s)
        _turned(g, i, 0, weighted[i], weighted[i + 1], c, s)
    half[m - 1] = information[m - 1]
    H[m - 1, m:] = weighted_A[m - 1]
    g[m - 1, 0] = weighted[m - 1]
    for i in range(m):
        for j in range(0, m - 1, 2):
            H[i, j], H[i, j + 1] = c * half[i, j] - s * half[i, j + 1], s * half[i, j] + c * half[i, j + 1]
        H[i, m - 1] = half[i, m - 1]
        H[m:, i] = H[i, m:]
    H[m:, m:] = on_A.T @ weighted_A
    g[m:, 0] = on_A.T @ weighted
    return H, g[:, 0].copy(), float(error @ weighted)


@njit(cache=True)
def batch_error(
    offsets: IntArray,
    rows: IntArray,
    p_AL: FloatArray,
    X_AD: FloatArray,
    starts: IntArray,
    information: FloatArray,
    X_MN: FloatArray,
    p_ML: FloatArray,
) -> float:
    """The weighted squared error of k keyframes, arguments as in `assemble`."""
    total = 0.0
    for k in range(len(X_AD)):
        some = slice(offsets[k], offsets[k + 1])
        error, _on_A = _residual(rows[some], p_AL[some], X_AD[k], X_MN[k], X_MN[k + 1], p_ML)
        m = len(error)
        total += float(error @ (information[starts[k] : starts[k + 1]].reshape(m, m) @ error))
    return total


@njit(cache=True)
def assemble(
    offsets: IntArray,
    rows: IntArray,
    p_AL: FloatArray,
    X_AD: FloatArray,
    starts: IntArray,
    information: FloatArray,
    X_MN: FloatArray,
    p_ML: FloatArray,
    landmark_at: IntArray,
    node_at: IntArray,
    cell: IntArray,
    first: IntArray,
    size: IntArray,
    block_at: IntArray,
    blocks: FloatArray,
    gradient: FloatArray,
) -> tuple[float, FloatArray]:
    """Add the Hessians and gradients of k keyframes to a system in cells.

    offsets: (k + 1,) keyframe j has the entries offsets[j]:offsets[j + 1] of rows, the rows of its landmarks in p_ML,
    and of p_AL. starts: (k + 1,) the same of information, each flattened. landmark_at (n,), node_at (k + 1,): the
    unknown that a landmark's x, or a node's x, is, -1 for the origin. cell: (u,) of each unknown; first, size: (c,)
    first unknown and number of unknowns of a cell. block_at: (c, c) where in blocks the block of two cells begins, the
    lower number first, row by row.

    Returns the weighted squared error, and (k, 6, 6) the Hessians' blocks of each keyframe's two poses, D first.
    """
    total, poses = 0.0, np.empty((len(X_AD), 6, 6))
    for k in range(len(X_AD)):
        some = slice(offsets[k], offsets[k + 1])
        n = offsets[k + 1] - offsets[k]
        m = 2 * n + 3
        W = information[starts[k] : starts[k + 1]].reshape(m, m)
        H, g, error = linearised(rows[some], p_AL[some], X_AD[k], W, X_MN[k], X_MN[k + 1], p_ML)
        total += error
        poses[k] = H[2 * n :, 2 * n :]
        at = np.empty(m + 3, dtype=np.int64)
        for i in range(n):
            at[2 * i] = landmark_at[rows[offsets[k] + i]]
            at[2 * i + 1] = at[2 * i] + 1
        for i in range(3):
            at[2 * n + i] = node_at[k + 1] + i
            at[m + i] = node_at[k] + i if node_at[k] >= 0 else -1
        for i in range(m + 3):
            if at[i] < 0:
                continue
            gradient[at[i]] += g[i]
            row = cell[at[i]]
            for j in range(m + 3):
                if at[j] >= 0 and row <= cell[at[j]]:
                    column = cell[at[j]]
                    place = (at[i] - first[row]) * size[column] + at[j] - first[column]
                    blocks[block_at[row, column] + place] += H[i, j]
    return total, poses


@njit(cache=True)
def chain(own: FloatArray, poses: FloatArray) -> tuple[float, FloatArray]:
    """A chain of nodes, given the landmarks, eliminated from its beginning up to the last.

    own: (3, 3) information on its first node, infinite where that is the origin. poses: (k, 6, 6) what keyframes add,
    as `assemble` has it. Returns log det of the information on the nodes eliminated, and (3, 3) that on the last.
    """
    total = 0.0
    for k in range(len(poses)):
        if own[0, 0] == np.inf:
            own = poses[k, :3, :3].copy()
            continue
        own = own + poses[k, 3:, 3:]
        total += math.log(np.linalg.det(own))
        across = np.ascontiguousarray(poses[k, :3, 3:])
        own = poses[k, :3, :3] - across @ np.linalg.solve(own, np.ascontiguousarray(across.T))
    return total, own


@njit(cache=True)
def fused_information(
    rows_1: IntArray,
    p_1: FloatArray,
    X_1: FloatArray,
    information_1: FloatArray,
    on_yaw_1: FloatArray,
    rows_2: IntArray,
    p_2: FloatArray,
    X_2: FloatArray,
    information_2: FloatArray,
    on_yaw_2: FloatArray,
    p_AL: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, float, float, float]:
    """Two keyframes, from A to B and from B to D, as one from A to D, with B marginalised out.

    rows_1, rows_2: of their landmarks among those of both (n, 2), p_AL: where these are about, in A, m. Returns p_AL
    (n, 2), X_AB (3,), X_AD (3,), the information (2n + 3, 2n + 3) of (p_AL, X_AD), their derivative (2n + 3,) on the
    camera's yaw, the slope and curvature of half their weighted squared error over that, and the standard deviation of
    B's position, m.
    """
    n = len(p_AL)
    p_AL, A, B, D = p_AL.copy(), np.zeros(3), X_1.copy(), np.empty(3)
    c, s = math.cos(B[2]), math.sin(B[2])
    D[0], D[1], D[2] = B[0] + c * X_2[0] - s * X_2[1], B[1] + s * X_2[0] + c * X_2[1], B[2] + X_2[2]
    # Landmarks, D, B.
    at_1, at_2 = np.empty(2 * len(rows_1) + 6, dtype=np.int64), np.empty(2 * len(rows_2) + 6, dtype=np.int64)
    for i in range(len(rows_1)):
        at_1[2 * i], at_1[2 * i + 1] = 2 * rows_1[i], 2 * rows_1[i] + 1
    for i in range(len(rows_2)):
        at_2[2 * i], at_2[2 * i + 1] = 2 * rows_2[i], 2 * rows_2[i] + 1
    for i in range(3):
        at_1[len(at_1) - 6 + i], at_1[len(at_1) - 3 + i] = 2 * n + 3 + i, -1
        at_2[len(at_2) - 6 + i], at_2[len(at_2) - 3 + i] = 2 * n + i, 2 * n + 3 + i
    size = 2 * n + 6
    H = np.zeros((size, size))
    for _ in range(MOST_STEPS):
        H[:], g = 0.0, np.zeros(size)
        H_1, g_1, _error = linearised(rows_1, p_1, X_1, information_1, A, B, p_AL)
        H_2, g_2, _error = linearised(rows_2, p_2, X_2, information_2, B, D, p_AL)
        _scatter(H, g, at_1, H_1, g_1)
        _scatter(H, g, at_2, H_2, g_2)
        step = np.linalg.solve(H, -g)
        for i in range(n):
            p_AL[i, 0] += step[2 * i]
            p_AL[i, 1] += step[2 * i + 1]
        D += step[2 * n : 2 * n + 3]
        B += step[2 * n + 3 :]
        if np.max(np.abs(step)) < SMALL_STEP:
            break
    # What the yaw changes is linear in what was seen.
    gradients, errors = np.zeros((3, size)), np.zeros(3)
    for k in range(3):
        h = (k - 1) * YAW_STEP
        p, X = _at_other_yaw(p_1, X_1, on_yaw_1, h)
        H_1, g_1, error_1 = linearised(rows_1, p, X, information_1, A, B, p_AL)
        p, X = _at_other_yaw(p_2, X_2, on_yaw_2, h)
        H_2, g_2, error_2 = linearised(rows_2, p, X, information_2, B, D, p_AL)
        H[:] = 0.0
        _scatter(H, gradients[k], at_1, H_1, g_1)
        _scatter(H, gradients[k], at_2, H_2, g_2)
        errors[k] = 0.5 * (error_1 + error_2)
    by_yaw = (gradients[2] - gradients[0]) / (2.0 * YAW_STEP)
    change = np.linalg.solve(H, -by_yaw)
    on_yaw = change[: 2 * n + 3].copy()
    slope = (errors[2] - errors[0]) / (2.0 * YAW_STEP)
    curvature = (errors[0] - 2.0 * errors[1] + errors[2]) / YAW_STEP**2 + np.sum(by_yaw * change)
    m = 2 * n + 3
    across = np.ascontiguousarray(H[:m, m:])
    information = H[:m, :m] - across @ np.linalg.solve(np.ascontiguousarray(H[m:, m:]), np.ascontiguousarray(across.T))
    D[2] = wrap(D[2])
    covariance = np.linalg.inv(H)
    deviation = math.sqrt(covariance[m, m] + covariance[m + 1, m + 1])
    return p_AL, B, D, 0.5 * (information + information.T), on_yaw, slope, curvature, deviation


@njit(cache=True)
def _at_other_yaw(
    p_AL: FloatArray, X_AD: FloatArray, on_yaw: FloatArray, change: float
) -> tuple[FloatArray, FloatArray]:
    """A keyframe's p_AL and X_AD with the camera's yaw changed, rad."""
    p, n = p_AL.copy(), len(p_AL)
    for i in range(n):
        p[i, 0] += change * on_yaw[2 * i]
        p[i, 1] += change * on_yaw[2 * i + 1]
    return p, X_AD + change * on_yaw[2 * n :]


@njit(cache=True)
def _scatter(H: FloatArray, g: FloatArray, at: IntArray, H_k: FloatArray, g_k: FloatArray) -> None:
    for i in range(len(at)):
        if at[i] >= 0:
            g[at[i]] += g_k[i]
            for j in range(len(at)):
                if at[j] >= 0:
                    H[at[i], at[j]] += H_k[i, j]
