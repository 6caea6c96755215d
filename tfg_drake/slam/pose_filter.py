"""The filter between views: pose, odometry calibration and tags met on the way, beside landmarks it only considers.

State x: pose (3) in the frame D the filter started in, calibration (3) of the odometry model, local tags (2 each) that
enter under flat priors at their first sighting. Considered: landmarks y of the map with their joint covariance P_yy
(Schmidt's consider filter): they inform the pose, with their uncertainty, and are never updated themselves. Instead of
the cross covariance the filter keeps how an error of theirs moves the state, x = W y + what is independent of them:
P_xy = W P_yy, and only landmarks that have been seen have columns in W. So the map may be as large as it likes. Without
considered landmarks it is plain EKF SLAM.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray, TagDetections, message, replace
from tfg_drake.slam.departure_frame import covariance_in_departure_frame, covariance_with_departure
from tfg_drake.slam.odometry_model import OdometryModel, predict_increment, wrap

POSE = 3
CORE = 6
# Mahalanobis gate of one sighting (2 degrees of freedom): 1 in 270 000 good ones fails it.
GATE = 25.0
# What `_index` says of a tag that is neither local (row, >= 0) nor considered (-1 - row).
NEW = np.iinfo(np.int64).max


@message
class PoseFilter:
    """The filter's Gaussian, in the frame D it started in.

    mean: (6 + 2k,) x, y, theta, distance scale, gyro bias, gyro scale, then the local tags' positions. covariance:
    (6 + 2k, 6 + 2k). sensitivity: (6 + 2k, 2s), W above, of the considered landmarks that have been seen, which are in
    the rows seen: (s,). local_ids, last_seen: (k,) ids and stamps (s). map_ids: (n,) ascending and p_DL: (n, 2) of the
    considered landmarks. heading: rad, of D in M. considered: (2n + 3, 2n + 3) covariance of (p_ML row by row, X_MD).
    """

    mean: FloatArray
    covariance: FloatArray
    sensitivity: FloatArray
    seen: IntArray
    local_ids: IntArray
    last_seen: FloatArray
    local_frames: IntArray
    map_ids: IntArray
    p_DL: FloatArray
    heading: float
    considered: FloatArray


def start(
    model: OdometryModel, map_ids: IntArray, p_DL: FloatArray, heading: float, considered: FloatArray
) -> PoseFilter:
    """A filter at the origin of its frame, known exactly, that considers n landmarks (see PoseFilter)."""
    covariance = np.zeros((CORE, CORE))
    covariance[POSE:, POSE:] = model.calibration_covariance
    return PoseFilter(
        mean=np.concatenate([np.zeros(POSE), model.calibration]),
        covariance=covariance,
        sensitivity=np.zeros((CORE, 0)),
        seen=np.empty(0, dtype=np.int64),
        local_ids=np.empty(0, dtype=np.int64),
        last_seen=np.empty(0),
        local_frames=np.empty(0, dtype=np.int64),
        map_ids=map_ids,
        p_DL=p_DL,
        heading=heading,
        considered=considered,
    )


def start_alone(model: OdometryModel) -> PoseFilter:
    """A filter at the origin of its frame, known exactly, that considers nothing."""
    return start(model, np.empty(0, dtype=np.int64), np.empty((0, 2)), 0.0, np.zeros((POSE, POSE)))


def step(
    filter_: PoseFilter, model: OdometryModel, increment: FloatArray, dt: float, detections: TagDetections
) -> tuple[PoseFilter, int, int]:
    """The filter after an odometry increment (3,) of `odometry_model.arc` over dt seconds and the frame at its end.

    Known tags correct it, all at once, unknown ones join it. A tag is looked up among the considered landmarks, then
    among the local tags. A sighting outside its gate is ignored. Also returns how many sightings were of known tags,
    and how many of those were ignored.
    """
    mean, covariance, sensitivity, seen, local_ids, last_seen, local_frames, known, ignored = _step(
        filter_.mean,
        filter_.covariance,
        filter_.sensitivity,
        filter_.seen,
        filter_.local_ids,
        filter_.last_seen,
        filter_.local_frames,
        filter_.map_ids,
        filter_.p_DL,
        filter_.heading,
        filter_.considered,
        increment,
        dt,
        model.noise,
        detections.stamp,
        detections.ids,
        detections.range,
        detections.bearing,
        detections.sigma_range,
        detections.sigma_bearing,
    )
    moved = replace(
        filter_,
        mean=mean,
        covariance=covariance,
        sensitivity=sensitivity,
        seen=seen,
        local_ids=local_ids,
        last_seen=last_seen,
        local_frames=local_frames,
    )
    return moved, known, ignored


def keep_local(filter_: PoseFilter, keep: BoolArray) -> PoseFilter:
    """The filter with only some (k,) of its local tags: the others are marginalised out."""
    if keep.all():
        return filter_
    rows = np.concatenate([np.ones(CORE, dtype=bool), np.repeat(keep, 2)])
    return replace(
        filter_,
        mean=filter_.mean[rows],
        covariance=filter_.covariance[np.ix_(rows, rows)],
        sensitivity=filter_.sensitivity[rows],
        local_ids=filter_.local_ids[keep],
        last_seen=filter_.last_seen[keep],
        local_frames=filter_.local_frames[keep],
    )


@njit(cache=True)
def _index(ids: IntArray, map_ids: IntArray, local_ids: IntArray) -> IntArray:
    index = np.empty(len(ids), dtype=np.int64)
    for i in range(len(ids)):
        index[i] = NEW
        row = np.searchsorted(map_ids, ids[i])
        if row < len(map_ids) and map_ids[row] == ids[i]:
            index[i] = -1 - row
        else:
            for k in range(len(local_ids)):
                if local_ids[k] == ids[i]:
                    index[i] = k
    return index


@njit(cache=True)
def _predict(
    mean: FloatArray, P: FloatArray, W: FloatArray, increment: FloatArray, dt: float, noise: FloatArray
) -> None:
    """Bring mean, covariance and sensitivity an odometry increment on, in place."""
    X, on_calibration, Q = predict_increment(increment, dt, mean[3:6], noise)
    c, s = math.cos(mean[2]), math.sin(mean[2])
    R = np.zeros((3, 3))
    R[0, 0], R[0, 1], R[1, 0], R[1, 1], R[2, 2] = c, -s, s, c, 1.0
    motion = c * X[0] - s * X[1], s * X[0] + c * X[1]
    # x' = F x on the pose's rows: identity, and the lever of heading and calibration, the state's entries 2 to 5.
    lever = np.zeros((3, 4))
    lever[0, 0], lever[1, 0] = -motion[1], motion[0]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                lever[i, 1 + j] += R[i, k] * on_calibration[k, j]
    # The heading's own row is last, for the others need it as it was.
    for i in range(3):
        for j in range(4):
            for q in range(len(mean)):
                P[i, q] += lever[i, j] * P[2 + j, q]
            for q in range(W.shape[1]):
                W[i, q] += lever[i, j] * W[2 + j, q]
    for q in range(len(mean)):
        for i in range(3):
            for j in range(4):
                P[q, i] += lever[i, j] * P[q, 2 + j]
    for i in range(3):
        for j in range(3):
            for k in range(3):
                for m in range(3):
                    P[i, j] += R[i, k] * Q[k, m] * R[j, m]
    mean[0] += motion[0]
    mean[1] += motion[1]
    mean[2] = wrap(mean[2] + X[2])


@njit(cache=True)
def predict_pose(
    mean: FloatArray,
    covariance: FloatArray,
    sensitivity: FloatArray,
    seen: IntArray,
    p_DL: FloatArray,
    heading: float,
    considered: FloatArray,
    increment: FloatArray,
    dt: float,
    noise: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The pose (3,) alone after an odometry increment, its covariance (3, 3), and that with X_MD (3, 3). Other
    arguments as in PoseFilter and OdometryModel."""
    shared = covariance_with_departure(considered, heading, p_DL, seen)
    X, P, C = mean[:CORE].copy(), np.empty((CORE, CORE)), np.zeros((CORE, POSE))
    for i in range(CORE):
        for j in range(CORE):
            P[i, j] = covariance[i, j]
        for j in range(POSE):
            for q in range(len(shared)):
                C[i, j] += sensitivity[i, q] * shared[q, j]
    _predict(X, P, C, increment, dt, noise)
    return X[:POSE].copy(), P[:POSE, :POSE].copy(), C[:POSE].copy()


