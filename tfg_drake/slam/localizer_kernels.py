"""Kernels of the localiser's filter, called for each odometry message, frame and scan, see `localizer.Localizer`."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.slam.measurement import (
    CAMERA,
    COLUMNS,
    ERROR,
    OF_LANDMARK,
    OF_MOUNT,
    OF_SENSOR,
    OF_TWIST,
    SCANNER,
    linearise_tag,
    linearise_wall,
    look_of,
    sensor_pose,
)
from tfg_drake.slam.odometry_model import predict_increment, wrap
from tfg_drake.slam.scan_lines import bearing_of
from tfg_drake.slam.shared import CLOCK, RANGE_SCALE, SHARED
from tfg_drake.slam.walls import OVERLAP, SAME_DIRECTION, UNCLEAR, WallSet

# mean (3 + 2k,), covariance P (3 + 2k, 3 + 2k) and sensitivity W (3 + 2k, 13 + 2s).
State = tuple[FloatArray, FloatArray, FloatArray]
# The shared parameters (13,), and C (13 + 2s, 13 + 2s), the covariance of these and of the landmarks seen.
Considered = tuple[FloatArray, FloatArray]
# An increment (3,) of `odometry_model.arc`, its duration, s, and the noise (3,) of `random_walks`.
Motion = tuple[FloatArray, float, FloatArray]
# The robot's twist (2,) at a frame, m/s and rad/s, and the assumed offset of the camera's clock, ahead, s.
Instant = tuple[FloatArray, float]
# For each tag (m,) of a frame its first column of W if it is a seen landmark, and its first index in the state if it is
# a local tag, -1 otherwise; and the places p_DL (s, 2) of the seen landmarks.
Places = tuple[IntArray, IntArray, FloatArray]
# Bearings and ranges (m,) of a frame, rad and m, and their standard deviations.
Frame = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
# The robot's speed and turn rate (2,) at a scan, m/s and rad/s, and their variances (2,).
Twist = tuple[FloatArray, FloatArray]
POSE = 3
# A sighting with a larger squared Mahalanobis distance is ignored (2 degrees of freedom: 1 in 270 000 good ones).
GATE = 25.0


@njit(cache=True)
def pose_in_map(
    state: State, considered: Considered, motion: Motion, X_MD: FloatArray, with_D: FloatArray, of_map: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return X_MB (3,) and its covariance (3, 3) after an odometry increment. with_D: (13 + 2s, 3) covariance of the
    considered with X_MD (3,), whose own is the last block of of_map."""
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
    """Return the state after an odometry increment, corrected by a frame and with its new tags, in its order; and a
    mask (m,) of its sightings of known tags that are inside their gate."""
    state, z = (state[0].copy(), state[1].copy(), state[2].copy()), np.column_stack(frame)
    _predict(state, considered, motion)
    accepted, new = _correct(state, considered, instant, places, z), (places[0] < 0) & (places[1] < 0)
    return _with_local(state, considered, instant, z[new]) if new.any() else state, accepted


@njit(cache=True)
def _turn(theta: float) -> FloatArray:
    """Return the matrix (3, 3) that rotates a pose by a heading."""
    c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@njit(cache=True)
def _predict(state: State, considered: Considered, motion: Motion) -> None:
    """Move the state on by an odometry increment, in place."""
    (mean, P, W), (shared, C) = state, considered
    X, on_calibration, Q = predict_increment(motion[0], motion[1], shared[:3], motion[2])
    R = _turn(mean[2])
    x, y, B = R[0, 0] * X[0] + R[0, 1] * X[1], R[1, 0] * X[0] + R[1, 1] * X[1], R @ on_calibration
    # Half of the gain in covariance of the pose with the whole state; its transpose is the other half.
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
    """Transform the errors of a pose, the first rows (3, n), to the pose moved by (x, y), the lever of its heading."""
    rows[0] -= y * rows[2]
    rows[1] += x * rows[2]


