"""Kernels of the published approximations to the information gain, for comparison with the exact one.

In the notation of the paper's Sec. III-C: A = G^T G, H = G^T K and B = K^T K are the blocks of the measurements'
information, of old (o) and new (u) landmarks, Sigma_o the marginal covariance of the known landmarks in view, and Pi
the information about the arrival pose before the turn. With C = I + G Sigma_o G^T,

    |I + Sigma_o A_o - Sigma_o H_o (B_o + Pi)^-1 H_o^T| = |C| |Pi + K_o^T C^-1 K_o| / |Pi + B_o|
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.messages import FloatArray
from tfg_drake.planning.exact_gain import Arrival, Known, New, arrival_covariance, log_det, terms, to_arrival

# The authors' program (github.com/mubeipeng/ActiveSLAM, fdcb6bc, src/planner.cpp): weight of one landmark against the
# others, 1/m^2, the least number of landmarks in view, and nats per expected landmark.
AUTHORS_WEIGHT = 10.0
AUTHORS_LEAST = 3
AUTHORS_NATS = 5.0 * math.log(100.0)


def limit_gain(points: FloatArray, arrival: Arrival, known: Known, new: New, noise: FloatArray) -> FloatArray:
    """The limit of the paper's Theorem 1 as the prior of new landmarks grows; arguments and result of exact_gain.

        1/2 log|I + Sigma_o A_o - Sigma_o H_o Bo'^-1 H_o^T| + 1/2 n_x log|I + sigma_u a_u|
            - 1/2 log(|Bo' + B_u| / |Bo'|)

    with Bo' = B_o + Pi, Pi the information about the pose given the landmarks: the paper's equation with the factor of
    one half, the Sigma_o lost in its proof, and the price of localising by new tags. The arrival pose counts as
    independent of the landmarks.
    """
    F = to_arrival(arrival.X_MD, points)
    log, T, B = terms(points, F, known, new, noise)
    _, S = arrival_covariance(F, arrival, known.covariance)  # Pi^-1
    B_known, B_given_map = B[:, 0], T[:, 3:, 3:]
    price_given_map, price_known, price_all = log_det(
        np.eye(3) + np.stack([S @ B_given_map, S @ B_known, S @ (B_known + B[:, 1])])
    )
    exploitation = 0.5 * (log[:, 0] + price_given_map - price_known)
    exploration = 0.5 * (log[:, 1] - price_all + price_known)
    return np.stack([exploitation, exploration, 0.5 * log.sum(axis=1) - exploitation - exploration], axis=1)


def paper_gain(points: FloatArray, known: Known, new: New, noise: FloatArray) -> FloatArray:
    """Theorem 1 as printed (the paper's last equation of Sec. III-C); arguments and result of exact_gain.

        log|I + Sigma_o A_o - Sigma_o H_o B^-1 H_o^T| + n_x log|I + sigma_u a_u|,   B = B_o + B_u

    without the factor of one half and without a prior of the pose. Only the second Sigma_o is added: without it the
    determinant is negative more often than not. Where B is singular, with fewer than two tags in view, nothing.
    """
    log, T, B = terms(points, np.tile(np.eye(3), (len(points), 1, 1)), known, new, noise)
    expected = np.append(0, np.cumsum(new.number[new.rows] > 0.0))[new.offsets]
    seen = np.diff(known.offsets) + np.diff(expected) >= 2
    seen &= np.linalg.det(B[:, 0] + B[:, 1]) > 0.0
    log, B_given_map, B_all = log[seen], T[seen, 3:, 3:] + B[seen, 1], B[seen, 0] + B[seen, 1]
    exploitation, out = log[:, 0] + log_det(B_given_map) - log_det(B_all), np.zeros((len(points), 3))
    out[seen] = np.stack([exploitation, log[:, 1], log[:, 0] - exploitation], axis=1)
    return out


def authors_gain(points: FloatArray, known: Known, new: New, normal: FloatArray) -> FloatArray:
    """The gain of the authors' C++ program, `Planner::generateNextGoal`; shared arguments and result of exact_gain.

        log|I + Sigma_o A|,   A = w (I - 1 1^T / m),   and   5 density log 100 times the angle of frontier in view, rad

    It ignores range and bearing: every landmark counts alike, and only a common shift of all adds nothing. Places that
    see fewer than three known landmarks are not considered. The original has a heading in each landmark, and takes as
    frontier the angle between unconnected landmarks with consecutive bearings. normal: (u, 2) of the frontier at
    new.p_MU.
    """
    out = np.zeros((len(points), 3))
    for c, point in enumerate(points):
        rows = known.entry[known.rows[known.offsets[c] : known.offsets[c + 1]]]
        m = len(rows)
        if m < AUTHORS_LEAST:
            continue
        axes = np.stack([2 * rows, 2 * rows + 1], axis=1).ravel()
        C = np.eye(2 * m) + AUTHORS_WEIGHT * known.covariance[np.ix_(axes, axes)]
        shift = np.tile(np.eye(2), (m, 1)) / math.sqrt(m)
        log_map = float(log_det(C))
        out[c, 0] = log_map + float(log_det(shift.T @ np.linalg.solve(C, shift)))
        u = new.rows[new.offsets[c] : new.offsets[c + 1]]
        d = point - new.p_MU[u]
        ahead = np.maximum(0.0, (d * normal[u]).sum(axis=1))
        out[c, 1] = AUTHORS_NATS * float((new.number[u] * ahead / (d * d).sum(axis=1)).sum())
        out[c, 2] = log_map - out[c, 0]
    return out
