"""An oracle: drives with all shared parameters off, and the dense least squares of all their frames at once.

Each pose, each tag and each parameter is an unknown; Jacobians are central differences. Nothing is reduced, fused or
linearised but at the optimum, so what keyframes and their graph say is to be what this says.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import splu

from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import TagDetections
from tfg_drake.slam.noise import Noise
from tfg_drake.slam.odometry_model import arc, predict_increment, random_walks
from tfg_drake.slam.shared import SHARED, Shared
from tfg_drake.slam.turn import TurnFrame, no_detections, twists

WALKS = random_walks(OdometryConfig())
# As messages hold it: kernels are compiled anew for arrays that can be written.
WALKS.flags.writeable = False
NOISE = Noise(WALKS)
# Standard deviations of the parameters, in their order.
SIGMA = np.array([0.015, 0.001, 0.01, 0.0175, 0.005, 0.005, 0.05, 0.01, 0.005, 0.005, 0.02, 0.02, 0.01])
PRIOR = Shared(np.zeros(SHARED), np.diag(SIGMA**2))
# Half the field of view, rad, the longest range, m, and the time between two frames, s.
HALF_VIEW, REACH, PERIOD = 1.08, 10.0, 0.1
# Step of the differences, m and rad.
STEP = 1e-6


def measured(X, p, shared, twist):
    """Range and bearing (m, 2) of points p (m, 2) by the camera of a robot at poses X (m, 3) and twists (m, 2)."""
    yaw, ahead, aside, clock, range_scale = shared[[3, 4, 5, 6, 7]]
    c, s = np.cos(X[:, 2]), np.sin(X[:, 2])
    lever = ahead - clock * twist[:, 0]
    dx, dy = p[:, 0] - X[:, 0] - c * lever + s * aside, p[:, 1] - X[:, 1] - s * lever - c * aside
    bearing = np.arctan2(dy, dx) - X[:, 2] + clock * twist[:, 1] - yaw
    return np.column_stack([(1.0 + range_scale) * np.hypot(dx, dy), se2.wrap_angle(bearing)])


class Drive:
    """A robot among tags (n, 2) whose parameters are `shared` (13,). noise scales every random error: 0 is none.

    X_WB: where it is. begins: X_WA of each piece.
    """

    def __init__(self, tags, shared, seed, noise=1.0):
        self.tags, self.shared, self.noise = tags, shared, noise
        self.rng = np.random.default_rng(seed)
        self.X_WB, self.X_OB, self.time = np.zeros(3), np.zeros(3), 0.0
        self.begins, self.walks = [], WALKS

    def instant(self):
        return TurnFrame(self.time, self.time, self.X_OB.copy(), no_detections(self.time))

    def piece(self, speed, turn_rate, seconds):
        """Begin, frames and end of a piece of the way, a turn where the speed is 0."""
        begin = self.instant()
        self.begins.append(self.X_WB.copy())
        frames = tuple(self._step(np.array([speed, turn_rate])) for _ in range(round(seconds / PERIOD)))
        return begin, frames, self.instant()

    def p_ML(self, ids):
        """Tags in the frame of the drive's first pose."""
        return se2.transform(se2.inverse(self.begins[0]), self.tags[ids])

    @property
    def X_MB(self):
        return se2.between(self.begins[0], self.X_WB)

    def _step(self, twist):
        speed, turn = twist[0] * PERIOD, twist[1] * PERIOD
        chord = speed * np.sinc(0.5 * turn / np.pi)
        motion = np.array([chord * np.cos(0.5 * turn), chord * np.sin(0.5 * turn), turn])
        # What odometry says is the motion less the noise of `predict_increment`, and its own errors of scale and bias.
        covariance = predict_increment(np.array([chord, 0.0, turn]), PERIOD, np.zeros(3), self.walks)[2]
        x, y, turned = motion - self.noise * np.linalg.cholesky(covariance) @ self.rng.normal(size=3)
        distance_scale, bias, gyro_scale = self.shared[:3]
        said = (1.0 + gyro_scale) * turned + bias * PERIOD
        middle = 0.5 * (said - turned)
        c, s = (1.0 + distance_scale) * np.cos(middle), (1.0 + distance_scale) * np.sin(middle)
        self.X_OB = se2.compose(self.X_OB, np.array([c * x - s * y, s * x + c * y, said]))
        self.X_WB = se2.compose(self.X_WB, motion)
        self.time += PERIOD
        return TurnFrame(self.time, self.time, self.X_OB.copy(), self._seen(twist))

    def _seen(self, twist):
        n = len(self.tags)
        r, b = measured(np.tile(self.X_WB, (n, 1)), self.tags, self.shared, np.tile(twist, (n, 1))).T
        ids = np.flatnonzero((r < REACH) & (r > 0.2) & (np.abs(b) < HALF_VIEW))
        r, b = r[ids], b[ids]
        sigma_r, sigma_b = 0.02 + 0.01 * r, np.full(len(ids), 0.01)
        normal = self.noise * self.rng.normal(size=(2, len(ids)))
        return TagDetections(self.time, ids, r + sigma_r * normal[0], b + sigma_b * normal[1], sigma_r, sigma_b)


