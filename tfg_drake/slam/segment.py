"""The motion between two goals: odometry, sharpened by tags seen on the way as segment-local copies.

The copies enter under flat priors and die with the segment, and the map never enters, so the factor between two
goals counts nothing twice.
"""

from __future__ import annotations

from tfg_drake.messages import FloatArray, TagDetections
from tfg_drake.slam import pose_filter
from tfg_drake.slam.odometry_model import OdometryModel
from tfg_drake.slam.pose_filter import PoseFilter

# A copy not seen for this long is marginalised out, s.
MEMORY = 2.0


def start_segment(model: OdometryModel) -> PoseFilter:
    """The filter of a new segment: at its origin, the departure pose D of the last goal."""
    return pose_filter.start_alone(model)


def step_segment(
    segment: PoseFilter, model: OdometryModel, increment: FloatArray, dt: float, detections: TagDetections
) -> PoseFilter:
    """The segment after an odometry increment (3,) over dt seconds and the frame at its end."""
    segment, _, _ = pose_filter.step(segment, model, increment, dt, detections)
    return pose_filter.keep_local(segment, segment.last_seen > detections.stamp - MEMORY)


def segment_factor(segment: PoseFilter) -> tuple[FloatArray, FloatArray]:
    """X_DA (3,), the pose reached in D, and its covariance (3, 3), of (x, y) in D and theta."""
    return segment.mean[:3], segment.covariance[:3, :3]
