"""The filter between goals: pose, odometry calibration and tags met on the way, beside landmarks it only considers.

State x: pose (3) in the frame the filter started in, calibration (3) of the odometry model, local tags (2 each) that
enter under flat priors at their first sighting. Considered: landmarks y of the map with their joint covariance P_yy
and the cross covariance P_xy (Schmidt's consider filter): they inform the pose, with their uncertainty, and are never
updated themselves. Further quantities that no sighting depends on may be carried along behind them. Without considered
landmarks it is plain EKF SLAM.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray, TagDetections, message, replace
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
    (6 + 2k, 6 + 2k). cross: (6 + 2k, 2n + e) covariance with what is considered. local_ids, last_seen: (k,) ids and
    stamps (s). map_ids: (n,) ascending and p_DL: (n, 2) of the considered landmarks. considered: (2n + e, 2n + e)
    covariance of those, row by row, and of e further quantities.
    """

    mean: FloatArray
    covariance: FloatArray
    cross: FloatArray
    local_ids: IntArray
    last_seen: FloatArray
    map_ids: IntArray
    p_DL: FloatArray
    considered: FloatArray


def start(model: OdometryModel, map_ids: IntArray, p_DL: FloatArray, considered: FloatArray) -> PoseFilter:
    """A filter at the origin of its frame, known exactly, that considers n landmarks (see PoseFilter)."""
    covariance = np.zeros((CORE, CORE))
    covariance[POSE:, POSE:] = model.calibration_covariance
    return PoseFilter(
        mean=np.concatenate([np.zeros(POSE), model.calibration]),
        covariance=covariance,
        cross=np.zeros((CORE, len(considered))),
        local_ids=np.empty(0, dtype=np.int64),
        last_seen=np.empty(0),
        map_ids=map_ids,
        p_DL=p_DL,
        considered=considered,
    )


def start_alone(model: OdometryModel) -> PoseFilter:
    """A filter at the origin of its frame, known exactly, that considers nothing."""
    return start(model, np.empty(0, dtype=np.int64), np.empty((0, 2)), np.empty((0, 0)))


