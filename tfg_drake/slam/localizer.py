"""The pose between views: a filter beside landmarks and shared parameters that it considers and never updates.

State: the pose in the frame of the last departure pose D, and tags met on the way, which enter at their first sighting.
Considered (Schmidt): the landmarks of the map and the shared parameters, with their joint covariance. They inform the
pose, with their uncertainty, and the map learns from views only. Instead of the cross covariance the filter keeps how
an error of theirs moves the state, x = W c + what is independent of them, for those landmarks only that have been seen:
so the map may be as large as it likes. It is linearised in D, where all that is near is known well: in M a filter takes
the heading that it shares with the whole map for something that its sightings tell (the inconsistency of EKF SLAM).
"""

from __future__ import annotations

import math

import numpy as np
import scipy.linalg

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, TagDetections, message, replace
from tfg_drake.slam.keyframe import rows_of
from tfg_drake.slam.odometry_model import predict_increment, wrap
from tfg_drake.slam.shared import CAMERA_YAW, CLOCK, LEVER_X, LEVER_Y, RANGE_SCALE, SHARED
from tfg_drake.slam.tag_error import in_place

POSE = 3
# Squared deviations beyond which a sighting is ignored (2 degrees of freedom): 1 in 270 000 good ones.
GATE = 25.0
# Local tags kept at most; the longest unseen go first.
MOST_LOCAL = 30
# Tags seen in fewer frames become no goal: one of them may be wrong, or its id misread.
LEAST_FRAMES = 2
# Standard deviations of a pose found by geometry before the tags it was found from are used, m, m, rad.
ANYWHERE = (1.0, 1.0, 0.5)


@message
class Localizer:
    """The filter's Gaussian in D.

    map: what it considers, D is its X_MD. mean: (3 + 2k,) pose and local tags, covariance: (3 + 2k, 3 + 2k). seen: (s,)
    rows in map.local of the landmarks seen since D, p_DL: (s, 2) where they are. considered: (8 + 2s, 8 + 2s)
    covariance of the parameters and of these in D, with_D: (8 + 2s, 3) with X_MD. sensitivity: (3 + 2k, 8 + 2s), W.
    local_ids, last_seen, local_frames: (k,) ids, stamps (s) and frames of the local tags.
    """

    map: MapEstimate
    mean: FloatArray
    covariance: FloatArray
    seen: IntArray
    p_DL: FloatArray
    considered: FloatArray
    with_D: FloatArray
    sensitivity: FloatArray
    local_ids: IntArray
    last_seen: FloatArray
    local_frames: IntArray

    @property
    def X_MB(self) -> FloatArray:
        """(3,) the pose."""
        return se2.compose(self.map.X_MD, self.mean[:POSE])


def start_localizer(estimate: MapEstimate) -> Localizer:
    """The localiser at the departure pose of the newest map."""
    none = np.empty(0, dtype=np.int64)
    considered, with_D, p_DL = _considered(estimate, none)
    return Localizer(
        map=estimate,
        mean=np.zeros(POSE),
        covariance=np.zeros((POSE, POSE)),
        seen=none,
        p_DL=p_DL,
        considered=considered,
        with_D=with_D,
        sensitivity=np.zeros((POSE, SHARED)),
        local_ids=none,
        last_seen=np.empty(0),
        local_frames=none,
    )


def restart_localizer(
    estimate: MapEstimate, noise: FloatArray, X_MB: FloatArray, detections: TagDetections
) -> Localizer:
    """The localiser at a pose X_MB (3,) found by geometry, as uncertain as the mapped tags it was found from say."""
    localizer = start_localizer(estimate)
    mean = se2.between(estimate.X_MD, X_MB)
    localizer = replace(localizer, mean=mean, covariance=np.diag(ANYWHERE) ** 2)
    return step_localizer(localizer, noise, np.zeros(3), 0.0, detections, np.zeros(2), 0.0)[0]


