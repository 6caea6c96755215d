"""The map between two solves: its joint Gaussian, updated by one more keyframe.

A keyframe hardly moves the landmarks around the robot, so an iterated Kalman update gives the result of a solve of the
whole graph, in a tenth of the time. Each tag is first compared with its prediction from all others. `needs_solve`
decides when the graph must be linearised again.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.linalg

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, Observation, is_tag, message, replace
from tfg_drake.slam.keyframe import Keyframe, Measured, Pair, placed, residual, rows_of, without_tags
from tfg_drake.slam.keyframe_graph import KeyframeGraph, extended
from tfg_drake.slam.shared import METRES, SHARED, Shared, scale_of
from tfg_drake.slam.walls import wall_ends

# A known tag whose squared Mahalanobis distance from its prediction by all others exceeds this is rejected: it was
# misread, moved or associated wrongly. `evidence` decides what follows.
REJECTED = 49.0
# Iterations of an update.
ITERATIONS = 4
# The graph is solved if, since the last solve, a landmark has moved by more than FAR_MOVED, m; half as many keyframes
# or MANY_KEYFRAMES, the fewer of these, were added; a shared parameter has moved by PARAMETER_MOVED of its deviation
# then; the pose's deviation has grown by LOOSER, m and rad, in quadrature; or one of the NEAREST landmarks to the robot
# is not jointly known. It is also solved if a rotation of the map about its origin by the heading's deviation leaves
# the tangent by more than OFF_TANGENT, m, at the distance BEYOND, m, past the robot: each update would add false
# information on the heading.
FAR_MOVED = 0.05
BEYOND, OFF_TANGENT = 5.0, 0.003
MANY_KEYFRAMES = 32
NEAREST = 100
LOOSER = np.array([0.02, 0.005])
PARAMETER_MOVED = 1.0
# Directions of the parameters on which a keyframe has less information than this, in prior deviations, are ignored.
LEAST_TOLD = 1e-9


# Mean and covariance of the map's landmarks known jointly, its newest pose and the parameters, see `_in_unit_of`.
Joint = tuple[FloatArray, FloatArray]


@message
class _Told:
    """A keyframe as measurements of an update: y ~ (mean + by_shared s, covariance) given the parameters s, and on
    these u^T s = told with unit variance, u: (13, r)."""

    mean: FloatArray
    by_shared: FloatArray
    covariance: FloatArray
    of_shared: FloatArray
    told: FloatArray


@message
class _Update:
    """An update by m landmarks in rows (m,) of the map's local, and by measurements of the parameters, linearised at
    its result. H: (2m + r, 2m + 16) on the landmarks, A and the parameters. root: lower Cholesky factor of the
    innovation's covariance, nu: the innovation from the prior mean, in units of that root."""

    local_row: IntArray
    H: FloatArray
    root: FloatArray
    nu: FloatArray


def distance_to(known: MapEstimate | KeyframeGraph, X: FloatArray) -> FloatArray:
    """Return the distances (n,), m, of landmarks from a pose X_MX (3,); for a wall, of its seen part."""
    off = known.p_ML - X[:2]
    ends = wall_ends(known)
    along = ends[:, 1] - ends[:, 0]
    share = -np.sum((ends[:, 0] - X[:2]) * along, axis=1) / np.maximum(np.sum(along**2, axis=1), 1e-12)
    off[: len(along)] = ends[:, 0] + np.clip(share, 0.0, 1.0)[:, None] * along - X[:2]
    return np.asarray(np.hypot(*off.T))


