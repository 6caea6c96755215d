"""Kernels of the exact information gain: mutual information of landmarks and a turn's measurements.

    I(L; z) = 1/2 log|I + J S J^T| - 1/2 log|I + K S_x|L K^T|,   J = [G K]

with G and K the whitened Jacobians of ranges and bearings by landmarks and arrival pose x, S the joint covariance of
both and S_x|L the covariance of the pose given all landmarks.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray, IntArray


@njit(cache=True)
def _whitened(dx: float, dy: float, noise: FloatArray) -> FloatArray:
    """Jacobian (2, 2) of range and bearing by the landmark at (dx, dy) from the robot, over their deviations.

    noise: (base range noise, range noise per metre, range floor, bearing deviation), for the whole turn.
    """
    r = max(math.sqrt(dx * dx + dy * dy), 0.05)
    sigma_range = max(noise[0] + noise[1] * r, noise[2])
    G = np.empty((2, 2))
    G[0, 0], G[0, 1] = dx / r / sigma_range, dy / r / sigma_range
    G[1, 0], G[1, 1] = -dy / (r * r) / noise[3], dx / (r * r) / noise[3]
    return G


@njit(cache=True)
def share_seen(distance: FloatArray | float, reach: FloatArray) -> FloatArray:
    """How much of what a frontier point stands for is seen from a distance (m): the depth of view left behind it.

    distance: (n,) or a number, m. reach: (sensor range, depth), m, as in exact_gain.
    """
    return np.minimum(1.0, np.maximum(0.0, (reach[0] - distance) / reach[1]))  # type: ignore[no-any-return]


@njit(cache=True)
def known_terms(
    x: float, y: float, rows: IntArray, p_ML: FloatArray, covariance: FloatArray, noise: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of the known landmarks seen from (x, y), rows (m,) of p_ML (n, 2): the whitened Jacobians G (m, 2, 2) by each and
    K (2m, 3) by the pose, and C (2m, 2m) = I + G S_LL G^T. Other arguments as in exact_gain."""
    m = len(rows)
    G = np.empty((m, 2, 2))
    K = np.zeros((2 * m, 3))
    C = np.empty((2 * m, 2 * m))
    for i in range(m):
        a = 2 * rows[i]
        G[i] = _whitened(p_ML[rows[i], 0] - x, p_ML[rows[i], 1] - y, noise)
        K[2 * i : 2 * i + 2, :2] = -G[i]
        K[2 * i + 1, 2] = -1.0 / noise[3]
        for j in range(i + 1):
            b = 2 * rows[j]
            s00, s01 = covariance[a, b], covariance[a, b + 1]
            s10, s11 = covariance[a + 1, b], covariance[a + 1, b + 1]
            for q in range(2):
                t0 = G[i, q, 0] * s00 + G[i, q, 1] * s10
                t1 = G[i, q, 0] * s01 + G[i, q, 1] * s11
                C[2 * i + q, 2 * j] = t0 * G[j, 0, 0] + t1 * G[j, 0, 1]
                C[2 * i + q, 2 * j + 1] = t0 * G[j, 1, 0] + t1 * G[j, 1, 1]
    for i in range(2 * m):
        C[i, i] += 1.0
        for j in range(i):
            C[j, i] = C[i, j]
    return G, K, C


@njit(cache=True)
def new_terms(
    x: float,
    y: float,
    rows: IntArray,
    p_MU: FloatArray,
    new_count: FloatArray,
    prior_sigma: float,
    noise: FloatArray,
    reach: FloatArray,
) -> tuple[float, FloatArray, FloatArray]:
    """Of the new landmarks seen from (x, y), at rows (u,) of p_MU: log|D|, D = I + sigma_u^2 G G^T, the information
    K^T K (3, 3) that they give of the pose were they known, and K^T D^-1 K (3, 3). Arguments as in exact_gain.

    Each new landmark's measurement is on its own, tied to the others by the pose only.
    """
    log_new = 0.0
    B_new = np.zeros((3, 3))
    B_new_given_prior = np.zeros((3, 3))
    K = np.zeros((2, 3))
    K[1, 2] = -1.0 / noise[3]
    for u in rows:
        dx, dy = p_MU[u, 0] - x, p_MU[u, 1] - y
        count = new_count[u] * share_seen(math.sqrt(dx * dx + dy * dy), reach)
        if count == 0.0:
            continue
        G = _whitened(dx, dy, noise)
        # G G^T is diagonal: range and bearing vary along directions at right angles.
        d_range = 1.0 + prior_sigma * prior_sigma * (G[0, 0] * G[0, 0] + G[0, 1] * G[0, 1])
        d_bearing = 1.0 + prior_sigma * prior_sigma * (G[1, 0] * G[1, 0] + G[1, 1] * G[1, 1])
        log_new += count * (math.log(d_range) + math.log(d_bearing))
        K[:, :2] = -G
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


