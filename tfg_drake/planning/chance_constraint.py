"""The clearance that keeps the probability of a collision small (the paper's Sec. V, last equation).

The paper asks for Pr(x in edge) < delta, which is zero for any line. Here the robot is a disc of radius r, and what
counts is its position relative to the surface: a path must keep

    d >= r + Phi^-1(1 - delta / 2) sigma,   sigma^2 = sigma_L^2 + max(TRACKING_DEVIATION, sigma_O)^2

from every surface: in a door and in a corner two of them are as near. sigma_L is the predicted deviation of the robot
relative to the landmarks that carry the surfaces nearby, across any direction, as it is recognised in a second of
frames, and sigma_O what odometry adds in that second. Its absolute uncertainty far from the start does not close a
door: the door moves with it.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.spatial import cKDTree
from scipy.special import ndtr, ndtri

from tfg_drake.config import OdometryConfig, TagSensorConfig
from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, TfgMap
from tfg_drake.planning.expected_view import SURFACE_TOLERANCE, View, expected_tags, local_view, visible_targets
from tfg_drake.planning.odometry_drift import straight_drift

# Landmarks farther away are left out of the prediction: they add little and cost most, m; and of those nearer all but
# so many.
LOCALISATION_RANGE = 5.0
LOCALISATION_TAGS = 10
# The pose is what this much time of frames makes it, s.
LOCALISATION_TIME = 1.0
# Deviation of the robot from its path and of a surface from the landmarks it is anchored to, m.
TRACKING_DEVIATION = 0.02
# Surfaces that a robot at a point might touch are carried by landmarks this near, m, that face it with nothing between:
# those in the room behind a wall may have drifted far from its front, and do not matter to who drives along that.
SURFACE_REACH = 1.5


@njit(cache=True)
def localised_deviation(
    points: FloatArray,
    offsets: IntArray,
    index: IntArray,
    targets: FloatArray,
    range_noise: float,
    range_noise_per_metre: float,
    bearing_noise: float,
    frames: float,
    covariance: FloatArray,
    carry_offsets: IntArray,
    carry_index: IntArray,
) -> FloatArray:
    """Greatest deviation (n,), m, of a robot's position at each point, relative to those landmarks that carry what it
    could touch.

    Point i sees targets[index[offsets[i]:offsets[i + 1]]] of targets (t, 2), each in `frames` frames of range and
    bearing, heading unknown, and takes them to be where the map has them; LOCALISATION_TAGS of them count, the nearest.
    covariance: (>= 2t, >= 2t) of the targets, m^2; (0, 0) where their own errors are left out. Relative to which
    targets: carry_index[carry_offsets[i]:carry_offsets[i + 1]], where there are none all within SURFACE_REACH. inf
    with fewer than two in view.
    """
    out = np.full(len(points), np.inf)
    uncertain = len(covariance) > 0
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        rows = index[offsets[i] : offsets[i + 1]]
        if len(rows) < 2:
            continue
        if len(rows) > LOCALISATION_TAGS:
            square = np.empty(len(rows))
            for k in range(len(rows)):
                square[k] = (targets[rows[k], 0] - x) ** 2 + (targets[rows[k], 1] - y) ** 2
            rows = rows[np.argsort(square)[:LOCALISATION_TAGS]]
        m = len(rows)
        H = np.empty((m, 3, 2))  # K^T G: what an error of each landmark does to the information on the pose
        b_xx, b_xy, b_yy, b_xt, b_yt, b_tt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(m):
            dx, dy = targets[rows[k], 0] - x, targets[rows[k], 1] - y
            r = max(math.sqrt(dx * dx + dy * dy), 0.05)
            ux, uy = dx / r, dy / r
            w_range = frames / (range_noise + range_noise_per_metre * r) ** 2
            w_bearing = frames / bearing_noise**2
            xx = w_range * ux * ux + w_bearing * uy * uy / (r * r)
            xy = w_range * ux * uy - w_bearing * ux * uy / (r * r)
            yy = w_range * uy * uy + w_bearing * ux * ux / (r * r)
            hx, hy = -w_bearing * uy / r, w_bearing * ux / r
            b_xx, b_xy, b_yy = b_xx + xx, b_xy + xy, b_yy + yy
            b_xt, b_yt, b_tt = b_xt + hx, b_yt + hy, b_tt + w_bearing
            H[k, 0, 0], H[k, 0, 1], H[k, 1, 1] = xx, xy, yy
            H[k, 1, 0] = xy
            H[k, 2, 0], H[k, 2, 1] = hx, hy
        # The heading eliminated.
        tx, ty = b_xt / b_tt, b_yt / b_tt
        b_xx, b_xy, b_yy = b_xx - tx * b_xt, b_xy - tx * b_yt, b_yy - ty * b_yt
        det = b_xx * b_yy - b_xy * b_xy
        if det <= 0.0:
            continue
        p_xx, p_xy, p_yy = b_yy / det, -b_xy / det, b_xx / det
        if not uncertain:
            out[i] = math.sqrt(_largest(p_xx, p_xy, p_yy))
            continue

        # The robot's error is M dL + noise: it takes part in those of the landmarks it goes by. N = S M^T.
        M = np.empty((m, 2, 2))
        for k in range(m):
            for j in range(2):
                h_x, h_y = H[k, 0, j] - tx * H[k, 2, j], H[k, 1, j] - ty * H[k, 2, j]
                M[k, 0, j] = p_xx * h_x + p_xy * h_y
                M[k, 1, j] = p_xy * h_x + p_yy * h_y
        xx, xy, yy = p_xx, p_xy, p_yy
        for k in range(m):
            n00, n01, n10, n11 = _shared(covariance, rows[k], rows, M)
            xx += M[k, 0, 0] * n00 + M[k, 0, 1] * n10
            xy += M[k, 0, 0] * n01 + M[k, 0, 1] * n11
            yy += M[k, 1, 0] * n01 + M[k, 1, 1] * n11
        worst = 0.0
        carry = carry_index[carry_offsets[i] : carry_offsets[i + 1]]
        if len(carry) == 0:
            # As in a door, where what carries the jambs looks away to either side.
            carry = np.flatnonzero((targets[:, 0] - x) ** 2 + (targets[:, 1] - y) ** 2 <= SURFACE_REACH**2)
        for s in carry:
            n00, n01, n10, n11 = _shared(covariance, s, rows, M)
            a = xx - 2.0 * n00 + covariance[2 * s, 2 * s]
            b = xy - n01 - n10 + covariance[2 * s, 2 * s + 1]
            c = yy - 2.0 * n11 + covariance[2 * s + 1, 2 * s + 1]
            worst = max(worst, _largest(a, b, c))
        out[i] = math.sqrt(worst if worst > 0.0 else _largest(p_xx, p_xy, p_yy))
    return out


@njit(cache=True)
def _shared(covariance: FloatArray, row: int, rows: IntArray, M: FloatArray) -> tuple[float, float, float, float]:
    """The covariance (2, 2), row by row, of one landmark's error with the sum of those of others times M (m, 2, 2)."""
    a = 2 * row
    n00, n01, n10, n11 = 0.0, 0.0, 0.0, 0.0
    for j in range(len(rows)):
        b = 2 * rows[j]
        n00 += covariance[a, b] * M[j, 0, 0] + covariance[a, b + 1] * M[j, 0, 1]
        n01 += covariance[a, b] * M[j, 1, 0] + covariance[a, b + 1] * M[j, 1, 1]
        n10 += covariance[a + 1, b] * M[j, 0, 0] + covariance[a + 1, b + 1] * M[j, 0, 1]
        n11 += covariance[a + 1, b] * M[j, 1, 0] + covariance[a + 1, b + 1] * M[j, 1, 1]
    return n00, n01, n10, n11