def updated(
    graph: KeyframeGraph, estimate: MapEstimate, one: Keyframe, *, is_view: bool = True
) -> tuple[KeyframeGraph, MapEstimate, IntArray]:
    """Return graph and map with one keyframe more, which begins at the map's newest pose, and the ids of its known tags
    that were rejected because they contradict all others.

    Args:
        graph: with the values of its last solve. estimate: landmarks and newest pose, updated since.
        one: the keyframe; its known tags must be jointly known.
        is_view: True for a turn or glance, False for a piece of the way.

    The stage in `estimate` is not updated, see `finished`.
    """
    told, before = _told(one, graph), _in_unit_of(one, estimate)
    row, known = rows_of(one.ids, estimate.ids)
    local_row, seen = estimate.local_entry[row[known]], np.flatnonzero(known)
    kept = np.arange(len(seen))
    while True:
        update = _iterated(before, local_row[kept], told, seen[kept], one, estimate.anchor[row[seen[kept]]])
        distance = _distances(update)
        if np.max(distance, initial=0.0) <= REJECTED:
            break
        kept = np.delete(kept, np.argmax(distance))
    rejected = np.delete(one.ids[seen], kept)
    if len(rejected):
        one = without_tags(one, rejected)
        told = _told(one, graph)
    return *_joined(graph, estimate, before, one, told, update, is_view), rejected


def _in_unit_of(one: Keyframe, estimate: MapEstimate) -> Joint:
    """Return (p_ML[local] row by row, X_MD, shared) and their covariance with lengths in the unit of a keyframe, which
    contains no scale, so that successive linearisations add no false information on it."""
    x = np.concatenate([estimate.local_p_ML.ravel(), estimate.X_MD, estimate.shared])
    if one.unit == METRES:
        return x, estimate.joint_covariance
    length, scale = _is_length(estimate.ids[estimate.local]), scale_of(one.unit, estimate.shared)
    P = _in_unit(estimate.joint_covariance, scale, np.where(length, x, 0.0), len(x) - SHARED + one.unit)
    return np.where(length, scale * x, x), P


def _is_length(ids: IntArray) -> BoolArray:
    """Return a mask of the lengths among (landmarks with ids (m,), X_MD, shared): all but the angles of walls, the
    heading and the shared parameters."""
    tags = is_tag(ids)
    of_landmarks = np.column_stack([tags, np.ones_like(tags)]).ravel()
    return np.concatenate([of_landmarks, [True, True], np.zeros(1 + SHARED, dtype=bool)])


def _in_unit(P: FloatArray, scale: float, lever: FloatArray, of_scale: int) -> FloatArray:
    """Return the covariance of x in another unit, x' = scale * x, where the scale in row of_scale moves x' by the lever
    (u,)."""
    by = np.where(lever != 0.0, scale, 1.0)
    half = by * P[of_scale] + 0.5 * P[of_scale, of_scale] * lever
    other = by[:, None] * P * by + lever[:, None] * half + half[:, None] * lever
    return np.asarray(np.where(np.tri(len(P), dtype=bool), other, other.T))  # Rounding must not break the symmetry.


def _told(one: Keyframe, graph: KeyframeGraph) -> _Told:
    """Return a keyframe as measurements. The constant errors of tags count as noise, independent in each keyframe; a
    solve treats them exactly."""
    covariance, by_shared = one.conditional()
    if graph.tag_error.any():
        root, n, i = one.on_error * graph.tag_error, len(one.ids), np.arange(len(one.ids))
        covariance[:-3, :-3].reshape(n, 2, n, 2)[i, :, i, :] += root @ root.transpose(0, 2, 1)
    information, vector = one.alone()
    sigma = graph.prior.sigma
    value, direction = np.linalg.eigh(sigma[:, None] * information * sigma)
    some = value > LEAST_TOLD
    root = np.sqrt(value[some])
    told = -(direction[:, some].T @ (sigma * vector)) / root
    return _Told(
        np.append(one.y_AL.ravel(), one.y_AD), by_shared, covariance, direction[:, some] * root / sigma[:, None], told
    )


def jointly_known(estimate: MapEstimate, ids: IntArray) -> BoolArray:
    """Return a mask of the tags (m,) that are jointly known with the newest pose, or not known at all."""
    row, known = rows_of(ids, estimate.ids)
    return ~known | np.isin(row, estimate.local)


