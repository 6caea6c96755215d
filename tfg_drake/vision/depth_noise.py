"""What a depth camera makes of perfect depth: noise that grows with the square of it, alike in neighbouring pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Stereo compares windows: pixels of a square this wide have one error.
_WINDOW = 5


def with_noise(depth: NDArray[np.float32], noise: float, seed: int) -> NDArray[np.float32]:
    """A depth image (h, w), m, 0 and inf as they are. noise: standard deviation at 1 m, m. seed: of the noise."""
    if noise == 0.0:
        return depth
    h, w = depth.shape
    drawn = np.random.default_rng(seed).standard_normal((-(-h // _WINDOW), -(-w // _WINDOW)), dtype=np.float32)
    error = np.repeat(np.repeat(np.float32(noise) * drawn, _WINDOW, axis=0), _WINDOW, axis=1)[:h, :w]
    measured = np.where(np.isfinite(depth), depth, np.float32(0.0))
    return np.where(measured > 0.0, np.maximum(measured + error * measured**2, np.float32(1e-3)), depth)
