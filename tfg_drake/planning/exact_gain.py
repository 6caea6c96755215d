"""Kernels of the exact information gain: mutual information of landmarks and a turn's measurements.

    I(L; z) = 1/2 log|I + J S J^T| - 1/2 log|I + K S_x|L K^T|,   J = [G K]

with G and K the whitened Jacobians of the tags' ranges and bearings and of the distances of walls' points by landmarks
and arrival pose x, S the joint covariance of both and S_x|L the covariance of the pose given all landmarks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tfg_drake.geometry.segment_grid import rows_in_box, segment_grid
from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.measurement import whitened_tag


class Known(NamedTuple):
    """The known landmarks and which of them c candidates see.

    Candidate i sees rows[offsets[i]:offsets[i + 1]] of the points p_MT (t, 2), m in M, whose landmarks have the places
    entry (t,) in the covariance (2n + 3, 2n + 3) of the landmarks, row by row, and of the departure pose. by_landmark,
    normal: as of `expected_view.Targets`; of a wall's point the distance along the normal is all that is measured.
    """

    offsets: IntArray
    rows: IntArray
    p_MT: FloatArray
    entry: IntArray
    by_landmark: FloatArray
    normal: FloatArray
    covariance: FloatArray


class New(NamedTuple):
    """The new landmarks that c candidates are expected to see.

    Candidate i sees as many as number (u,) says, a fraction allowed, at each of rows[offsets[i]:offsets[i + 1]] of p_MU
    (u, 2), m in M. Their priors are independent, of deviation prior_sigma, m. reach: (sensor range, depth), m: one
    counts in proportion to how far the view goes on behind its frontier point, in full from depth on.
    """

    offsets: IntArray
    rows: IntArray
    p_MU: FloatArray
    number: FloatArray
    prior_sigma: float
    reach: FloatArray


class Arrival(NamedTuple):
    """How c candidates are arrived at: the departure pose X_MD (3,), its covariance given all landmarks (3, 3), and
    what odometry adds on the way to each, (c, 3, 3), of (x, y) in M and theta."""

    X_MD: FloatArray
    departure_given_map: FloatArray
    odometry: FloatArray


@njit(cache=True)
def whitened(d: FloatArray, noise: FloatArray) -> FloatArray:
    """As `whitened_tag`, (k, 2, 2), of landmarks at d (k, 2), m, from the robot."""
    G = np.empty((len(d), 2, 2))
    for k in range(len(d)):
        G[k, 0, 0], G[k, 0, 1], G[k, 1, 0], G[k, 1, 1] = whitened_tag(d[k, 0], d[k, 1], noise)
    return G


def share_seen(distance: FloatArray | float, reach: FloatArray) -> FloatArray:
    """How much of what a frontier point stands for is seen from a distance (m): the depth of view left behind it.

    distance: (n,) or a number, m. reach: as in New.
    """
    return np.minimum(1.0, np.maximum(0.0, (reach[0] - distance) / reach[1]))  # type: ignore[no-any-return]


_share_seen = njit(cache=True)(share_seen)  # for kernels


@njit(cache=True)
def known_terms(
    x: float, y: float, c: int, known: Known, noise: FloatArray
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """The k measurements of the known landmarks that candidate c sees from (x, y): the first column (k,) of each one's
    landmark in the covariance, the whitened Jacobians G (k, 2) by it and K (k, 3) by the pose, and C (k, k) = I + G
    S_LL G^T. noise: as in whitened_tag."""
    rows = known.rows[known.offsets[c] : known.offsets[c + 1]]
    covariance, most = known.covariance, 2 * len(rows)
    column, G, K, k = np.empty(most, dtype=np.int64), np.empty((most, 2)), np.zeros((most, 3)), 0
    for row in rows:
        dx, dy = known.p_MT[row, 0] - x, known.p_MT[row, 1] - y
        n_x, n_y, on = known.normal[row, 0], known.normal[row, 1], known.by_landmark[row]
        column[k] = 2 * known.entry[row]
        if n_x != 0.0 or n_y != 0.0:
            K[k, 0], K[k, 1], K[k, 2] = -n_x, -n_y, dy * n_x - dx * n_y
            G[k, 0], G[k, 1] = n_x * on[0, 0] + n_y * on[1, 0], n_x * on[0, 1] + n_y * on[1, 1]
            k += 1
        else:
            G[k, 0], G[k, 1], G[k + 1, 0], G[k + 1, 1] = whitened_tag(dx, dy, noise)
            K[k, :2], K[k + 1, :2], K[k + 1, 2] = -G[k], -G[k + 1], -1.0 / noise[3]
            column[k + 1], k = column[k], k + 2
    column, G, K = column[:k], G[:k], K[:k]
    C = np.empty((k, k))
    for i in range(k):
        a, b = column[i], -1
        for j in range(i + 1):
            if column[j] != b:
                b = column[j]
                t0 = G[i, 0] * covariance[a, b] + G[i, 1] * covariance[a + 1, b]
                t1 = G[i, 0] * covariance[a, b + 1] + G[i, 1] * covariance[a + 1, b + 1]
            C[i, j] = t0 * G[j, 0] + t1 * G[j, 1]
            C[j, i] = C[i, j]
        C[i, i] += 1.0
    return column, G, K, C


@njit(cache=True)
def new_terms(x: float, y: float, c: int, new: New, noise: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Of the new landmarks that candidate c sees from (x, y): log|D|, D = I + sigma_u^2 G G^T, the information K^T K
    (3, 3) that they give of the pose were they known, and K^T D^-1 K (3, 3). noise: as in whitened_tag.

    Each new landmark's measurement is on its own, tied to the others by the pose only.
    """
    log_new = 0.0
    B_new = np.zeros((3, 3))
    B_new_given_prior = np.zeros((3, 3))
    K = np.zeros((2, 3))
    K[1, 2] = -1.0 / noise[3]
    variance = new.prior_sigma * new.prior_sigma
    for u in new.rows[new.offsets[c] : new.offsets[c + 1]]:
        dx, dy = new.p_MU[u, 0] - x, new.p_MU[u, 1] - y
        count = new.number[u] * _share_seen(math.sqrt(dx * dx + dy * dy), new.reach)
        if count == 0.0:
            continue
        g00, g01, g10, g11 = whitened_tag(dx, dy, noise)
        # G G^T is diagonal: range and bearing vary along directions at right angles.
        d_range, d_bearing = 1.0 + variance * (g00 * g00 + g01 * g01), 1.0 + variance * (g10 * g10 + g11 * g11)
        log_new += count * (math.log(d_range) + math.log(d_bearing))
        K[0, 0], K[0, 1], K[1, 0], K[1, 1] = -g00, -g01, -g10, -g11
        for i in range(3):
            for j in range(3):
                of_range, of_bearing = count * K[0, i] * K[0, j], count * K[1, i] * K[1, j]
                B_new[i, j] += of_range + of_bearing
                B_new_given_prior[i, j] += of_range / d_range + of_bearing / d_bearing
    return log_new, B_new, B_new_given_prior


