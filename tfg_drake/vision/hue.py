"""Brightness drawn as hue, for a renderer that spoils edges of brightness.

Drake's RenderEngineVtk smooths what it has drawn (FXAA): a pixel beside an edge takes on some of the brighter side, and
a black square of 24 pixels comes out half a pixel too small. It looks for edges of luminance. So black is drawn as red
and white as green, equally bright for it: light changes both alike, and what is green is how bright the thing is.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from tfg_drake.messages import FloatArray
from tfg_drake.vision.image import Image

# Ratio of red to green in the luminance of ITU-R BT.601.
_GREEN = 0.299 / 0.587
_GREY_OF_GREEN = np.clip(np.rint(np.arange(256) / _GREEN), 0.0, 255.0).astype(np.uint8)
# Blur that the renderer, which samples the middle of a pixel, lacks: deviations of 0.29 pixels of a pixel's square and
# 0.3 of the lens, combined.
_PIXEL_AND_LENS = 0.42


def hue_of(grey: FloatArray | NDArray[np.uint8]) -> Image:
    """(..., 3) RGB to draw for grey levels (...), 0 to 255."""
    level = np.asarray(grey, dtype=float)
    hue = np.rint(np.stack([255.0 - level, _GREEN * level, np.zeros_like(level)], axis=-1))
    return np.asarray(hue, dtype=np.uint8)


def photographed(rendered: Image) -> Image:
    """(h, w) in grey: what a camera shows of what was drawn in hues, (h, w, 3) or (h, w, 4)."""
    grey = cv2.LUT(np.ascontiguousarray(rendered[..., 1]), _GREY_OF_GREEN)
    return np.asarray(cv2.GaussianBlur(grey, (3, 3), _PIXEL_AND_LENS), dtype=np.uint8)
