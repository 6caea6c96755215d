"""The calibration of a camera that Drake renders."""

from __future__ import annotations

import numpy as np
from pydrake.systems.sensors import CameraInfo

from tfg_drake.vision.calibration import CameraCalibration

# Drake's renderer has the optical axis at (center_x, center_y) from the corner of the first pixel, ours is from its
# centre: an edge in the axis shows so in colour and in depth (RenderEngineVtk, Drake 1.51).
_PIXEL_CENTRE = 0.5


def calibration_of(info: CameraInfo) -> CameraCalibration:
    """The calibration of the images that Drake renders with these intrinsics."""
    matrix = np.array(info.intrinsic_matrix(), dtype=float)
    matrix[:2, 2] -= _PIXEL_CENTRE
    return CameraCalibration(info.width(), info.height(), matrix, "plumb_bob", np.zeros(0))