@njit(cache=True)
def solved_by_cholesky(C: FloatArray, W: FloatArray) -> float:
    """log|C| of a covariance C (k, k) = L L^T; W (k, w) becomes L^-1 W in place."""
    L = np.linalg.cholesky(C)
    log_C = 0.0
    for i in range(len(C)):
        for j in range(i):
            for k in range(W.shape[1]):
                W[i, k] -= L[i, j] * W[j, k]
        for k in range(W.shape[1]):
            W[i, k] /= L[i, i]
        log_C += 2.0 * math.log(L[i, i])
    return log_C


def to_arrival(X_MD: FloatArray, points: FloatArray) -> FloatArray:
    """F (c, 3, 3): what an error of the departure pose X_MD, (x, y) in M and theta, makes at an arrival at each point
    (c, 2), m in M."""
    F = np.tile(np.eye(3), (len(points), 1, 1))
    F[:, 0, 2], F[:, 1, 2] = X_MD[1] - points[:, 1], points[:, 0] - X_MD[0]
    return F


def arrival_covariance(F: FloatArray, arrival: Arrival, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Covariance (c, 3, 3) of the arrival pose, and what it is given all landmarks; covariance: as in Known."""
    F_T = F.transpose(0, 2, 1)
    of_arrival = F @ covariance[-3:, -3:] @ F_T + arrival.odometry
    return of_arrival, F @ arrival.departure_given_map @ F_T + arrival.odometry


def terms(
    points: FloatArray, F: FloatArray, known: Known, new: New, noise: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of each candidate: log|C| and log|D| (c, 2); T (c, 6, 6) = W^T C^-1 W, W = [G S_Lx, K], by known landmarks; and
    (c, 3, 3, 3) K^T K by known, K^T K and K^T D^-1 K by new ones. F: (c, 3, 3). C, G, K, D: `known_terms`, `new_terms`.
    """
    return _terms(points, F, *known, *new, noise)


@njit(cache=True)
def _terms(
    points: FloatArray,
    F: FloatArray,
    known_offsets: IntArray,
    known_rows: IntArray,
    p_MT: FloatArray,
    entry: IntArray,
    by_landmark: FloatArray,
    normal: FloatArray,
    covariance: FloatArray,
    new_offsets: IntArray,
    new_rows: IntArray,
    p_MU: FloatArray,
    number: FloatArray,
    prior_sigma: float,
    reach: FloatArray,
    noise: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """As terms. Known and New are passed field by field: numba dispatches on arrays many times quicker than on named
    tuples."""
    known = Known(known_offsets, known_rows, p_MT, entry, by_landmark, normal, covariance)
    new = New(new_offsets, new_rows, p_MU, number, prior_sigma, reach)
    logs, T, B = np.zeros((len(points), 2)), np.zeros((len(points), 6, 6)), np.zeros((len(points), 3, 3, 3))
    pose = len(covariance) - 3
    for c in range(len(points)):
        x, y = points[c, 0], points[c, 1]
        column, G, K, C = known_terms(x, y, c, known, noise)
        W = np.empty((len(column), 6))
        for i in range(len(column)):
            a = column[i]
            for k in range(3):
                W[i, k] = G[i, 0] * covariance[a, pose + k] + G[i, 1] * covariance[a + 1, pose + k]
        W[:, 0] += F[c, 0, 2] * W[:, 2]
        W[:, 1] += F[c, 1, 2] * W[:, 2]
        W[:, 3:] = K
        if len(column) > 0:
            B[c, 0] = K.T.copy() @ K
            logs[c, 0] = solved_by_cholesky(C, W)
            T[c] = W.T.copy() @ W
        logs[c, 1], B[c, 1], B[c, 2] = new_terms(x, y, c, new, noise)
    return logs, T, B


@njit(cache=True)
def _adjugate(S: FloatArray) -> tuple[float, float, float, float, float, float]:
    """The upper triangle, row by row, of the inverse of a symmetric S (3, 3) times its determinant."""
    xx, xy, xt, yy, yt, tt = S[0, 0], S[0, 1], S[0, 2], S[1, 1], S[1, 2], S[2, 2]
    return (
        yy * tt - yt * yt,
        xt * yt - xy * tt,
        xy * yt - xt * yy,
        xx * tt - xt * xt,
        xy * xt - xx * yt,
        xx * yy - xy * xy,
    )


@njit(cache=True)
def most_gain(
    points: FloatArray,
    S_xx: FloatArray,
    S_x_given_L: FloatArray,
    F: FloatArray,
    p_MT: FloatArray,
    facing: FloatArray,
    entry: IntArray,
    by_landmark: FloatArray,
    normal: FloatArray,
    covariance: FloatArray,
    range_max: float,
    max_incidence: float,
    new_offsets: IntArray,
    new_rows: IntArray,
    p_MU: FloatArray,
    number: FloatArray,
    prior_sigma: float,
    reach: FloatArray,
    noise: FloatArray,
) -> FloatArray:
    """The most that a turn at each point (c, 2), m in M, brings by known and by new landmarks, (c, 2), nats, whatever
    hides some of them: with z the measurements,

        I(L; z) <= I(L; x) + I(L; z | x),   I(L; z | x) <= the sum over all landmarks that could be in view.

    S_xx, S_x_given_L: (c, 3, 3) covariance of the arrival pose, also given all landmarks, F: (c, 3, 3), see
    `to_arrival`. p_MT to normal: as of `expected_view.Targets`. covariance: as in Known. What is farther away than
    range_max (m) or seen more aslant than max_incidence (rad) is not in view. The fields of New; noise: as in
    whitened_tag.
    """
    most, cos_max, pose = np.zeros((len(points), 2)), math.cos(max_incidence), len(covariance) - 3
    grid, near = segment_grid(np.hstack((p_MT, p_MT))), np.empty(len(p_MT), dtype=np.int64)
    variance = prior_sigma**2
    for c in range(len(points)):
        x, y = points[c, 0], points[c, 1]
        # The inverse of the arrival pose's covariance, but for its determinant.
        a, b, d, e, f, g = _adjugate(S_xx[c])
        det = S_xx[c, 0, 0] * a + S_xx[c, 0, 1] * b + S_xx[c, 0, 2] * d
        of_T = _adjugate(S_x_given_L[c])
        det_T = S_x_given_L[c, 0, 0] * of_T[0] + S_x_given_L[c, 0, 1] * of_T[1] + S_x_given_L[c, 0, 2] * of_T[2]
        if not (det > 0.0 and det_T > 0.0):
            most[c] = np.inf
            continue
        product = max(1.0, det / det_T)
        for k in range(rows_in_box(grid, x - range_max, x + range_max, y - range_max, y + range_max, near)):
            i = near[k]
            dx, dy = p_MT[i, 0] - x, p_MT[i, 1] - y
            r = math.sqrt(dx * dx + dy * dy)
            if entry[i] < 0 or r > range_max or -(dx * facing[i, 0] + dy * facing[i, 1]) < cos_max * r:
                continue
            # Its covariance given the arrival pose.
            p, q = 2 * entry[i], 2 * entry[i] + 1
            x0, x1, x2 = covariance[p, pose], covariance[p, pose + 1], covariance[p, pose + 2]
            y0, y1, y2 = covariance[q, pose], covariance[q, pose + 1], covariance[q, pose + 2]
            x0, x1, y0, y1 = x0 + F[c, 0, 2] * x2, x1 + F[c, 1, 2] * x2, y0 + F[c, 0, 2] * y2, y1 + F[c, 1, 2] * y2
            u0, u1, u2 = a * x0 + b * x1 + d * x2, b * x0 + e * x1 + f * x2, d * x0 + f * x1 + g * x2
            xx = covariance[p, p] - (u0 * x0 + u1 * x1 + u2 * x2) / det
            xy = covariance[p, q] - (u0 * y0 + u1 * y1 + u2 * y2) / det
            u0, u1, u2 = a * y0 + b * y1 + d * y2, b * y0 + e * y1 + f * y2, d * y0 + f * y1 + g * y2
            yy = covariance[q, q] - (u0 * y0 + u1 * y1 + u2 * y2) / det
            n_x, n_y, on = normal[i, 0], normal[i, 1], by_landmark[i]
            if n_x != 0.0 or n_y != 0.0:
                g0, g1 = n_x * on[0, 0] + n_y * on[1, 0], n_x * on[0, 1] + n_y * on[1, 1]
                product *= max(1.0, 1.0 + g0 * g0 * xx + 2.0 * g0 * g1 * xy + g1 * g1 * yy)
            else:
                g00, g01, g10, g11 = whitened_tag(dx, dy, noise)
                of_range = g00 * g00 * xx + 2.0 * g00 * g01 * xy + g01 * g01 * yy
                of_bearing = g10 * g10 * xx + 2.0 * g10 * g11 * xy + g11 * g11 * yy
                of_both = g00 * (g10 * xx + g11 * xy) + g01 * (g10 * xy + g11 * yy)
                product *= max(1.0, (1.0 + of_range) * (1.0 + of_bearing) - of_both**2)
            if product > 1e100:
                most[c, 0], product = most[c, 0] + 0.5 * math.log(product), 1.0
        most[c, 0] += 0.5 * math.log(product)
        for u in new_rows[new_offsets[c] : new_offsets[c + 1]]:
            dx, dy = p_MU[u, 0] - x, p_MU[u, 1] - y
            count = number[u] * _share_seen(math.sqrt(dx * dx + dy * dy), reach)
            g00, g01, g10, g11 = whitened_tag(dx, dy, noise)
            d_range, d_bearing = 1.0 + variance * (g00 * g00 + g01 * g01), 1.0 + variance * (g10 * g10 + g11 * g11)
            most[c, 1] += 0.5 * count * math.log(d_range * d_bearing)
    return most


def exact_gain(points: FloatArray, arrival: Arrival, known: Known, new: New, noise: FloatArray) -> FloatArray:
    """Exploitation, exploration and price of the pose, (c, 3), nats, of a turn at each point (c, 2), m in M.

    noise: as in whitened_tag. One factorisation serves the known and the unknown pose, as I + J S J^T = C + W M W^T
    with M = [[0, I], [I, S_xx]] by an error of the map and one of the pose.
    """
    F = to_arrival(arrival.X_MD, points)
    log, T, B = terms(points, F, known, new, noise)
    S_xx, S_x_given_L = arrival_covariance(F, arrival, known.covariance)
    N = np.concatenate([np.broadcast_to(np.eye(3), S_xx.shape), S_xx], axis=1)  # the last three columns of M
    inner = np.eye(6) + np.concatenate([T[:, :, 3:], T @ N], axis=2)  # I + T M
    S_x_given_z = S_xx - N.transpose(0, 2, 1) @ np.linalg.solve(inner, T @ N)

    log_known = log[:, 0] + log_det(inner)
    prices = np.stack([S_x_given_L @ B[:, 0], S_x_given_L @ (B[:, 0] + B[:, 1]), S_x_given_z @ B[:, 2]])
    price_known, price_all, log_localised = log_det(np.eye(3) + prices)
    exploitation = 0.5 * (log_known - price_known)
    exploration = 0.5 * (log[:, 1] + log_localised - price_all + price_known)
    return np.stack([exploitation, exploration, 0.5 * log.sum(axis=1) - exploitation - exploration], axis=1)


def log_det(A: FloatArray) -> FloatArray:
    """log|A|, (...), of matrices (..., k, k)."""
    return np.asarray(np.linalg.slogdet(A)[1])
