"""Keyframes linearised in batch: errors, gradients and Hessians of all of them in one compiled call.

A keyframe's error on its poses A and D and its landmarks is e = [R_A^T (L_i - t_A) - p_AL_i; A^-1 D - X_AD], weighted
by its information. Poses move additively, (x, y) in M and theta; so their covariances are those of `messages`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.odometry_model import wrap

# A fusion is iterated until no unknown moves by more than this, m or rad, but no more often than this.
SMALL_STEP = 1e-9
MOST_STEPS = 5
# A change of yaw small enough that no angle wraps, rad.
YAW_STEP = 1e-3


class Keyframes(NamedTuple):
    """k keyframes in flat arrays.

    offsets: (k + 1,) keyframe j has the entries offsets[j]:offsets[j + 1] of rows and p_AL. rows: of its landmarks in
    p_ML. p_AL: (., 2), X_AD: (k, 3). starts: (k + 1,) the same of information, each flattened.
    """

    offsets: IntArray
    rows: IntArray
    p_AL: FloatArray
    X_AD: FloatArray
    starts: IntArray
    information: FloatArray


class OnErrors(NamedTuple):
    """What k keyframes say of the errors of their tags, one keyframe after the other, each flattened.

    on_error: the derivatives (2n + 3, 2n) of what was seen on the errors. curvature (2n, 2n), slope (2n,): what each
    says of the errors by itself.
    """

    on_error: FloatArray
    curvature: FloatArray
    slope: FloatArray


class Unknowns(NamedTuple):
    """Which unknown the x of a landmark (n,) or of a node (k + 1,) is, and a tag's error of range (n,); negative for
    what is none: the origin, and errors where tags have none."""

    landmark_at: IntArray
    node_at: IntArray
    error_at: IntArray


class InCells(NamedTuple):
    """How the information on u unknowns is kept, in the blocks of c cells.

    cell: (u,) of each unknown. first, size: (c,) first unknown and number of unknowns of a cell. block_at: (c, c) where
    the block of two cells begins, the lower number first, row by row.
    """

    cell: IntArray
    first: IntArray
    size: IntArray
    block_at: IntArray


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
def _seen(
    k: int, keyframes: Keyframes, X_MN: FloatArray, p_ML: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Of keyframe k: the rows (n,) of its landmarks, its information (2n + 3, 2n + 3), its error (2n + 3,) and the
    Jacobian of that (2n + 3, 3) on A."""
    some = slice(keyframes.offsets[k], keyframes.offsets[k + 1])
    rows = keyframes.rows[some]
    error, on_A = _residual(rows, keyframes.p_AL[some], keyframes.X_AD[k], X_MN[k], X_MN[k + 1], p_ML)
    W = keyframes.information[keyframes.starts[k] : keyframes.starts[k + 1]].reshape(len(error), len(error))
    return rows, W, error, on_A


@njit(cache=True)
def _of_keyframe(k: int, rows: IntArray, unknowns: Unknowns) -> IntArray:
    """The unknowns (2n + 6,) of keyframe k: those of its landmarks, in rows (n,), then D's and A's; negative where one
    has none."""
    n = len(rows)
    at = np.empty(2 * n + 6, dtype=np.int64)
    for i in range(n):
        at[2 * i] = unknowns.landmark_at[rows[i]]
        at[2 * i + 1] = at[2 * i] + 1
    A, D = unknowns.node_at[k], unknowns.node_at[k + 1]
    for i in range(3):
        at[2 * n + i] = D + i
        at[2 * n + 3 + i] = A + i if A >= 0 else -1
    return at


@njit(cache=True)
def batch_error(keyframes: Keyframes, X_MN: FloatArray, p_ML: FloatArray) -> float:
    """The weighted squared error of k keyframes."""
    total = 0.0
    for k in range(len(keyframes.X_AD)):
        _rows, W, error, _on_A = _seen(k, keyframes, X_MN, p_ML)
        total += float(error @ (W @ error))
    return total


