"""The information about the landmarks that a full turn at a candidate goal is expected to bring.

The gain is the mutual information of all landmarks L, known and new, and the measurements z of the turn:

    I(L; z) = 1/2 log|I + J S J^T| - 1/2 log|I + K S_x|L K^T|,   J = [G K]

with G and K the whitened Jacobians of ranges and bearings by landmarks and arrival pose x, S the joint covariance
of both and S_x|L the covariance of the pose given all landmarks. This is what the paper's Section IV approximates
(Theorem 1); it holds for a pose that odometry ties to the map, and depends on relative covariance only.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numba import njit
from scipy.linalg import cho_factor, cho_solve

from tfg_drake.config import ExplorerConfig, OdometryConfig, TagSensorConfig
from tfg_drake.messages import FloatArray, IntArray, MapEstimate, TfgMap
from tfg_drake.planning.expected_view import View

# A turn's measurements of one tag are never worth more than this, m and rad: the headings of its frames are uncertain
# and tie all tags of a goal together.
RANGE_FLOOR = 0.01
BEARING_FLOOR = 0.002
# A frontier yields its full number of new landmarks to a view that reaches this share of the sensor's range beyond it.
FRONTIER_DEPTH = 0.5


@dataclasses.dataclass(frozen=True)
class Gains:
    """Expected gains of c candidates, all (c,), nats.

    exploitation: what the known landmarks alone would bring. exploration: what the new ones add. pose_price: how much
    more both would bring were the arrival pose known. gain: exploitation + exploration, the price paid.
    """

    exploitation: FloatArray
    exploration: FloatArray
    pose_price: FloatArray

    @property
    def gain(self) -> FloatArray:
        """Exploitation + exploration, (c,), nats."""
        return self.exploitation + self.exploration


@njit(cache=True)
def _whitened(dx: float, dy: float, noise: FloatArray) -> FloatArray:
    """Jacobian (2, 2) of range and bearing by the landmark at (dx, dy) from the robot, over their deviations.

    noise: (base range noise, range noise per metre, range floor, bearing deviation), for the whole turn.
    """
    r = max(math.sqrt(dx * dx + dy * dy), 0.05)
    sigma_range = max(noise[0] + noise[1] * r, noise[2])
    G = np.empty((2, 2))
    G[0, 0], G[0, 1] = dx / r / sigma_range, dy / r / sigma_range
    G[1, 0], G[1, 1] = -dy / (r * r) / noise[3], dx / (r * r) / noise[3]
    return G


@njit(cache=True)
def share_seen(distance: FloatArray | float, reach: FloatArray) -> FloatArray:
    """How much of what a frontier point stands for is seen from a distance (m): the depth of view left behind it.

    distance: (n,) or a number, m. reach: (sensor range, depth), m, as in exact_gain.
    """
    return np.minimum(1.0, np.maximum(0.0, (reach[0] - distance) / reach[1]))  # type: ignore[no-any-return]


def frontier_reach(sensor: TagSensorConfig) -> FloatArray:
    """(sensor range, depth), m: a frontier counts in full where the view goes on behind it by this depth."""
    return np.array([sensor.range, FRONTIER_DEPTH * sensor.range])


@njit(cache=True)
def exact_gain(
    points: FloatArray,
    odometry: FloatArray,
    known_offsets: IntArray,
    known: IntArray,
    new_offsets: IntArray,
    new: IntArray,
    p_ML: FloatArray,
    X_MD: FloatArray,
    covariance: FloatArray,
    departure_given_map: FloatArray,
    p_MU: FloatArray,
    new_count: FloatArray,
    prior_sigma: float,
    noise: FloatArray,
    reach: FloatArray,
) -> FloatArray:
    """Exploitation, exploration and price of the pose, (c, 3), nats, of a turn at each point (c, 2), m in M.

    The arrival pose is the departure pose X_MD composed with odometry of covariance odometry (c, 3, 3), in M.
    covariance: (2n + 3, 2n + 3) of landmarks p_ML (n, 2) and X_MD. departure_given_map: (3, 3), that of X_MD given
    all landmarks. Point i sees the rows known[known_offsets[i]:known_offsets[i + 1]] of p_ML and as many new landmarks
    as new_count (u,) says, a fraction allowed, at each of the rows new[new_offsets[i]:...] of p_MU (u, 2), whose
    priors are independent, of deviation prior_sigma (m). noise: as in _whitened. reach: (sensor range, depth), m: a
    new landmark counts in proportion to how far the view goes on behind its frontier point, in full from depth on.
    """
    out = np.zeros((len(points), 3))
    pose = 2 * len(p_ML)
    eye3 = np.eye(3)
    for c in range(len(points)):
        x, y = points[c, 0], points[c, 1]
        F = np.eye(3)
        F[0, 2], F[1, 2] = -(y - X_MD[1]), x - X_MD[0]
        S_xx = F @ covariance[pose:, pose:].copy() @ F.T + odometry[c]
        S_x_given_L = F @ departure_given_map @ F.T + odometry[c]

        rows = known[known_offsets[c] : known_offsets[c + 1]]
        m = len(rows)
        G = np.empty((m, 2, 2))
        W = np.zeros((2 * m, 6))  # [G S_Lx, K]
        C = np.empty((2 * m, 2 * m))  # I + G S_LL G^T
        for i in range(m):
            a = 2 * rows[i]
            G[i] = _whitened(p_ML[rows[i], 0] - x, p_ML[rows[i], 1] - y, noise)
            for q in range(2):
                s = G[i, q, 0] * covariance[a, pose:] + G[i, q, 1] * covariance[a + 1, pose:]
                W[2 * i + q, 0] = s[0] + F[0, 2] * s[2]
                W[2 * i + q, 1] = s[1] + F[1, 2] * s[2]
                W[2 * i + q, 2] = s[2]
                W[2 * i + q, 3], W[2 * i + q, 4] = -G[i, q, 0], -G[i, q, 1]
            W[2 * i + 1, 5] = -1.0 / noise[3]
            for j in range(i + 1):
                b = 2 * rows[j]
                s00, s01 = covariance[a, b], covariance[a, b + 1]
                s10, s11 = covariance[a + 1, b], covariance[a + 1, b + 1]
                for q in range(2):
                    t0 = G[i, q, 0] * s00 + G[i, q, 1] * s10
                    t1 = G[i, q, 0] * s01 + G[i, q, 1] * s11
                    C[2 * i + q, 2 * j] = t0 * G[j, 0, 0] + t1 * G[j, 0, 1]
                    C[2 * i + q, 2 * j + 1] = t0 * G[j, 1, 0] + t1 * G[j, 1, 1]
        for i in range(2 * m):
            C[i, i] += 1.0
            for j in range(i):
                C[j, i] = C[i, j]

        # I + J S J^T = C + W M W^T: one factorisation serves the known and the unknown pose.
        log_map = 0.0
        T = np.zeros((6, 6))
        B_known = np.zeros((3, 3))
        if m > 0:
            B_known = W[:, 3:].T.copy() @ W[:, 3:].copy()
            L = np.linalg.cholesky(C)
            for i in range(2 * m):
                for j in range(i):
                    for k in range(6):
                        W[i, k] -= L[i, j] * W[j, k]
                for k in range(6):
                    W[i, k] /= L[i, i]
                log_map += 2.0 * math.log(L[i, i])
            T = W.T.copy() @ W
        M = np.zeros((6, 6))
        M[:3, 3:] = eye3
        M[3:, :3] = eye3
        M[3:, 3:] = S_xx
        inner = np.eye(6) + T @ M
        log_known = log_map + math.log(np.linalg.det(inner))
        N = np.zeros((6, 3))
        N[:3] = eye3
        N[3:] = S_xx
        S_x_given_z = S_xx - N.T.copy() @ np.linalg.solve(inner, T @ N)

        # Each new landmark's measurement is D = I + sigma_u^2 G G^T on its own, tied to the others by the pose only.
        log_new = 0.0
        B_new = np.zeros((3, 3))
        B_new_given_prior = np.zeros((3, 3))
        for k in range(new_offsets[c], new_offsets[c + 1]):
            u = new[k]
            G_u = _whitened(p_MU[u, 0] - x, p_MU[u, 1] - y, noise)
            K = np.zeros((2, 3))
            K[:, :2] = -G_u
            K[1, 2] = -1.0 / noise[3]
            D = np.eye(2) + prior_sigma * prior_sigma * (G_u @ G_u.T)
            count = new_count[u] * share_seen(math.sqrt((p_MU[u, 0] - x) ** 2 + (p_MU[u, 1] - y) ** 2), reach)
            log_new += count * math.log(D[0, 0] * D[1, 1] - D[0, 1] * D[1, 0])
            B_new += count * (K.T @ K)
            B_new_given_prior += count * (K.T @ np.linalg.solve(D, K))

        price_known = math.log(np.linalg.det(eye3 + S_x_given_L @ B_known))
        price_all = math.log(np.linalg.det(eye3 + S_x_given_L @ (B_known + B_new)))
        log_localised = math.log(np.linalg.det(eye3 + S_x_given_z @ B_new_given_prior))
        out[c, 0] = 0.5 * (log_known - price_known)
        out[c, 1] = 0.5 * (log_new + log_localised - price_all + price_known)
        out[c, 2] = 0.5 * (log_map + log_new) - out[c, 0] - out[c, 1]
    return out


def turn_noise(sensor: TagSensorConfig, turn_rate: float) -> FloatArray:
    """Deviations of one tag's range and bearing after a full turn at turn_rate (rad/s), as exact_gain takes them.

    A tag is in view for field_of_view / turn_rate seconds; the frames' noise averages down to the floors.
    """
    frames = max(1.0, sensor.detection_probability * sensor.rate * sensor.field_of_view / turn_rate)
    root = math.sqrt(frames)
    return np.array(
        [
            sensor.range_noise / root,
            sensor.range_noise_per_metre / root,
            RANGE_FLOOR,
            max(sensor.bearing_noise / root, BEARING_FLOOR),
        ]
    )


def odometry_covariance(
    X_MD: FloatArray, points: FloatArray, distance: FloatArray, time: FloatArray, odometry: OdometryConfig
) -> FloatArray:
    """Covariance (c, 3, 3), in M, that odometry adds between X_MD (3,) and an arrival at each point (c, 2), m.

    distance: (c,) m and time: (c,) s of travel, modelled as straight: the along-track error is the encoders', the
    heading's is the gyro's random walk and bias, the cross-track error the integral of the heading's.
    """
    direction = np.arctan2(points[:, 1] - X_MD[1], points[:, 0] - X_MD[0])
    walk, bias = odometry.gyro_noise**2 * time, (odometry.gyro_bias * time) ** 2
    Q = np.zeros((len(points), 3, 3))
    Q[:, 0, 0] = odometry.distance_noise**2 * distance + (odometry.distance_scale * distance) ** 2
    Q[:, 1, 1] = (walk / 3.0 + bias / 4.0) * distance**2
    Q[:, 1, 2] = Q[:, 2, 1] = (walk + bias) / 2.0 * distance
    Q[:, 2, 2] = walk + bias
    R = np.zeros_like(Q)
    R[:, 0, 0] = R[:, 1, 1] = np.cos(direction)
    R[:, 1, 0] = np.sin(direction)
    R[:, 0, 1] = -R[:, 1, 0]
    R[:, 2, 2] = 1.0
    return np.asarray(R @ Q @ R.transpose(0, 2, 1))


def departure_given_landmarks(estimate: MapEstimate) -> FloatArray:
    """Covariance (3, 3) of the departure pose X_MD given all landmarks that are known jointly with it."""
    n = 2 * len(estimate.local)
    S = estimate.covariance
    S_DD = np.array(S[n:, n:])
    if n == 0:
        return S_DD
    conditional = S_DD - S[n:, :n] @ cho_solve(cho_factor(S[:n, :n], lower=True), S[:n, n:])
    return np.asarray(0.5 * (conditional + conditional.T))


def local_view(tags: View, estimate: MapEstimate) -> View:
    """A view of rows of estimate.ids as one of the entries of estimate.local, those that are not in it left out."""
    entry = np.full(len(estimate.ids), -1)
    entry[estimate.local] = np.arange(len(estimate.local))
    index = entry[tags.index]
    point = np.repeat(np.arange(len(tags.count)), tags.count)[index >= 0]
    return View(np.append(0, np.cumsum(np.bincount(point, minlength=len(tags.count)))), index[index >= 0])


def information_gain(
    points: FloatArray,
    distance: FloatArray,
    time: FloatArray,
    tags: View,
    frontiers: View,
    estimate: MapEstimate,
    tfg: TfgMap,
    sensor: TagSensorConfig,
    odometry: OdometryConfig,
    explorer: ExplorerConfig,
) -> Gains:
    """Expected gains of a full turn at each point (c, 2), m in M, reached after distance (c,) m and time (c,) s.

    tags and frontiers: what the points see. Each metre of frontier in view stands for explorer.density new landmarks,
    seen where the frontier point is, less where the view ends soon behind it. The arrival pose is known through
    odometry since the last departure alone, as in the factor that will join the two goals. Landmarks that are not known
    jointly with the departure pose count for nothing.
    """
    tags = local_view(tags, estimate)
    out = exact_gain(
        np.ascontiguousarray(points),
        odometry_covariance(estimate.X_MD, points, distance, time, odometry),
        tags.offsets,
        tags.index,
        frontiers.offsets,
        frontiers.index,
        estimate.p_ML[estimate.local],
        estimate.X_MD,
        estimate.covariance,
        departure_given_landmarks(estimate),
        tfg.frontiers,
        explorer.density * tfg.frontier_length,
        explorer.prior_sigma,
        turn_noise(sensor, explorer.turn_rate),
        frontier_reach(sensor),
    )
    return Gains(exploitation=out[:, 0], exploration=out[:, 1], pose_price=out[:, 2])
