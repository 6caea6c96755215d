"""Effects of an exposure on a perfect image: blur by the robot's turn, too little light or too much, noise."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from tfg_drake.config import CameraRealityConfig
from tfg_drake.vision.image import Image, grey

# Motion, pixels during the exposure, below which nothing is blurred.
_SHARP = 0.05


def exposed(image: Image, blur: float, reality: CameraRealityConfig, seed: int) -> Image:
    """(h, w) in grey. blur: pixels by which what is seen moves sideways while the frame is exposed. seed: of its noise.

    Raises ValueError where the image is none.
    """
    seen = grey(image)
    if abs(blur) > _SHARP:
        seen = cv2.filter2D(seen.astype(np.float32), -1, _box(abs(blur)))
    if reality.brightness == 1.0 and reality.noise == 0.0:
        return np.asarray(np.clip(np.rint(seen), 0.0, 255.0), dtype=np.uint8)
    noise = np.random.default_rng(seed).standard_normal(seen.shape, dtype=np.float32)
    level = noise * np.float32(reality.noise) + seen * np.float32(reality.brightness)
    return np.asarray(np.clip(np.rint(level), 0.0, 255.0), dtype=np.uint8)


def _box(width: float) -> NDArray[np.float32]:
    """The mean over so many pixels of a row, and parts of a pixel at its ends: (1, n), n odd."""
    half = int(np.ceil(0.5 * (width - 1.0)))
    weights = np.ones(2 * half + 1, dtype=np.float32)
    weights[[0, -1]] = 1.0 if half == 0 else 0.5 * (width - (2 * half - 1))
    return np.asarray(weights / weights.sum())[None]