@njit(cache=True)
def _step(
    mean: FloatArray,
    covariance: FloatArray,
    sensitivity: FloatArray,
    seen: IntArray,
    local_ids: IntArray,
    last_seen: FloatArray,
    local_frames: IntArray,
    map_ids: IntArray,
    p_DL: FloatArray,
    heading: float,
    considered: FloatArray,
    increment: FloatArray,
    dt: float,
    noise: FloatArray,
    stamp: float,
    ids: IntArray,
    range_: FloatArray,
    bearing: FloatArray,
    sigma_range: FloatArray,
    sigma_bearing: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, IntArray, FloatArray, IntArray, int, int]:
    index = _index(ids, map_ids, local_ids)
    seen, W = _with_columns(seen, sensitivity, index)
    mean, P = mean.copy(), covariance.copy()
    _predict(mean, P, W, increment, dt, noise)
    z = np.empty((len(ids), 4))
    for i in range(len(ids)):
        z[i, 0], z[i, 1], z[i, 2], z[i, 3] = range_[i], bearing[i], sigma_range[i], sigma_bearing[i]
    accepted = _correct(mean, P, W, seen, p_DL, heading, considered, index, z)
    local, known, used = len(local_ids), 0, 0
    joined, stamps = np.empty(local + len(ids), dtype=np.int64), np.empty(local + len(ids))
    frames = np.empty(local + len(ids), dtype=np.int64)
    for k in range(local):
        joined[k], stamps[k], frames[k] = local_ids[k], last_seen[k], local_frames[k]
    for i in range(len(ids)):
        if index[i] == NEW:
            joined[local], stamps[local], frames[local] = ids[i], stamp, 1
            local += 1
        else:
            known += 1
            used += accepted[i]
            if index[i] >= 0:
                frames[index[i]] += 1 if accepted[i] else -1
                if accepted[i]:
                    stamps[index[i]] = stamp
    mean, P, W = _initialise(mean, P, W, index, z)
    joined, stamps, frames = joined[:local].copy(), stamps[:local].copy(), frames[:local].copy()
    return mean, P, W, seen, joined, stamps, frames, known, known - used