@njit(cache=True)
def assemble(
    which: IntArray,
    keyframes: Keyframes,
    X_MN: FloatArray,
    p_ML: FloatArray,
    unknowns: Unknowns,
    cells: InCells,
    blocks: FloatArray,
    gradient: FloatArray,
) -> tuple[float, FloatArray]:
    """Add the Hessians and gradients of some of k keyframes, which (q,), to a system in cells.

    Returns the weighted squared error, and (q, 6, 6) the Hessians' blocks of each keyframe's two poses, D first.
    """
    total, poses, cell = 0.0, np.empty((len(which), 6, 6)), cells.cell
    for q in range(len(which)):
        k = which[q]
        some = slice(keyframes.offsets[k], keyframes.offsets[k + 1])
        rows = keyframes.rows[some]
        m = 2 * len(rows) + 3
        W = keyframes.information[keyframes.starts[k] : keyframes.starts[k + 1]].reshape(m, m)
        H, g, error = linearised(rows, keyframes.p_AL[some], keyframes.X_AD[k], W, X_MN[k], X_MN[k + 1], p_ML)
        total += error
        poses[q] = H[m - 3 :, m - 3 :]
        at = _of_keyframe(k, rows, unknowns)
        for i in range(m + 3):
            if at[i] < 0:
                continue
            gradient[at[i]] += g[i]
            for j in range(m + 3):
                if at[j] >= 0 and cell[at[i]] <= cell[at[j]]:
                    _add_to_cells(blocks, cells, at[i], at[j], H[i, j])
    return total, poses


