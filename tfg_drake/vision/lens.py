"""Undoing the lens: pixels to directions."""

from __future__ import annotations

import cv2
import numpy as np

from tfg_drake.messages import FloatArray
from tfg_drake.vision.calibration import CameraCalibration

# More steps than OpenCV's default of five, which leaves an error of tenths of a pixel at the edge of a wide lens.
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
# Step of the numerical derivative, pixels.
_STEP = 0.5


def undistorted(pixels: FloatArray, calibration: CameraCalibration) -> FloatArray:
    """Points (..., 2) on the plane z = 1 of the camera's frame C whose images are pixels (..., 2)."""
    points = np.ascontiguousarray(pixels, dtype=float).reshape(-1, 1, 2)
    if not len(points):
        return np.zeros(pixels.shape)
    K, coefficients = calibration.matrix.copy(), calibration.coefficients.copy()
    if calibration.model == "equidistant":
        found = cv2.fisheye.undistortPoints(points, K, coefficients, criteria=_CRITERIA)
    else:
        # OpenCV 4 has the criteria in a function of its own.
        undistort = getattr(cv2, "undistortPointsIter", None) or cv2.undistortPoints
        found = undistort(points, K, coefficients if len(coefficients) else None, None, None, criteria=_CRITERIA)
    return np.asarray(found, dtype=float).reshape(pixels.shape)


def on_pixels(pixels: FloatArray, calibration: CameraCalibration) -> FloatArray:
    """The derivative (..., 2, 2) of `undistorted` on the pixels (..., 2), by differences."""
    steps = _STEP * np.eye(2)
    ahead = undistorted(pixels[..., None, :] + steps, calibration)
    behind = undistorted(pixels[..., None, :] - steps, calibration)
    return np.swapaxes((ahead - behind) / (2.0 * _STEP), -1, -2)
