"""The chance constraint: the clearance that bounds the probability of a collision (the paper's Sec. III-E, last
equation).

The paper requires Pr(x in edge) < delta, which is zero for any line. Here the robot is a disc of radius r, and its
position relative to the surface counts: a path must keep

    d >= r + Phi^-1(1 - delta / 2) sigma,   sigma^2 = sigma_L^2 + max(TRACKING_DEVIATION, sigma_O)^2

from every surface; delta / 2 because in a door or corner two surfaces are equally near. sigma_L is the predicted
deviation, in the worst direction, of the robot relative to the landmarks of the surfaces nearby after one second of
frames, and sigma_O the error that odometry adds in that second. The absolute uncertainty far from the start does not
close a door, as the door moves with the robot.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.spatial import cKDTree
from scipy.special import ndtr, ndtri

from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.geometry.segment_grid import segment_grid
from tfg_drake.messages import FloatArray, IntArray, MapEstimate, TfgMap
from tfg_drake.planning.exact_gain import Known, known_terms
from tfg_drake.planning.expected_view import SURFACE_TOLERANCE, expected_tags, visible_targets
from tfg_drake.planning.odometry_drift import straight_drift
from tfg_drake.planning.parameters import PlanningParameters

# The prediction takes this number of landmarks in view, the nearest; others add little.
LOCALISATION_TAGS = 10
# The predicted pose is determined by the frames of this time, s.
LOCALISATION_TIME = 1.0
# Greatest length of way over which odometry drifts without a view, m, where walls are landmarks.
BETWEEN_VIEWS = 1.5
# Deviation of the robot from its path and of a surface from the landmarks it is anchored to, m.
TRACKING_DEVIATION = 0.02
# The surfaces that the robot may touch are anchored to landmarks within this distance, m, that face it unhidden: those
# behind a wall may have drifted against its front.
SURFACE_REACH = 1.5


@njit(cache=True)
def localised_deviation(
    points: FloatArray,
    offsets: IntArray,
    index: IntArray,
    targets: FloatArray,
    facing: FloatArray,
    reach: float,
    max_incidence: float,
    noise: FloatArray,
    entry: IntArray,
    covariance: FloatArray,
) -> tuple[FloatArray, IntArray, IntArray]:
    """Return the greatest deviation (n,), m, of a robot's position at each point, relative to the landmarks of the
    surfaces that it could touch.

    Point i has the targets index[offsets[i]:offsets[i + 1]] of targets (t, 2), m, that face facing (t, 2), in view. It
    sees those within reach (m) and max_incidence (rad), each by range and bearing, heading unknown, and takes them to
    be where the map has them; LOCALISATION_TAGS of them count, the nearest. noise: as of `whitened_tag`. entry: (t,)
    the place of each target in the covariance, row by row, -1 for those that it is not of. Where enough of those in
    view are in it, only they count, with their own errors, and relative to those of them in view within SURFACE_REACH,
    where there are none all that are so near; else the errors of the map are left out. inf with fewer than two in view.

    Returns also how many targets each point sees, and how many of these have a place in the covariance, (n,) and (n,).
    """
    sigma = np.full(len(points), np.inf)
    sees, knows = np.zeros(len(points), dtype=np.int64), np.zeros(len(points), dtype=np.int64)
    cos_max = math.cos(max_incidence)
    rows, known = np.empty(len(targets), dtype=np.int64), np.empty(len(targets), dtype=np.int64)
    carry = np.empty(len(targets), dtype=np.int64)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        carries = 0
        for t in index[offsets[i] : offsets[i + 1]]:
            dx, dy = targets[t, 0] - x, targets[t, 1] - y
            r = math.sqrt(dx * dx + dy * dy)
            if r <= reach and -(dx * facing[t, 0] + dy * facing[t, 1]) >= cos_max * r:
                rows[sees[i]] = t
                sees[i] += 1
                if entry[t] >= 0:
                    known[knows[i]] = t
                    knows[i] += 1
            if r <= SURFACE_REACH and entry[t] >= 0:
                carry[carries] = t
                carries += 1
        # By few of those in view that happen to be known jointly the place would be known worse than it is.
        is_joint = knows[i] >= 2 and knows[i] >= min(sees[i], LOCALISATION_TAGS)
        if is_joint and carries == 0:
            # As in a door, where what carries the jambs looks away to either side.
            for t in range(len(targets)):
                if entry[t] >= 0 and (targets[t, 0] - x) ** 2 + (targets[t, 1] - y) ** 2 <= SURFACE_REACH**2:
                    carry[carries] = t
                    carries += 1
        seen = known[: knows[i]] if is_joint else rows[: sees[i]]
        if len(seen) > LOCALISATION_TAGS:
            square = np.empty(len(seen))
            for k in range(len(seen)):
                square[k] = (targets[seen[k], 0] - x) ** 2 + (targets[seen[k], 1] - y) ** 2
            seen = seen[np.argsort(square)[:LOCALISATION_TAGS]]
        if len(seen) >= 2:
            sigma[i] = _deviation_at(x, y, seen, carry[:carries], is_joint, targets, noise, entry, covariance)
    return sigma, sees, knows


@njit(cache=True)
def _deviation_at(
    x: float,
    y: float,
    rows: IntArray,
    carry: IntArray,
    is_joint: bool,
    targets: FloatArray,
    noise: FloatArray,
    entry: IntArray,
    covariance: FloatArray,
) -> float:
    """Return the deviation, m, at (x, y) by the targets of these rows (m,), relative to those, carry (s,), of surfaces
    that it could touch. is_joint: the targets' own errors count. Further arguments as of localised_deviation."""
    no_walls = np.zeros((len(targets), 2, 2)), np.zeros((len(targets), 2))
    known = Known(np.array([0, len(rows)]), rows, targets, entry, *no_walls, covariance)
    column, G, K, C = known_terms(x, y, 0, known, noise)
    information = K.T.copy() @ K
    if np.linalg.det(information) <= 0.0:
        return np.inf
    # How far each measurement's error moves the robot.
    by_look = np.linalg.solve(information, K.T.copy())[:2].copy()
    by_noise = by_look @ by_look.T
    if not is_joint:
        return math.sqrt(_largest(by_noise))
    # It takes part in the errors of the landmarks that it goes by.
    own, worst = by_look @ C @ by_look.T, 0.0
    for t in carry:
        s = 2 * entry[t]
        with_surface = G[:, :1] * covariance[column, s : s + 2] + G[:, 1:] * covariance[column + 1, s : s + 2]
        shared = by_look @ with_surface
        worst = max(worst, _largest(own + shared + shared.T + covariance[s : s + 2, s : s + 2]))
    return math.sqrt(worst if worst > 0.0 else _largest(by_noise))


