"""The body's way at the scans of a recording, where it is known at some instants."""

from __future__ import annotations

import itertools

import numpy as np

from tfg_drake.datasets.recording import Recording
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray
from tfg_drake.slam.odometry_model import first_reckoning, reckon
from tfg_drake.storage.trajectory import poses_at


def poses_between(recording: Recording, stamps: FloatArray, X_MB: FloatArray) -> FloatArray:
    """(n, 3) poses at the recording's scans, where some are known, X_MB (k, 3) at stamps (k,), in order: by odometry
    from the known ones on either side, each the less the farther it is in time."""
    reckoned = [first_reckoning(recording.odometry[0])]
    for earlier, later in itertools.pairwise(recording.odometry):
        reckoned.append(reckon(reckoned[-1], earlier, later))
    X_OB, told = np.array([one.X_OB for one in reckoned]), np.array([one.stamp for one in reckoned])
    at = np.array([scan.stamp for scan in recording.scans])
    of_known, of_scan = (poses_at(t, told, X_OB) for t in (stamps, at))
    before = np.clip(np.searchsorted(stamps, at, "right") - 1, 0, len(stamps) - 1)
    after = np.minimum(before + 1, len(stamps) - 1)
    share = np.clip((at - stamps[before]) / np.maximum(stamps[after] - stamps[before], 1e-9), 0.0, 1.0)
    first, second = (se2.compose(X_MB[k], se2.between(of_known[k], of_scan)) for k in (before, after))
    apart = second - first
    apart[:, 2] = se2.wrap_angle(apart[:, 2])
    return np.asarray(first + share[:, None] * apart)
