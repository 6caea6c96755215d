"""The online pose in the map: mapped landmarks considered, never updated, and tags met on the way as own states.

Path sightings localise only; the map learns from views. Correlations between pose and map are kept, so the pose's
covariance stays honest over any number of frames. The filter works in the frame of the last departure pose D and
carries X_MD along, so that the pose in M has its full covariance too.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, MapEstimate, TagDetections, message, replace
from tfg_drake.slam import pose_filter
from tfg_drake.slam.departure_frame import local_positions
from tfg_drake.slam.odometry_model import OdometryModel, wrap
from tfg_drake.slam.pose_filter import CORE, POSE, PoseFilter, predict_pose
from tfg_drake.slam.tag_error import in_place

# Local tags kept at most; the longest unseen go first.
MOST_LOCAL = 30
# Nobody goes to look for a tag that fewer frames saw where it seems to be: one of them may be wrong, or its id misread.
LEAST_FRAMES = 2
# Standard deviations of a pose found by geometry before the tags it was found from are used, m, m, rad.
ANYWHERE = (1.0, 1.0, 0.5)


@message
class Localizer:
    """The filter in D, X_MD (3,): the last departure pose, or that of a view near which the robot found itself."""

    X_MD: FloatArray
    filter: PoseFilter


def start_localizer(model: OdometryModel, map_estimate: MapEstimate | None) -> Localizer:
    """The localiser at the departure pose of the newest map, or at the origin of an empty one."""
    if map_estimate is None:
        return Localizer(np.zeros(3), pose_filter.start_alone(model))
    return _around(model, map_estimate)


def restart_localizer(
    model: OdometryModel, map_estimate: MapEstimate, X_MB: FloatArray, detections: TagDetections
) -> Localizer:
    """The localiser at a pose X_MB (3,) found by geometry, as uncertain as the mapped tags it was found from say."""
    localizer = _around(model, map_estimate)
    filter_ = localizer.filter
    mean, covariance = filter_.mean.copy(), filter_.covariance.copy()
    mean[:POSE] = se2.between(map_estimate.X_MD, X_MB)
    covariance[:POSE, :POSE] = np.diag(ANYWHERE) ** 2
    filter_ = replace(filter_, mean=mean, covariance=covariance)
    filter_, _, _ = pose_filter.step(filter_, model, np.zeros(3), 0.0, detections)
    return replace(localizer, filter=filter_)


def _around(model: OdometryModel, map_estimate: MapEstimate) -> Localizer:
    """A localiser at the departure pose that considers the landmarks known jointly, with what the constant errors of
    tags make of where they seem to be from there."""
    X_MD, considered, m = map_estimate.X_MD, map_estimate.covariance, len(map_estimate.local)
    p_DL = local_positions(map_estimate)
    if map_estimate.tag_error.any():
        considered, i = considered.copy(), np.arange(m)
        seeming = in_place(map_estimate.local_p_ML - X_MD[:2], map_estimate.tag_error)
        considered[:-3, :-3].reshape(m, 2, m, 2)[i, :, i, :] += seeming
    filter_ = pose_filter.start(model, map_estimate.ids[map_estimate.is_local], p_DL, float(X_MD[2]), considered)
    return Localizer(X_MD, filter_)


def step_localizer(
    localizer: Localizer, model: OdometryModel, increment: FloatArray, dt: float, detections: TagDetections
) -> tuple[Localizer, int, int]:
    """The localiser after an odometry increment (3,) over dt seconds and the frame at its end; how many of the frame's
    sightings were of tags it knows, and how many of those it ignored."""
    filter_, known, ignored = pose_filter.step(localizer.filter, model, increment, dt, detections)
    # What was seen elsewhere as often as there is forgotten: its next sighting says where it is.
    keep = filter_.local_frames > 0
    if len(keep) > MOST_LOCAL:
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
        filter_.mean,
        filter_.covariance,
        filter_.sensitivity,
        filter_.seen,
        filter_.p_DL,
        filter_.considered,
        increment,
        dt,
        model.noise,
    )
    return X_MB, covariance


@njit(cache=True)
def _in_map(
    X_MD: FloatArray,
    mean: FloatArray,
    covariance: FloatArray,
    sensitivity: FloatArray,
    seen: IntArray,
    p_DL: FloatArray,
    considered: FloatArray,
    increment: FloatArray,
    dt: float,
    noise: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """X_MB (3,) = X_MD X_DB and its covariance (3, 3), X_DB of the filter after an odometry increment."""
    X_DB, P_BB, P_BD = predict_pose(
        mean, covariance, sensitivity, seen, p_DL, X_MD[2], considered, increment, dt, noise
    )
    c, s = math.cos(X_MD[2]), math.sin(X_MD[2])
    x, y = c * X_DB[0] - s * X_DB[1], s * X_DB[0] + c * X_DB[1]
    # By X_DB and by X_MD.
    J = np.zeros((3, 6))
    J[0, 0], J[0, 1], J[1, 0], J[1, 1], J[2, 2] = c, -s, s, c, 1.0
    J[0, 3], J[1, 4], J[2, 5], J[0, 5], J[1, 5] = 1.0, 1.0, 1.0, -y, x
    joint = np.empty((6, 6))
    for i in range(3):
        for j in range(3):
            joint[i, j], joint[i, 3 + j], joint[3 + j, i] = P_BB[i, j], P_BD[i, j], P_BD[i, j]
            joint[3 + i, 3 + j] = considered[i - 3, j - 3]
    P_MB = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            for k in range(6):
                for m in range(6):
                    P_MB[i, j] += J[i, k] * joint[k, m] * J[j, m]
    return np.array([X_MD[0] + x, X_MD[1] + y, wrap(X_MD[2] + X_DB[2])]), P_MB


def new_tags(localizer: Localizer, ids: IntArray) -> tuple[IntArray, FloatArray]:
    """The ids (u,) of the tags met on the way, in LEAST_FRAMES or more, that are not among some ids (n,), ascending,
    and their p_MU (u, 2)."""
    filter_ = localizer.filter
    new_ids, p_MU = _new_tags(localizer.X_MD, filter_.mean, filter_.local_ids, filter_.local_frames, ids)
    return new_ids, p_MU


@njit(cache=True)
def _new_tags(
    X_MD: FloatArray, mean: FloatArray, local_ids: IntArray, local_frames: IntArray, ids: IntArray
) -> tuple[IntArray, FloatArray]:
    new_ids, p_MU, count = np.empty(len(local_ids), dtype=np.int64), np.empty((len(local_ids), 2)), 0
    c, s = math.cos(X_MD[2]), math.sin(X_MD[2])
    for i in range(len(local_ids)):
        row = np.searchsorted(ids, local_ids[i])
        if local_frames[i] < LEAST_FRAMES:
            continue
        if row == len(ids) or ids[row] != local_ids[i]:
            x, y = mean[CORE + 2 * i], mean[CORE + 2 * i + 1]
            new_ids[count] = local_ids[i]
            p_MU[count, 0], p_MU[count, 1] = X_MD[0] + c * x - s * y, X_MD[1] + s * x + c * y
            count += 1
    return new_ids[:count].copy(), p_MU[:count].copy()
