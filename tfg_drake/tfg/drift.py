"""How far apart two things that belong together may have been mapped.

The two faces of one wall carry different landmarks, and on a large map those may be tied together only by a long way
round: by then they can stand apart by more than the wall is thick, or pass through each other. The same holds for what
the robot sees now and what it mapped when it was last here.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.messages import BoolArray, FloatArray, MapEstimate

# Landmarks this far from a place at most speak for the faces there, m.
NEIGHBOURHOOD = 2.0
# How much drift is believed, m: beyond it places would be taken for each other that have nothing in common.
MOST_DRIFT = 0.5
# What belongs together is no farther apart than this many standard deviations.
DRIFT_SIGMAS = 3.0


def drift_from_robot(estimate: MapEstimate) -> FloatArray:
    """Covariance (n, 2, 2), m^2 along the axes of M, of where each landmark lies seen from the last departure pose.

    What the robot has just seen is small here, however uncertain both are in M. Those too far away to be known jointly
    with it may have drifted by MOST_DRIFT.
    """
    n = len(estimate.local)
    P = estimate.covariance
    lever = estimate.p_ML[estimate.local] - estimate.X_MD[:2]
    # Relative error: that of the landmark, less the robot's, less what the robot's heading adds over the distance.
    J = np.zeros((n, 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2], J[:, 1, 2] = -lever[:, 1], lever[:, 0]
    cross = P[: 2 * n, -3:].reshape(n, 2, 3) @ J.transpose(0, 2, 1)
    rows = np.arange(n)
    own = P[: 2 * n, : 2 * n].reshape(n, 2, n, 2)[rows, :, rows, :]
    drift = np.tile(MOST_DRIFT**2 * np.eye(2), (len(estimate.ids), 1, 1))
    drift[estimate.local] = own - cross - cross.transpose(0, 2, 1) + J @ P[-3:, -3:] @ J.transpose(0, 2, 1)
    return drift


def known_jointly(points: FloatArray, estimate: MapEstimate, reach: float = NEIGHBOURHOOD) -> BoolArray:
    """Whether all landmarks within reach (m) of each of the points (n, 2), in M, are known jointly with the departure
    pose, (n,)."""
    others = np.ones(len(estimate.ids), dtype=np.bool_)
    others[estimate.local] = False
    if not others.any() or not len(points):
        return np.ones(len(points), dtype=np.bool_)
    distance, _ = cKDTree(estimate.p_ML[others]).query(points)
    return np.asarray(distance > reach)


def drift_between(points: FloatArray, normals: FloatArray, estimate: MapEstimate) -> FloatArray:
    """Standard deviation (n,), m, along the normals, between the landmarks round each point, the worst pair's.

    points: (n, 2) and unit normals (n, 2) in M. Zero where fewer than two landmarks are near that are known jointly,
    MOST_DRIFT at most.
    """
    result = np.zeros(len(points))
    if len(estimate.local) < 2 or not len(points):
        return result
    near = cKDTree(estimate.p_ML[estimate.local]).query_ball_point(points, NEIGHBOURHOOD)
    for i, rows in enumerate(near):
        if len(rows) < 2:
            continue
        x, y = 2 * np.array(rows), 2 * np.array(rows) + 1
        u, v = normals[i]
        P = estimate.covariance
        along = u * u * P[np.ix_(x, x)] + v * v * P[np.ix_(y, y)] + u * v * (P[np.ix_(x, y)] + P[np.ix_(y, x)])
        variance = np.diag(along)
        result[i] = np.sqrt(max(float(np.max(variance[:, None] + variance[None, :] - along - along.T)), 0.0))
    return np.minimum(result, MOST_DRIFT)
