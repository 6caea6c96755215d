"""Tags rendered by OpenCV's warps, an oracle that knows nothing of the code under test. Without the packages that see,
whoever imports this is skipped."""

import cv2
import numpy as np
import pytest

pytest.importorskip("robotpy_apriltag", reason="robotpy-apriltag is not installed: pip install 'tfg-drake[camera]'")

# Pixels of a tag's texture a cell, and how many times finer than the image it is rendered.
CELL, FINER = 20, 4
DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)


def corners_of(R_CT, p_CT, size):
    """(4, 3) of a tag in C, m, clockwise from the upper left as one looks at it; T is x right, y down, z away."""
    square = size * np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])
    return square @ R_CT.T + p_CT


def projected(points, calibration):
    """Pixels (..., 2) of points (..., 3) in C by cv2's forward model."""
    flat, zero = points.reshape(-1, 1, 3), np.zeros(3)
    if calibration.model == "equidistant":
        pixels = cv2.fisheye.projectPoints(flat, zero, zero, calibration.matrix.copy(), calibration.coefficients.copy())
    else:
        pixels = cv2.projectPoints(flat, zero, zero, calibration.matrix.copy(), calibration.coefficients.copy())
    return pixels[0].reshape(*points.shape[:-1], 2)


def render(tags, calibration, noise=2.0, seed=0):
    """An image (h, w) of tags, each (id, R_CT, p_CT, size), of a camera without distortion; noise: grey levels."""
    h, w = calibration.height, calibration.width
    canvas = np.full((h * FINER, w * FINER), 128.0, dtype=np.float32)
    for tag, R_CT, p_CT, size in tags:
        texture = np.full((10 * CELL, 10 * CELL), 255, dtype=np.uint8)
        texture[CELL:-CELL, CELL:-CELL] = cv2.aruco.generateImageMarker(DICTIONARY, tag, 8 * CELL)
        black = np.array([[CELL, CELL], [9 * CELL, CELL], [9 * CELL, 9 * CELL], [CELL, 9 * CELL]]) - 0.5
        at = (projected(corners_of(R_CT, p_CT, size), calibration) + 0.5) * FINER - 0.5
        H = cv2.getPerspectiveTransform(black.astype(np.float32), at.astype(np.float32))
        seen = cv2.warpPerspective(texture, H, canvas.shape[::-1], flags=cv2.INTER_AREA).astype(np.float32)
        there = cv2.warpPerspective(np.ones_like(texture), H, canvas.shape[::-1], flags=cv2.INTER_NEAREST) > 0
        canvas[there] = seen[there]
    small = cv2.resize(canvas, (w, h), interpolation=cv2.INTER_AREA)
    small += np.random.default_rng(seed).normal(scale=noise, size=small.shape)
    return np.clip(np.round(small), 0, 255).astype(np.uint8)
