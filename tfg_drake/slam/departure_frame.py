"""The map as seen from the last departure pose D, where a robot knows it best.

Far from the map's origin, or before a loop closes, absolute positions may be metres off while neighbours agree to
centimetres. A filter linearised in M then takes the heading it shares with the whole map for something that its
sightings tell (the well-known inconsistency of EKF SLAM); in D those uncertainties are small and nothing is lost.
"""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, MapEstimate


def in_departure_frame(estimate: MapEstimate, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """p_DL (m, 2) of the landmarks in some rows (m,) of the estimate, and the covariance of (p_DL row by row, X_MD).

    That is (2m + 3, 2m + 3). The rows must be among estimate.local.
    """
    m = len(rows)
    entry = np.searchsorted(estimate.local, rows)
    X_MD = estimate.X_MD
    R_MD = se2.rotation(float(X_MD[2]))
    p_DL = (estimate.p_ML[rows] - X_MD[:2]) @ R_MD
    index = np.concatenate(
        [np.repeat(2 * entry, 2) + np.tile([0, 1], m), len(estimate.covariance) - np.array([3, 2, 1])]
    )
    P = estimate.covariance[np.ix_(index, index)]
    P[: 2 * m] = (R_MD.T @ P[: 2 * m].reshape(m, 2, 2 * m + 3)).reshape(2 * m, 2 * m + 3)
    P[:, : 2 * m] = (P[:, : 2 * m].reshape(2 * m + 3, m, 2) @ R_MD).reshape(2 * m + 3, 2 * m)
    # p_DL = R_MD^T (p_ML - t_MD): what remains is how it changes with X_MD.
    by_pose = np.empty((2 * m, 3))
    by_pose[:, :2] = np.tile(-R_MD.T, (m, 1))
    by_pose[0::2, 2], by_pose[1::2, 2] = p_DL[:, 1], -p_DL[:, 0]
    P[: 2 * m] += by_pose @ P[2 * m :]
    P[:, : 2 * m] += P[:, 2 * m :] @ by_pose.T
    return p_DL, 0.5 * (P + P.T)
