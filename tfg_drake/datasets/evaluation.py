"""How near an estimate of a recorded run is to the truth, each figure after its own alignment in SE(2).

Frames: W the truth's world, M the estimate's map.
"""

from __future__ import annotations

import itertools

import numpy as np
import scipy.spatial

from tfg_drake.comparison.metrics import rmse
from tfg_drake.datasets.recording import GroundTruth, Recording
from tfg_drake.geometry import se2
from tfg_drake.geometry.alignment import align
from tfg_drake.messages import BoolArray, FloatArray, IntArray, LaserScan, message
from tfg_drake.slam.odometry_model import first_reckoning, reckon
from tfg_drake.storage.trajectory import poses_at

# Longest time between true poses over which they are interpolated, s.
LONGEST_GAP = 1.0
# A landmark farther than this from the truth, m, after alignment to the others, is a misfit.
MISFIT = 1.0
# A relative error is the mean over PAIRS pairs of scans, up to PAIR_WAY, m of way, apart, drawn with PAIR_SEED.
PAIRS, PAIR_WAY, PAIR_SEED = 1000, 20.0, 0
# A thickness is measured at SAMPLES hits, from the hits within NEIGHBOURHOOD, m, if there are LEAST_HITS.
SAMPLES, NEIGHBOURHOOD, LEAST_HITS = 3000, 0.3, 10


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
    p_WB = truth_at(truth, stamps[inside])[:, :2]
    X_WM = align(p_WB, X_MB[inside, :2])
    return RobotError(rmse(se2.transform(X_WM, X_MB[inside, :2]) - p_WB), X_WM, len(p_WB))


def truth_at(truth: GroundTruth, stamps: FloatArray) -> FloatArray:
    """(n, 3) true poses at stamps (n,), s, interpolated."""
    return poses_at(stamps, truth.stamps, truth.X_WB)


def poses_between(recording: Recording, stamps: FloatArray, X_MB: FloatArray) -> FloatArray:
    """(n, 3) poses at the recording's scans, where some are known, X_MB (k, 3) at stamps (k,), in order: by odometry
    from the known ones on either side, each the less the farther it is in time."""
    reckoned = [first_reckoning(recording.odometry[0])]
    for earlier, later in itertools.pairwise(recording.odometry):
        reckoned.append(reckon(reckoned[-1], earlier, later))
    told, X_OB = np.array([one.stamp for one in reckoned]), np.array([one.X_OB for one in reckoned])
    return by_odometry(np.array([scan.stamp for scan in recording.scans]), stamps, X_MB, told, X_OB)


def by_odometry(at: FloatArray, stamps: FloatArray, X_MB: FloatArray, told: FloatArray, X_OB: FloatArray) -> FloatArray:
    """(n, 3) poses at times (n,), s, where some are known, X_MB (k, 3) at stamps (k,), by odometry X_OB (m, 3) at times
    (m,); see `poses_between`."""
    of_known, of_asked = (poses_at(t, told, X_OB) for t in (stamps, at))
    before = np.clip(np.searchsorted(stamps, at, "right") - 1, 0, len(stamps) - 1)
    after = np.minimum(before + 1, len(stamps) - 1)
    share = np.clip((at - stamps[before]) / np.maximum(stamps[after] - stamps[before], 1e-9), 0.0, 1.0)
    first, second = (se2.compose(X_MB[k], se2.between(of_known[k], of_asked)) for k in (before, after))
    apart = second - first
    apart[:, 2] = se2.wrap_angle(apart[:, 2])
    return np.asarray(first + share[:, None] * apart)


def relative_error(X_WS: FloatArray, X_MS: FloatArray) -> tuple[dict[str, float], dict[str, float]]:
    """How far estimated poses X_MS (n, 3) of two scans are off to each other, by the true ones X_WS (n, 3):
    translation, m, and rotation, rad, each as the mean and the mean of the worst tenth over PAIRS pairs, PAIR_WAY apart
    at most.

    Kuemmerle et al., "On measuring the accuracy of SLAM algorithms", Autonomous Robots 27, 2009.
    """
    rng = np.random.default_rng(PAIR_SEED)
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(X_WS[:, :2], axis=0).T)))
    first = rng.integers(0, len(way) - 1, PAIRS)
    second = rng.integers(first + 1, np.maximum(np.searchsorted(way, way[first] + PAIR_WAY, "right"), first + 2))
    off = se2.between(se2.between(X_WS[first], X_WS[second]), se2.between(X_MS[first], X_MS[second]))
    errors = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
    translation, rotation = (
        {"mean": float(one.mean()), "worst_tenth": float(np.sort(one)[-PAIRS // 10 :].mean())} for one in errors
    )
    return translation, rotation


def hits(scans: tuple[LaserScan, ...], X_MS: FloatArray) -> FloatArray:
    """(h, 2) what n scans met, seen from X_MS (n, 3)."""
    found = []
    for scan, X in zip(scans, X_MS, strict=True):
        met = scan.ranges < scan.range_max - 3.0 * scan.sigma
        direction = np.column_stack([np.cos(scan.angles[met]), np.sin(scan.angles[met])])
        found.append(se2.transform(X, scan.ranges[met, None] * direction))
    return np.concatenate(found)


def wall_thickness(p_MH: FloatArray) -> float:
    """How thick walls are in a map of hits (h, 2), m: the mean deviation normal to the line through what is near each,
    nan where nothing is. It needs no truth: a map that was put together wrongly shows walls twice.

    The mean plane variance of Razlaw et al., "Evaluation of registration methods for sparse 3D laser scans", ECMR 2015.
    """
    tree, rng, deviations = scipy.spatial.cKDTree(p_MH), np.random.default_rng(PAIR_SEED), []
    for p in p_MH[rng.choice(len(p_MH), min(SAMPLES, len(p_MH)), replace=False)]:
        near = p_MH[tree.query_ball_point(p, NEIGHBOURHOOD)]
        if len(near) >= LEAST_HITS:
            deviations.append(np.sqrt(max(np.linalg.eigvalsh(np.cov(near.T))[0], 0.0)))
    return float(np.mean(deviations)) if deviations else float("nan")


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
    # How far each is from where another should be.
    apart = np.linalg.norm(p_estimated[:, None] - p_W, axis=2)
    swapped = (apart < MISFIT) & (apart.T < MISFIT)
    notes, left = [], list(range(len(ids)))
    while left:
        i = left.pop(0)
        off, other = apart[i, i], next((j for j in left if swapped[i, j]), None)
        if other is None:
            notes.append(f"landmark {ids[i]} lies {off:.1f} m from the given truth")
        else:
            left.remove(other)
            pair = f"landmarks {ids[i]} and {ids[other]}"
            notes.append(f"{pair} lie {off:.1f} m from the given truth: each where the other should be")
    return tuple(notes)
