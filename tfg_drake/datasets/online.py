"""The online estimator on a recording: messages in the order of their stamps, the pose noted as it was at the time."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from tfg_drake.datasets.recording import Recording
from tfg_drake.messages import FloatArray, MapEstimate, Odometry, message
from tfg_drake.slam import estimator

# A piece of trajectory is closed after this much motion, s of it, once something has been seen.
PERIOD = 1.0

# Called with the share of the work done, 0 to 1.
OnProgress = Callable[[float], None]


@message
class OnlineRun:
    """stamps: (f,) s and X_MB: (f, 3), the pose after every frame as it was estimated then; M is the odometry's origin.

    map: the map at the end, None where nothing was seen.
    """

    stamps: FloatArray
    X_MB: FloatArray
    map: MapEstimate | None


def run_online(recording: Recording, period: float = PERIOD, on_progress: OnProgress | None = None) -> OnlineRun:
    """Run the estimator over a whole recording. The robot makes no turns, so its way is mapped in pieces.

    period: s of motion, with something seen, after which a piece is closed.
    """
    report = on_progress or (lambda _share: None)
    state = estimator.initial_state(recording.model, path_keyframe_period=math.inf)
    stamps, X_MB = [], []
    frames = iter(recording.detections)
    frame = next(frames, None)
    moved, seen, last = 0.0, False, None
    total = max(len(recording.odometry), 1)
    for number, odometry in enumerate(recording.odometry):
        fresh = False
        while frame is not None and frame.stamp <= odometry.stamp:
            state = estimator.process_detections(state, frame)
            seen, fresh = seen or len(frame.ids) > 0, True
            frame = next(frames, None)
        state = estimator.process_odometry(state, odometry)
        moved += _motion(last, odometry)
        last = odometry
        if fresh:
            pose = estimator.pose_estimate(state)
            stamps.append(pose.stamp)
            X_MB.append(pose.X_MB)
        if seen and moved >= period:
            state = estimator.close_piece(state, odometry.stamp)
            moved, seen = 0.0, False
        if number % 100 == 0:
            report(number / total)
    if seen and last is not None:
        state = estimator.close_piece(state, last.stamp)
    report(1.0)
    return OnlineRun(np.array(stamps), np.array(X_MB).reshape(-1, 3), estimator.map_estimate(state))


def _motion(before: Odometry | None, after: Odometry) -> float:
    """The time (s) between two messages if the robot moved."""
    return after.stamp - before.stamp if before is not None and not after.at_rest else 0.0
