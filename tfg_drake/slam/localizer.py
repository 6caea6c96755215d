"""The online pose in the map: mapped landmarks considered, never updated, and tags met on the way as own states.

Path sightings localise only; the map learns from goals. Correlations between pose and map are kept, so the pose's
covariance stays honest over any number of frames. The filter works in the frame of the last departure pose D and
carries X_MD along, so that the pose in M has its full covariance too.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, MapEstimate, TagDetections, message, replace
from tfg_drake.slam import pose_filter
from tfg_drake.slam.departure_frame import in_departure_frame
from tfg_drake.slam.odometry_model import OdometryModel, wrap
from tfg_drake.slam.pose_filter import CORE, POSE, PoseFilter, motion

# Landmarks considered: the nearest to the departure pose, or to the robot.
WINDOW = 300
# On a large map others take their place when the robot has come this far from there, m, and near another goal.
FAR = 5.0
# Two parts of one map differ by this where they meet, m, m, rad.
AGREEMENT = (0.03, 0.03, 0.01)
# What is known of the landmarks to better than this counts as known exactly, m and rad: there a matrix is singular.
BLUR = (1e-3, 1e-4)
# Local tags kept at most; the longest unseen go first.
MOST_LOCAL = 30
# Standard deviations of a pose found by geometry before the tags it was found from are used, m, m, rad.
ANYWHERE = (1.0, 1.0, 0.5)


@message
class Localizer:
    """The filter in D, X_MD (3,), and center (2,), m in M: the place round which landmarks are considered.

    D is the last departure pose; on a large map that of a goal which the robot has come by since.
    """

    X_MD: FloatArray
    center: FloatArray
    filter: PoseFilter


def start_localizer(model: OdometryModel, map_estimate: MapEstimate | None) -> Localizer:
    """The localiser at the departure pose of the newest map, or at the origin of an empty one."""
    if map_estimate is None:
        nothing = np.empty(0, dtype=np.int64)
        return Localizer(
            np.zeros(3), np.zeros(2), pose_filter.start(model, nothing, np.empty((0, 2)), np.zeros((POSE, POSE)))
        )
    return _around(model, map_estimate, map_estimate.X_MD)


def restart_localizer(
    model: OdometryModel, map_estimate: MapEstimate, X_MB: FloatArray, detections: TagDetections
) -> Localizer:
    """The localiser at a pose X_MB (3,) found by geometry, as uncertain as the mapped tags it was found from say."""
    localizer = _around(model, map_estimate, X_MB)
    filter_ = localizer.filter
    mean, covariance = filter_.mean.copy(), filter_.covariance.copy()
    mean[:POSE] = se2.between(map_estimate.X_MD, X_MB)
    covariance[:POSE, :POSE] = np.diag(ANYWHERE) ** 2
    filter_ = replace(filter_, mean=mean, covariance=covariance)
    filter_, _, _ = pose_filter.step(filter_, model, np.zeros(3), 0.0, detections)
    return replace(localizer, filter=filter_)


def moved_localizer(localizer: Localizer, model: OdometryModel, map_estimate: MapEstimate) -> Localizer:
    """The localiser in the frame of another departure pose, that of an estimate seen from where the robot is now.

    What is known of the pose, and of the tags met on the way, relative to the landmarks considered so far stays known,
    but for AGREEMENT, by which two parts of one map may differ; what they share with the landmarks is given up. The
    next sightings tell it anew.
    """
    old = localizer.filter
    X_MB, _ = localized_pose(localizer, model, np.zeros(3), 0.0)
    moved = _around(model, map_estimate, X_MB)
    blur = np.diag(np.append(np.full(len(old.considered) - 1, BLUR[0]), BLUR[1])) ** 2
    relative = old.covariance - old.cross @ np.linalg.solve(old.considered + blur, old.cross.T)

    p_MU = local_tags(localizer)
    mean = old.mean.copy()
    mean[:POSE] = se2.between(map_estimate.X_MD, X_MB)
    mean[CORE:] = se2.transform(se2.inverse(map_estimate.X_MD), p_MU).ravel()
    turn = se2.rotation(float(localizer.X_MD[2] - map_estimate.X_MD[2]))
    to_new = np.eye(len(mean))
    for i in (0, *range(CORE, len(mean), 2)):
        to_new[i : i + 2, i : i + 2] = turn
    # An error of the map moves and turns the robot and the tags that it has met as one.
    together = np.zeros((len(mean), POSE))
    together[:POSE] = np.eye(POSE)
    together[CORE::2, 0] = together[CORE + 1 :: 2, 1] = 1.0
    lever = mean[CORE:].reshape(-1, 2) - mean[:2]
    together[CORE::2, 2], together[CORE + 1 :: 2, 2] = -lever[:, 1], lever[:, 0]
    covariance = to_new @ relative @ to_new.T + together @ np.diag(AGREEMENT) ** 2 @ together.T
    filter_ = replace(
        moved.filter,
        mean=mean,
        covariance=0.5 * (covariance + covariance.T),
        cross=np.zeros((len(mean), len(moved.filter.considered))),
        local_ids=old.local_ids,
        last_seen=old.last_seen,
    )
    return replace(moved, filter=filter_)


def _around(model: OdometryModel, map_estimate: MapEstimate, X_MB: FloatArray) -> Localizer:
    """A localiser at the departure pose that considers the landmarks nearest to X_MB (3,), of those known jointly."""
    local = map_estimate.local
    distance = np.hypot(*(map_estimate.p_ML[local] - X_MB[:2]).T)
    near = np.sort(local[np.argsort(distance, kind="stable")[:WINDOW]])
    p_DL, covariance = in_departure_frame(map_estimate, near)
    filter_ = pose_filter.start(model, map_estimate.ids[near], p_DL, covariance)
    return Localizer(map_estimate.X_MD, X_MB[:2], filter_)


def step_localizer(
    localizer: Localizer, model: OdometryModel, increment: FloatArray, dt: float, detections: TagDetections
) -> tuple[Localizer, int, int]:
    """The localiser after an odometry increment (3,) over dt seconds and the frame at its end; how many of the frame's
    sightings were of tags it knows, and how many of those it ignored."""
    filter_, known, ignored = pose_filter.step(localizer.filter, model, increment, dt, detections)
    if len(filter_.local_ids) > MOST_LOCAL:
        keep = np.ones(len(filter_.local_ids), dtype=bool)
        keep[np.argsort(-filter_.last_seen, kind="stable")[MOST_LOCAL:]] = False
        filter_ = pose_filter.keep_local(filter_, keep)
    return replace(localizer, filter=filter_), known, ignored


def without_local(localizer: Localizer) -> Localizer:
    """The localiser without the tags met on the way."""
    filter_ = localizer.filter
    return replace(localizer, filter=pose_filter.keep_local(filter_, np.zeros(len(filter_.local_ids), dtype=bool)))


def localized_pose(
    localizer: Localizer, model: OdometryModel, increment: FloatArray, dt: float
) -> tuple[FloatArray, FloatArray]:
    """X_MB (3,) and its covariance (3, 3), an odometry increment (3,) over dt seconds past the localiser's instant."""
    filter_ = localizer.filter
    X_MB, covariance = _in_map(
        localizer.X_MD,
        filter_.considered,
        filter_.mean,
        filter_.covariance,
        filter_.cross,
        increment,
        dt,
        model.noise,
    )
    return X_MB, covariance