@njit(cache=True)
def to_arrival(X_MD: FloatArray, x: float, y: float) -> FloatArray:
    """F (3, 3): what an error of the departure pose X_MD, (x, y) in M and theta, makes at an arrival at (x, y)."""
    F = np.eye(3)
    F[0, 2], F[1, 2] = -(y - X_MD[1]), x - X_MD[0]
    return F


@njit(cache=True)
def exact_gain(
    points: FloatArray,
    odometry: FloatArray,
    known_offsets: IntArray,
    known: IntArray,
    new_offsets: IntArray,
    new: IntArray,
    p_ML: FloatArray,
    X_MD: FloatArray,
    covariance: FloatArray,
    departure_given_map: FloatArray,
    p_MU: FloatArray,
    new_count: FloatArray,
    prior_sigma: float,
    noise: FloatArray,
    reach: FloatArray,
) -> FloatArray:
    """Exploitation, exploration and price of the pose, (c, 3), nats, of a turn at each point (c, 2), m in M.

    The arrival pose is the departure pose X_MD composed with odometry of covariance odometry (c, 3, 3), in M.
    covariance: (2n + 3, 2n + 3) of landmarks p_ML (n, 2) and X_MD. departure_given_map: (3, 3), that of X_MD given
    all landmarks. Point i sees the rows known[known_offsets[i]:known_offsets[i + 1]] of p_ML and as many new landmarks
    as new_count (u,) says, a fraction allowed, at each of the rows new[new_offsets[i]:...] of p_MU (u, 2), whose
    priors are independent, of deviation prior_sigma (m). noise: as in _whitened. reach: (sensor range, depth), m: a
    new landmark counts in proportion to how far the view goes on behind its frontier point, in full from depth on.
    """
    out = np.zeros((len(points), 3))
    pose = 2 * len(p_ML)
    eye3 = np.eye(3)
    for c in range(len(points)):
        x, y = points[c, 0], points[c, 1]
        F = to_arrival(X_MD, x, y)
        S_xx = F @ covariance[pose:, pose:].copy() @ F.T + odometry[c]
        S_x_given_L = F @ departure_given_map @ F.T + odometry[c]

        rows = known[known_offsets[c] : known_offsets[c + 1]]
        G, K, C = known_terms(x, y, rows, p_ML, covariance, noise)
        W = np.empty((2 * len(rows), 6))  # [G S_Lx, K]
        for i in range(len(rows)):
            a = 2 * rows[i]
            for q in range(2):
                s = G[i, q, 0] * covariance[a, pose:] + G[i, q, 1] * covariance[a + 1, pose:]
                W[2 * i + q, 0] = s[0] + F[0, 2] * s[2]
                W[2 * i + q, 1] = s[1] + F[1, 2] * s[2]
                W[2 * i + q, 2] = s[2]
        W[:, 3:] = K

        # I + J S J^T = C + W M W^T: one factorisation serves the known and the unknown pose.
        log_map = 0.0
        T = np.zeros((6, 6))
        B_known = np.zeros((3, 3))
        if len(rows) > 0:
            B_known = K.T.copy() @ K
            log_map = solved_by_cholesky(C, W)
            T = W.T.copy() @ W
        M = np.zeros((6, 6))
        M[:3, 3:] = eye3
        M[3:, :3] = eye3
        M[3:, 3:] = S_xx
        inner = np.eye(6) + T @ M
        log_known = log_map + math.log(np.linalg.det(inner))
        N = np.zeros((6, 3))
        N[:3] = eye3
        N[3:] = S_xx
        S_x_given_z = S_xx - N.T.copy() @ np.linalg.solve(inner, T @ N)

        seen = new[new_offsets[c] : new_offsets[c + 1]]
        log_new, B_new, B_new_given_prior = new_terms(x, y, seen, p_MU, new_count, prior_sigma, noise, reach)
        price_known = math.log(np.linalg.det(eye3 + S_x_given_L @ B_known))
        price_all = math.log(np.linalg.det(eye3 + S_x_given_L @ (B_known + B_new)))
        log_localised = math.log(np.linalg.det(eye3 + S_x_given_z @ B_new_given_prior))
        out[c, 0] = 0.5 * (log_known - price_known)
        out[c, 1] = 0.5 * (log_new + log_localised - price_all + price_known)
        out[c, 2] = 0.5 * (log_map + log_new) - out[c, 0] - out[c, 1]
    return out
