"""The scanner's way through a building by a log of its scans: by walls as landmarks, or by GMapping."""

from __future__ import annotations

import itertools
import math

import numpy as np

from tfg_drake.config import GridConfig
from tfg_drake.datasets.recording import OnProgress, Recording
from tfg_drake.geometry import se2
from tfg_drake.grid import gmapping
from tfg_drake.messages import FloatArray, Observation, message, replace
from tfg_drake.slam import estimator
from tfg_drake.slam.estimator_state import EstimatorState, initial_state
from tfg_drake.slam.odometry_model import first_reckoning, reckon
from tfg_drake.slam.shared import SCANNER_X, SCANNER_Y, SCANNER_YAW, Shared
from tfg_drake.slam.walls import LEAST_LOOKS, no_walls

# A piece of the way is mapped after this length, m, and so many scans at least: some logs have but one a metre.
PIECE_LENGTH = 1.0
PIECE_SCANS = 4
# Walls of buildings that are lived in, see `scan_lines`, m.
UNEVENNESS = 0.03
# A new wall needs one look for so many scans a metre of way, LEAST_LOOKS at most.
SCANS_PER_LOOK = 3.0


@message
class WallRun:
    """X_MS: (n, 3) the scanner at each scan, by the whole log, M the map; online: the same as it was estimated then.
    state: the estimator's at the end."""

    X_MS: FloatArray
    online: FloatArray
    state: EstimatorState


@message
class GridRun:
    """stamps: (u,) s, of the scans that went into the map, X_MS: (u, 3) the scanner then, in the best particle's path;
    online: (u, 3) the same as it was estimated then. state: the filter's at the end."""

    stamps: FloatArray
    X_MS: FloatArray
    online: FloatArray
    state: gmapping.GmappingState


def run_walls(recording: Recording, on_progress: OnProgress = lambda _share: None) -> WallRun:
    """Map a log with walls as landmarks, piece by piece of the way: nothing turns round to look.

    Raises ValueError where the log has no odometry.
    """
    if not recording.odometry:
        raise ValueError("A log without odometry cannot be mapped.")
    way = float(np.hypot(*np.diff([one.X_OB[:2] for one in recording.odometry], axis=0).T).sum())
    looks_needed = np.clip(len(recording.scans) / max(way, 1.0) / SCANS_PER_LOOK, 1, LEAST_LOOKS)
    walls = no_walls(UNEVENNESS, int(looks_needed))
    state = initial_state(recording.model, math.inf, recording.prior, landmarks="walls", walls=walls)
    scans, length, looks, last = list(recording.scans[::-1]), 0.0, 0, recording.odometry[0]
    seen: list[Observation] = []
    online: list[FloatArray] = []
    for number, odometry in enumerate(recording.odometry):
        while scans and scans[-1].stamp <= odometry.stamp:
            state, looks = estimator.process_scan(state, scans.pop()), looks + 1
        # Nobody carries a recorded robot away; where scans are few, a search for it may end elsewhere.
        state = replace(estimator.process_odometry(state, odometry), contradictions=0)
        online.append(estimator.pose_estimate(state).X_MB)
        length += math.hypot(*(odometry.X_OB - last.X_OB)[:2])
        last = odometry
        if (length >= PIECE_LENGTH and looks >= PIECE_SCANS) or number == len(recording.odometry) - 1:
            before = state.map
            state = estimator.close_piece(state, odometry.stamp)
            if state.map is not None and state.map is not before:
                seen.append(state.map.observation)
                length, looks = 0.0, 0
        on_progress(number / len(recording.odometry))
    state = estimator.finished_map(state)
    starts = state.graph.X_MA
    stamps, first = np.unique(np.concatenate([one.stamps for one in seen]), return_index=True)
    X_MB = np.concatenate([se2.compose(X_MA, one.X_AB) for X_MA, one in zip(starts, seen, strict=True)])[first]
    X_BS, at = _scanner(state.graph.shared), np.array([one.stamp for one in recording.odometry])
    return WallRun(
        se2.compose(poses_between(recording, stamps, X_MB), X_BS),
        se2.compose(poses_between(recording, at, np.array(online)), X_BS),
        state,
    )


def run_grid(
    recording: Recording, config: GridConfig, seed: int, on_progress: OnProgress = lambda _share: None
) -> GridRun:
    """Map a log by GMapping, whose body's origin is the scanner."""
    X_BS = _scanner(recording.prior)
    state = gmapping.initial_state(config, recording.model, seed)
    stamps, online, poses, parents = [], [], [], []
    scans = list(recording.scans[::-1])
    for number, odometry in enumerate(recording.odometry):
        state = gmapping.process_odometry(state, replace(odometry, X_OB=se2.compose(odometry.X_OB, X_BS)))
        while scans and scans[-1].stamp <= odometry.stamp:
            before, state = state.updates, gmapping.process_scan(state, scans.pop())
            if state.updates > before:
                stamps.append(state.stamp)
                online.append(gmapping.pose_estimate(state, 0).X_MB)
                poses.append(state.X_MU)
                parents.append(state.parents)
        on_progress(number / len(recording.odometry))
    row, path = gmapping.best_particle(state), []
    for X_MU, origin in zip(reversed(poses), reversed(parents), strict=True):
        path.append(X_MU[row])
        row = int(origin[row])
    return GridRun(np.array(stamps), np.reshape(path[::-1], (-1, 3)), np.reshape(online, (-1, 3)), state)


def poses_between(recording: Recording, stamps: FloatArray, X_MB: FloatArray) -> FloatArray:
    """(n, 3) poses at the recording's scans, where some are known, X_MB (k, 3) at stamps (k,), in order: by odometry
    from the known ones on either side, each the less the farther it is in time."""
    reckoned = [first_reckoning(recording.odometry[0])]
    for earlier, later in itertools.pairwise(recording.odometry):
        reckoned.append(reckon(reckoned[-1], earlier, later))
    X_OB, told = np.array([one.X_OB for one in reckoned]), [one.stamp for one in reckoned]
    X_OB[:, 2] = np.unwrap(X_OB[:, 2])
    at = np.array([scan.stamp for scan in recording.scans])
    of_known, of_scan = (np.column_stack([np.interp(t, told, one) for one in X_OB.T]) for t in (stamps, at))
    before = np.clip(np.searchsorted(stamps, at, "right") - 1, 0, len(stamps) - 1)
    after = np.minimum(before + 1, len(stamps) - 1)
    share = np.clip((at - stamps[before]) / np.maximum(stamps[after] - stamps[before], 1e-9), 0.0, 1.0)
    first, second = (se2.compose(X_MB[k], se2.between(of_known[k], of_scan)) for k in (before, after))
    apart = second - first
    apart[:, 2] = se2.wrap_angle(apart[:, 2])
    return np.asarray(first + share[:, None] * apart)


def _scanner(shared: Shared) -> FloatArray:
    """X_BS (3,)."""
    return shared.mean[[SCANNER_X, SCANNER_Y, SCANNER_YAW]]
