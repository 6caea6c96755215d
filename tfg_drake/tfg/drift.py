"""The drift of landmarks: their uncertainty relative to the robot, and which of them are jointly known with it."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, is_tag

# Greatest distance, m, of a landmark whose drift stands for that of a surface.
NEIGHBOURHOOD = 2.0
# Greatest drift, m, that is assumed: with more, unrelated places would be taken for each other.
MOST_DRIFT = 0.5
# Two surfaces may be one within this many standard deviations of their drift.
DRIFT_SIGMAS = 3.0


def drift_from_robot(estimate: MapEstimate, rows: IntArray) -> FloatArray:
    """Return the covariances (n, 2, 2), m^2 along the axes of M, of the landmarks in rows (n,) relative to the last
    departure pose.

    They are small for landmarks just seen, however uncertain both are in M. Landmarks too far away to be jointly known
    with the pose may have drifted by MOST_DRIFT.
    """
    drift = np.tile(MOST_DRIFT**2 * np.eye(2), (len(rows), 1, 1))
    entry = estimate.local_entry[rows]
    known = entry >= 0
    rows, entry = rows[known], entry[known]
    P, both = estimate.covariance, np.stack([2 * entry, 2 * entry + 1], axis=1)
    lever = estimate.places[rows] - estimate.X_MD[:2]
    # Relative error: that of the landmark, less the robot's, less what the robot's heading adds over the distance.
    J, by = np.zeros((len(rows), 2, 3)), np.tile(np.eye(2), (len(rows), 1, 1))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2], J[:, 1, 2] = -lever[:, 1], lever[:, 0]
    # A wall lies somewhere along its normal only.
    walls = ~is_tag(estimate.ids[rows])
    angle = estimate.p_ML[rows[walls], 0]
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, :, None]
    J[walls] = normal @ (normal.transpose(0, 2, 1) @ J[walls])
    by[walls] = normal * np.array([0.0, 1.0])
    cross = by @ P[both, -3:] @ J.transpose(0, 2, 1)
    own = by @ P[both[:, :, None], both[:, None]] @ by.transpose(0, 2, 1)
    drift[known] = own - cross - cross.transpose(0, 2, 1) + J @ P[-3:, -3:] @ J.transpose(0, 2, 1)
    return drift


def known_jointly(points: FloatArray, estimate: MapEstimate, reach: float = NEIGHBOURHOOD) -> BoolArray:
    """Return a mask (n,) of the points (n, 2), in M, around which all landmarks within reach (m) are jointly known with
    the departure pose."""
    others = ~estimate.is_local
    if not others.any() or not len(points):
        return np.ones(len(points), dtype=np.bool_)
    distance, _ = cKDTree(estimate.places[others]).query(points)
    return np.asarray(distance > reach)
