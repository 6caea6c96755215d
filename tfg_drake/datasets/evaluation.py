"""How near an estimate of a recorded run is to the truth, each figure after its own alignment in SE(2).

Frames: W the truth's world, M the estimate's map.
"""

from __future__ import annotations

import itertools

import numpy as np

from tfg_drake.comparison.metrics import rmse
from tfg_drake.datasets.recording import GroundTruth
from tfg_drake.geometry import se2
from tfg_drake.geometry.alignment import align
from tfg_drake.messages import BoolArray, FloatArray, IntArray, message

# True poses farther apart than this leave the time between them without truth, s.
LONGEST_GAP = 1.0
# A landmark farther than this from the given truth, m, after alignment to those that are not, is a misfit.
MISFIT = 1.0


@message
class RobotError:
    """rmse: m, nan where nothing can be compared. X_WM: (3,) the alignment. compared: number of poses."""

    rmse: float
    X_WM: FloatArray
    compared: int


@message
class LandmarkError:
    """rmse: m, over all landmarks that have a truth, nan where none has. X_WM: (3,) the alignment. ids: (n,) the
    landmarks compared. misfit_ids: (f,) those that lie far from the given truth while the others fit.
    rmse_without: m, of the others, after their own alignment. notes: what the misfits look like, a sentence each."""

    rmse: float
    X_WM: FloatArray
    ids: IntArray
    misfit_ids: IntArray
    rmse_without: float
    notes: tuple[str, ...]


def robot_error(truth: GroundTruth, stamps: FloatArray, X_MB: FloatArray) -> RobotError:
    """RMSE of estimated positions against the truth, interpolated linearly at the estimates' stamps.

    stamps (n,) s, X_MB (n, 3). Estimates outside the truth's span or in a gap of it do not count.
    """
    if not len(truth.stamps) or not len(stamps):
        return RobotError(float("nan"), np.zeros(3), 0)
    after = np.clip(np.searchsorted(truth.stamps, stamps), 1, len(truth.stamps) - 1) if len(truth.stamps) > 1 else 0
    gap = truth.stamps[after] - truth.stamps[np.maximum(after - 1, 0)]
    inside = (stamps >= truth.stamps[0]) & (stamps <= truth.stamps[-1]) & (gap <= LONGEST_GAP)
    if not inside.any():
        return RobotError(float("nan"), np.zeros(3), 0)
    at = stamps[inside]
    p_WB = np.column_stack([np.interp(at, truth.stamps, truth.X_WB[:, i]) for i in range(2)])
    X_WM = align(p_WB, X_MB[inside, :2])
    return RobotError(rmse(se2.transform(X_WM, X_MB[inside, :2]) - p_WB), X_WM, len(at))


def landmark_error(truth: GroundTruth, ids: IntArray, p_ML: FloatArray) -> LandmarkError:
    """RMSE of estimated landmarks ids (n,) at p_ML (n, 2), and which of them contradict the given truth."""
    common, in_truth, in_map = np.intersect1d(truth.ids, ids, return_indices=True)
    p_W, p_M = truth.p_WL[in_truth], p_ML[in_map]
    X_WM = align(p_W, p_M)
    fits = _consensus(p_W, p_M)
    X_fit = align(p_W[fits], p_M[fits])
    p_fit = se2.transform(X_fit, p_M)
    return LandmarkError(
        rmse=rmse(se2.transform(X_WM, p_M) - p_W),
        X_WM=X_fit,
        ids=common,
        misfit_ids=common[~fits],
        rmse_without=rmse(p_fit[fits] - p_W[fits]),
        notes=_describe(common[~fits], p_fit[~fits], p_W[~fits]),
    )


def _consensus(p_W: FloatArray, p_M: FloatArray) -> BoolArray:
    """(n,) the landmarks that agree with the truth within MISFIT under one rigid transform that most agree with.

    Every pair of landmarks proposes a transform; all are taken to agree where no majority does.
    """
    n = len(p_W)
    best = np.zeros(n, dtype=bool)
    for i, j in itertools.combinations(range(n), 2):
        pair = [i, j]
        if np.linalg.norm(p_W[i] - p_W[j]) < MISFIT:
            continue
        fits = np.linalg.norm(se2.transform(align(p_W[pair], p_M[pair]), p_M) - p_W, axis=1) < MISFIT
        if fits.sum() > best.sum():
            best = fits
    if best.sum() <= max(n // 2, 2):
        return np.ones(n, dtype=bool)
    X_WM = align(p_W[best], p_M[best])
    return np.asarray(np.linalg.norm(se2.transform(X_WM, p_M) - p_W, axis=1) < MISFIT)


def _describe(ids: IntArray, p_estimated: FloatArray, p_W: FloatArray) -> tuple[str, ...]:
    """A sentence for every two landmarks that have changed places and one for every other misfit."""
    notes, left = [], list(range(len(ids)))
    while left:
        i = left.pop(0)
        off = float(np.linalg.norm(p_estimated[i] - p_W[i]))
        other = next(
            (
                j
                for j in left
                if np.linalg.norm(p_estimated[i] - p_W[j]) < MISFIT and np.linalg.norm(p_estimated[j] - p_W[i]) < MISFIT
            ),
            None,
        )
        if other is None:
            notes.append(f"landmark {ids[i]} lies {off:.1f} m from the given truth")
        else:
            left.remove(other)
            pair = f"landmarks {ids[i]} and {ids[other]}"
            notes.append(f"{pair} lie {off:.1f} m from the given truth: each where the other should be")
    return tuple(notes)
