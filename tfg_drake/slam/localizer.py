"""The online pose in the map: mapped landmarks considered, never updated, and tags met on the way as own states.

Path sightings localise only; the map learns from goals. Correlations between pose and map are kept, so the pose's
covariance stays honest over any number of frames.
"""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import FloatArray, MapEstimate, TagDetections
from tfg_drake.slam import pose_filter
from tfg_drake.slam.odometry_model import OdometryModel
from tfg_drake.slam.pose_filter import PoseFilter

# Landmarks considered: the nearest to the departure pose.
WINDOW = 300
# Local tags kept at most; the longest unseen go first.
MOST_LOCAL = 30


def start_localizer(model: OdometryModel, map_estimate: MapEstimate | None) -> PoseFilter:
    """The localiser at the departure pose of the newest map, or at the origin of an empty one."""
    if map_estimate is None:
        return pose_filter.start_at_origin(model)
    distance = np.hypot(*(map_estimate.p_ML - map_estimate.X_MD[:2]).T)
    near = np.sort(np.argsort(distance, kind="stable")[:WINDOW])
    rows = np.repeat(2 * near, 2) + np.tile([0, 1], len(near))
    covariance = map_estimate.covariance
    return pose_filter.start(
        model,
        map_estimate.X_MD,
        covariance[-3:, -3:],
        map_estimate.ids[near],
        map_estimate.p_ML[near],
        covariance[np.ix_(rows, rows)],
        covariance[-3:, rows],
    )


def step_localizer(
    localizer: PoseFilter, model: OdometryModel, increment: FloatArray, dt: float, detections: TagDetections
) -> PoseFilter:
    """The localiser after an odometry increment (3,) over dt seconds and the frame at its end."""
    localizer = pose_filter.step(localizer, model, increment, dt, detections)
    if len(localizer.local_ids) <= MOST_LOCAL:
        return localizer
    keep = np.ones(len(localizer.local_ids), dtype=bool)
    keep[np.argsort(-localizer.last_seen, kind="stable")[MOST_LOCAL:]] = False
    return pose_filter.keep_local(localizer, keep)