@njit(cache=True)
def _largest(a: float, b: float, c: float) -> float:
    """The larger eigenvalue of [[a, b], [b, c]]."""
    return 0.5 * (a + c) + math.sqrt(0.25 * (a - c) ** 2 + b * b)


def predicted_deviation(
    points: FloatArray,
    estimate: MapEstimate,
    tfg: TfgMap,
    sensor: TagSensorConfig,
    odometry: OdometryConfig,
    speed: float,
    before: FloatArray | float = math.inf,
) -> tuple[FloatArray, BoolArray]:
    """Deviation sigma (n,), m, of the robot relative to the surfaces near each point (n, 2), in M.

    Where two or more landmarks are in view, that of a pose from one second of frames (the share of a turn that the
    field of view covers), and of the map there where enough of its landmarks are known jointly; elsewhere that of the
    nearest such point, or of the place where the robot stands, grown by odometry over the straight way from there at
    `speed` (m/s). The robot drives on while the frames come: everywhere TRACKING_DEVIATION is added or what odometry
    adds in that second, which bounds what the filter has not yet taken out, if that is more (by rollouts at one and at
    three times the usual noise the greater of both is enough). before: (n,) m, what it was when enough landmarks there
    were last known jointly, inf where they never were: far from the robot it stays that, nothing has changed there
    since. Returns also which (n,) are so known, now or then.
    """

    def in_view(reach: float, max_incidence: float) -> View:
        targets = estimate.p_ML, tfg.facing, tfg.segments
        return View(*visible_targets(points, *targets, reach, max_incidence, SURFACE_TOLERANCE, 0.0))

    near = in_view(min(sensor.range, LOCALISATION_RANGE), sensor.max_incidence)
    touchable = local_view(in_view(SURFACE_REACH, 0.5 * math.pi), estimate)
    frames = sensor.detection_probability * sensor.rate * LOCALISATION_TIME
    frames *= min(1.0, sensor.field_of_view / (2 * math.pi))
    noise = sensor.range_noise, sensor.range_noise_per_metre, sensor.bearing_noise, frames
    local = local_view(near, estimate)
    # By few of those in view that happen to be known jointly the place would be known worse than it is.
    joint = (local.count >= 2) & (local.count >= np.minimum(near.count, LOCALISATION_TAGS))
    sigma = np.empty(len(points))
    for which, view, targets, covariance in (
        (joint, local, estimate.p_ML[estimate.local], estimate.covariance),
        (~joint, near, estimate.p_ML, np.zeros((0, 0))),
    ):
        rows = np.flatnonzero(which)
        seen, carry = view.of(rows), touchable.of(rows)
        sigma[which] = localised_deviation(
            points[which], seen.offsets, seen.index, targets, *noise, covariance, carry.offsets, carry.index
        )
    localised = np.isfinite(sigma)
    if not localised.all():
        anchors = np.vstack([points[localised], estimate.X_MD[None, :2]])
        at_anchor = np.append(sigma[localised], 0.0)
        d, nearest = cKDTree(anchors).query(points[~localised])
        sigma[~localised] = np.sqrt(at_anchor[nearest] ** 2 + _drift(d, odometry, speed))
    on_the_way = np.maximum(TRACKING_DEVIATION**2, _drift(np.array(speed * LOCALISATION_TIME), odometry, speed))
    sigma = np.sqrt(sigma**2 + on_the_way)
    remembered = ~joint & (near.count >= 2) & (local.count < near.count) & np.isfinite(before)
    return np.where(remembered, before, sigma), joint | remembered


