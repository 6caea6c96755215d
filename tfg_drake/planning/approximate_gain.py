"""Kernels of the published approximations to the information gain, to be compared with the exact one.

In the notation of the paper's Sec. IV: A = G^T G, H = G^T K and B = K^T K are the blocks of the measurements'
information, of old (o) and new (u) landmarks, Sigma_o the marginal covariance of the known landmarks in view, and Pi
the information about the arrival pose that is there before the turn. With C = I + G Sigma_o G^T,

    |I + Sigma_o A_o - Sigma_o H_o (B_o + Pi)^-1 H_o^T| = |C| |Pi + K_o^T C^-1 K_o| / |Pi + B_o|
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray
from tfg_drake.planning.exact_gain import Arrival, Known, New, known_terms, new_terms, solved_by_cholesky, to_arrival

# The authors' program: weight of one landmark against the others, 1/m^2, the least landmarks in view that count, and
# nats of an expected landmark at their constants.
AUTHORS_WEIGHT = 10.0
AUTHORS_LEAST = 3
AUTHORS_NATS = 5.0 * math.log(100.0)


@njit(cache=True)
def limit_gain(points: FloatArray, arrival: Arrival, known: Known, new: New, noise: FloatArray) -> FloatArray:
    """What Theorem 1 of the paper tends to as the prior of new landmarks grows; arguments and result of exact_gain.

        1/2 log|I + Sigma_o A_o - Sigma_o H_o Bo'^-1 H_o^T| + 1/2 n_x log|I + sigma_u a_u|
            - 1/2 log(|Bo' + B_u| / |Bo'|)

    with Bo' = B_o + Pi, Pi the information about the pose given the landmarks: the paper's equation with the factor of
    one half, the Sigma_o lost in its proof, and the price of localising by tags that are new themselves. The arrival
    pose is taken to be independent of the landmarks.
    """
    out = np.zeros((len(points), 3))
    eye3, F = np.eye(3), to_arrival(arrival.X_MD, points)
    for c in range(len(points)):
        x, y = points[c, 0], points[c, 1]
        S = F[c] @ arrival.departure_given_map @ F[c].T + arrival.odometry[c]  # Pi^-1
        rows, _, K, C = known_terms(x, y, c, known, noise)
        log_map = 0.0
        B_known = np.zeros((3, 3))
        B_given_map = np.zeros((3, 3))
        if len(rows) > 0:
            B_known = K.T.copy() @ K
            log_map = solved_by_cholesky(C, K)
            B_given_map = K.T.copy() @ K
        log_new, B_new, _ = new_terms(x, y, c, new, noise)
        price_known = math.log(np.linalg.det(eye3 + S @ B_known))
        out[c, 0] = 0.5 * (log_map + math.log(np.linalg.det(eye3 + S @ B_given_map)) - price_known)
        out[c, 1] = 0.5 * (log_new - math.log(np.linalg.det(eye3 + S @ (B_known + B_new))) + price_known)
        out[c, 2] = 0.5 * (log_map + log_new) - out[c, 0] - out[c, 1]
    return out


@njit(cache=True)
def paper_gain(points: FloatArray, known: Known, new: New, noise: FloatArray) -> FloatArray:
    """Theorem 1 as printed (the paper's last equation of Sec. IV-C); arguments and result of exact_gain.

        log|I + Sigma_o A_o - Sigma_o H_o B^-1 H_o^T| + n_x log|I + sigma_u a_u|,   B = B_o + B_u

    without the factor of one half and without a prior of the pose. Only the second Sigma_o is added: without it the
    determinant is negative more often than not. Where B is singular, with fewer than two tags in view, nothing.
    """
    out = np.zeros((len(points), 3))
    for c in range(len(points)):
        x, y = points[c, 0], points[c, 1]
        expected = new.rows[new.offsets[c] : new.offsets[c + 1]]
        log_new, B_new, _ = new_terms(x, y, c, new, noise)
        rows, _, K, C = known_terms(x, y, c, known, noise)
        B = B_new.copy()
        if len(rows) > 0:
            B += K.T.copy() @ K
        if len(rows) + np.count_nonzero(new.number[expected]) < 2 or np.linalg.det(B) <= 0.0:
            continue
        log_map = 0.0
        B_given_map = B_new
        if len(rows) > 0:
            log_map = solved_by_cholesky(C, K)
            B_given_map = B_new + K.T.copy() @ K
        out[c, 0] = log_map + math.log(np.linalg.det(B_given_map)) - math.log(np.linalg.det(B))
        out[c, 1] = log_new
        out[c, 2] = log_map - out[c, 0]
    return out


@njit(cache=True)
def authors_gain(points: FloatArray, known: Known, new: New, normal: FloatArray) -> FloatArray:
    """The gain of the authors' C++ program, for point landmarks; shared arguments and result of exact_gain.

        log|I + Sigma_o A|,   A = w (I - 1 1^T / m),   and   5 density log 100 times the angle of frontier in view, rad

    It knows neither range nor bearing: every landmark is as good, and only a common shift of all brings nothing.
    Places that see fewer than three known landmarks are not considered. normal: (u, 2) of the frontier at new.p_MU.
    """
    out = np.zeros((len(points), 3))
    for c in range(len(points)):
        x, y = points[c, 0], points[c, 1]
        rows = known.rows[known.offsets[c] : known.offsets[c + 1]]
        m = len(rows)
        if m < AUTHORS_LEAST:
            continue
        C = np.eye(2 * m)
        for i in range(m):
            for j in range(m):
                a, b = 2 * rows[i], 2 * rows[j]
                C[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] += AUTHORS_WEIGHT * known.covariance[a : a + 2, b : b + 2]
        shift = np.zeros((2 * m, 2))
        shift[0::2, 0] = shift[1::2, 1] = 1.0 / math.sqrt(m)
        log_map = solved_by_cholesky(C, shift)
        out[c, 0] = log_map + math.log(np.linalg.det(shift.T.copy() @ shift))
        angle = 0.0
        for u in new.rows[new.offsets[c] : new.offsets[c + 1]]:
            dx, dy = x - new.p_MU[u, 0], y - new.p_MU[u, 1]
            angle += new.number[u] * max(0.0, dx * normal[u, 0] + dy * normal[u, 1]) / (dx * dx + dy * dy)
        out[c, 1] = AUTHORS_NATS * angle
        out[c, 2] = log_map - out[c, 0]
    return out
