"""The map between two solves: its joint Gaussian, updated by one keyframe more.

What a keyframe says of the landmarks round the robot hardly moves them, so an iterated Kalman update takes it in as a
solve of the whole graph would, in a tenth of the time. Each tag is first compared with what all others predict of it.
`needs_solve` says when so much has moved that the graph is to be linearised anew.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.linalg

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, Observation, message, replace
from tfg_drake.slam.keyframe_graph import KeyframeGraph, at_yaw, extended, rows_of, without_tags
from tfg_drake.slam.keyframe_kernels import chain, linearised
from tfg_drake.slam.map_solver import estimate_of, with_local

# Squared Mahalanobis distance of a known tag from what all others say, beyond which the tag is left out: it was
# misread, has been moved or is tied to the wrong place. What comes of that, `doubt` says.
REJECTED = 49.0
# Iterations of an update.
ITERATIONS = 4
# The graph is solved when a landmark has moved this far, m, since the last solve, when it has half as many keyframes
# more, or so many, when one of so many landmarks nearest to the robot is not known jointly, or when the heading is
# known no better than this, rad: a sighting then turns more than a linearisation can follow.
FAR_MOVED = 0.05
LOOSE_HEADING = 0.1
MANY_KEYFRAMES = 32
NEAREST = 100


@message
class _Update:
    """An update by m tags, linearised at its result. H: (2m, 2m + 3) by the tags and A. root: (2m, 2m) lower Cholesky
    factor of the innovation's covariance, nu: (2m,) the innovation from the prior mean, in units of that root."""

    H: FloatArray
    root: FloatArray
    nu: FloatArray


def updated(
    graph: KeyframeGraph,
    estimate: MapEstimate,
    observation: Observation,
    *,
    is_view: bool = True,
) -> tuple[KeyframeGraph, MapEstimate, IntArray]:
    """Graph and map with one keyframe more, which begins where the map's newest pose is, and the ids of the known tags
    left out of it because they contradict all others.

    Args:
        graph: with the values of its last solve. estimate: what has become of the landmarks and the newest pose since.
        observation: those of its tags that are known must be known jointly.
        is_view: whether it is a turn or glance, not a piece of the way.

    What `estimate` says of the stage is not brought up to date, see `finished`.
    """
    observation = at_yaw(observation, float(graph.yaw[0]))
    loose = _with_tag_errors(observation, graph.tag_error)
    row, known = rows_of(observation.ids, estimate.ids)
    local_row, seen = estimate.local_entry[row[known]], np.flatnonzero(known)
    kept = np.arange(len(seen))
    while True:
        update = _iterated(estimate, local_row[kept], loose, seen[kept])
        distance = _distances(update)
        if np.max(distance, initial=0.0) <= REJECTED:
            break
        kept = np.delete(kept, np.argmax(distance))
    rejected = np.delete(observation.ids[seen], kept)
    observation, loose = without_tags(observation, rejected), without_tags(loose, rejected)
    return *_joined(graph, estimate, observation, loose.covariance, local_row[kept], update, is_view), rejected


def _with_tag_errors(observation: Observation, tag_error: FloatArray) -> Observation:
    """The observation as uncertain as the constant errors of its tags, of these deviations (2,), make it, as if they
    were others in each keyframe: a solve knows better."""
    n = len(observation.on_error)
    if not n or not tag_error.any():
        return observation
    root, covariance, i = observation.on_error * tag_error, observation.covariance.copy(), np.arange(n)
    covariance[:-3, :-3].reshape(n, 2, n, 2)[i, :, i, :] += root @ root.transpose(0, 2, 1)
    return replace(observation, covariance=covariance)


def jointly_known(estimate: MapEstimate, ids: IntArray) -> BoolArray:
    """Which of some tags (m,) are known jointly with the newest pose, or not known at all."""
    row, known = rows_of(ids, estimate.ids)
    return ~known | np.isin(row, estimate.local)


