"""Corners of a tag to hundredths of a pixel: all of its cells are laid over the image, not its outline alone.

A detector fits lines to the outline. Of a small tag they are a few pixels long, and blur moves them inward: far tags
seem farther by half a per cent, in all images alike. But every cell of a known tag tells its place, and blur moves the
edges of black and of white cells to opposite sides (alignment by the enhanced correlation coefficient, Evangelidis,
Psarakis 2008). How blurred the image is, is tried out, for a pattern that is too blurred is found too large.
"""

from __future__ import annotations

import functools

import cv2
import numpy as np
from numpy.typing import NDArray

from tfg_drake.messages import FloatArray
from tfg_drake.vision.image import Image

Image32 = NDArray[np.float32]

# OpenCV's dictionaries of the tag families that robotpy_apriltag is compiled with.
FAMILIES = {"tag36h11": cv2.aruco.DICT_APRILTAG_36h11, "tag16h5": cv2.aruco.DICT_APRILTAG_16h5}
# Number of points of the pattern along a cell, that of its pixels within these bounds.
_FINEST, _COARSEST = 8, 5
# Candidates of an image's blur along either side of the tag, pixels, and the first one.
_BLURS, _BLUR = (0.4, 0.5, 0.6, 0.7, 0.85, 1.0, 1.4, 2.0), 0.6
# Tags with more pixels per cell are not refined, as the detector's lines are long enough.
_LARGE = 20.0
# Greatest displacement of a refined corner, pixels and share of the side; beyond it the fit is wrong.
_FARTHEST, _FARTHEST_SHARE = 1.0, 0.05
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 6, 1e-5)


def refined(image: Image, corners: FloatArray, tag: int, family: str) -> tuple[FloatArray, float]:
    """The corners (4, 2) of a tag in a grey image (h, w), pixels, and how well its cells correlate with it.

    corners: from the upper right one of the upright tag counter-clockwise. They stay as they were where the cells are
    not found, then the correlation is 0, and of a tag so large that it needs no refinement, then it is 1.
    """
    cells = _cells(tag, family)
    n = len(cells) - 2
    across = 0.5 * (np.linalg.norm(corners[0] - corners[1]) + np.linalg.norm(corners[3] - corners[2])) / n
    down = 0.5 * (np.linalg.norm(corners[2] - corners[1]) + np.linalg.norm(corners[3] - corners[0])) / n
    cell = max(across, down)
    if not 0.0 < min(across, down) <= cell:
        return corners, 0.0
    if cell > _LARGE:
        return corners, 1.0
    fine = int(np.clip(round(cell), _COARSEST, _FINEST))
    # Half a cell of the white border: what lies beyond it is anything.
    cut = fine - fine // 2
    sharp: Image32 = np.kron(cells, np.ones((fine, fine), dtype=np.float32))

    def pattern(blur: tuple[float, float]) -> Image32:
        wide, high = float(fine * blur[0] / across), float(fine * blur[1] / down)
        return np.asarray(cv2.GaussianBlur(sharp, (0, 0), sigmaX=wide, sigmaY=high)[cut:-cut, cut:-cut], np.float32)

    low = fine - cut - 0.5
    high = low + n * fine
    square = np.array([[high, low], [low, low], [low, high], [high, high]], dtype=np.float32)
    first = np.maximum(np.floor(corners.min(axis=0) - 2.0 * cell), 0.0).astype(int)
    last = np.ceil(corners.max(axis=0) + 2.0 * cell).astype(int) + 1
    part = image[first[1] : last[1], first[0] : last[0]].astype(np.float32)
    blur = (_BLUR, _BLUR)
    try:
        warp = cv2.getPerspectiveTransform(square, (corners - first).astype(np.float32)).astype(np.float32)
        warp = _aligned(pattern(blur), part, warp)
        seen = _straightened(part, warp, pattern(blur).shape)
        for side in range(2):
            tried = [(b, blur[1]) if side == 0 else (blur[0], b) for b in _BLURS]
            blur = max(tried, key=lambda one: _likeness(pattern(one), seen))
        warp = _aligned(pattern(blur), part, warp)
    except cv2.error:
        return corners, 0.0
    found = cv2.perspectiveTransform(square[None], warp.astype(float))[0] + first
    if not np.linalg.norm(found - corners, axis=1).max() < _FARTHEST + _FARTHEST_SHARE * n * cell:
        return corners, 0.0
    return np.asarray(found), _likeness(pattern(blur), _straightened(part, warp, pattern(blur).shape))


def _aligned(pattern: Image32, image: Image32, warp: Image32) -> Image32:
    """The homography (3, 3) from the pattern's pixels to the image's, near one to begin with; raises cv2.error."""
    found = cv2.findTransformECC(pattern, image, warp.copy(), cv2.MOTION_HOMOGRAPHY, _CRITERIA, None, 1)
    return np.asarray(found[1], dtype=np.float32)


def _straightened(image: Image32, warp: Image32, shape: tuple[int, ...]) -> Image32:
    """The part of an image that a homography lays a pattern of that shape over."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(image, warp, shape[::-1], flags=flags), dtype=np.float32)


def _likeness(one: Image32, other: Image32) -> float:
    """The correlation of two images of a size, brightness and contrast aside."""
    return float(cv2.matchTemplate(one, other, cv2.TM_CCOEFF_NORMED)[0, 0])


@functools.lru_cache(maxsize=1024)
def _cells(tag: int, family: str) -> Image32:
    """Grey levels of a tag's cells with its white border, one cell wide."""
    dictionary = cv2.aruco.getPredefinedDictionary(FAMILIES[family])
    n = dictionary.markerSize + 2
    cells = cv2.aruco.generateImageMarker(dictionary, tag, n).astype(np.float32)
    return np.pad(cells, 1, constant_values=255.0)
