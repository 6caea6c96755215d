"""Where the robot is a moment after its pose was estimated, or before: every message is of an instant of its own."""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry.se2 import compose
from tfg_drake.messages import FloatArray, PoseEstimate


def pose_at(pose: PoseEstimate, stamp: float) -> FloatArray:
    """The pose X_MB (3,) at a time (s) near pose.stamp, by the measured speed."""
    dt = stamp - pose.stamp
    v, w = pose.speed * dt
    return compose(pose.X_MB, np.array([v * np.cos(0.5 * w), v * np.sin(0.5 * w), w]))
