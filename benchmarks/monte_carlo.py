"""How often a path would really be collided with: the chance constraint's probability by sampling.

Every rollout draws landmarks and departure pose from their joint Gaussian, and with them the surfaces they carry. The
robot drives the path by a pose that it keeps by odometry and by sightings of the tags in its field of view, taken to be
where the map has them (a Schmidt-Kalman filter, linear about the path); a rollout collides where the disc of the robot,
at its true place, touches a true surface. Slow, for checks.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.config import OdometryConfig, RobotConfig, TagSensorConfig
from tfg_drake.geometry.distance import clearance
from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, TfgMap
from tfg_drake.planning.chance_constraint import TRACKING_DEVIATION
from tfg_drake.planning.exact_gain import whitened
from tfg_drake.planning.expected_view import Visibility, expected_tags

# Surfaces more than REACH, m, from a point of the path are ignored there.
REACH = 1.2
# Correlation length of the follower's tracking error, m.
TRACKING_LENGTH = 1.0


@dataclasses.dataclass(frozen=True)
class Gaussian:
    """The joint Gaussian's samples: dL (s, m, 2), m, of the landmarks known jointly, and dX (s, 3) of X_MD."""

    dL: FloatArray
    dX: FloatArray


def draw(estimate: MapEstimate, rng: np.random.Generator, rollouts: int) -> Gaussian:
    """Samples of what landmarks and departure pose truly are, less the estimate."""
    S = estimate.covariance
    values, vectors = np.linalg.eigh(0.5 * (S + S.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    d = rng.normal(size=(rollouts, len(S))) @ root.T
    return Gaussian(d[:, :-3].reshape(rollouts, -1, 2), d[:, -3:])


def collisions(
    path: FloatArray,
    estimate: MapEstimate,
    tfg: TfgMap,
    robot: RobotConfig,
    sensor: TagSensorConfig,
    odometry: OdometryConfig,
    rng: np.random.Generator,
    rollouts: int,
) -> BoolArray:
    """Which rollouts (s,) touch a surface at which points (k,) of a path (k, 2), m in M, from X_MD on, (s, k).

    The path has at least two points, and at least one landmark is known jointly with X_MD.
    """
    truth = draw(estimate, rng, rollouts)
    off = _pose_errors(path, estimate, tfg, robot.max_speed, sensor, odometry, truth, rng)
    ends = _moved_ends(tfg.segments, tfg.segment_ids, estimate)
    return np.stack(
        [_touches(path[k], off[:, k], tfg.segments, ends, truth.dL, robot.radius) for k in range(len(path))]
    ).T


def _pose_errors(
    path: FloatArray,
    estimate: MapEstimate,
    tfg: TfgMap,
    speed: float,
    sensor: TagSensorConfig,
    odometry: OdometryConfig,
    truth: Gaussian,
    rng: np.random.Generator,
) -> FloatArray:
    """How far (s, k, 2), m in M, the robot is from where it means to be at each point of the path (k, 2)."""
    count, k = len(truth.dX), len(path)
    ahead = np.diff(path, axis=0)
    heading = np.arctan2(*np.vstack([ahead, ahead[-1:]]).T[::-1])
    step = np.append(0.0, np.hypot(*ahead.T))
    visible = expected_tags(path, estimate, tfg, sensor)
    entry = estimate.local_entry[visible.index]
    visible = Visibility(visible.offsets, entry).kept(entry >= 0)
    p_ML = estimate.local_p_ML
    S = estimate.covariance
    n = 2 * len(p_ML)
    P, P_xL = S[n:, n:].copy(), S[n:, :n].copy()
    e = truth.dX.copy()  # true less estimated pose
    dL = truth.dL.reshape(count, n)
    scale = rng.normal(0.0, odometry.distance_scale, count)
    bias = rng.normal(0.0, odometry.gyro_bias, count)
    tracking = rng.normal(0.0, TRACKING_DEVIATION, count)
    off = np.empty((count, k, 2))
    driven = 0.0
    for i in range(k):
        # The step that led here was in the direction of the piece before.
        c, s = math.cos(heading[max(i - 1, 0)]), math.sin(heading[max(i - 1, 0)])
        dt = step[i] / speed
        F = np.eye(3)
        F[0, 2], F[1, 2] = -step[i] * s, step[i] * c
        driven += step[i]
        # The constant scale and bias enter the filter as what they add up to since the way began.
        along = odometry.distance_noise**2 * step[i] + odometry.distance_scale**2 * (2.0 * driven - step[i]) * step[i]
        turn = odometry.gyro_noise**2 * dt + odometry.gyro_bias**2 * (2.0 * driven - step[i]) / speed * dt
        Q = np.diag([c * c * along, s * s * along, turn])
        Q[0, 1] = Q[1, 0] = c * s * along
        P, P_xL = F @ P @ F.T + Q, F @ P_xL
        slip = scale * step[i] + rng.normal(0.0, odometry.distance_noise * math.sqrt(step[i]), count)
        e = e @ F.T
        e[:, 0] += c * slip
        e[:, 1] += s * slip
        e[:, 2] += bias * dt + rng.normal(0.0, odometry.gyro_noise * math.sqrt(dt), count)

        rows = visible.index[visible.offsets[i] : visible.offsets[i + 1]]
        d = p_ML[rows] - path[i]
        in_view = np.abs(wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - heading[i])) < 0.5 * sensor.field_of_view
        rows, d = rows[in_view], d[in_view]
        frames = sensor.detection_probability * sensor.rate * dt
        if len(rows) and frames > 0.0:
            H_x, H_L, columns = _jacobians(rows, d, sensor, frames)
            P_LL = S[np.ix_(columns, columns)]
            cross = P @ H_x.T + P_xL[:, columns] @ H_L.T
            innovation = H_x @ cross + H_L @ (P_xL[:, columns].T @ H_x.T + P_LL @ H_L.T) + np.eye(len(H_x))
            K = np.linalg.solve(innovation, cross.T).T
            seen = e @ H_x.T + dL[:, columns] @ H_L.T + rng.normal(size=(count, len(H_x)))
            e = e - seen @ K.T
            P_xL = P_xL - K @ (H_x @ P_xL + H_L @ S[columns][:, :n])
            P = P - K @ cross.T
            P = 0.5 * (P + P.T)
        keep = math.exp(-step[i] / TRACKING_LENGTH)
        tracking = keep * tracking + math.sqrt(1.0 - keep * keep) * rng.normal(0.0, TRACKING_DEVIATION, count)
        off[:, i] = e[:, :2] + tracking[:, None] * [-math.sin(heading[i]), math.cos(heading[i])]
    return off


def _jacobians(
    rows: IntArray, d: FloatArray, sensor: TagSensorConfig, frames: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Whitened Jacobians (2m, 3) by the pose and (2m, 2m) by the landmarks seen at d (m, 2), and those's columns."""
    m = len(rows)
    noise = np.array([sensor.range_noise, sensor.range_noise_per_metre, 0.0, sensor.bearing_noise])
    G = whitened(d, noise / math.sqrt(frames))
    H_x, H_L = np.zeros((2 * m, 3)), np.zeros((2 * m, 2 * m))
    H_x[:, :2] = -G.reshape(-1, 2)
    H_x[1::2, 2] = -math.sqrt(frames) / sensor.bearing_noise
    for i in range(m):
        H_L[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = G[i]
    return H_x, H_L, np.stack([2 * rows, 2 * rows + 1], axis=1).ravel()


@dataclasses.dataclass(frozen=True)
class _Ends:
    """How surface pieces (g,) move: each end goes with landmark first (g, 2) and, by share (g, 2), with second."""

    first: IntArray
    second: IntArray
    share: FloatArray


def _moved_ends(segments: FloatArray, ids: IntArray, estimate: MapEstimate) -> _Ends:
    """The landmarks that the ends of surface pieces (g, 4) go with: those of ids (g, 2) that each joins, -1 for none; a
    piece without a landmark goes with the nearest one."""
    known, p_ML = estimate.ids[estimate.is_local], estimate.local_p_ML
    row = np.minimum(np.searchsorted(known, ids), len(known) - 1)
    found = known[row] == ids
    ends = segments.reshape(-1, 2, 2)
    _, nearest = cKDTree(p_ML).query(ends)
    one = np.where(found[:, :1], row[:, :1], np.where(found[:, 1:], row[:, 1:], nearest))
    two = np.where(found[:, 1:], row[:, 1:], one)
    along = p_ML[two] - p_ML[one]
    square = np.maximum((along**2).sum(axis=2), 1e-12)
    share = np.clip(((ends - p_ML[one]) * along).sum(axis=2) / square, 0.0, 1.0)
    return _Ends(one, two, share)


def _touches(
    point: FloatArray, off: FloatArray, segments: FloatArray, ends: _Ends, dL: FloatArray, radius: float
) -> BoolArray:
    """Whether a disc at a point (2,), off by (s, 2), touches a piece of surface that moved with the landmarks, (s,)."""
    near = np.flatnonzero(clearance(segments, np.concatenate([point, point])[None], np.inf) < REACH)
    place = point + off
    hit = np.zeros(len(off), dtype=np.bool_)
    for g in near:
        moved = segments[g].reshape(2, 2) + (
            (1.0 - ends.share[g])[None, :, None] * dL[:, ends.first[g]]
            + ends.share[g][None, :, None] * dL[:, ends.second[g]]
        )
        a, along = moved[:, 0], moved[:, 1] - moved[:, 0]
        t = np.clip(((place - a) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
        hit |= np.hypot(*(place - a - t[:, None] * along).T) < radius
    return hit
