"""View of a camera: the part of its surroundings that it sees, as the planner needs it."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

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


def joint_view(cameras: Sequence[tuple[float, CameraView]]) -> CameraView:
    """The view of cameras together, each with its yaw on the robot, rad: to as much on either side of straight ahead,
    as far as the one that sees least far. One camera alone has its own view, wherever it looks."""
    if len(cameras) == 1:
        return cameras[0][1]
    reach = [0.0, 0.0]
    for side, sign in enumerate((1.0, -1.0)):
        # A camera goes on where another ends.
        for _ in cameras:
            for yaw, view in cameras:
                centre, half = sign * yaw % (2.0 * math.pi), 0.5 * view.field_of_view
                if centre > math.pi and centre + half > 2.0 * math.pi:
                    centre -= 2.0 * math.pi  # it looks to the other side, but straight ahead, too
                if centre - half <= reach[side] + 1e-9:
                    reach[side] = max(reach[side], centre + half)
    field_of_view = 2.0 * min(math.pi, *reach)
    # Where none looks ahead each sees what comes by as the robot turns.
    if field_of_view <= 0.0:
        field_of_view = min(view.field_of_view for _, view in cameras)
    return CameraView(field_of_view, min(view.range for _, view in cameras))