@njit(cache=True)
def _in_map(
    X_MD: FloatArray,
    considered: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    cross: FloatArray,
    increment: FloatArray,
    dt: float,
    noise: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """X_MB (3,) = X_MD X_DB and its covariance (3, 3), X_DB of the filter after an odometry increment."""
    X_DB, F, N = motion(mean, increment, dt, noise)
    c, s = math.cos(X_MD[2]), math.sin(X_MD[2])
    x, y = c * X_DB[0] - s * X_DB[1], s * X_DB[0] + c * X_DB[1]
    # The error of X_MB is J times that of X_MD and of the filter's state before the increment, and N turned into M.
    size = len(considered) - POSE
    J = np.zeros((POSE, POSE + CORE))
    J[0, 0] = J[1, 1] = J[2, 2] = 1.0
    J[0, 2], J[1, 2] = -y, x
    joint = np.empty((POSE + CORE, POSE + CORE))
    for j in range(CORE):
        J[0, POSE + j] = c * F[0, j] - s * F[1, j]
        J[1, POSE + j] = s * F[0, j] + c * F[1, j]
        J[2, POSE + j] = F[2, j]
        for k in range(CORE):
            joint[POSE + j, POSE + k] = covariance[j, k]
        for k in range(POSE):
            joint[POSE + j, k] = joint[k, POSE + j] = cross[j, size + k]
    for j in range(POSE):
        for k in range(POSE):
            joint[j, k] = considered[size + j, size + k]
    P = np.empty((POSE, POSE))
    for i in range(POSE):
        by = np.zeros(POSE + CORE)
        for j in range(POSE + CORE):
            for k in range(POSE + CORE):
                by[k] += J[i, j] * joint[j, k]
        for m in range(POSE):
            P[i, m] = 0.0
            for k in range(POSE + CORE):
                P[i, m] += by[k] * J[m, k]
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    for i in range(POSE):
        for m in range(POSE):
            for j in range(POSE):
                for k in range(POSE):
                    P[i, m] += R[i, j] * N[j, k] * R[m, k]
    return np.array([X_MD[0] + x, X_MD[1] + y, wrap(X_MD[2] + X_DB[2])]), P


def local_tags(localizer: Localizer) -> FloatArray:
    """p_MU (u, 2) of the tags met on the way, row for row with localizer.filter.local_ids."""
    return se2.transform(localizer.X_MD, localizer.filter.mean[CORE:].reshape(-1, 2))
