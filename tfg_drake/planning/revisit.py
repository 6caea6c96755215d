"""The second look after exploration: finds the place that reduces the landmarks' expected squared error most.

Entropy depends on the determinant of the landmarks' covariance, the squared error on its trace: a map can have low
entropy and yet be bent. Seeing any tag again lowers the entropy; a bend is removed where early and late parts of the
map meet. The joint Gaussian determines these places (A-optimality, while entropy is D-optimality).
"""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.planning.candidates import Situation, time_all_round
from tfg_drake.planning.exact_gain import Known, known_terms, to_arrival
from tfg_drake.planning.expected_view import SURFACE_TOLERANCE, Targets, Visibility
from tfg_drake.planning.odometry_drift import odometry_covariance

# Approximate greatest number of places evaluated; landmarks are visible from so far that more places add little.
PLACES = 100
# Greatest number of landmarks in view that a place is evaluated by.
SEEN = 40
# Approximate greatest number of landmarks whose error is evaluated.
SAMPLE = 400


def worth_revisiting(nodes: IntArray, now: Situation) -> FloatArray:
    """Return the share of the landmarks' expected RMS error that a turn at each of the nodes (v,) of the roadmap
    removes, divided by the share by which it lengthens the mission, (v,); 0 for places not evaluated.

    Above 1 the product of error and time falls. With the squared error, measuring everything again would always be
    worth 1, and the mission would never end if landmark errors were independent. On a large map the jointly known
    landmarks represent all. Observations on the way do not count.
    """
    estimate, roadmap, parameters, turns = now.landmarks, now.roadmap, now.parameters, now.turns
    value = np.zeros(len(nodes))
    if not len(estimate.local):
        return value
    # The places are mostly the same at every stage, as node ids do not change.
    asked = np.flatnonzero(roadmap.node_ids(nodes) % (1 + len(nodes) // PLACES) == 0)
    nodes = nodes[asked]
    sensor, explorer = parameters.sensor, parameters.explorer
    points, time = roadmap.points[nodes], roadmap.travel_time[nodes]
    Q = odometry_covariance(estimate.X_MD, points, roadmap.travel_length[nodes], time, parameters.odometry)
    targets, covariance = known_jointly(turns.targets, estimate.covariance)
    seen = turns.targets.known_jointly(turns.seen(points))
    seen = Visibility(seen.offsets, (np.cumsum(turns.targets.entry >= 0) - 1)[seen.index])
    seen = seen.kept(known_together(seen, covariance))
    count = len(targets.entry)
    of = (2 * np.arange(0, count, 1 + (count - 1) // SAMPLE)[:, None] + [0, 1]).ravel()
    error, by_targets = np.diag(covariance)[of].sum(), covariance[:, of]
    squared = by_targets @ by_targets.T
    time = time + time_all_round(sensor, explorer)
    seen, each = seen.thinned(SEEN), np.tile(np.eye(2), (count, 1, 1))
    known = Known(seen.offsets, seen.index, targets.p_MT, np.arange(count), each, targets.normal, covariance)
    removed = error_removed(points, Q, estimate.X_MD, known, squared, turns.noise)
    share_of_error = 1.0 - np.sqrt(np.maximum(1.0 - removed / error, 0.0))
    value[asked] = share_of_error / (time / (estimate.stamp + time))
    return value


def known_jointly(targets: Targets, covariance: FloatArray) -> tuple[Targets, FloatArray]:
    """Return the t targets whose landmarks are jointly known, and the covariance (2t + 3, 2t + 3) of their places, row
    by row, and of the departure pose. covariance: (2n + 3, 2n + 3) of those landmarks and the pose."""
    joint = targets.entry >= 0
    targets = Targets._make(column[joint] for column in targets)
    for _ in range(2):
        by_landmark = covariance[:-3].reshape(-1, 2, covariance.shape[1])[targets.entry]
        covariance = np.vstack([np.concatenate(targets.by_landmark @ by_landmark), covariance[-3:]]).T
    return targets, covariance


def known_together(seen: Visibility, covariance: FloatArray) -> BoolArray:
    """Return a mask of the targets in view, one value for each entry of seen.index, that are known relative to the
    others there as well as the walls that could hide them.

    After exploration every target visible from a place has been seen together with its surroundings. A target that has
    not is connected to the rest of the map by a long path, whose error alone has moved it in front of its wall.

    covariance: (2t + 3, 2t + 3) of the targets and a pose.
    """
    variance = np.diag(covariance)[:-3].reshape(-1, 2).sum(axis=1)
    place, row = np.repeat(np.arange(len(seen.count)), seen.count), seen.index
    by_variance = row[np.lexsort((variance[row], place))]
    middle = by_variance[(seen.offsets[:-1] + seen.count // 2)[place]]
    together = covariance[2 * row, 2 * middle] + covariance[2 * row + 1, 2 * middle + 1]
    return np.asarray(variance[row] + variance[middle] - 2.0 * together <= SURFACE_TOLERANCE**2)


def error_removed(
    points: FloatArray, Q: FloatArray, X_MD: FloatArray, known: Known, squared: FloatArray, noise: FloatArray
) -> FloatArray:
    """Return the reduction (c,), m^2, of the trace of the covariance of targets L by a turn at each point (c, 2), m in
    M.

    With S the joint covariance of targets, L among them, and the departure pose, G and K the whitened Jacobians of the
    measurements by targets and arrival pose, and J = [G, K F], F from departure to arrival,

        tr S_LL - tr S_LL|z = tr((I + K Q K^T + J S J^T)^-1 J S_.L S_L. J^T).

    Q: (c, 3, 3), in M, what odometry adds on the way from the departure pose X_MD (3,). known: the targets that each
    point sees, which are landmarks of their own. squared: S_.L S_L., (2t + 3, 2t + 3). noise: as in `exact_gain`.
    """
    removed = np.zeros(len(points))
    for c, ((x, y), F) in enumerate(zip(points, to_arrival(X_MD, points), strict=True)):
        column, G, K, C = known_terms(x, y, c, known, noise)
        of_squared = known_terms(x, y, c, known._replace(covariance=squared), noise)[3]
        KF = K @ F
        by_view = []
        for S, by_targets in ((known.covariance, C), (squared, of_squared)):
            half = G[:, :1] * S[column, -3:] + G[:, 1:] * S[column + 1, -3:] + 0.5 * KF @ S[-3:, -3:]
            by_view.append(by_targets - np.eye(len(C)) + KF @ half.T + half @ KF.T)
        removed[c] = np.trace(np.linalg.solve(np.eye(len(C)) + K @ Q[c] @ K.T + by_view[0], by_view[1]))
    return removed
