"""The online estimator on a recording: messages in the order of their stamps, the pose noted as it was at the time."""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.datasets.batch_smoother import LONGEST_GAP
from tfg_drake.datasets.recording import OnProgress, Recording
from tfg_drake.messages import BoolArray, FloatArray, MapEstimate, Odometry, message
from tfg_drake.slam import estimator
from tfg_drake.slam.estimator_state import EstimatorState, initial_state

# A piece of the way ends after this length, m, once something has been seen.
PIECE_LENGTH = 1.0


@message
class OnlineRun:
    """stamps: (f,) s and X_MB: (f, 3), the pose after every frame, and every LONGEST_GAP between frames while the robot
    moves, as it was estimated then; M is the odometry's origin.

    seen: (f,) whether landmarks had just been seen; elsewhere the robot reckons blindly. state: the estimator's at
    the end.
    """

    stamps: FloatArray
    X_MB: FloatArray
    seen: BoolArray
    state: EstimatorState

    @property
    def map(self) -> MapEstimate | None:
        """The map at the end, None where nothing was seen."""
        return self.state.map


def run_online(
    recording: Recording, piece_length: float = PIECE_LENGTH, on_progress: OnProgress | None = None
) -> OnlineRun:
    """Run the estimator over a whole recording. The robot makes no turns, so its way is mapped in pieces.

    piece_length: m of way, with something seen, after which a piece is closed.
    """
    report = on_progress or (lambda _share: None)
    state = initial_state(recording.model, path_keyframe_period=math.inf)
    noted: list[tuple[float, FloatArray, bool]] = []
    frames = iter(recording.detections)
    frame = next(frames, None)
    length, unnoted, seen = 0.0, 0.0, False
    opened = recording.odometry[0].stamp if recording.odometry else 0.0
    last: Odometry | None = None
    total = max(len(recording.odometry), 1)
    for number, odometry in enumerate(recording.odometry):
        fresh, sighted = False, False
        # The estimator takes a frame when odometry beyond it has come.
        while frame is not None and frame.stamp < odometry.stamp:
            state = estimator.process_detections(state, frame)
            sighted, fresh = sighted or len(frame.ids) > 0, True
            frame = next(frames, None)
        seen = seen or sighted
        state = estimator.process_odometry(state, odometry)
        if last is not None and not odometry.at_rest:
            length += float(np.hypot(*(odometry.X_OB - last.X_OB)[:2]))
            unnoted += odometry.stamp - last.stamp
        last = odometry
        if fresh or unnoted >= LONGEST_GAP:
            unnoted = 0.0
            pose = estimator.pose_estimate(state)
            noted.append((pose.stamp, pose.X_MB, sighted))
        if seen and (length >= piece_length or odometry.stamp - opened >= recording.piece_time):
            state = estimator.close_piece(state, odometry.stamp)
            length, seen, opened = 0.0, False, odometry.stamp
        if number % 100 == 0:
            report(number / total)
    if seen and last is not None:
        state = estimator.close_piece(state, last.stamp)
    report(1.0)
    stamps, X_MB, just_seen = zip(*noted, strict=True) if noted else ((), (), ())
    return OnlineRun(np.array(stamps), np.array(X_MB).reshape(-1, 3), np.array(just_seen, dtype=bool), state)
