"""What of its surroundings a camera sees, as the planner needs it."""

from __future__ import annotations

import dataclasses

import numpy as np

from tfg_drake.vision import lens
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.camera_sheet import LEAST_WIDTH, MOST_INCIDENCE


@dataclasses.dataclass(frozen=True)
class CameraView:
    """field_of_view: horizontal, to as much on either side of the optical axis, rad. range: of tags, m. max_incidence:
    between the line of sight and a tag's normal, rad."""

    field_of_view: float
    range: float
    max_incidence: float = MOST_INCIDENCE


def camera_view(calibration: CameraCalibration, tag_size: float) -> CameraView:
    """The view of a camera for tags of a size, m."""
    middle = calibration.matrix[1, 2]
    edges = lens.undistorted(np.array([[0.0, middle], [calibration.width - 1.0, middle]]), calibration)
    left, right = np.arctan(np.abs(edges[:, 0])).tolist()
    return CameraView(2.0 * min(left, right), tag_size * calibration.focal / LEAST_WIDTH)