def needs_solve(graph: KeyframeGraph, solved: KeyframeGraph, estimate: MapEstimate) -> bool:
    """Return whether an updated graph and map must be solved; solved: the graph at the last solve."""
    if len(graph.keyframes) >= len(solved.keyframes) + min(max(len(solved.keyframes) // 2, 1), MANY_KEYFRAMES):
        return True
    if 0.5 * estimate.covariance[-1, -1] * (math.hypot(*estimate.X_MD[:2]) + BEYOND) > OFF_TANGENT:
        return True
    if np.any(np.abs(estimate.shared - solved.shared.mean) > PARAMETER_MOVED * solved.shared.sigma):
        return True
    moved = estimate.p_ML[np.searchsorted(estimate.ids, solved.ids)] - solved.p_ML
    if np.max(np.abs(moved), initial=0.0) > FAR_MOVED:
        return True
    if estimate.is_joint:
        return False
    distance = distance_to(estimate, estimate.X_MD)
    return not estimate.is_local[np.argpartition(distance, NEAREST)[:NEAREST]].all()


def deviation_of(estimate: MapEstimate) -> FloatArray:
    """Return the standard deviations (2,) of the newest pose, m and rad."""
    variance = np.diag(estimate.covariance)[-3:]
    return np.array([math.sqrt(variance[0] + variance[1]), math.sqrt(variance[2])])


def is_looser(graph: KeyframeGraph, estimate: MapEstimate, before: FloatArray) -> bool:
    """Return whether the newest pose is less certain than (2,) at the last solve, and scan points can improve it."""
    looser = np.square(deviation_of(estimate)) - np.square(before)
    return bool(len(graph.keyframes[-1].points) and np.any(looser > LOOSER**2))


def estimate_of(
    graph: KeyframeGraph, stamp: float, observation: Observation, places: Pair, local: IntArray, joint: FloatArray
) -> MapEstimate:
    """Return the message of a graph with values p_ML (n, 2) and X_MD (3,) of its landmarks and newest pose; joint: (2m
    + 16, 2m + 16) covariance of its local landmarks, that pose and the parameters."""
    return MapEstimate(
        stage=len(graph.view_keyframe),
        stamp=stamp,
        ids=graph.ids,
        p_ML=places[0],
        anchor=graph.anchor,
        reach=graph.reach,
        X_MD=places[1],
        local=local,
        covariance=joint[:-SHARED, :-SHARED],
        landmark_covariance=graph.landmark_covariance,
        X_MA=graph.X_MA,
        observation=observation,
        entropy=graph.entropy,
        tag_error=graph.tag_error,
        shared=graph.shared.mean,
        with_shared=joint[:, -SHARED:],
    )


def finished(
    graph: KeyframeGraph, estimate: MapEstimate, stamp: float, observation: Observation
) -> tuple[KeyframeGraph, MapEstimate]:
    """Return graph and map after all updates of a stage. stamp: s, observation: of the newest view, with its
    trajectory."""
    m, each = np.arange(len(estimate.local)), graph.landmark_covariance.copy()
    each[estimate.local] = estimate.covariance[:-3, :-3].reshape(len(m), 2, len(m), 2)[m, :, m, :]
    entropy = graph.entropy_beyond + entropy_of(estimate.covariance[:-3, :-3])
    graph = replace(graph, landmark_covariance=each, entropy=entropy)
    told = replace(estimate, stage=len(graph.view_keyframe), stamp=stamp, observation=observation)
    return graph, replace(told, landmark_covariance=each, entropy=entropy)


def entropy_of(covariance: FloatArray) -> float:
    """Return the entropy 1/2 log|2 pi e Sigma|, nats, of a covariance (u, u)."""
    if not len(covariance):
        return 0.0
    root = scipy.linalg.cholesky(covariance, lower=True, check_finite=False)
    return float(0.5 * len(covariance) * math.log(2.0 * math.pi * math.e) + np.sum(np.log(np.diag(root))))


def _entries(size: int, local_row: IntArray) -> IntArray:
    """Return the entries, in a joint covariance of this size, of landmarks in rows (m,) of local, the pose and the
    parameters."""
    return np.append((2 * local_row[:, None] + [0, 1]).ravel(), np.arange(size - 3 - SHARED, size))


def _iterated(
    joint: Joint, local_row: IntArray, told: _Told, seen: IntArray, one: Keyframe, p_MC: FloatArray
) -> _Update:
    """Return the update by m landmarks, in rows local_row (m,) of local and seen (m,) of the keyframe, with anchors
    p_MC (m, 2). joint: the map's."""
    (mean, covariance), m, r = joint, len(seen), len(told.told)
    at = _entries(len(covariance), local_row)
    P = covariance[np.ix_(at, at)]
    of_seen = (2 * seen[:, None] + [0, 1]).ravel()
    noise = scipy.linalg.block_diag(told.covariance[np.ix_(of_seen, of_seen)], np.eye(r))
    y, by_shared = told.mean[of_seen], told.by_shared[of_seen]
    walls, p_AC = int(np.count_nonzero(seen < one.walls)), one.anchor[seen]
    x_0 = x = mean[at]
    H = np.zeros((2 * m + r, 2 * m + 3 + SHARED))
    H[2 * m :, 2 * m + 3 :] = told.of_shared.T
    H[: 2 * m, 2 * m + 3 :] = -by_shared
    i = np.arange(m)
    for _ in range(ITERATIONS if m else 1):
        X_MA, shared = x[2 * m : 2 * m + 3], x[2 * m + 3 :]
        # In the keyframe's unit, in which x is.
        measured = Measured(walls, (y + by_shared @ shared).reshape(-1, 2), p_AC, X_MA, METRES)
        error, on, by_landmark = residual(x[: 2 * m].reshape(-1, 2), p_MC, measured, X_MA, X_MA, shared)
        H[: 2 * m, : 2 * m].reshape(m, 2, m, 2)[i, :, i, :] = by_landmark[:m]
        H[: 2 * m, 2 * m : 2 * m + 3] = on[: 2 * m, :3]
        off = np.append(-error[: 2 * m], told.told - told.of_shared.T @ shared)
        innovation = off - H @ (x_0 - x)
        root = np.linalg.cholesky(H @ P @ H.T + noise)
        x = x_0 + P @ (H.T @ scipy.linalg.cho_solve((root, True), innovation, check_finite=False))
    nu = scipy.linalg.solve_triangular(root, innovation, lower=True, check_finite=False)
    return _Update(local_row, H, root, nu)


def _distances(update: _Update) -> FloatArray:
    """Return the squared Mahalanobis distance (m,) of each tag from its prediction by all others."""
    m = len(update.local_row)
    if not m:
        return np.zeros(0)
    half = scipy.linalg.solve_triangular(update.root, np.eye(len(update.root), 2 * m), lower=True, check_finite=False)
    weighted, i = (half.T @ update.nu).reshape(m, 2, 1), np.arange(m)
    own = (half.T @ half).reshape(m, 2, m, 2)[i, :, i, :]
    return np.asarray((weighted * np.linalg.solve(own, weighted)).sum(axis=(1, 2)))


def _joined(
    graph: KeyframeGraph, estimate: MapEstimate, before: Joint, one: Keyframe, told: _Told, by: _Update, is_view: bool
) -> tuple[KeyframeGraph, MapEstimate]:
    """Return graph and map with a keyframe whose known tags are all accepted. before: the map's joint, by: their
    update."""
    (mean, covariance), (_, known), local_row = before, rows_of(one.ids, estimate.ids), by.local_row
    # Its new landmarks and D, in A, whose errors are correlated with those of its known tags.
    beyond = np.append(np.repeat(~known, 2), np.ones(3, dtype=np.bool_))
    size, more, R, G = len(covariance), int(np.count_nonzero(beyond)), told.covariance, told.by_shared
    G_b = G[beyond]
    with_y = covariance[:, -SHARED:] @ G_b.T
    P = np.empty((size + more, size + more))
    P[:size, :size], P[:size, size:], P[size:, :size] = covariance, with_y, with_y.T
    P[size:, size:] = R[np.ix_(beyond, beyond)] + G_b @ with_y[-SHARED:]
    y = told.mean[beyond] + G_b @ estimate.shared
    x = np.append(mean, y)
    if len(by.nu):
        gain = by.H @ P[_entries(size, local_row)]
        gain[: 2 * len(local_row), size:] -= R[np.ix_(beyond, ~beyond)].T
        half = scipy.linalg.solve_triangular(by.root, gain, lower=True, check_finite=False)
        P -= half.T @ half
        x += half.T @ by.nu
    # From (A, parameters, new tags and D in A) to (new tags, D in M, parameters).
    old, new = size - 3 - SHARED, (more - 3) // 2
    X_MA, shared, y = x[old : old + 3], x[old + 3 : size], x[size:]
    R_MA, fresh = se2.rotation(float(X_MA[2])), one.ids[~known]
    p_AL, X_AD, walls = y[:-3].reshape(-1, 2), y[-3:], int(np.count_nonzero(~is_tag(fresh)))
    p_ML, _ = placed(X_MA, fresh, p_AL, one.anchor[~known])
    # A wall's anchor is fixed in M: a change of the pose shifts the wall along its normal.
    lever = np.vstack([one.anchor[~known][:walls], p_AL[walls:], X_AD[:2]]) @ R_MA.T
    J = np.zeros((more + SHARED, 3 + SHARED + more))
    of_places = J[: more - 1]
    of_places[:, :2] = np.tile(np.eye(2), (new + 1, 1))
    of_places[0::2, 2], of_places[1::2, 2] = -lever[:, 1], lever[:, 0]
    i = np.arange(new + 1)
    of_places[:, 3 + SHARED : -1].reshape(new + 1, 2, new + 1, 2)[i, :, i, :] = R_MA
    for k in range(walls):
        normal = np.array([np.cos(p_ML[k, 0]), np.sin(p_ML[k, 0])])
        of_places[2 * k + 1, :3] = normal @ of_places[2 * k : 2 * k + 2, :3]
        of_places[2 * k, :3] = 0.0, 0.0, 1.0
        of_places[2 * k : 2 * k + 2, 3 + SHARED + 2 * k : 5 + SHARED + 2 * k] = np.eye(2)
    J[more - 1, 2] = J[more - 1, -1] = 1.0
    J[more:, 3 : 3 + SHARED] = np.eye(SHARED)
    across, within = J @ P[old:, :old], J @ P[old:, old:] @ J.T
    joint = np.empty((old + more + SHARED, old + more + SHARED))
    joint[:old, :old], joint[old:, :old], joint[:old, old:] = P[:old, :old], across, across.T
    joint[old:, old:] = 0.5 * (within + within.T)

    # Back to metres.
    X_MD = se2.compose(X_MA, X_AD)
    places = np.concatenate([x[:old], p_ML.ravel(), X_MD, shared])
    if one.unit != METRES:
        scale, length = scale_of(one.unit, shared), _is_length(np.append(estimate.ids[estimate.local], fresh))
        places = np.where(length, places / scale, places)
        X_MA, X_MD = X_MA / [scale, scale, 1.0], X_MD / [scale, scale, 1.0]
        lever = np.where(length, -places / scale, 0.0)
        joint = _in_unit(joint, 1.0 / scale, lever, len(joint) - SHARED + one.unit)
    graph = replace(
        graph,
        X_MN=np.vstack([graph.X_MN[:-1], X_MA]),
        shared=Shared(shared, joint[-SHARED:, -SHARED:].copy()),
    )
    graph = extended(graph, one, X_MD, is_view=is_view)
    p_ML, row = np.empty((len(graph.ids), 2)), np.searchsorted(graph.ids, estimate.ids)
    p_ML[row] = estimate.p_ML
    local = np.append(row[estimate.local], np.searchsorted(graph.ids, one.ids[~known]))
    p_ML[local] = places[: -3 - SHARED].reshape(-1, 2)
    if new:
        order = np.argsort(local, kind="stable")
        local, entries = local[order], _entries(len(joint), order)
        joint = joint.take(entries, axis=0).take(entries, axis=1)
    return graph, estimate_of(graph, estimate.stamp, estimate.observation, (p_ML, X_MD), local, joint)
