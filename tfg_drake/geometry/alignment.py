"""The rigid transform between two sets of the same points."""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry.se2 import rotation
from tfg_drake.messages import FloatArray


def align(p_AP: FloatArray, p_BP: FloatArray) -> FloatArray:
    """The pose X_AB (3,) that brings points p_BP (n, 2) closest to p_AP (n, 2), least squares, without scale.

    Horn (1987) and Umeyama (1991), planar. Without points: the identity.
    """
    if not len(p_AP):
        return np.zeros(3)
    mean_A, mean_B = p_AP.mean(axis=0), p_BP.mean(axis=0)
    a, b = p_AP - mean_A, p_BP - mean_B
    theta = float(np.arctan2(np.sum(b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]), np.sum(a * b)))
    return np.append(mean_A - rotation(theta) @ mean_B, theta)