@njit(cache=True)
def _place(rows: IntArray, row: int) -> int:
    """Where a row stands among others, -1 if it does not."""
    for k in range(len(rows)):
        if rows[k] == row:
            return k
    return -1


@njit(cache=True)
def _with_columns(seen: IntArray, W: FloatArray, index: IntArray) -> tuple[IntArray, FloatArray]:
    """The rows of the landmarks seen so far, and the sensitivity to them, with those that are seen first by a frame:
    nothing depends on them yet."""
    rows, count = np.empty(len(seen) + len(index), dtype=np.int64), len(seen)
    for k in range(count):
        rows[k] = seen[k]
    for i in range(len(index)):
        if index[i] < 0 and _place(seen, -1 - index[i]) < 0:
            rows[count] = -1 - index[i]
            count += 1
    wider = np.zeros((len(W), 2 * count))
    for q in range(len(W)):
        for k in range(W.shape[1]):
            wider[q, k] = W[q, k]
    return rows[:count].copy(), wider


@njit(cache=True)
def _correct(
    mean: FloatArray,
    P: FloatArray,
    W: FloatArray,
    seen: IntArray,
    p_DL: FloatArray,
    heading: float,
    considered: FloatArray,
    index: IntArray,
    z: FloatArray,
) -> BoolArray:
    """Correct mean, P and W in place by one frame; which sightings were inside their gate.

    All tags are linearised at the same state: gain S^-1 H (P, P_xy), landmarks left as they are.
    """
    accepted, known = np.zeros(len(index), dtype=np.bool_), np.empty(len(index), dtype=np.int64)
    # Of each known tag: where its position begins in the state, or in the columns of W, and in those of `shared`.
    at, of = np.empty(len(index), dtype=np.int64), np.empty(len(index), dtype=np.int64)
    rows = np.empty(len(index), dtype=np.int64)
    m, count, size, width = 0, 0, len(mean), W.shape[1]
    for i in range(len(index)):
        if index[i] == NEW:
            continue
        known[m], at[m] = i, CORE + 2 * index[i]
        if index[i] < 0:
            at[m], of[m], rows[count] = 2 * _place(seen, -1 - index[i]), 2 * count, -1 - index[i]
            count += 1
        m += 1
    shared = covariance_in_departure_frame(considered, heading, p_DL, seen, rows[:count])
    # By pose and tag; H (P, P_xy) as covariance with the state and sensitivity to the landmarks, and the residual.
    H, S = np.zeros((2 * m, 5)), np.zeros((2 * m, 2 * m))
    Y = np.zeros((2 * m, size + width + 1))
    for a in range(m):
        i, local = known[a], index[known[a]] >= 0
        if local:
            dx, dy = mean[at[a]] - mean[0], mean[at[a] + 1] - mean[1]
        else:
            dx, dy = p_DL[-1 - index[i], 0] - mean[0], p_DL[-1 - index[i], 1] - mean[1]
        r2 = max(dx * dx + dy * dy, 1e-6)
        r = math.sqrt(r2)
        b = 2 * a
        H[b, 0], H[b, 1], H[b, 3], H[b, 4] = -dx / r, -dy / r, dx / r, dy / r
        H[b + 1, 0], H[b + 1, 1], H[b + 1, 2], H[b + 1, 3], H[b + 1, 4] = dy / r2, -dx / r2, -1.0, -dy / r2, dx / r2
        Y[b, -1], Y[b + 1, -1] = z[i, 0] - r, wrap(z[i, 1] - (math.atan2(dy, dx) - mean[2]))
        for j in range(3):
            _add(Y, b, 0, H[b, j], H[b + 1, j], P[j])
            _add(Y, b, size, H[b, j], H[b + 1, j], W[j])
        for j in range(2):
            u, v = H[b, 3 + j], H[b + 1, 3 + j]
            if local:
                _add(Y, b, 0, u, v, P[at[a] + j])
                _add(Y, b, size, u, v, W[at[a] + j])
                continue
            Y[b, size + at[a] + j] += u
            Y[b + 1, size + at[a] + j] += v
            for q in range(size):
                value = 0.0
                for k in range(width):
                    value += W[q, k] * shared[k, of[a] + j]
                Y[b, q] += u * value
                Y[b + 1, q] += v * value
    for a in range(m):
        local = index[known[a]] >= 0
        for b in range(2 * a, 2 * m):
            for j in range(5):
                # The covariance of the one tag's sighting with the other one's pose and tag.
                value = 0.0
                if j < 3:
                    value = Y[b, j]
                elif local:
                    value = Y[b, at[a] + j - 3]
                else:
                    for k in range(width):
                        value += Y[b, size + k] * shared[k, of[a] + j - 3]
                S[b, 2 * a] += H[2 * a, j] * value
                S[b, 2 * a + 1] += H[2 * a + 1, j] * value
        for f in range(2):
            S[2 * a + f, 2 * a + f] += z[known[a], 2 + f] ** 2
    for a in range(m):
        b = 2 * a
        x, xy, y, u, v = S[b, b], S[b + 1, b], S[b + 1, b + 1], Y[b, -1], Y[b + 1, -1]
        accepted[known[a]] = y * u * u - 2.0 * xy * u * v + x * v * v <= GATE * (x * y - xy * xy)
        if not accepted[known[a]]:
            # What is outside its gate says nothing.
            for f in range(b, b + 2):
                for k in range(2 * m):
                    S[f, k], S[k, f] = 0.0, 0.0
                for k in range(Y.shape[1]):
                    Y[f, k] = 0.0
                S[f, f] = 1.0
    # S = G G^T, Y = G^-1 (H P, ...), so that P - Y^T Y is symmetric and the gain is Y^T G^-1.
    for a in range(2 * m):
        for b in range(a + 1):
            value = S[a, b]
            for j in range(b):
                value -= S[a, j] * S[b, j]
            S[a, b] = math.sqrt(max(value, 1e-18)) if a == b else value / S[b, b]
        for b in range(a):
            for q in range(Y.shape[1]):
                Y[a, q] -= S[a, b] * Y[b, q]
        for q in range(Y.shape[1]):
            Y[a, q] /= S[a, a]
        for q in range(size):
            mean[q] += Y[a, -1] * Y[a, q]
            for k in range(size):
                P[q, k] -= Y[a, q] * Y[a, k]
            for k in range(width):
                W[q, k] -= Y[a, q] * Y[a, size + k]
    mean[2] = wrap(mean[2])
    return accepted