@dataclasses.dataclass
class Dense:
    """The optimum. ids (n,), p_ML (n, 2), X_MN (k + 1, 3) between k pieces, shared (13,), covariance: of (p_ML row by
    row, X_MN[1:], shared), cost: half the squared errors of the frames, in sigmas, there, and log_information: the
    logarithm of the determinant of all unknowns' information."""

    ids: np.ndarray
    p_ML: np.ndarray
    X_MN: np.ndarray
    shared: np.ndarray
    covariance: np.ndarray
    cost: float
    log_information: float

    @property
    def newest(self):
        """Rows of (p_ML row by row, the newest pose, shared) in the covariance."""
        size = len(self.covariance)
        return np.append(np.arange(2 * len(self.ids)), np.arange(size - SHARED - 3, size))

    def off(self, p_ML, X_MD, shared):
        """How far other values are off, (2n + 16,), and the covariance of those."""
        x = np.concatenate([p_ML.ravel(), X_MD, shared])
        error = x - np.concatenate([self.p_ML.ravel(), self.X_MN[-1], self.shared])
        error[2 * len(self.ids) + 2] = se2.wrap_angle(error[2 * len(self.ids) + 2])
        return error, self.covariance[np.ix_(self.newest, self.newest)]


def _motion_errors(whitener, increments, dt):
    """Whitened errors (m, 3) of the motions between poses (m, 3) and (m, 3): a function of these and the parameters."""

    def errors(before, after, shared):
        distance_scale, bias, gyro_scale = shared[:3]
        turn = (increments[:, 2] - bias * dt) / (1.0 + gyro_scale)
        c, s = np.cos(0.5 * turn), np.sin(0.5 * turn)
        u, v = increments[:, 0] / (1.0 + distance_scale), increments[:, 1] / (1.0 + distance_scale)
        error = se2.between(before, after) - np.column_stack([c * u - s * v, s * u + c * v, turn])
        error[:, 2] = se2.wrap_angle(error[:, 2])
        # The noise is one of what is measured.
        error *= [1.0 + distance_scale, 1.0 + distance_scale, 1.0 + gyro_scale]
        return np.einsum("mij,mj->mi", whitener, error)

    return errors


def _sighting_errors(z, sigma, twist):
    """Whitened errors (m, 2) of sightings z (m, 2): a function of poses (m, 3), tags (m, 2) and the parameters."""

    def errors(X, p, shared):
        error = measured(X, p, shared, twist) - z
        error[:, 1] = se2.wrap_angle(error[:, 1])
        return error / sigma

    return errors


def _rows(errors, arguments, columns):
    """Errors and their sparse entries (row, column, value). arguments: (m, a) arrays and the parameters last; columns:
    the first unknown of each, (m,), negative for what is held."""
    value = errors(*arguments)
    entries = []
    for which, (argument, first) in enumerate(zip(arguments, columns, strict=True)):
        for a in range(argument.shape[-1]):
            move = np.zeros(argument.shape)
            move[..., a] = STEP
            plus, minus = ([*arguments[:which], argument + sign * move, *arguments[which + 1 :]] for sign in (1, -1))
            slope = (errors(*plus) - errors(*minus)) / (2.0 * STEP)
            row = np.arange(value.size).reshape(value.shape)
            column = np.broadcast_to((first + a)[:, None], value.shape)
            free = np.broadcast_to((first >= 0)[:, None], value.shape)
            entries.append(np.stack([row[free], column[free], slope[free]]))
    return value.ravel(), np.hstack(entries)


