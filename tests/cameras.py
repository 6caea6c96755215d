"""Cameras that tests look through."""

import numpy as np

from tfg_drake.vision.calibration import CameraCalibration


def pinhole(width, height, focal):
    """The calibration of an ideal camera with its axis through the middle of the image; focal: pixels."""
    matrix = np.array([[focal, 0.0, 0.5 * (width - 1)], [0.0, focal, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
    return CameraCalibration(width, height, matrix, "plumb_bob", np.zeros(0))