@njit(cache=True)
def _add(target: FloatArray, row: int, begin: int, u: float, v: float, source: FloatArray) -> None:
    """Add a row times u and v to two rows, from a column on."""
    for q in range(len(source)):
        target[row, begin + q] += u * source[q]
        target[row + 1, begin + q] += v * source[q]


@njit(cache=True)
def _initialise(
    mean: FloatArray, covariance: FloatArray, sensitivity: FloatArray, index: IntArray, z: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The filter with a local tag more for each new sighting; z: range, bearing and their sigmas."""
    old, size = len(mean), len(mean)
    for i in range(len(index)):
        size += 2 * (index[i] == NEW)
    if size == old:
        return mean, covariance, sensitivity
    joined, P, W = np.empty(size), np.empty((size, size)), np.empty((size, sensitivity.shape[1]))
    for q in range(old):
        joined[q] = mean[q]
        for k in range(old):
            P[q, k] = covariance[q, k]
        for k in range(W.shape[1]):
            W[q, k] = sensitivity[q, k]
    k = old
    for i in range(len(index)):
        if index[i] != NEW:
            continue
        angle = mean[2] + z[i, 1]
        c, s = math.cos(angle), math.sin(angle)
        # The tag moves with the robot, and the robot's heading has a lever.
        for e, place, lever in ((0, z[i, 0] * c, -z[i, 0] * s), (1, z[i, 0] * s, z[i, 0] * c)):
            joined[k + e] = mean[e] + place
            for q in range(k + e):
                P[k + e, q] = P[e, q] + lever * P[2, q]
                P[q, k + e] = P[k + e, q]
            P[k + e, k + e] = P[k + e, e] + lever * P[k + e, 2]
            for q in range(W.shape[1]):
                W[k + e, q] = W[e, q] + lever * W[2, q]
        along, across = z[i, 2] ** 2, (z[i, 0] * z[i, 3]) ** 2
        P[k, k] += along * c * c + across * s * s
        P[k + 1, k + 1] += along * s * s + across * c * c
        P[k, k + 1] += (along - across) * c * s
        P[k + 1, k] += (along - across) * c * s
        k += 2
    return joined, P, W
