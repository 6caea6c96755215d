"""How far apart two things that belong together may have been mapped.

The two faces of one wall carry different landmarks, and on a large map those may be tied together only by a long way
round: by then they can stand apart by more than the wall is thick, or pass through each other. The same holds for what
the robot sees now and what it mapped when it was last here.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate

# Landmarks this far from a place at most speak for the faces there, m.
NEIGHBOURHOOD = 2.0
# How much drift is believed, m: beyond it places would be taken for each other that have nothing in common.
MOST_DRIFT = 0.5
# What belongs together is no farther apart than this many standard deviations.
DRIFT_SIGMAS = 3.0


def drift_from_robot(estimate: MapEstimate, rows: IntArray) -> FloatArray:
    """Covariance (n, 2, 2), m^2 along the axes of M, of where the landmarks of these rows (n,) lie seen from the last
    departure pose.

    What the robot has just seen is small here, however uncertain both are in M. Those too far away to be known jointly
    with it may have drifted by MOST_DRIFT.
    """
    drift = np.tile(MOST_DRIFT**2 * np.eye(2), (len(rows), 1, 1))
    entry = estimate.local_entry[rows]
    known = entry >= 0
    rows, entry = rows[known], entry[known]
    P, both = estimate.covariance, np.stack([2 * entry, 2 * entry + 1], axis=1)
    lever = estimate.p_ML[rows] - estimate.X_MD[:2]
    # Relative error: that of the landmark, less the robot's, less what the robot's heading adds over the distance.
    J = np.zeros((len(rows), 2, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1.0
    J[:, 0, 2], J[:, 1, 2] = -lever[:, 1], lever[:, 0]
    cross = P[both, -3:] @ J.transpose(0, 2, 1)
    own = P[both[:, :, None], both[:, None]]
    drift[known] = own - cross - cross.transpose(0, 2, 1) + J @ P[-3:, -3:] @ J.transpose(0, 2, 1)
    return drift


def known_jointly(points: FloatArray, estimate: MapEstimate, reach: float = NEIGHBOURHOOD) -> BoolArray:
    """Whether all landmarks within reach (m) of each of the points (n, 2), in M, are known jointly with the departure
    pose, (n,)."""
    others = ~estimate.is_local
    if not others.any() or not len(points):
        return np.ones(len(points), dtype=np.bool_)
    distance, _ = cKDTree(estimate.p_ML[others]).query(points)
    return np.asarray(distance > reach)


def drift_between(points: FloatArray, normals: FloatArray, estimate: MapEstimate) -> FloatArray:
    """Standard deviation (n,), m, along the normals, between the landmarks round each point, the worst pair's.

    points: (n, 2) and unit normals (n, 2) in M. Zero where fewer than two landmarks are near that are known jointly,
    MOST_DRIFT at most.
    """
    variance = _worst_pair(points, normals, estimate.local_p_ML, estimate.covariance)
    return np.asarray(np.minimum(np.sqrt(variance), MOST_DRIFT))


@njit(cache=True)
def _worst_pair(points: FloatArray, normals: FloatArray, p_ML: FloatArray, covariance: FloatArray) -> FloatArray:
    """The largest variance (n,), m^2, of how far apart two of the landmarks p_ML (l, 2) within NEIGHBOURHOOD of each of
    the points (n, 2) are along its normal (n, 2), by their covariance, row by row."""
    worst = np.zeros(len(points))
    near, along = np.empty(len(p_ML), dtype=np.int64), np.empty(len(p_ML))
    for i in range(len(points)):
        u, v = normals[i, 0], normals[i, 1]
        count = 0
        for k in range(len(p_ML)):
            dx, dy = p_ML[k, 0] - points[i, 0], p_ML[k, 1] - points[i, 1]
            if dx * dx + dy * dy > NEIGHBOURHOOD * NEIGHBOURHOOD:
                continue
            x, y = 2 * k, 2 * k + 1
            near[count] = k
            along[count] = u * u * covariance[x, x] + v * v * covariance[y, y] + 2.0 * u * v * covariance[x, y]
            for other in range(count):
                a, b = 2 * near[other], 2 * near[other] + 1
                shared = u * u * covariance[x, a] + v * v * covariance[y, b]
                shared += u * v * (covariance[x, b] + covariance[y, a])
                worst[i] = max(worst[i], along[count] + along[other] - 2.0 * shared)
            count += 1
    return worst