@njit(cache=True)
def _correct(state: State, considered: Considered, instant: Instant, places: Places, z: FloatArray) -> BoolArray:
    """Correct the state by the known tags of a frame, all at once, in place; returns a mask (m,) of its sightings of
    these that were inside their gate. Landmarks and parameters are left as they are."""
    mean, (shared, C), (column, entry, p_DL) = state[0], considered, places
    known = np.flatnonzero((column >= 0) | (entry >= 0))
    m, rows, accepted = 2 * len(known), np.empty((2, COLUMNS)), np.zeros(len(z), dtype=np.bool_)
    H, H_c, residual, noise = np.zeros((m, len(mean))), np.zeros((m, len(C))), np.empty(m), np.empty(m)
    for k in range(len(known)):
        i, a, b = known[k], 2 * k, 2 * k + 2
        if entry[i] >= 0:
            into, at, p = H, entry[i], mean[entry[i] : entry[i] + 2]
        else:
            into, at, p = H_c, column[i], p_DL[(column[i] - SHARED) // 2]
        linearise_tag(rows, mean, shared[CAMERA:], instant[1], instant[0], z[i, 0], z[i, 1], p)
        H[a:b, :POSE], H_c[a:b, CAMERA : CAMERA + OF_SENSOR] = rows[:, :POSE], rows[:, OF_MOUNT:OF_LANDMARK]
        into[a:b, at : at + 2], residual[a:b], noise[a:b] = rows[:, OF_LANDMARK:ERROR], -rows[:, ERROR], z[i, 2:] ** 2
    accepted[known] = update(state, C, H, H_c, residual, noise)
    return accepted


@njit(cache=True)
def update(
    state: State, C: FloatArray, H: FloatArray, H_c: FloatArray, residual: FloatArray, noise: FloatArray
) -> BoolArray:
    """Correct the state, in place, by pairs of measurements with residual (2m,), variances noise (2m,), and Jacobians H
    (2m, 3 + 2k) on the state and H_c (2m, 13 + 2s) on the considered; returns a mask (m,) of the pairs that are inside
    their gate, which are used."""
    mean, P, W = state
    HW, CH = H @ W + H_c, C @ H_c.T
    HP = H @ P + (W @ CH).T
    S = HP @ H.T + HW @ CH + np.diag(noise)
    x, y, xx, xy, yy = residual[::2], residual[1::2], np.diag(S)[::2], np.diag(S, 1)[::2], np.diag(S)[1::2]
    accepted = yy * x * x - 2.0 * xy * x * y + xx * y * y <= GATE * (xx * yy - xy * xy)
    if accepted.any():
        kept = np.flatnonzero(np.repeat(accepted, 2))
        # With S = G G^T and G^-1 (H P, H W, residual), P - (H P)^T S^-1 H P remains symmetric.
        G = np.linalg.cholesky(S[kept][:, kept])
        HP, HW, nu = np.linalg.solve(G, HP[kept]), np.linalg.solve(G, HW[kept]), np.linalg.solve(G, residual[kept])
        mean += HP.T @ nu
        mean[2] = wrap(mean[2])
        P -= HP.T @ HP
        W -= HP.T @ HW
    return accepted


@njit(cache=True)
def _with_local(state: State, considered: Considered, instant: Instant, z: FloatArray) -> State:
    """Return the state with one local tag more for each sighting z (m, 4)."""
    (mean, P, W), (shared, C), m, size = state, considered, 2 * len(z), len(state[0])
    G, G_c, noise, p_DU = np.zeros((m, POSE)), np.zeros((m, len(C))), np.zeros((m, m)), np.empty(m)
    rows, camera = np.empty((2, COLUMNS)), shared[CAMERA:]
    x, y, theta = sensor_pose(mean, camera, instant[0], shared[CLOCK] - instant[1])
    for k in range(len(z)):
        a, b, r, angle = 2 * k, 2 * k + 2, z[k, 1] / (1.0 + shared[RANGE_SCALE]), theta + z[k, 0]
        p_DU[a:b] = x + r * math.cos(angle), y + r * math.sin(angle)
        linearise_tag(rows, mean, camera, instant[1], instant[0], z[k, 0], z[k, 1], p_DU[a:b])
        # Implicit derivative: the tag moves so that its measured bearing and range stay the same.
        b_x, b_y, r_x, r_y = rows[0, OF_LANDMARK], rows[0, ERROR - 1], rows[1, OF_LANDMARK], rows[1, ERROR - 1]
        back = np.array([[r_y, -b_y], [-r_x, b_x]]) / (b_x * r_y - b_y * r_x)
        by_rows = -back @ rows
        G[a:b], G_c[a:b, CAMERA : CAMERA + OF_SENSOR] = by_rows[:, :POSE], by_rows[:, OF_MOUNT:OF_LANDMARK]
        by_noise = back * z[k, 2:]
        noise[a:b, a:b] = by_noise @ by_noise.T
    GW, CG = G @ W[:POSE] + G_c, C @ G_c.T
    GP = G @ P[:POSE] + (W @ CG).T
    joined = np.empty((size + m, size + m))
    joined[:size, :size], joined[size:, :size], joined[:size, size:] = P, GP, GP.T
    joined[size:, size:] = GP[:, :POSE].copy() @ G.T + GW @ CG + noise
    return np.append(mean, p_DU), joined, np.vstack((W, GW))


@njit(cache=True)
def walls_seen(
    X_DB: FloatArray, shared: FloatArray, twist: FloatArray, lines: FloatArray, in_D: WallSet
) -> tuple[IntArray, int]:
    """Return the wall (k,) of each line (k, 11) of a scan, -1 if none or more than one matches; and the number of lines
    without one that lie behind a wall, within its reach.

    X_DB: (3,) and twist (2,): the robot's. in_D: walls in D.
    """
    found, through, (walls, p_DC, reach), mount = np.full(len(lines), -1), 0, in_D, shared[SCANNER:]
    for j in range(len(lines)):
        line, earlier = lines[j], mount[3] + mount[4] * bearing_of(lines[j])
        # When the line's middle was measured: the scanner's pose, the line's normal, the middle from the scanner.
        s_x, s_y, theta = sensor_pose(X_DB, mount, twist, earlier)
        c, s = math.cos(theta + line[0]), math.sin(theta + line[0])
        m_x, m_y = c * line[1] - s * line[4], s * line[1] + c * line[4]
        least, is_behind = min(OVERLAP, 0.5 * (lines[j, 3] - lines[j, 2])), False
        for w in range(len(walls)):
            n_x, n_y = math.cos(walls[w, 0]), math.sin(walls[w, 0])
            d_x, d_y = s_x - p_DC[w, 0], s_y - p_DC[w, 1]
            # Distance of the scanner before the wall, and of the line's middle behind it.
            before = walls[w, 1] - n_x * d_x - n_y * d_y
            behind = n_x * m_x + n_y * m_y - before
            if before > 0.0 and behind >= UNCLEAR:
                share = before / (before + behind)
                at = n_x * (d_y + share * m_y) - n_y * (d_x + share * m_x)
                is_behind |= reach[w, 0] + OVERLAP < at < reach[w, 1] - OVERLAP
            if n_x * c + n_y * s < SAME_DIRECTION or abs(behind) > UNCLEAR:
                continue
            at = n_x * (d_y + m_y) - n_y * (d_x + m_x) - lines[j, 4]
            if min(reach[w, 1], at + lines[j, 3]) - max(reach[w, 0], at + lines[j, 2]) >= least:
                found[j] = w if found[j] == -1 else -2
        through += is_behind and found[j] < 0
    return np.maximum(found, -1), through


@njit(cache=True)
def correct_by_walls(
    state: State, considered: Considered, twist: Twist, lines: FloatArray, column: IntArray, in_D: WallSet
) -> BoolArray:
    """Correct the state, in place, by lines (k, 11) of a scan; returns a mask (k,) of those inside their gate.

    column: (k,) first index of each line's wall among the considered, in_D: these k walls in D.
    """
    (mean, _, _), (shared, C), m, (walls, p_DC, _) = state, considered, 2 * len(lines), in_D
    H, H_c, off, noise = np.zeros((m, len(mean))), np.zeros((m, len(C))), np.empty(m), np.empty(m)
    rows, look = np.empty((2, COLUMNS)), np.empty(7)
    for j in range(len(lines)):
        a, b = 2 * j, 2 * j + 2
        look_of(lines[j], look)
        linearise_wall(rows, mean, shared[SCANNER:], twist[0], look, walls[j], p_DC[j])
        H[a:b, :POSE], H_c[a:b, SCANNER : SCANNER + OF_SENSOR] = rows[:, :POSE], rows[:, OF_MOUNT:OF_LANDMARK]
        H_c[a:b, column[j] : column[j] + 2] = rows[:, OF_LANDMARK:ERROR]
        off[a:b], noise[a:b] = rows[:, ERROR], lines[j, 5:7] ** 2 + rows[:, OF_TWIST:] ** 2 @ twist[1]
    return update(state, C, H, H_c, -off, noise)