def deviation_along(
    path: FloatArray,
    estimate: MapEstimate,
    tfg: TfgMap,
    sensor: TagSensorConfig,
    odometry: OdometryConfig,
    speed: float,
) -> FloatArray:
    """Deviation sigma (k,), m, at the points of a path (k, 2), m in M, for a robot that drives it from the first on.

    That of `predicted_deviation` at its start and wherever the robot, facing along the path, has two landmarks in view;
    but no more than it was at any such point before and odometry has added since. So a robot that drives away from all
    landmarks is not sure of its place by those behind it, and past a place with few of them it goes on by what it knew.
    """
    sigma, _ = predicted_deviation(path, estimate, tfg, sensor, odometry, speed)
    step = np.diff(path, axis=0)
    heading = np.arctan2(*np.vstack([step[:1], step]).T[::-1])
    view = expected_tags(path, estimate, tfg, sensor)
    point = np.repeat(np.arange(len(path)), view.count)
    d = estimate.p_ML[view.index] - path[point]
    ahead = np.abs(wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - heading[point])) < 0.5 * sensor.field_of_view
    in_view = np.bincount(point[ahead], minlength=len(path))
    known = np.flatnonzero((in_view >= 2) | (np.arange(len(path)) == 0))
    s = np.append(0.0, np.cumsum(np.hypot(*step.T)))
    since = s[:, None] - s[known]
    variance = sigma[known] ** 2 + _drift(np.maximum(since, 0.0), odometry, speed)
    return np.asarray(np.sqrt(np.where(since >= 0.0, variance, np.inf).min(axis=1)))


def _drift(length: FloatArray, odometry: OdometryConfig, speed: float) -> FloatArray:
    """Variance, m^2, that odometry adds over straight ways of these lengths, m, in the worse direction."""
    along, across, _, _ = straight_drift(length, length / speed, odometry)
    return np.asarray(np.maximum(along, across))


def required_clearance(radius: float, sigma: FloatArray, collision_probability: float) -> FloatArray:
    """Clearance (n,), m, that a disc of this radius (m) needs with deviation sigma (n,), m, between two surfaces."""
    return np.asarray(radius + ndtri(1.0 - 0.5 * collision_probability) * sigma)


def collision_probability(clearance: FloatArray, radius: float, sigma: FloatArray) -> FloatArray:
    """The probability (n,) of a collision between two surfaces at this clearance (n,), m: see required_clearance."""
    return np.asarray(np.minimum(1.0, 2.0 * ndtr((radius - clearance) / sigma)))
