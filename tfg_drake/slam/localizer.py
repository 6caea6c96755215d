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
from tfg_drake.slam.pose_filter import CORE, POSE, PoseFilter, predict_pose

# Landmarks considered: the nearest to the departure pose, or to the robot.
WINDOW = 300
# Local tags kept at most; the longest unseen go first.
MOST_LOCAL = 30
# Standard deviations of a pose found by geometry before the tags it was found from are used, m, m, rad.
ANYWHERE = (1.0, 1.0, 0.5)


@message
class Localizer:
    """The filter in D, X_MD (3,): the last departure pose, or that of a goal near which the robot found itself."""

    X_MD: FloatArray
    filter: PoseFilter


def start_localizer(model: OdometryModel, map_estimate: MapEstimate | None) -> Localizer:
    """The localiser at the departure pose of the newest map, or at the origin of an empty one."""
    if map_estimate is None:
        nothing = np.empty(0, dtype=np.int64)
        return Localizer(np.zeros(3), pose_filter.start(model, nothing, np.empty((0, 2)), np.zeros((POSE, POSE))))
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


def _around(model: OdometryModel, map_estimate: MapEstimate, X_MB: FloatArray) -> Localizer:
    """A localiser at the departure pose that considers the landmarks nearest to X_MB (3,), of those known jointly."""
    local = map_estimate.local
    distance = np.hypot(*(map_estimate.p_ML[local] - X_MB[:2]).T)
    near = np.sort(local[np.argsort(distance, kind="stable")[:WINDOW]])
    p_DL, covariance = in_departure_frame(map_estimate, near)
    filter_ = pose_filter.start(model, map_estimate.ids[near], p_DL, covariance)
    return Localizer(map_estimate.X_MD, filter_)


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
    X_DB, P_BB, P_BD = predict_pose(mean, covariance, cross, POSE, increment, dt, noise)
    P_DD = considered[-POSE:, -POSE:].copy()
    c, s = math.cos(X_MD[2]), math.sin(X_MD[2])
    x, y = c * X_DB[0] - s * X_DB[1], s * X_DB[0] + c * X_DB[1]
    by_D, by_B = np.eye(3), np.eye(3)
    by_D[0, 2], by_D[1, 2] = -y, x
    by_B[0, 0], by_B[0, 1], by_B[1, 0], by_B[1, 1] = c, -s, s, c
    mixed = by_B @ P_BD @ by_D.T
    X_MB = np.array([X_MD[0] + x, X_MD[1] + y, wrap(X_MD[2] + X_DB[2])])
    return X_MB, by_D @ P_DD @ by_D.T + by_B @ P_BB @ by_B.T + mixed + mixed.T


def local_tags(localizer: Localizer) -> FloatArray:
    """p_MU (u, 2) of the tags met on the way, row for row with localizer.filter.local_ids."""
    return se2.transform(localizer.X_MD, localizer.filter.mean[CORE:].reshape(-1, 2))
