"""The localiser's filter in plain arrays, called for each odometry message and frame: see `localizer.Localizer`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.slam.odometry_model import predict_increment, wrap
from tfg_drake.slam.shared import CAMERA_YAW, CLOCK, LEVER_X, LEVER_Y, RANGE_SCALE, SHARED

# mean (3 + 2k,), covariance P (3 + 2k, 3 + 2k) and sensitivity W (3 + 2k, 13 + 2s).
State = tuple[FloatArray, FloatArray, FloatArray]
# The shared parameters (13,), and C (13 + 2s, 13 + 2s), the covariance of these and of the landmarks seen.
Considered = tuple[FloatArray, FloatArray]
# An increment (3,) of `odometry_model.arc`, over so many seconds, and the noise (3,) of `random_walks`.
Motion = tuple[FloatArray, float, FloatArray]
# twist (2,) of the robot at a frame, m/s and rad/s, and how much the camera's clock was taken to be ahead, s.
Instant = tuple[FloatArray, float]
# Where the tags (m,) of a frame are, the last two of `whereabouts`, and p_DL (s, 2), where the landmarks seen are.
Places = tuple[IntArray, IntArray, FloatArray]
# Ranges and bearings (m,) of a frame, m and rad, and their standard deviations.
Frame = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
POSE = 3
# Squared deviations beyond which a sighting is ignored (2 degrees of freedom): 1 in 270 000 good ones.
GATE = 25.0


@njit(cache=True)
def whereabouts(
    ids: IntArray, map_ids: IntArray, seen: IntArray, local_ids: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Of each tag (m,) its row among map_ids, ascending, where it begins in W's columns if it is in the rows `seen`,
    and where in the state if it is a local tag; -1 where it is not there."""
    row, column, entry = np.full(len(ids), -1), np.full(len(ids), -1), np.full(len(ids), -1)
    for i in range(len(ids)):
        at = np.searchsorted(map_ids, ids[i])
        if at < len(map_ids) and map_ids[at] == ids[i]:
            row[i] = at
            for k in np.flatnonzero(seen == at):
                column[i] = SHARED + 2 * k
        else:
            for k in np.flatnonzero(local_ids == ids[i]):
                entry[i] = POSE + 2 * k
    return row, column, entry


