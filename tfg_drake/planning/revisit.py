"""Where to look once more when all is explored: the place that takes most off the landmarks' expected squared error.

Entropy is the determinant of the landmarks' covariance, the squared error its trace: a map can be rich in nats and yet
be bent. Nats are earned by any tag that is seen again; a bend is taken out where what was seen first and what was seen
long after meet. The joint Gaussian tells where that is (A-optimality, where entropy is D-optimality).
"""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.planning.candidates import Situation, time_all_round
from tfg_drake.planning.exact_gain import to_arrival, whitened
from tfg_drake.planning.expected_view import SURFACE_TOLERANCE, Visibility, local_visibility
from tfg_drake.planning.odometry_drift import odometry_covariance

# Places that are asked, about as many at most: landmarks are seen from so far away that more tell little more.
PLACES = 100
# They are screened by so many of the landmarks in view, and so many of the best judged by all.
SCREENING = 12
BEST = 10
# The error is that of about so many landmarks.
SAMPLE = 400
# Deviation, m, of a look at a point of a wall along that wall.
FREE = 30.0


def worth_revisiting(nodes: IntArray, now: Situation) -> FloatArray:
    """The share of the landmarks' expected RMS error that a turn at each of the nodes (v,) of the roadmap removes,
    over the share of the mission's time that it then has taken, (v,); 0 where a place is not asked.

    Above 1 the product of error and time falls. By the squared error measuring everything all over again would stay
    worth 1, and the mission never end where errors of landmarks are independent. Of a large map the landmarks that are
    known jointly speak for all. What is seen on the way is not counted.
    """
    estimate, roadmap, parameters, turns = now.landmarks, now.roadmap, now.parameters, now.turns()
    value = np.zeros(len(nodes))
    if not len(estimate.local):
        return value
    # Mostly the same places at every stage: node ids are given once and for all.
    asked = np.flatnonzero(roadmap.node_ids(nodes) % (1 + len(nodes) // PLACES) == 0)
    nodes = nodes[asked]
    sensor, explorer = parameters.sensor, parameters.explorer
    points, time = roadmap.points[nodes], roadmap.travel_time[nodes]
    Q = odometry_covariance(estimate.X_MD, points, roadmap.travel_length[nodes], time, parameters.odometry)
    seen = local_visibility(turns.seen(points), estimate)
    seen = seen.kept(known_together(seen, estimate.covariance))
    covariance, p_ML = estimate.covariance, estimate.local_p_ML
    by_landmarks, error = covariance[:, :-3], np.trace(covariance[:-3, :-3])
    if len(p_ML) > SAMPLE:
        of = (2 * np.arange(0, len(p_ML), 1 + len(p_ML) // SAMPLE)[:, None] + [0, 1]).ravel()
        by_landmarks, error = covariance[:, of], np.diag(covariance)[of].sum()
    squared = by_landmarks @ by_landmarks.T
    time = time + time_all_round(sensor, explorer)

    def share_of_error(rows: IntArray, of: Visibility) -> FloatArray:
        known = p_ML, estimate.X_MD, covariance, squared, turns.noise, turns.wall
        removed = error_removed(points[rows], Q[rows], of, *known)
        return np.asarray(1.0 - np.sqrt(np.maximum(1.0 - removed / error, 0.0)))

    share_of_time = time / (estimate.stamp + time)
    worth = share_of_error(np.arange(len(nodes)), seen.thinned(SCREENING)) / share_of_time
    best = np.sort(np.argsort(-worth, kind="stable")[:BEST])
    worth[best] = share_of_error(best, seen.of(best)) / share_of_time[best]
    value[asked] = worth
    return value


def known_together(seen: Visibility, covariance: FloatArray) -> BoolArray:
    """Which of the landmarks in view, one truth value for each entry of seen.index, are known relative to the others
    there as well as the walls that hide them.

    All is explored, so what can be seen from a place has been seen with what is round it. What has not hangs on the
    rest of the map by a long way, and only that way's error has put it before the wall that it is behind.

    covariance: (2n + 3, 2n + 3) of the landmarks and a pose.
    """
    variance = np.diag(covariance)[:-3].reshape(-1, 2).sum(axis=1)
    place, row = np.repeat(np.arange(len(seen.count)), seen.count), seen.index
    by_variance = row[np.lexsort((variance[row], place))]
    middle = by_variance[(seen.offsets[:-1] + seen.count // 2)[place]]
    together = covariance[2 * row, 2 * middle] + covariance[2 * row + 1, 2 * middle + 1]
    return np.asarray(variance[row] + variance[middle] - 2.0 * together <= SURFACE_TOLERANCE**2)


def error_removed(
    points: FloatArray,
    Q: FloatArray,
    visible: Visibility,
    p_ML: FloatArray,
    X_MD: FloatArray,
    covariance: FloatArray,
    squared: FloatArray,
    noise: FloatArray,
    wall: FloatArray,
) -> FloatArray:
    """By how much, (c,) m^2, a turn at each point (c, 2), m in M, lowers the trace of the covariance of landmarks L.

    With S the joint covariance of landmarks, L among them, and the departure pose, A what an error of the arrival pose
    makes of where the landmarks in view V are seen, R the noise there, and J = [I, A F] by both, F from departure to
    arrival,

        tr S_LL - tr S_LL|z = tr((R + A Q A^T + J S J^T)^-1 J S_.L S_L. J^T).

    Q: (c, 3, 3), in M, what odometry adds on the way from the departure pose X_MD (3,). visible: which of the landmarks
    p_ML (n, 2), m in M, each point sees. covariance: (2n + 3, 2n + 3) of p_ML row by row and of X_MD. squared: S_.L
    S_L., (2n + 3, 2n + 3). noise, wall: as in `exact_gain`.
    """
    c, m = len(points), int(visible.count.max(initial=0))
    # All points at once, as if each saw as many: the rows of what it does not see are zero and take nothing off.
    sees = np.arange(m) < visible.count[:, None]
    seen = np.zeros((c, m), dtype=np.int64)
    seen[sees] = visible.index
    d, normal = (p_ML[seen] - points[:, None])[sees], wall[visible.index]
    G, of_wall = whitened(d, noise), normal.any(axis=1)
    G[of_wall, 0] = normal[of_wall]
    # Along a wall its points are not seen.
    along = normal[of_wall] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    G[of_wall, 1] = along / np.hypot(*along.T)[:, None] / FREE
    to_position = G.transpose(0, 2, 1) / np.square(G).sum(axis=2)[:, None]
    by_arrival = np.zeros((c, m, 2, 3))
    by_arrival[sees, :, :2] = -np.eye(2)
    by_arrival[sees, :, 2] = d @ np.array([[0.0, -1.0], [1.0, 0.0]])
    A = by_arrival.reshape(c, 2 * m, 3)
    R = np.zeros((c, m, 2, m, 2))
    R[:, np.arange(m), :, np.arange(m)] = np.eye(2)
    tag = np.nonzero(sees)
    R[tag[0], tag[1], :, tag[1]] = to_position @ to_position.transpose(0, 2, 1)
    AF = A @ to_arrival(X_MD, points)
    rows = np.stack([2 * seen, 2 * seen + 1], axis=2).reshape(c, 2 * m)
    in_view = np.repeat(sees, 2, axis=1)[:, :, None]
    both, both_in_view = rows[:, :, None] * len(covariance) + rows[:, None], in_view & in_view.transpose(0, 2, 1)

    def by_view(S: FloatArray) -> FloatArray:
        """J S J^T, (c, 2m, 2m)."""
        half = S[rows, -3:] * in_view + 0.5 * AF @ S[-3:, -3:]
        by_pose = np.concatenate([AF, half], axis=2) @ np.concatenate([half, AF], axis=2).transpose(0, 2, 1)
        return np.asarray(S.take(both) * both_in_view + by_pose)

    C = R.reshape(c, 2 * m, 2 * m) + A @ Q @ A.transpose(0, 2, 1) + by_view(covariance)
    return np.asarray(np.trace(np.linalg.solve(C, by_view(squared)), axis1=1, axis2=2))
