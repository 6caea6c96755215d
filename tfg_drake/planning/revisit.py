"""Where to look once more when all is explored: the place that takes most off the landmarks' expected squared error.

Entropy is the determinant of the landmarks' covariance, the squared error its trace: a map can be rich in nats and yet
be bent. Nats are earned by any tag that is seen again; a bend is taken out where what was seen first and what was seen
long after meet. The joint Gaussian tells where that is (A-optimality, where entropy is D-optimality).
"""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import FloatArray, IntArray, MapEstimate, Roadmap, TfgMap
from tfg_drake.planning.candidates import GoalParameters, time_all_round
from tfg_drake.planning.exact_gain import to_arrival
from tfg_drake.planning.expected_view import View, expected_tags
from tfg_drake.planning.information_gain import odometry_covariance, sightings_of_turn, turn_noise

# Places that are asked, about as many at most: tags are seen from so far away that more tell little more.
PLACES = 100
# Tags are never nearer than this, m.
NEAREST = 0.05


def worth_revisiting(
    nodes: IntArray,
    estimate: MapEstimate,
    tfg: TfgMap,
    roadmap: Roadmap,
    parameters: GoalParameters,
) -> FloatArray:
    """The share of the landmarks' expected squared error that a turn at each of the nodes (v,) of the roadmap removes,
    over the share of the mission's time that it then has taken, (v,); 0 where a place is not asked.

    Measuring everything all over again is worth 1: variance times time stays. Above that their product falls. Landmarks
    that are not all known jointly cannot tell, and nothing is worth it.
    """
    value = np.zeros(len(nodes))
    if len(estimate.local) < len(estimate.ids) or not len(estimate.ids):
        return value
    # The same places at every stage: names are given once and for all.
    asked = np.flatnonzero(roadmap.names(nodes) % (1 + len(nodes) // PLACES) == 0)
    nodes = nodes[asked]
    sensor, explorer = parameters.sensor, parameters.explorer
    points, time = roadmap.points[nodes], roadmap.travel_time[nodes]
    Q = odometry_covariance(estimate.X_MD, points, roadmap.travel_length[nodes], time, parameters.odometry)
    tags = expected_tags(points, estimate, tfg, sensor)
    noise = turn_noise(sensor, sightings_of_turn(sensor, explorer.turn_rate))
    removed = error_removed(points, Q, tags, estimate.p_ML, estimate.X_MD, estimate.covariance, noise)
    time = time + time_all_round(sensor, explorer)
    value[asked] = removed / np.trace(estimate.covariance[:-3, :-3]) / (time / (estimate.stamp + time))
    return value


def error_removed(
    points: FloatArray,
    Q: FloatArray,
    tags: View,
    p_ML: FloatArray,
    X_MD: FloatArray,
    covariance: FloatArray,
    noise: FloatArray,
) -> FloatArray:
    """By how much, (c,) m^2, a turn at each point (c, 2), m in M, lowers the trace of the landmarks' covariance.

    With S the joint covariance of the landmarks L and the arrival pose, and J the whitened Jacobian of ranges and
    bearings by both,

        tr S_LL - tr S_LL|z = tr((I + J S J^T)^-1 J S_.L S_L. J^T).

    Q: (c, 3, 3), in M, what odometry adds on the way from the departure pose X_MD (3,). tags: which of the landmarks
    p_ML (n, 2), m in M, each point sees. covariance: (2n + 3, 2n + 3) of p_ML row by row and of X_MD. noise: as in
    `exact_gain`.
    """
    n = 2 * len(p_ML)
    squared = covariance[:, :n] @ covariance[:n]
    removed = np.zeros(len(points))
    for c in np.flatnonzero(tags.count):
        seen = tags.index[tags.offsets[c] : tags.offsets[c + 1]]
        J, K = _whitened(p_ML[seen] - points[c], noise)
        J = np.hstack([J, K @ to_arrival(X_MD, *points[c])])
        rows = np.r_[np.stack([2 * seen, 2 * seen + 1], axis=1).ravel(), n : n + 3]
        both = np.ix_(rows, rows)
        C = np.eye(len(J)) + J @ covariance[both] @ J.T + K @ Q[c] @ K.T
        removed[c] = np.trace(np.linalg.solve(C, J @ squared[both] @ J.T))
    return removed


def _whitened(d: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Jacobians of ranges and bearings of landmarks at d (m, 2), m, from the robot, over their deviations: by the
    landmarks (2m, 2m) and by the pose (2m, 3). noise: as in `exact_gain`."""
    m = len(d)
    r = np.maximum(np.hypot(*d.T), NEAREST)
    sigma = np.maximum(noise[0] + noise[1] * r, noise[2])
    G = np.empty((m, 2, 2))
    G[:, 0] = d / (r * sigma)[:, None]
    G[:, 1] = d[:, ::-1] * [-1.0, 1.0] / (r * r * noise[3])[:, None]
    J = np.zeros((m, 2, m, 2))
    J[np.arange(m), :, np.arange(m)] = G
    K = np.zeros((m, 2, 3))
    K[:, :, :2] = -G
    K[:, 1, 2] = -1.0 / noise[3]
    return J.reshape(2 * m, 2 * m), K.reshape(2 * m, 3)
