"""The figures of a run that need the truth: pure functions, plain arrays in, floats out.

Frames: W world, M map. Truth in W becomes truth in M with X_MW, the inverse of the start pose. A figure without data
is nan.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from tfg_drake.geometry.alignment import align
from tfg_drake.geometry.distance import point_distance
from tfg_drake.geometry.se2 import transform, wrap_angle
from tfg_drake.messages import FloatArray
from tfg_drake.tfg.polyline import covered
from tfg_drake.world.reachability import cut_walls

# A true surface is mapped, and a mapped one true, within SURFACE_TOLERANCE, m; a true face is mapped within
# FACE_TOLERANCE, m.
SURFACE_TOLERANCE = 0.25
FACE_TOLERANCE = 0.05


def rmse(error: FloatArray) -> float:
    """Root of the mean squared length of the rows of error (n, d); nan without rows."""
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1)))) if len(error) else float("nan")


def landmark_rmse(p_ML: FloatArray, p_ML_true: FloatArray) -> float:
    """RMSE of estimated against true landmarks, both (n, 2) in M, m."""
    return rmse(p_ML - p_ML_true)


def landmark_rmse_aligned(p_ML: FloatArray, p_ML_true: FloatArray) -> float:
    """RMSE, m, after the rigid transform that fits the estimates (n, 2) to the truth (n, 2) best."""
    return rmse(transform(align(p_ML_true, p_ML), p_ML) - p_ML_true)


def anees(error: FloatArray, covariance: FloatArray) -> float:
    """Average normalised estimation error squared: the mean of e' P^-1 e / d over errors (n, d) with (n, d, d); 1 is
    consistent (Bar-Shalom, Li and Kirubarajan 2001, section 5.4); nan without errors."""
    if not len(error):
        return float("nan")
    return float(
        np.mean(np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0], axis=1)) / error.shape[1]
    )


def landmark_nees(p_ML: FloatArray, p_ML_true: FloatArray, covariance: FloatArray) -> float:
    """e' P^-1 e / 2n of all landmarks (n, 2) jointly, P the leading (2n, 2n) block of covariance; nan without any."""
    n = len(p_ML)
    if not n:
        return float("nan")
    error = (p_ML - p_ML_true).ravel()
    factor = scipy.linalg.cho_factor(covariance[: 2 * n, : 2 * n])
    return float(error @ scipy.linalg.cho_solve(factor, error) / (2 * n))


def pose_anees(X_MB: FloatArray, X_MB_true: FloatArray, covariance: FloatArray) -> float:
    """ANEES of poses (n, 3) with covariances (n, 3, 3) of (x, y) in M and theta."""
    error = X_MB - X_MB_true
    error[:, 2] = wrap_angle(error[:, 2])
    return anees(error, covariance)


def statistics(error: FloatArray) -> dict[str, float]:
    """mean, std, max and final of a series of errors (n,), in its own unit; nan without errors."""
    error = error if len(error) else np.full(1, np.nan)
    return {
        "mean": float(error.mean()),
        "std": float(error.std()),
        "max": float(error.max()),
        "final": float(error[-1]),
    }


def pose_errors(X_MB: FloatArray, X_MB_true: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distances (n,), m, and absolute heading differences (n,), rad, between estimated and true poses (n, 3)."""
    error = X_MB - X_MB_true
    return np.asarray(np.hypot(error[:, 0], error[:, 1])), np.abs(wrap_angle(error[:, 2]))


def surface_coverage(p_WS: FloatArray, segments: FloatArray) -> float:
    """Share of the reachable surface pieces p_WS (n, 2) within SURFACE_TOLERANCE of a mapped segment (m, 4) in W."""
    if not len(p_WS):
        return float("nan")
    return float(np.mean(point_distance(p_WS, np.ascontiguousarray(segments)) <= SURFACE_TOLERANCE))


def face_coverage(p_WS: FloatArray, normals: FloatArray, segments: FloatArray, *, has_sides: bool) -> float:
    """Share of the reachable faces, at p_WS (n, 2) with unit normals (n, 2) in W, within FACE_TOLERANCE of a mapped
    segment (m, 4) in W, and on its left if the segments have sides."""
    if not len(p_WS):
        return float("nan")
    segments = np.ascontiguousarray(segments)
    if has_sides:
        return float(np.mean(covered(p_WS, normals, segments, np.full(len(p_WS), FACE_TOLERANCE))))
    return float(np.mean(point_distance(p_WS, segments) <= FACE_TOLERANCE))


def surface_phantom(segments: FloatArray, walls: FloatArray) -> float:
    """Length, m, of the mapped segments (m, 4) that has no wall (k, 4) within SURFACE_TOLERANCE, both in W.

    Segments are cut into pieces of at most 5 cm, each judged by its centre.
    """
    length = np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])
    segments, length = segments[length > 0.0], length[length > 0.0]
    total = 0.0
    for segment, metres in zip(segments, length, strict=True):
        centers, _ = cut_walls(segment[None])
        far = point_distance(centers, np.ascontiguousarray(walls)) > SURFACE_TOLERANCE
        total += float(metres * np.mean(far))
    return total