def step(
    filter_: PoseFilter, model: OdometryModel, increment: FloatArray, dt: float, detections: TagDetections
) -> tuple[PoseFilter, int, int]:
    """The filter after an odometry increment (3,) of `odometry_model.arc` over dt seconds and the frame at its end.

    Known tags correct it, all at once, unknown ones join it. A tag is looked up among the considered landmarks, then
    among the local tags. A sighting outside its gate is ignored. Also returns how many sightings were of known tags,
    and how many of those were ignored.
    """
    mean, covariance, cross, local_ids, last_seen, known, ignored = _step(
        filter_.mean,
        filter_.covariance,
        filter_.cross,
        filter_.local_ids,
        filter_.last_seen,
        filter_.map_ids,
        filter_.p_DL,
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
    moved = replace(filter_, mean=mean, covariance=covariance, cross=cross, local_ids=local_ids, last_seen=last_seen)
    return moved, known, ignored


def keep_local(filter_: PoseFilter, keep: BoolArray) -> PoseFilter:
    """The filter with only some (k,) of its local tags: the others are marginalised out."""
    if np.all(keep):
        return filter_
    rows = np.concatenate([np.ones(CORE, dtype=bool), np.repeat(keep, 2)])
    return replace(
        filter_,
        mean=filter_.mean[rows],
        covariance=filter_.covariance[np.ix_(rows, rows)],
        cross=filter_.cross[rows],
        local_ids=filter_.local_ids[keep],
        last_seen=filter_.last_seen[keep],
    )


@njit(cache=True)
def _index(ids: IntArray, map_ids: IntArray, local_ids: IntArray) -> IntArray:
    index = np.full(len(ids), NEW)
    for i in range(len(ids)):
        row, end = 0, len(map_ids)
        while row < end:
            middle = (row + end) // 2
            if map_ids[middle] < ids[i]:
                row = middle + 1
            else:
                end = middle
        if row < len(map_ids) and map_ids[row] == ids[i]:
            index[i] = -1 - row
        else:
            for k in range(len(local_ids)):
                if local_ids[k] == ids[i]:
                    index[i] = k
    return index


@njit(cache=True)
def motion(
    mean: FloatArray, increment: FloatArray, dt: float, noise: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What an odometry increment does to the pose: the state (6,) after it, F (3, 6) and N (3, 3).

    The pose's error is F times that of the state before it, and a random one of covariance N. mean: (6 + 2k,) as in
    PoseFilter; increment, dt and noise as in `predict_increment`.
    """
    X, on_calibration, Q = predict_increment(increment, dt, mean[POSE:CORE], noise)
    c, s = math.cos(mean[2]), math.sin(mean[2])
    dx, dy = c * X[0] - s * X[1], s * X[0] + c * X[1]
    state = mean[:CORE].copy()
    state[0] += dx
    state[1] += dy
    state[2] = wrap(mean[2] + X[2])
    # Identity, the lever of the heading, and the calibration, turned as the motion is.
    F = np.zeros((POSE, CORE))
    F[0, 0] = F[1, 1] = F[2, 2] = 1.0
    F[0, 2], F[1, 2] = -dy, dx
    N = np.empty((POSE, POSE))
    for j in range(3):
        F[0, 3 + j] = c * on_calibration[0, j] - s * on_calibration[1, j]
        F[1, 3 + j] = s * on_calibration[0, j] + c * on_calibration[1, j]
        F[2, 3 + j] = on_calibration[2, j]
        N[0, j], N[1, j], N[2, j] = c * Q[0, j] - s * Q[1, j], s * Q[0, j] + c * Q[1, j], Q[2, j]
    for i in range(3):
        N[i, 0], N[i, 1] = c * N[i, 0] - s * N[i, 1], s * N[i, 0] + c * N[i, 1]
    return state, F, N


@njit(cache=True)
def _predict(
    mean: FloatArray,
    covariance: FloatArray,
    cross: FloatArray,
    increment: FloatArray,
    dt: float,
    noise: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    mean, P, cross = mean.copy(), covariance.copy(), cross.copy()
    state, F, N = motion(mean, increment, dt, noise)
    _move(F, P)
    for k in range(len(mean)):
        row = np.zeros(POSE)
        for i in range(POSE):
            for j in range(CORE):
                row[i] += F[i, j] * P[k, j]
        for i in range(POSE):
            P[k, i] = row[i] + (N[k, i] if k < POSE else 0.0)
    _move(F, cross)
    for i in range(POSE):
        mean[i] = state[i]
    return mean, P, cross


@njit(cache=True)
def _step(
    mean: FloatArray,
    covariance: FloatArray,
    cross: FloatArray,
    local_ids: IntArray,
    last_seen: FloatArray,
    map_ids: IntArray,
    p_DL: FloatArray,
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
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, FloatArray, int, int]:
    mean, P, cross = _predict(mean, covariance, cross, increment, dt, noise)
    index = _index(ids, map_ids, local_ids)
    z = np.empty((len(ids), 4))
    new = 0
    for i in range(len(ids)):
        z[i, 0], z[i, 1], z[i, 2], z[i, 3] = range_[i], bearing[i], sigma_range[i], sigma_bearing[i]
        new += index[i] == NEW
    accepted = _correct(mean, P, cross, p_DL, considered, index, z, GATE)
    local = len(local_ids)
    joined, seen = np.empty(local + new, dtype=np.int64), np.full(local + new, stamp)
    for k in range(local):
        joined[k], seen[k] = local_ids[k], last_seen[k]
    fresh, used = np.empty((new, 4)), 0
    new = 0
    for i in range(len(ids)):
        used += accepted[i]
        if index[i] == NEW:
            joined[local + new] = ids[i]
            for e in range(4):
                fresh[new, e] = z[i, e]
            new += 1
        elif accepted[i] and index[i] >= 0:
            seen[index[i]] = stamp
    if new > 0:
        mean, P, cross = _initialise(mean, P, cross, fresh)
    known = len(ids) - new
    return mean, P, cross, joined, seen, known, known - used


@njit(cache=True)
def _move(F: FloatArray, rows: FloatArray) -> None:
    """Put F (3, 6) times the first six rows in the place of the first three."""
    moved = np.zeros((POSE, rows.shape[1]))
    for i in range(POSE):
        for j in range(CORE):
            _add(moved[i], F[i, j], rows[j])
    for i in range(POSE):
        for k in range(rows.shape[1]):
            rows[i, k] = moved[i, k]


@njit(cache=True)
def _correct(
    mean: FloatArray,
    P: FloatArray,
    cross: FloatArray,
    p_DL: FloatArray,
    considered: FloatArray,
    index: IntArray,
    z: FloatArray,
    gate: float,
) -> BoolArray:
    """Correct mean, P and cross in place by one frame; which sightings were inside their gate.

    All tags are linearised at the same state: gain S^-1 H (P, P_xy), landmarks left as they are.
    """
    accepted = np.zeros(len(index), dtype=np.bool_)
    H_x = np.zeros((len(index), 2, 3))
    H_p = np.zeros((len(index), 2, 2))
    residual = np.zeros((len(index), 2))
    for i in range(len(index)):
        if index[i] == NEW:
            continue
        if index[i] >= 0:
            k = 6 + 2 * index[i]
            dx, dy = mean[k] - mean[0], mean[k + 1] - mean[1]
        else:
            dx, dy = p_DL[-1 - index[i], 0] - mean[0], p_DL[-1 - index[i], 1] - mean[1]
        r2 = max(dx * dx + dy * dy, 1e-6)
        r = math.sqrt(r2)
        residual[i, 0] = z[i, 0] - r
        residual[i, 1] = wrap(z[i, 1] - (math.atan2(dy, dx) - mean[2]))
        H_p[i, 0, 0], H_p[i, 0, 1] = dx / r, dy / r
        H_p[i, 1, 0], H_p[i, 1, 1] = -dy / r2, dx / r2
        H_x[i, 0, 0], H_x[i, 0, 1], H_x[i, 1, 0], H_x[i, 1, 1] = -dx / r, -dy / r, dy / r2, -dx / r2
        H_x[i, 1, 2] = -1.0
        accepted[i] = _inside_gate(P, cross, considered, index[i], H_x[i], H_p[i], residual[i], z[i], gate)
    used, m = np.empty(len(index), dtype=np.int64), 0
    for i in range(len(index)):
        if accepted[i]:
            used[m] = i
            m += 1
    size = len(mean)
    # Rows of H (P, P_xy): covariance of the predicted sightings with the state and with the landmarks.
    HP = np.zeros((2 * m, size))
    HC = np.zeros((2 * m, cross.shape[1]))
    for a in range(m):
        i = used[a]
        for e in range(2):
            row, row_c = HP[2 * a + e], HC[2 * a + e]
            for j in range(3):
                _add(row, H_x[i, e, j], P[j])
                _add(row_c, H_x[i, e, j], cross[j])
            for j in range(2):
                if index[i] >= 0:
                    k = 6 + 2 * index[i] + j
                    _add(row, H_p[i, e, j], P[k])
                    _add(row_c, H_p[i, e, j], cross[k])
                else:
                    k = 2 * (-1 - index[i]) + j
                    for q in range(size):
                        row[q] += H_p[i, e, j] * cross[q, k]
                    _add(row_c, H_p[i, e, j], considered[k])
    S = np.zeros((2 * m, 2 * m))
    nu = np.zeros(2 * m)
    for a in range(m):
        i = used[a]
        for e in range(2):
            nu[2 * a + e] = residual[i, e]
            for b in range(2 * m):
                value = 0.0
                for j in range(3):
                    value += H_x[i, e, j] * HP[b, j]
                for j in range(2):
                    if index[i] >= 0:
                        value += H_p[i, e, j] * HP[b, 6 + 2 * index[i] + j]
                    else:
                        value += H_p[i, e, j] * HC[b, 2 * (-1 - index[i]) + j]
                S[2 * a + e, b] = value
            S[2 * a + e, 2 * a + e] += z[i, 2 + e] * z[i, 2 + e]
    # S = G G^T, Y = G^-1 H P, so that P - Y^T Y is symmetric; K^T = G^-T Y.
    for a in range(2 * m):
        for b in range(a + 1):
            value = S[a, b]
            for j in range(b):
                value -= S[a, j] * S[b, j]
            S[a, b] = math.sqrt(max(value, 1e-18)) if a == b else value / S[b, b]
    for a in range(2 * m):
        for b in range(a):
            _add(HP[a], -S[a, b], HP[b])
            nu[a] -= S[a, b] * nu[b]
        for q in range(size):
            HP[a, q] /= S[a, a]
        nu[a] /= S[a, a]
    for a in range(2 * m):
        _add(mean, nu[a], HP[a])
        for q in range(size):
            _add(P[q], -HP[a, q], HP[a])
    mean[2] = wrap(mean[2])
    if cross.shape[1] > 0:
        gain = HP.copy()
        for a in range(2 * m - 1, -1, -1):
            for b in range(a + 1, 2 * m):
                _add(gain[a], -S[b, a], gain[b])
            for q in range(size):
                gain[a, q] /= S[a, a]
        for q in range(size):
            for a in range(2 * m):
                _add(cross[q], -gain[a, q], HC[a])
    return accepted


@njit(cache=True)
def _add(target: FloatArray, factor: float, source: FloatArray) -> None:
    for q in range(len(source)):
        target[q] += factor * source[q]


@njit(cache=True)
def _inside_gate(
    covariance: FloatArray,
    cross: FloatArray,
    considered: FloatArray,
    index: int,
    H_x: FloatArray,
    H_p: FloatArray,
    residual: FloatArray,
    z: FloatArray,
    gate: float,
) -> bool:
    """Whether one sighting is within its Mahalanobis gate."""
    k = 6 + 2 * index if index >= 0 else 2 * (-1 - index)
    joint = np.empty((5, 5))
    for i in range(3):
        for j in range(3):
            joint[i, j] = covariance[i, j]
        for j in range(2):
            joint[i, 3 + j] = joint[3 + j, i] = covariance[i, k + j] if index >= 0 else cross[i, k + j]
    for i in range(2):
        for j in range(2):
            joint[3 + i, 3 + j] = covariance[k + i, k + j] if index >= 0 else considered[k + i, k + j]
    S = np.zeros((2, 2))
    for i in range(5):
        for j in range(5):
            for e in range(2):
                for f in range(2):
                    left = H_x[e, i] if i < 3 else H_p[e, i - 3]
                    right = H_x[f, j] if j < 3 else H_p[f, j - 3]
                    S[e, f] += left * joint[i, j] * right
    a, b, d = S[0, 0] + z[2] * z[2], S[0, 1], S[1, 1] + z[3] * z[3]
    u, v = residual[0], residual[1]
    return bool(d * u * u - 2.0 * b * u * v + a * v * v <= gate * (a * d - b * b))


@njit(cache=True)
def _initialise(
    mean: FloatArray, covariance: FloatArray, cross: FloatArray, z: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The filter with a local tag more for each sighting (range, bearing and their sigmas)."""
    old, new = len(mean), 2 * len(z)
    joined = np.empty(old + new)
    P = np.zeros((old + new, old + new))
    C = np.zeros((old + new, cross.shape[1]))
    for i in range(old):
        joined[i] = mean[i]
        _add(P[i], 1.0, covariance[i])
        _add(C[i], 1.0, cross[i])
    J = np.zeros((new, 3))
    for i in range(len(z)):
        r, angle = z[i, 0], mean[2] + z[i, 1]
        c, s = math.cos(angle), math.sin(angle)
        joined[old + 2 * i], joined[old + 2 * i + 1] = mean[0] + r * c, mean[1] + r * s
        J[2 * i, 0] = J[2 * i + 1, 1] = 1.0
        J[2 * i, 2], J[2 * i + 1, 2] = -r * s, r * c
    for i in range(new):
        for j in range(3):
            _add(P[old + i], J[i, j], covariance[j])
            _add(C[old + i], J[i, j], cross[j])
    for i in range(new):
        for j in range(old):
            P[j, old + i] = P[old + i, j]
        for k in range(new):
            for j in range(3):
                P[old + i, old + k] += P[old + i, j] * J[k, j]
    for i in range(len(z)):
        angle = mean[2] + z[i, 1]
        c, s = math.cos(angle), math.sin(angle)
        along, across = z[i, 2] ** 2, (z[i, 0] * z[i, 3]) ** 2
        k = old + 2 * i
        P[k, k] += along * c * c + across * s * s
        P[k + 1, k + 1] += along * s * s + across * c * c
        P[k, k + 1] += (along - across) * c * s
        P[k + 1, k] += (along - across) * c * s
    return joined, P, C