@njit(cache=True)
def _largest(S: FloatArray) -> float:
    """Return the larger eigenvalue of a covariance (2, 2)."""
    return float(0.5 * (S[0, 0] + S[1, 1]) + math.sqrt(0.25 * (S[0, 0] - S[1, 1]) ** 2 + S[0, 1] ** 2))


def predicted_deviation(
    points: FloatArray,
    estimate: MapEstimate,
    tfg: TfgMap,
    parameters: PlanningParameters,
    before: FloatArray | float = math.inf,
) -> FloatArray:
    """Return the predicted deviation sigma (n,), m, of the robot relative to the surfaces near each point (n, 2), in M.

    Where two or more landmarks are in view, that of a pose from one second of frames (the share of a turn that the
    field of view covers), and of the map there where enough of its landmarks are known jointly; elsewhere that of the
    nearest such point, or of the place where the robot stands, grown by odometry over the straight way from there at
    full speed, where walls are landmarks over BETWEEN_VIEWS of it at most. The robot drives on while the frames
    come: everywhere TRACKING_DEVIATION is added or what odometry adds in that second, which bounds what the filter has
    not yet taken out, if that is more (by rollouts at one and at three times the usual noise the greater of both is
    enough).

    before: (n,) m, what it was found to be last, inf where it never was: where not enough landmarks are known jointly,
    far from the robot, it stays that.
    """
    sensor, speed = parameters.sensor, parameters.robot.max_speed
    in_view = visible_targets(
        points,
        estimate.p_ML,
        tfg.facing,
        tfg.segments,
        segment_grid(tfg.segments),
        max(sensor.range, SURFACE_REACH),
        sensor.max_incidence,
        SURFACE_TOLERANCE,
        0.0,
        SURFACE_REACH,
    )
    frames = estimate.frame_worth * sensor.detection_probability * sensor.rate * LOCALISATION_TIME
    frames *= min(1.0, sensor.field_of_view / (2 * math.pi))
    noise = np.array([sensor.range_noise, sensor.range_noise_per_metre, 0.0, sensor.bearing_noise]) / math.sqrt(frames)
    sigma, sees, knows = localised_deviation(
        points,
        *in_view,
        estimate.p_ML,
        tfg.facing,
        sensor.range,
        sensor.max_incidence,
        noise,
        estimate.local_entry,
        estimate.covariance,
    )
    joint = (knows >= 2) & (knows >= np.minimum(sees, LOCALISATION_TAGS))
    localised = np.isfinite(sigma)
    if not localised.all():
        anchors = np.vstack([points[localised], estimate.X_MD[None, :2]])
        at_anchor = np.append(sigma[localised], 0.0)
        d, nearest = cKDTree(anchors).query(points[~localised])
        d = _unseen(d, estimate)
        sigma[~localised] = np.sqrt(at_anchor[nearest] ** 2 + _drift(d, parameters))
    on_the_way = np.maximum(TRACKING_DEVIATION**2, _drift(np.array(speed * LOCALISATION_TIME), parameters))
    sigma = np.sqrt(sigma**2 + on_the_way)
    stays = ~joint & (sees >= 2) & (knows < sees) & np.isfinite(before)
    return np.where(stays, before, sigma)


