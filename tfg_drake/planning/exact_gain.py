"""Kernels of the exact information gain: mutual information of landmarks and a turn's measurements.

    I(L; z) = 1/2 log|I + J S J^T| - 1/2 log|I + K S_x|L K^T|,   J = [G K]

with G and K the whitened Jacobians of the tags' ranges and bearings and of the distances of wall points with respect to
landmarks and arrival pose x, S the joint covariance of both and S_x|L the covariance of the pose given all landmarks.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.measurement import whitened_tag


class Known(NamedTuple):
    """The known landmarks and their visibility from c candidates.

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
    """The arrival at c candidates: the departure pose X_MD (3,), its covariance given all landmarks (3, 3), and the
    covariance that odometry adds on the way to each, (c, 3, 3), of (x, y) in M and theta."""

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
    """Return the share of a frontier point's landmarks seen from a distance (m), given by the depth of view behind it.

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


@njit(cache=True)
def terms(
    points: FloatArray, F: FloatArray, known: Known, new: New, noise: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of each candidate: log|C| and log|D| (c, 2); T (c, 6, 6) = W^T C^-1 W, W = [G S_Lx, K], by known landmarks; and
    (c, 3, 3, 3) K^T K by known, K^T K and K^T D^-1 K by new ones. F: (c, 3, 3). C, G, K, D: `known_terms`, `new_terms`.
    """
    covariance = known.covariance
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