def step_localizer(
    localizer: Localizer,
    noise: FloatArray,
    increment: FloatArray,
    dt: float,
    detections: TagDetections,
    twist: FloatArray,
    offset: float,
) -> tuple[Localizer, int, int]:
    """The localiser after an odometry increment (3,) of `odometry_model.arc` over dt seconds and the frame at its end;
    how many of the frame's sightings were of tags it knows, and how many of those it ignored.

    noise: (3,) of `random_walks`. twist: (2,) forward speed (m/s) and turn rate (rad/s) at the frame, offset: s, the
    camera's clock was taken to be so much ahead. Known tags correct the pose, all at once, unknown ones join the
    state. A sighting outside its gate is ignored.
    """
    now = _predicted(localizer, noise, increment, dt)
    if not len(detections.ids):
        return now, 0, 0
    row, known = rows_of(detections.ids, now.map.ids[now.map.local])
    new = np.setdiff1d(row[known], now.seen)
    if len(new):
        seen = np.append(now.seen, new)
        considered, with_D, p_DL = _considered(now.map, seen)
        sensitivity = np.pad(now.sensitivity, ((0, 0), (0, 2 * len(new))))
        now = replace(now, seen=seen, considered=considered, with_D=with_D, p_DL=p_DL, sensitivity=sensitivity)
    place_of = {int(row): at for at, row in enumerate(now.seen)}
    local_of = {int(tag): at for at, tag in enumerate(now.local_ids)}
    # Where each tag is: in W's columns, in the state, nowhere yet.
    column = np.array([SHARED + 2 * place_of[int(r)] if k else -1 for r, k in zip(row, known, strict=True)])
    entry = np.array([POSE + 2 * local_of.get(int(tag), -1) for tag in detections.ids])
    entry[(column >= 0) | (entry < POSE)] = -1
    at = np.flatnonzero((column >= 0) | (entry >= 0))
    z = np.column_stack([detections.range, detections.bearing, detections.sigma_range, detections.sigma_bearing])
    now, accepted = _corrected(now, z[at], column[at], entry[at], twist, offset)
    frames, last_seen = now.local_frames.copy(), now.last_seen.copy()
    local = np.flatnonzero(entry[at] >= 0)
    of = (entry[at][local] - POSE) // 2
    frames[of] += np.where(accepted[local], 1, -1)
    last_seen[of[accepted[local]]] = detections.stamp
    now = replace(now, local_frames=frames, last_seen=last_seen)
    fresh = np.setdiff1d(np.arange(len(z)), at)
    if len(fresh):
        now = _with_local(now, z[fresh], detections.ids[fresh], detections.stamp, twist, offset)
    # What was seen elsewhere as often as there is forgotten: its next sighting says where it is.
    keep = now.local_frames > 0
    if len(keep) > MOST_LOCAL:
        keep[np.argsort(-now.last_seen, kind="stable")[MOST_LOCAL:]] = False
    return _keep_local(now, keep), len(at), int(np.count_nonzero(~accepted))


def without_local(localizer: Localizer) -> Localizer:
    """The localiser without the tags met on the way."""
    return _keep_local(localizer, np.zeros(len(localizer.local_ids), dtype=bool))


def localized_pose(
    localizer: Localizer, noise: FloatArray, increment: FloatArray, dt: float
) -> tuple[FloatArray, FloatArray]:
    """X_MB (3,) and its covariance (3, 3), an odometry increment (3,) over dt seconds past the localiser's instant."""
    now, X_MD = _predicted(localizer, noise, increment, dt, pose_only=True), localizer.map.X_MD
    c, s = math.cos(X_MD[2]), math.sin(X_MD[2])
    x, y = c * now.mean[0] - s * now.mean[1], s * now.mean[0] + c * now.mean[1]
    by_B = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    by_D = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    across = by_B @ now.sensitivity[:POSE] @ localizer.with_D @ by_D.T
    own = by_B @ now.covariance[:POSE, :POSE] @ by_B.T
    of_D = by_D @ localizer.map.covariance[-3:, -3:] @ by_D.T
    return np.array([X_MD[0] + x, X_MD[1] + y, wrap(X_MD[2] + now.mean[2])]), own + across + across.T + of_D