@njit(cache=True)
def assemble_tag_errors(
    which: IntArray,
    keyframes: Keyframes,
    on_errors: OnErrors,
    X_MN: FloatArray,
    p_ML: FloatArray,
    errors: FloatArray,
    unknowns: Unknowns,
    cells: InCells,
    blocks: FloatArray,
    gradient: FloatArray,
) -> None:
    """Add to a system in cells what some of k keyframes, which (q,), say of the error of each tag, and with it of all
    else. errors: (n, 2) as p_AL and X_AD of the keyframes have them."""
    offsets, slope, error_at, cell = keyframes.offsets, on_errors.slope, unknowns.error_at, cells.cell
    begin, begin_own = np.zeros(len(offsets), dtype=np.int64), np.zeros(len(offsets), dtype=np.int64)
    for k in range(len(offsets) - 1):
        n = offsets[k + 1] - offsets[k]
        begin[k + 1], begin_own[k + 1] = begin[k] + (2 * n + 3) * 2 * n, begin_own[k] + 4 * n * n
    for k in which:
        if offsets[k] == offsets[k + 1]:
            continue
        tags, W, error, on_A = _seen(k, keyframes, X_MN, p_ML)
        n, m = len(tags), len(error)
        on = on_errors.on_error[begin[k] : begin[k + 1]].reshape(m, 2 * n)
        told = on_errors.curvature[begin_own[k] : begin_own[k + 1]].reshape(2 * n, 2 * n)
        weighted = W @ on
        back, own, pull = _pulled_back(on_A, weighted, X_MN[k, 2]), told + on.T @ weighted, weighted.T @ error
        pull -= slope[2 * offsets[k] : 2 * offsets[k + 1]] + told @ np.ascontiguousarray(errors[tags]).ravel()
        at = _of_keyframe(k, tags, unknowns)
        for j in range(2 * n):
            q = error_at[tags[j // 2]] + j % 2
            gradient[q] -= pull[j]
            for i in range(2 * n):
                other = error_at[tags[i // 2]] + i % 2
                if cell[q] <= cell[other]:
                    _add_to_cells(blocks, cells, q, other, own[j, i])
            for i in range(m + 3):
                if at[i] < 0:
                    continue
                if cell[at[i]] <= cell[q]:
                    _add_to_cells(blocks, cells, at[i], q, -back[i, j])
                if cell[q] <= cell[at[i]]:
                    _add_to_cells(blocks, cells, q, at[i], -back[i, j])


@njit(cache=True)
def batch_gradient(
    keyframes: Keyframes,
    on_errors: OnErrors,
    X_MN: FloatArray,
    p_ML: FloatArray,
    errors: FloatArray,
    unknowns: Unknowns,
    gradient: FloatArray,
) -> float:
    """Add the gradient of half the weighted squared error of k keyframes, and return that error. errors: as of
    `assemble_tag_errors`."""
    offsets, error_at = keyframes.offsets, unknowns.error_at
    total, begin, begin_own = 0.0, 0, 0
    for k in range(len(keyframes.X_AD)):
        tags, W, error, on_A = _seen(k, keyframes, X_MN, p_ML)
        n, m = len(tags), len(error)
        weighted = W @ error
        total += float(error @ weighted)
        back, at = _pulled_back(on_A, weighted.reshape(m, 1), X_MN[k, 2]), _of_keyframe(k, tags, unknowns)
        for i in range(m + 3):
            if at[i] >= 0:
                gradient[at[i]] += back[i, 0]
        if n > 0 and error_at[tags[0]] >= 0:
            on = on_errors.on_error[begin : begin + m * 2 * n].reshape(m, 2 * n)
            told = on_errors.curvature[begin_own : begin_own + 4 * n * n].reshape(2 * n, 2 * n)
            pull = on.T @ weighted - told @ np.ascontiguousarray(errors[tags]).ravel()
            for i in range(n):
                for f in range(2):
                    gradient[error_at[tags[i]] + f] -= pull[2 * i + f] - on_errors.slope[2 * (offsets[k] + i) + f]
        begin, begin_own = begin + m * 2 * n, begin_own + 4 * n * n
    return total


@njit(cache=True)
def tag_pulls(
    keyframes: Keyframes, on_errors: OnErrors, X_MN: FloatArray, p_ML: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How hard k keyframes pull at the errors (n, 2) of each tag where these are zero, and the variance (n, 2) of that
    where only noise does.

    Of two keyframes that see a tag from the same side the place of the tag takes all; poses are taken to be known.
    """
    pull, variance = np.zeros_like(p_ML), np.zeros_like(p_ML)
    total, by_place, begin, begin_own = np.zeros((len(p_ML), 2, 2)), np.zeros((len(p_ML), 2, 2)), 0, 0
    for k in range(len(keyframes.X_AD)):
        tags, W, error, _on_A = _seen(k, keyframes, X_MN, p_ML)
        n, weighted = len(tags), W @ error
        for i in range(n):
            row, x, y = tags[i], 2 * i, 2 * i + 1
            c, s = math.cos(X_MN[k, 2]), math.sin(X_MN[k, 2])
            R = np.array([[c, -s], [s, c]])
            own = R @ np.ascontiguousarray(W[x : y + 1, x : y + 1]) @ R.T
            total[row] += own
            on = np.empty((2, 2))
            for f in range(2):
                on[0, f] = on_errors.on_error[begin + 2 * n * x + x + f]
                on[1, f] = on_errors.on_error[begin + 2 * n * y + x + f]
            on = R @ on
            by_place[row] += own @ on
            for f in range(2):
                pull[row, f] += on_errors.slope[2 * keyframes.offsets[k] + x + f]
                pull[row, f] -= (R.T @ on)[0, f] * weighted[x] + (R.T @ on)[1, f] * weighted[y]
                variance[row, f] += on_errors.curvature[begin_own + (2 * n + 1) * (x + f)] + (on.T @ own @ on)[f, f]
        begin, begin_own = begin + len(error) * 2 * n, begin_own + 4 * n * n
    for row in range(len(p_ML)):
        taken = by_place[row].T @ np.linalg.solve(total[row], by_place[row])
        for f in range(2):
            variance[row, f] = max(variance[row, f] - taken[f, f], 0.0)
    return pull, variance


@njit(cache=True)
def _add_to_cells(blocks: FloatArray, cells: InCells, i: int, j: int, value: float) -> None:
    """Add a value to an entry of the system, whose row is of no later cell than its column."""
    row, column = cells.cell[i], cells.cell[j]
    place = (i - cells.first[row]) * cells.size[column] + j - cells.first[column]
    blocks[cells.block_at[row, column] + place] += value


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
    on_1: FloatArray,
    curvature_1: FloatArray,
    slope_1: FloatArray,
    rows_2: IntArray,
    p_2: FloatArray,
    X_2: FloatArray,
    information_2: FloatArray,
    on_2: FloatArray,
    curvature_2: FloatArray,
    slope_2: FloatArray,
    p_AL: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, float]:
    """Two keyframes, from A to B and from B to D, as one from A to D, with B marginalised out.

    rows_1, rows_2: of their landmarks among those of both (n, 2), p_AL: where these are about, in A, m. on_1, on_2:
    (2m + 3, 1 + 2m) derivative of what either saw of its m landmarks on the camera's yaw and on each tag's errors.
    curvature_1, curvature_2: (1 + 2m, 1 + 2m), slope_1, slope_2: (1 + 2m,) of half either's weighted squared error over
    these: what it says of them alone.

    Returns p_AL (n, 2), X_AB (3,), X_AD (3,), the information (2n + 3, 2n + 3) of (p_AL, X_AD), their derivative (2n +
    3, 1 + 2n) on yaw and errors, curvature (1 + 2n, 1 + 2n) and slope (1 + 2n,) of what both say of these, and the
    standard deviation of B's position, m.
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
    by_1, more, pull = _by_what_was_seen(rows_1, p_1, X_1, information_1, on_1, A, B, p_AL)
    curvature: FloatArray = np.zeros((1 + 2 * n, 1 + 2 * n))
    force, slope = np.zeros((size, 1 + 2 * n)), np.zeros(1 + 2 * n)
    _scatter_columns(force, at_1, rows_1, by_1)
    _scatter_own(curvature, slope, rows_1, curvature_1 + more, slope_1 + pull)
    by_2, more, pull = _by_what_was_seen(rows_2, p_2, X_2, information_2, on_2, B, D, p_AL)
    _scatter_columns(force, at_2, rows_2, by_2)
    _scatter_own(curvature, slope, rows_2, curvature_2 + more, slope_2 + pull)
    change = np.linalg.solve(H, force)
    on = np.empty((2 * n + 3, 1 + 2 * n))
    on[:] = change[: 2 * n + 3]
    curvature -= force.T @ change
    m = 2 * n + 3
    across = np.ascontiguousarray(H[:m, m:])
    information = H[:m, :m] - across @ np.linalg.solve(np.ascontiguousarray(H[m:, m:]), np.ascontiguousarray(across.T))
    D[2] = wrap(D[2])
    covariance = np.linalg.inv(H)
    deviation = math.sqrt(covariance[m, m] + covariance[m + 1, m + 1])
    curvature = np.asarray(0.5 * (curvature + curvature.T))
    return p_AL, B, D, 0.5 * (information + information.T), on, curvature, slope, deviation


@njit(cache=True)
def _by_what_was_seen(
    rows: IntArray,
    p_AL: FloatArray,
    X_AD: FloatArray,
    information: FloatArray,
    on: FloatArray,
    A: FloatArray,
    D: FloatArray,
    p_ML: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What pulls at landmarks, D and A, (2n + 6, q), where what was seen changes by its derivative on (2n + 3, q); and
    curvature (q, q) and slope (q,) of half the weighted squared error over those q."""
    error, on_A = _residual(rows, p_AL, X_AD, A, D, p_ML)
    weighted = information @ on
    return _pulled_back(on_A, weighted, A[2]), on.T @ weighted, -(weighted.T @ error)


@njit(cache=True)
def _pulled_back(on_A: FloatArray, weighted: FloatArray, heading: float) -> FloatArray:
    """J^T weighted (2n + 6, q), where J is the Jacobian of a keyframe's error on landmarks, D and A."""
    m, q = weighted.shape
    c, s = math.cos(heading), math.sin(heading)
    back = np.empty((m + 3, q))
    for j in range(q):
        for i in range(0, m - 1, 2):
            _turned(back, i, j, weighted[i, j], weighted[i + 1, j], c, s)
        back[m - 1, j] = weighted[m - 1, j]
    back[m:] = on_A.T @ weighted
    return back


@njit(cache=True)
def _scatter(H: FloatArray, g: FloatArray, at: IntArray, H_k: FloatArray, g_k: FloatArray) -> None:
    for i in range(len(at)):
        if at[i] >= 0:
            g[at[i]] += g_k[i]
            for j in range(len(at)):
                if at[j] >= 0:
                    H[at[i], at[j]] += H_k[i, j]


@njit(cache=True)
def _scatter_columns(force: FloatArray, at: IntArray, rows: IntArray, by: FloatArray) -> None:
    for i in range(len(at)):
        if at[i] >= 0:
            force[at[i], 0] += by[i, 0]
            for j in range(len(rows)):
                force[at[i], 1 + 2 * rows[j]] += by[i, 1 + 2 * j]
                force[at[i], 2 + 2 * rows[j]] += by[i, 2 + 2 * j]


@njit(cache=True)
def _scatter_own(curvature: FloatArray, slope: FloatArray, rows: IntArray, more: FloatArray, pull: FloatArray) -> None:
    for i in range(len(pull)):
        at_i = 2 * rows[(i - 1) // 2] + 2 - i % 2 if i > 0 else 0
        slope[at_i] += pull[i]
        for j in range(len(pull)):
            at_j = 2 * rows[(j - 1) // 2] + 2 - j % 2 if j > 0 else 0
            curvature[at_i, at_j] += more[i, j]