def dense(pieces, prior=PRIOR, walks=WALKS):
    """The least squares of all frames of pieces that follow each other."""
    instants, last, X, nodes = [pieces[0][0]], [], [np.zeros(3)], []
    for begin, frames, end in pieces:
        stamps, X_OB = (np.array([getattr(one, name) for one in (begin, *frames)]) for name in ("stamp", "X_OB"))
        # The end is the last frame's instant.
        for frame, twist in zip(
            (*frames, end), twists(stamps, X_OB, prior.mean)[[*range(1, len(stamps)), -1]], strict=True
        ):
            if frame.stamp > instants[-1].stamp + 1e-9:
                instants.append(frame)
                X.append(se2.compose(X[-1], se2.between(instants[-2].X_OB, frame.X_OB)))
            last.append((len(instants) - 1, frame, twist))
        nodes.append(len(instants) - 1)
    X = np.array(X)
    increments = np.array([arc(a.X_OB, b.X_OB) for a, b in itertools.pairwise(instants)])
    dt = np.array([b.clock - a.clock for a, b in itertools.pairwise(instants)])
    covariances = [predict_increment(u, t, np.zeros(3), walks)[2] for u, t in zip(increments, dt, strict=True)]
    whitener = np.array([np.linalg.inv(np.linalg.cholesky(one)) for one in covariances])
    seen = [(node, frame.detections, twist) for node, frame, twist in last]
    counts = [len(detections.ids) for _, detections, _ in seen]
    node = np.repeat([at for at, _, _ in seen], counts)
    twist = np.repeat([own for _, _, own in seen], counts, axis=0)
    z, sigma = (
        np.column_stack([np.concatenate([getattr(one, name) for _, one, _ in seen]) for name in names])
        for names in (("range", "bearing"), ("sigma_range", "sigma_bearing"))
    )
    ids, first, tag = np.unique(np.concatenate([one.ids for _, one, _ in seen]), return_index=True, return_inverse=True)
    angle = X[node[first], 2] + z[first, 1]
    p = X[node[first], :2] + z[first, :1] * np.column_stack([np.cos(angle), np.sin(angle)])
    shared = prior.mean.copy()
    tags_at, shared_at = 3 * (len(X) - 1), 3 * (len(X) - 1) + 2 * len(ids)
    size, information = shared_at + SHARED, np.linalg.inv(prior.covariance)
    pose_at = 3 * np.arange(len(X)) - 3
    of_motions = (pose_at[:-1], pose_at[1:], np.full(len(dt), shared_at))
    of_sightings = (pose_at[node], tags_at + 2 * tag, np.full(len(tag), shared_at))
    motion_errors, sighting_errors = _motion_errors(whitener, increments, dt), _sighting_errors(z, sigma, twist)
    for _ in range(20):
        motions, entries = _rows(motion_errors, (X[:-1], X[1:], shared), of_motions)
        sightings, others = _rows(sighting_errors, (X[node], p[tag], shared), of_sightings)
        others[0] += len(motions)
        row, column, value = np.hstack([entries, others])
        error = np.append(motions, sightings)
        J = scipy.sparse.csr_matrix((value, (row.astype(int), column.astype(int))), shape=(len(error), size))
        H, g = (J.T @ J).tolil(), J.T @ error
        H[shared_at:, shared_at:] += information
        g[shared_at:] += information @ (shared - prior.mean)
        factor = splu(H.tocsc())
        step = factor.solve(-g)
        X[1:] += step[:tags_at].reshape(-1, 3)
        p += step[tags_at:shared_at].reshape(-1, 2)
        shared = shared + step[shared_at:]
        if np.abs(step).max() < 1e-8:
            break
    at = [tags_at + np.arange(2 * len(ids))] + [3 * k - 3 + np.arange(3) for k in nodes]
    at = np.concatenate([*at, shared_at + np.arange(SHARED)])
    unit = np.zeros((size, len(at)))
    unit[at, np.arange(len(at))] = 1.0
    cost = 0.5 * float(error @ error)
    log_information = float(np.sum(np.log(np.abs(factor.U.diagonal()))))
    return Dense(ids, p, X[[0, *nodes]], shared, factor.solve(unit)[at], cost, log_information)
