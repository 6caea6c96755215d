"""Where the robot is when it has lost its way: its pose from one frame of mapped tags, by geometry.

Any two tags with range and bearing give a pose; the pose that most tags of the frame agree with wins and is refined by
least squares. Wrong ids and outliers are outvoted.
"""

from __future__ import annotations

import itertools

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, MapEstimate, TagDetections

# Mapped tags that must agree, and the share of the frame's mapped tags that they must be.
LEAST_AGREEING = 3
LEAST_SHARE = 0.6
# Agreement: within this many standard deviations of range and bearing, and this of the map, m.
GATE = 3.5
MAP_SIGMA = 0.05
# A landmark whose place in the map is less certain than this, m, is not where it seems.
LOOSE = 10.0
# Two tags nearer than this to each other tell no heading, m.
LEAST_BASE = 0.4


def relocalize(estimate: MapEstimate, detections: TagDetections) -> tuple[FloatArray, BoolArray] | None:
    """The pose X_MB (3,) from which most mapped tags of a frame are seen as they are, and which those are (n,).

    None where too few agree.
    """
    row = np.searchsorted(estimate.ids, detections.ids)
    mapped = np.flatnonzero(row < len(estimate.ids))
    mapped = mapped[estimate.ids[row[mapped]] == detections.ids[mapped]]
    # What hangs loose tells nothing of the rest of the map.
    mapped = mapped[np.trace(estimate.landmark_covariance[row[mapped]], axis1=1, axis2=2) < LOOSE**2]
    if len(mapped) < LEAST_AGREEING:
        return None
    p_ML = estimate.p_ML[row[mapped]]
    r, b = detections.range[mapped], detections.bearing[mapped]
    p_BL = r[:, None] * np.stack([np.cos(b), np.sin(b)], axis=1)
    tolerance = np.stack([detections.sigma_range[mapped], r * detections.sigma_bearing[mapped]], axis=1)
    tolerance = GATE * np.hypot(tolerance, MAP_SIGMA)
    best = np.zeros(len(mapped), dtype=bool)
    for i, j in itertools.combinations(range(len(mapped)), 2):
        if np.hypot(*(p_BL[j] - p_BL[i])) < LEAST_BASE:
            continue
        agree = _agree(_fit(p_BL[[i, j]], p_ML[[i, j]], np.ones(2)), p_BL, p_ML, b, tolerance)
        if agree.sum() > best.sum():
            best = agree
    if best.sum() < max(LEAST_AGREEING, LEAST_SHARE * len(mapped)):
        return None
    for _ in range(3):
        pose = _fit(p_BL[best], p_ML[best], 1.0 / tolerance[best].max(axis=1) ** 2)
        best = _agree(pose, p_BL, p_ML, b, tolerance)
        if best.sum() < LEAST_AGREEING:
            return None
    inliers = np.zeros(len(detections.ids), dtype=bool)
    inliers[mapped[best]] = True
    return pose, inliers


def _fit(p_BL: FloatArray, p_ML: FloatArray, weight: FloatArray) -> FloatArray:
    """The pose X_MB (3,) that carries points p_BL (n, 2) onto p_ML (n, 2) best, weights (n,)."""
    w = weight / weight.sum()
    in_B, in_M = w @ p_BL, w @ p_ML
    u, v = p_BL - in_B, p_ML - in_M
    theta = np.arctan2(w @ (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]), w @ (u * v).sum(axis=1))
    return np.append(in_M - se2.rotation(float(theta)) @ in_B, theta)


def _agree(
    pose: FloatArray, p_BL: FloatArray, p_ML: FloatArray, bearing: FloatArray, tolerance: FloatArray
) -> BoolArray:
    """Which tags (n,) are seen where they should be: along and across the line of sight within tolerance (n, 2), m."""
    error = se2.transform(se2.inverse(pose), p_ML) - p_BL
    c, s = np.cos(bearing), np.sin(bearing)
    along, across = c * error[:, 0] + s * error[:, 1], -s * error[:, 0] + c * error[:, 1]
    return np.asarray((np.abs(along) <= tolerance[:, 0]) & (np.abs(across) <= tolerance[:, 1]))