@njit(cache=True)
def pose_in_map(
    state: State, considered: Considered, motion: Motion, X_MD: FloatArray, with_D: FloatArray, of_map: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """X_MB (3,) and its covariance (3, 3), an odometry increment on. with_D: (13 + 2s, 3) covariance with X_MD (3,),
    whose own is the end of of_map."""
    mean, P, W = state[0][:POSE].copy(), state[1][:POSE, :POSE].copy(), state[2][:POSE].copy()
    _predict((mean, P, W), considered, motion)
    by_B = _turn(X_MD[2])
    x, y, turn = by_B @ mean
    by_D = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    across = by_B @ (W @ with_D) @ by_D.T
    of_D = by_D @ of_map[-POSE:, -POSE:].copy() @ by_D.T
    X_MB = np.array([X_MD[0] + x, X_MD[1] + y, wrap(X_MD[2] + turn)])
    return X_MB, by_B @ P @ by_B.T + across + across.T + of_D


@njit(cache=True)
def filtered(
    state: State, considered: Considered, motion: Motion, instant: Instant, places: Places, frame: Frame
) -> tuple[State, BoolArray]:
    """The state an odometry increment on, corrected by a frame and with its new tags, in its order; and which of its
    sightings (m,) are of known tags and inside their gate."""
    state, z = (state[0].copy(), state[1].copy(), state[2].copy()), np.column_stack(frame)
    _predict(state, considered, motion)
    accepted, new = _correct(state, considered, instant, places, z), (places[0] < 0) & (places[1] < 0)
    return _with_local(state, considered, instant, z[new]) if new.any() else state, accepted


@njit(cache=True)
def _turn(theta: float) -> FloatArray:
    """How a heading turns a pose: (3, 3)."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@njit(cache=True)
def _predict(state: State, considered: Considered, motion: Motion) -> None:
    """Bring the state an odometry increment on, in place."""
    (mean, P, W), (shared, C) = state, considered
    X, on_calibration, Q = predict_increment(motion[0], motion[1], shared[:3], motion[2])
    R = _turn(mean[2])
    x, y, B = R[0, 0] * X[0] + R[0, 1] * X[1], R[1, 0] * X[0] + R[1, 1] * X[1], R @ on_calibration
    # Half of what the covariance of the pose with the whole state gains: its transpose is the other half.
    gain = W @ C[:3].T @ B.T
    for of_pose in (P, W, gain):
        _move(of_pose, x, y)
    gain[:POSE] += 0.5 * (B @ C[:3, :3].copy() @ B.T + R @ Q @ R.T)
    _move(P.T, x, y)
    P[:, :POSE] += gain
    P[:POSE] += gain.T
    W[:POSE, :3] += B
    mean[0], mean[1], mean[2] = mean[0] + x, mean[1] + y, wrap(mean[2] + X[2])


@njit(cache=True)
def _move(rows: FloatArray, x: float, y: float) -> None:
    """Errors of a pose (3, n), and of what is below it, when it moves by (x, y): that of its heading has this lever."""
    rows[0] -= y * rows[2]
    rows[1] += x * rows[2]


@njit(cache=True)
def _camera(mean: FloatArray, shared: FloatArray, instant: Instant) -> FloatArray:
    """X_DC (3,), where the camera was and looked when the frame was taken."""
    twist, earlier = instant[0], shared[CLOCK] - instant[1]
    lever = np.array([shared[LEVER_X] - earlier * twist[0], shared[LEVER_Y], shared[CAMERA_YAW] - earlier * twist[1]])
    return np.asarray(mean[:POSE] + _turn(mean[2]) @ lever)


@njit(cache=True)
def _sighting(
    mean: FloatArray, shared: FloatArray, twist: FloatArray, X_DC: FloatArray, x: float, y: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Range and bearing (2,) of a tag at (x, y) from a camera at X_DC (3,), and their derivatives on its place (2, 2),
    the pose (2, 3) and the parameters (2, 13)."""
    dx, dy, c, s = x - X_DC[0], y - X_DC[1], math.cos(mean[2]), math.sin(mean[2])
    r, scale = max(math.hypot(dx, dy), 1e-3), 1.0 + shared[RANGE_SCALE]
    on = np.array([[scale * dx / r, scale * dy / r], [-dy / (r * r), dx / (r * r)]])
    by_pose, by_shared = np.zeros((2, POSE)), np.zeros((2, SHARED))
    for f in range(2):
        u, v = on[f, 0], on[f, 1]
        by_pose[f, 0], by_pose[f, 1] = -u, -v
        by_pose[f, 2] = u * (X_DC[1] - mean[1]) - v * (X_DC[0] - mean[0])
        by_shared[f, LEVER_X], by_shared[f, LEVER_Y] = -u * c - v * s, u * s - v * c
        by_shared[f, CLOCK] = -twist[0] * by_shared[f, LEVER_X]
    by_pose[1, 2] -= 1.0
    by_shared[1, CLOCK] += twist[1]
    by_shared[1, CAMERA_YAW], by_shared[0, RANGE_SCALE] = -1.0, r
    return np.array([scale * r, math.atan2(dy, dx) - X_DC[2]]), on, by_pose, by_shared


@njit(cache=True)
def _correct(state: State, considered: Considered, instant: Instant, places: Places, z: FloatArray) -> BoolArray:
    """Correct the state by the known tags of a frame, all at once, in place; which of its sightings (m,) were of these
    and inside their gate. Landmarks and parameters are left as they are."""
    mean, (shared, C), (column, entry, p_DL) = state[0], considered, places
    known = np.flatnonzero((column >= 0) | (entry >= 0))
    m, X_DC, accepted = 2 * len(known), _camera(mean, shared, instant), np.zeros(len(z), dtype=np.bool_)
    H, H_c, residual, noise = np.zeros((m, len(mean))), np.zeros((m, len(C))), np.empty(m), np.empty(m)
    for k in range(len(known)):
        i, a, b = known[k], 2 * k, 2 * k + 2
        if entry[i] >= 0:
            into, at, x, y = H, entry[i], mean[entry[i]], mean[entry[i] + 1]
        else:
            of = (column[i] - SHARED) // 2
            into, at, x, y = H_c, column[i], p_DL[of, 0], p_DL[of, 1]
        expected, into[a:b, at : at + 2], H[a:b, :POSE], H_c[a:b, :SHARED] = _sighting(
            mean, shared, instant[0], X_DC, x, y
        )
        residual[a:b], noise[a:b] = z[i, :2] - expected, z[i, 2:] ** 2
        residual[a + 1] = wrap(residual[a + 1])
    accepted[known] = update(state, C, H, H_c, residual, noise)
    return accepted


@njit(cache=True)
def update(
    state: State, C: FloatArray, H: FloatArray, H_c: FloatArray, residual: FloatArray, noise: FloatArray
) -> BoolArray:
    """Correct the state, in place, by pairs of measurements that are off by residual (2m,) with variances noise (2m,)
    and derivatives H (2m, 3 + 2k) on the state and H_c (2m, 13 + 2s) on what is considered; which pairs (m,) are inside
    their gate, and are used."""
    (mean, P, W), accepted = state, np.zeros(len(residual) // 2, dtype=np.bool_)
    HW, CH = H @ W + H_c, C @ H_c.T
    HP = H @ P + (W @ CH).T
    S = HP @ H.T + HW @ CH + np.diag(noise)
    for k in range(len(accepted)):
        a, b = 2 * k, 2 * k + 1
        xx, xy, yy, x, y = S[a, a], S[a, b], S[b, b], residual[a], residual[b]
        accepted[k] = yy * x * x - 2.0 * xy * x * y + xx * y * y <= GATE * (xx * yy - xy * xy)
    if accepted.any():
        kept = np.flatnonzero(np.repeat(accepted, 2))
        # S = G G^T, and G^-1 (H P, H W, residual): so P - (H P)^T S^-1 H P remains symmetric.
        G = np.linalg.cholesky(S[kept][:, kept])
        HP, HW, nu = np.linalg.solve(G, HP[kept]), np.linalg.solve(G, HW[kept]), np.linalg.solve(G, residual[kept])
        mean += HP.T @ nu
        mean[2] = wrap(mean[2])
        P -= HP.T @ HP
        W -= HP.T @ HW
    return accepted


@njit(cache=True)
def _with_local(state: State, considered: Considered, instant: Instant, z: FloatArray) -> State:
    """The state with a local tag more for each sighting z (m, 4)."""
    (mean, P, W), (shared, C), m, size = state, considered, 2 * len(z), len(state[0])
    G, G_c, noise, p_DU = np.zeros((m, POSE)), np.zeros((m, len(C))), np.zeros((m, m)), np.empty(m)
    X_DC, scale = _camera(mean, shared, instant), 1.0 + shared[RANGE_SCALE]
    for k in range(len(z)):
        a, b, r, angle = 2 * k, 2 * k + 2, z[k, 0] / scale, X_DC[2] + z[k, 1]
        u, v = math.cos(angle), math.sin(angle)
        p_DU[a:b] = X_DC[0] + r * u, X_DC[1] + r * v
        _, _, by_pose, by_shared = _sighting(mean, shared, instant[0], X_DC, p_DU[a], p_DU[a + 1])
        # It moves as it must so that it would be seen where it was.
        back = np.array([[u / scale, -r * v], [v / scale, r * u]])
        G[a:b], G_c[a:b, :SHARED], by_noise = -back @ by_pose, -back @ by_shared, back * z[k, 2:]
        noise[a:b, a:b] = by_noise @ by_noise.T
    GW, CG = G @ W[:POSE] + G_c, C @ G_c.T
    GP = G @ P[:POSE] + (W @ CG).T
    joined = np.empty((size + m, size + m))
    joined[:size, :size], joined[size:, :size], joined[:size, size:] = P, GP, GP.T
    joined[size:, size:] = GP[:, :POSE].copy() @ G.T + GW @ CG + noise
    return np.append(mean, p_DU), joined, np.vstack((W, GW))
