"""Vectors in the plane, each turned by an angle of its own."""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import FloatArray


def turned(vectors: FloatArray, angle: FloatArray) -> FloatArray:
    """Vectors (n, 2), each turned by its angle (n,), rad: in the frame that they come from, by that frame's heading."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = vectors[:, 0], vectors[:, 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=1)