def deviation_along(path: FloatArray, estimate: MapEstimate, tfg: TfgMap, parameters: PlanningParameters) -> FloatArray:
    """Return the deviation sigma (k,), m, at the points of a path (k, 2), m in M, for a robot that drives it from the
    first on.

    It is that of `predicted_deviation` at the start and wherever the robot, facing along the path, has two landmarks in
    view, but at most that at an earlier such point plus the odometry error since. So landmarks behind a robot that
    drives away from them do not localise it, and past a place with few landmarks it keeps its earlier accuracy.
    """
    sensor, sigma = parameters.sensor, predicted_deviation(path, estimate, tfg, parameters)
    step = np.diff(path, axis=0)
    heading = np.arctan2(*np.vstack([step[:1], step]).T[::-1])
    visible = expected_tags(path, estimate, tfg, sensor)
    point = np.repeat(np.arange(len(path)), visible.count)
    d = estimate.p_ML[visible.index] - path[point]
    ahead = np.abs(wrap_angle(np.arctan2(d[:, 1], d[:, 0]) - heading[point])) < 0.5 * sensor.field_of_view
    in_view = np.bincount(point[ahead], minlength=len(path))
    known = np.flatnonzero((in_view >= 2) | (np.arange(len(path)) == 0))
    s = np.append(0.0, np.cumsum(np.hypot(*step.T)))
    since = s[:, None] - s[known]
    variance = sigma[known] ** 2 + _drift(_unseen(np.maximum(since, 0.0), estimate), parameters)
    return np.asarray(np.sqrt(np.where(since >= 0.0, variance, np.inf).min(axis=1)))


def _unseen(length: FloatArray, estimate: MapEstimate) -> FloatArray:
    """Return the length, m, measured by odometry only, of ways of these lengths out of sight of tags: if walls are
    landmarks, the next view determines the pose relative to those nearby."""
    return np.minimum(length, BETWEEN_VIEWS) if estimate.by_walls else length


def _drift(length: FloatArray, parameters: PlanningParameters) -> FloatArray:
    """Return the variance, m^2, that odometry adds over straight ways of these lengths, m, driven at full speed, in the
    worse direction."""
    along, across, _, _ = straight_drift(length, length / parameters.robot.max_speed, parameters.odometry)
    return np.asarray(np.maximum(along, across))


def required_clearance(radius: float, sigma: FloatArray, collision_probability: float) -> FloatArray:
    """Return the clearance (n,), m, that a disc of a radius (m) needs between two surfaces with deviation sigma (n,),
    m."""
    return np.asarray(radius + ndtri(1.0 - 0.5 * collision_probability) * sigma)


def collision_probability(clearance: FloatArray, radius: float, sigma: FloatArray) -> FloatArray:
    """Return the probability (n,) of a collision between two surfaces at a clearance (n,), m, see
    required_clearance."""
    return np.asarray(np.minimum(1.0, 2.0 * ndtr((radius - clearance) / sigma)))