def needs_solve(graph: KeyframeGraph, solved: KeyframeGraph, estimate: MapEstimate) -> bool:
    """Whether an updated graph and map are to be solved; solved: the graph at the last solve."""
    if len(graph.keyframes) >= len(solved.keyframes) + min(max(len(solved.keyframes) // 2, 1), MANY_KEYFRAMES):
        return True
    if estimate.covariance[-1, -1] > LOOSE_HEADING**2:
        return True
    moved = estimate.p_ML[np.searchsorted(estimate.ids, solved.ids)] - solved.p_ML
    if np.max(np.abs(moved), initial=0.0) > FAR_MOVED:
        return True
    if estimate.is_joint:
        return False
    distance = np.hypot(*(estimate.p_ML - estimate.X_MD[:2]).T)
    return not estimate.is_local[np.argpartition(distance, NEAREST)[:NEAREST]].all()


def finished(
    graph: KeyframeGraph, estimate: MapEstimate, stamp: float, observation: Observation
) -> tuple[KeyframeGraph, MapEstimate]:
    """Graph and map after all updates of a stage. stamp: s, observation: the newest view's, with its trajectory."""
    each = with_local(graph.landmark_covariance, estimate.local, estimate.covariance)
    graph = replace(graph, landmark_covariance=each)
    return graph, estimate_of(
        graph, stamp, observation, estimate.p_ML, estimate.X_MD, estimate.local, estimate.covariance
    )


def _entries(size: int, local_row: IntArray) -> IntArray:
    """Where in a joint covariance of this size some landmarks, by their rows (m,) in local, and the pose are."""
    return np.append((2 * local_row[:, None] + [0, 1]).ravel(), [size - 3, size - 2, size - 1])


def _iterated(estimate: MapEstimate, local_row: IntArray, observation: Observation, seen: IntArray) -> _Update:
    """The update by m tags: local_row (m,) where they are in local, seen (m,) where in the observation."""
    m = len(seen)
    if m == 0:
        return _Update(np.zeros((0, 3)), np.zeros((0, 0)), np.zeros(0))
    at = _entries(len(estimate.covariance), local_row)
    P = estimate.covariance[np.ix_(at, at)]
    of_seen = (2 * seen[:, None] + [0, 1]).ravel()
    noise = observation.covariance[np.ix_(of_seen, of_seen)]
    x_0 = x = np.append(estimate.local_p_ML[local_row], estimate.X_MD)
    H = np.zeros((2 * m, 2 * m + 3))
    i = np.arange(m)
    for _ in range(ITERATIONS):
        R_AM = se2.rotation(float(x[-1])).T
        in_A = (x[:-3].reshape(-1, 2) - x[-3:-1]) @ R_AM.T
        H[:, :-3].reshape(m, 2, m, 2)[i, :, i, :] = R_AM
        H[:, -3:-1] = np.tile(-R_AM, (m, 1))
        H[0::2, -1], H[1::2, -1] = in_A[:, 1], -in_A[:, 0]
        innovation = (observation.p_AL[seen] - in_A).ravel() - H @ (x_0 - x)
        root = np.linalg.cholesky(H @ P @ H.T + noise)
        x = x_0 + P @ (H.T @ scipy.linalg.cho_solve((root, True), innovation, check_finite=False))
    return _Update(H, root, scipy.linalg.solve_triangular(root, innovation, lower=True, check_finite=False))


def _distances(update: _Update) -> FloatArray:
    """(m,) squared Mahalanobis distance of each tag from what all others predict of it."""
    m = len(update.nu) // 2
    half = scipy.linalg.solve_triangular(update.root, np.eye(2 * m), lower=True, check_finite=False) if m else None
    if half is None:
        return np.zeros(0)
    weighted, i = (half.T @ update.nu).reshape(m, 2, 1), np.arange(m)
    own = (half.T @ half).reshape(m, 2, m, 2)[i, :, i, :]
    return np.asarray((weighted * np.linalg.solve(own, weighted)).sum(axis=(1, 2)))


def _joined(
    graph: KeyframeGraph,
    estimate: MapEstimate,
    observation: Observation,
    R: FloatArray,
    local_row: IntArray,
    update: _Update,
    is_view: bool,
) -> tuple[KeyframeGraph, MapEstimate]:
    """Graph and map with an observation whose known tags are all believed, local_row (m,): where they are in local. R:
    its covariance with that of the tags' errors."""
    _, known = rows_of(observation.ids, estimate.ids)
    # What it says besides of known tags: in A, new tags and D. The errors of all of it go together.
    beyond = np.append(np.repeat(~known, 2), np.ones(3, dtype=bool))
    size, more, old = len(estimate.covariance), int(np.count_nonzero(beyond)), len(estimate.covariance) - 3
    P = np.zeros((size + more, size + more))
    P[:size, :size], P[size:, size:] = estimate.covariance, R[np.ix_(beyond, beyond)]
    x = np.concatenate([estimate.local_p_ML.ravel(), estimate.X_MD, observation.p_AL[~known].ravel(), observation.X_AD])
    if len(local_row):
        with_tags = estimate.covariance[:, _entries(size, local_row)] @ update.H.T
        gain = np.vstack([with_tags, -R[np.ix_(beyond, ~beyond)]]).T
        half = scipy.linalg.solve_triangular(update.root, gain, lower=True, check_finite=False)
        P -= half.T @ half
        x += half.T @ update.nu
    X_MA, p_AL, X_AD = x[old:size], x[size:-3].reshape(-1, 2), x[-3:]
    # From (A, new tags, D in A) to (new tags, D) in M.
    R_MA, new = se2.rotation(float(X_MA[2])), len(p_AL)
    lever = np.vstack([p_AL, X_AD[:2]]) @ R_MA.T
    J = np.zeros((more, 3 + more))
    J[:-1, :2] = np.tile(np.eye(2), (new + 1, 1))
    J[0:-1:2, 2], J[1:-1:2, 2] = -lever[:, 1], lever[:, 0]
    J[-1, 2] = J[-1, -1] = 1.0
    i = np.arange(new + 1)
    J[:-1, 3:-1].reshape(new + 1, 2, new + 1, 2)[i, :, i, :] = R_MA
    across, within = J @ P[old:, :old], J @ P[old:, old:] @ J.T
    covariance = P[: old + more, : old + more]
    covariance[old:, :old], covariance[:old, old:] = across, across.T
    covariance[old:, old:] = 0.5 * (within + within.T)

    graph = replace(graph, X_MN=np.vstack([graph.X_MN[:-1], X_MA]))
    X_MD = se2.compose(X_MA, X_AD)
    graph = _with_entropy(extended(graph, observation, X_MD, is_view=is_view), new, update.root, R)
    p_ML, row = np.empty((len(graph.ids), 2)), np.searchsorted(graph.ids, estimate.ids)
    p_ML[row] = estimate.p_ML
    local = np.append(row[estimate.local], np.searchsorted(graph.ids, observation.ids[~known]))
    p_ML[local] = np.vstack([x[:old].reshape(-1, 2), se2.transform(X_MA, p_AL)])
    if new:
        order = np.argsort(local, kind="stable")
        local, entries = local[order], _entries(len(covariance), order)
        covariance = covariance.take(entries, axis=0).take(entries, axis=1)
    return graph, replace(estimate, ids=graph.ids, p_ML=p_ML, X_MD=X_MD, local=local, covariance=covariance)


def _with_entropy(graph: KeyframeGraph, new: int, root: FloatArray, R: FloatArray) -> KeyframeGraph:
    """A graph that has got one keyframe more, with its entropy and the information on its newest pose as they are now.

    new: landmarks seen for the first time. root: lower Cholesky factor of the innovation's covariance, R: covariance of
    what was observed. The determinant of
    all that is known, poses too, grows by that of the innovation and falls by that of R; that of the poses given the
    landmarks, a chain, is taken off.
    """
    one = graph.keyframes[-1]
    rows = np.searchsorted(graph.ids, one.ids)
    H, _, _ = linearised(rows, one.p_AL, one.X_AD, one.information, graph.X_MN[-2], graph.X_MN[-1], graph.p_ML)
    poses = np.ascontiguousarray(H[None, 2 * len(rows) :, 2 * len(rows) :])
    of_chain, own = chain(graph.pose_information, poses)
    of_chain += float(np.linalg.slogdet(own)[1])
    if len(graph.keyframes) > 1:
        of_chain -= float(np.linalg.slogdet(graph.pose_information)[1])
    surer = 2.0 * float(np.sum(np.log(np.diag(root)))) - float(np.linalg.slogdet(R)[1]) - of_chain
    more = 0.5 * (2 * new * math.log(2.0 * math.pi * math.e) - surer)
    return replace(graph, entropy=graph.entropy + more, pose_information=own)