def new_tags(localizer: Localizer, ids: IntArray) -> tuple[IntArray, FloatArray]:
    """The ids (u,) of the tags met on the way, in LEAST_FRAMES or more, that are not among some ids (n,), ascending,
    and their p_MU (u, 2)."""
    some = (localizer.local_frames >= LEAST_FRAMES) & ~rows_of(localizer.local_ids, ids)[1]
    p_DU = localizer.mean[POSE:].reshape(-1, 2)[some]
    return localizer.local_ids[some], se2.transform(localizer.map.X_MD, p_DU)


def _considered(estimate: MapEstimate, seen: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """considered (8 + 2s, 8 + 2s), with_D (8 + 2s, 3) and p_DL (s, 2), of landmarks in rows (s,) of the map's local.

    p_DL = R_MD^T (p_ML - t_MD), so an error of X_MD moves it by -R_MD^T and turns it about D. The constant errors of
    tags add what they make of where tags seem to be from there.
    """
    X_MD, s, size = estimate.X_MD, len(seen), len(estimate.covariance)
    R_DM = se2.rotation(float(X_MD[2])).T
    p = estimate.local_p_ML[seen] - X_MD[:2]
    p_DL = p @ R_DM.T
    at = np.append((2 * seen[:, None] + [0, 1]).ravel(), np.arange(size - 3, size))
    P = np.empty((2 * s + 3 + SHARED, 2 * s + 3 + SHARED))
    P[:-SHARED, :-SHARED] = estimate.covariance[np.ix_(at, at)]
    P[:-SHARED, -SHARED:] = estimate.with_shared[at]
    P[-SHARED:, :-SHARED], P[-SHARED:, -SHARED:] = estimate.with_shared[at].T, estimate.with_shared[size:]

    def seen_from_D(rows: FloatArray) -> FloatArray:
        """Parameters, landmarks in D, X_MD, from landmarks in M, X_MD, parameters."""
        apart = rows[: 2 * s].reshape(s, 2, rows.shape[1]) - rows[2 * s : 2 * s + 2]
        in_D = np.einsum("ij,sjk->sik", R_DM, apart)
        turned = rows[2 * s + 2]
        in_D[:, 0] += p_DL[:, 1, None] * turned
        in_D[:, 1] -= p_DL[:, 0, None] * turned
        return np.vstack([rows[-SHARED:], in_D.reshape(2 * s, rows.shape[1]), rows[2 * s : 2 * s + 3]])

    joint = seen_from_D(seen_from_D(P).T)
    if estimate.tag_error.any():
        i = SHARED + 2 * np.arange(s)
        own = in_place(p_DL, estimate.tag_error)
        for a in range(2):
            for b in range(2):
                joint[i + a, i + b] += own[:, a, b]
    return joint[:-3, :-3].copy(), joint[:-3, -3:].copy(), p_DL


def _predicted(
    localizer: Localizer, noise: FloatArray, increment: FloatArray, dt: float, *, pose_only: bool = False
) -> Localizer:
    """The localiser an odometry increment on; pose_only: without its local tags."""
    mean, P, W = localizer.mean, localizer.covariance, localizer.sensitivity
    if pose_only:
        mean, P, W = mean[:POSE], P[:POSE, :POSE], W[:POSE]
    X, on_calibration, Q = predict_increment(increment, dt, localizer.map.shared[:3], noise)
    c, s = math.cos(mean[2]), math.sin(mean[2])
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    motion = R @ X
    F = np.array([[1.0, 0.0, -motion[1]], [0.0, 1.0, motion[0]], [0.0, 0.0, 1.0]])
    B = R @ on_calibration
    mean, P, W_before = mean.copy(), P.copy(), W
    of_calibration = W_before @ localizer.considered[:, :3] @ B.T
    P[:POSE] = F @ P[:POSE]
    P[:, :POSE] = P[:, :POSE] @ F.T
    across = F @ of_calibration[:POSE]
    P[POSE:, :POSE] += of_calibration[POSE:]
    P[:POSE, POSE:] += of_calibration[POSE:].T
    P[:POSE, :POSE] += across + across.T + B @ localizer.considered[:3, :3] @ B.T + R @ Q @ R.T
    W = W_before.copy()
    W[:POSE] = F @ W_before[:POSE]
    W[:POSE, :3] += B
    mean[:2] += motion[:2]
    mean[2] = wrap(mean[2] + X[2])
    return replace(localizer, mean=mean, covariance=P, sensitivity=W)


def _corrected(
    localizer: Localizer, z: FloatArray, column: IntArray, entry: IntArray, twist: FloatArray, offset: float
) -> tuple[Localizer, BoolArray]:
    """The localiser corrected by sightings of known tags, and which of them (m,) were inside their gate.

    z: (m, 4) range, bearing and their sigmas. column: (m,) where each tag begins in W's columns, -1 for local ones;
    entry: (m,) where these begin in the state. Landmarks and parameters are left as they are.
    """
    mean, P, W, C, shared = (
        localizer.mean,
        localizer.covariance,
        localizer.sensitivity,
        localizer.considered,
        localizer.map.shared,
    )
    m, is_local, i = len(z), entry >= 0, np.arange(len(z))
    if not m:
        return localizer, np.zeros(0, dtype=bool)
    tags = np.empty((m, 2))
    tags[is_local] = mean[entry[is_local][:, None] + [0, 1]]
    tags[~is_local] = localizer.p_DL[(column[~is_local] - SHARED) // 2]
    R, lever, earlier = _lever(mean, shared, twist, offset)
    d = tags - mean[:2] - lever
    r = np.maximum(np.hypot(d[:, 0], d[:, 1]), 1e-3)
    scale = 1.0 + float(shared[RANGE_SCALE])
    # Range and bearing by the tag's place.
    on = np.stack([scale * d / r[:, None], np.column_stack([-d[:, 1], d[:, 0]]) / (r * r)[:, None]], axis=1)
    H, H_c = np.zeros((m, 2, len(mean))), np.zeros((m, 2, len(C)))
    H[:, :, :2] = -on
    H[:, :, 2] = on @ np.array([lever[1], -lever[0]])
    H[:, 1, 2] -= 1.0
    for a in range(2):
        H[i[is_local], :, entry[is_local] + a] = on[is_local, :, a]
        H_c[i[~is_local], :, column[~is_local] + a] = on[~is_local, :, a]
    H_c[:, :, [LEVER_X, LEVER_Y]] = -on @ R
    H_c[:, :, CLOCK] = twist[0] * (on @ R[:, 0])
    H_c[:, 1, CLOCK] += twist[1]
    H_c[:, 1, CAMERA_YAW] = -1.0
    H_c[:, 0, RANGE_SCALE] = r
    bearing = np.arctan2(d[:, 1], d[:, 0]) - mean[2] + earlier * twist[1] - shared[CAMERA_YAW]
    residual = np.stack([z[:, 0] - scale * r, se2.wrap_angle(z[:, 1] - bearing)], axis=1).ravel()
    by_state, by_c = H.reshape(2 * m, -1), H_c.reshape(2 * m, -1)
    HW = by_state @ W + by_c
    HP = by_state @ P + by_c @ (C @ W.T)
    S = HP @ by_state.T + HW @ C @ by_c.T + np.diag(np.square(z[:, 2:]).ravel())
    own, off = S.reshape(m, 2, m, 2)[i, :, i, :], residual.reshape(m, 2, 1)
    accepted = (off * np.linalg.solve(own, off)).sum(axis=(1, 2)) <= GATE
    if not accepted.any():
        return localizer, accepted
    kept = np.repeat(accepted, 2)
    root = np.linalg.cholesky(S[np.ix_(kept, kept)])
    half = scipy.linalg.solve_triangular(
        root, np.hstack([HP[kept], HW[kept], residual[kept, None]]), lower=True, check_finite=False
    )
    half_P, half_W, nu = half[:, : len(mean)], half[:, len(mean) : -1], half[:, -1]
    mean = mean + half_P.T @ nu
    mean[2] = wrap(mean[2])
    return replace(localizer, mean=mean, covariance=P - half_P.T @ half_P, sensitivity=W - half_P.T @ half_W), accepted


def _with_local(
    localizer: Localizer, z: FloatArray, ids: IntArray, stamp: float, twist: FloatArray, offset: float
) -> Localizer:
    """The localiser with a local tag more for each sighting z (m, 4)."""
    mean, P, W, C, m = localizer.mean, localizer.covariance, localizer.sensitivity, localizer.considered, len(z)
    shared = localizer.map.shared
    R, lever, earlier = _lever(mean, shared, twist, offset)
    angle = mean[2] + z[:, 1] + shared[CAMERA_YAW] - earlier * twist[1]
    r = z[:, :1] / (1.0 + shared[RANGE_SCALE])
    direction = np.column_stack([np.cos(angle), np.sin(angle)])
    across = direction[:, ::-1] * (-1.0, 1.0)
    p_DU = mean[:2] + lever + r * direction
    # The tag moves with the robot, the robot's heading has a lever, and the camera's errors move it, too.
    G, G_c, i, size = np.zeros((m, 2, len(mean))), np.zeros((m, 2, len(C))), np.arange(m), len(mean)
    G[:, 0, 0] = G[:, 1, 1] = 1.0
    G[:, :, 2] = (p_DU - mean[:2])[:, ::-1] * (-1.0, 1.0)
    G_c[:, :, CAMERA_YAW], G_c[:, :, RANGE_SCALE] = r * across, -r * direction / (1.0 + shared[RANGE_SCALE])
    G_c[:, :, [LEVER_X, LEVER_Y]] = R
    G_c[:, :, CLOCK] = -twist[0] * R[:, 0] - twist[1] * r * across
    by_state, by_c = G.reshape(2 * m, -1), G_c.reshape(2 * m, -1)
    with_old = by_state @ P + by_c @ C @ W.T
    joined = np.empty((size + 2 * m, size + 2 * m))
    joined[:size, :size], joined[size:, :size], joined[:size, size:] = P, with_old, with_old.T
    joined[size:, size:] = with_old @ by_state.T + (by_state @ W + by_c) @ C @ by_c.T
    along, aside = z[:, 2, None] / (1.0 + shared[RANGE_SCALE]) * direction, (r * z[:, 3:]) * across
    own = along[:, :, None] * along[:, None, :] + aside[:, :, None] * aside[:, None, :]
    joined[size:, size:].reshape(m, 2, m, 2)[i, :, i, :] += own
    return replace(
        localizer,
        mean=np.append(mean, p_DU.ravel()),
        covariance=joined,
        sensitivity=np.vstack([W, by_state @ W + by_c]),
        local_ids=np.append(localizer.local_ids, ids),
        last_seen=np.append(localizer.last_seen, np.full(m, stamp)),
        local_frames=np.append(localizer.local_frames, np.ones(m, dtype=np.int64)),
    )


def _lever(
    mean: FloatArray, shared: FloatArray, twist: FloatArray, offset: float
) -> tuple[FloatArray, FloatArray, float]:
    """Rotation (2, 2) of the body in D, where the camera was seen from it (2,), m along D's axes, and how much earlier
    than taken, s, when the frame was taken."""
    earlier = float(shared[CLOCK]) - offset
    R = se2.rotation(float(mean[2]))
    return R, R @ [shared[LEVER_X] - earlier * twist[0], shared[LEVER_Y]], earlier


def _keep_local(localizer: Localizer, keep: BoolArray) -> Localizer:
    """The localiser with only some (k,) of its local tags: the others are marginalised out."""
    if keep.all():
        return localizer
    rows = np.append(np.ones(POSE, dtype=bool), np.repeat(keep, 2))
    return replace(
        localizer,
        mean=localizer.mean[rows],
        covariance=localizer.covariance[np.ix_(rows, rows)],
        sensitivity=localizer.sensitivity[rows],
        local_ids=localizer.local_ids[keep],
        last_seen=localizer.last_seen[keep],
        local_frames=localizer.local_frames[keep],
    )
