"""Where a round base on an arc first touches a point."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def touch_distance(x: float, y: float, curvature: float, radius: float, corridor: float) -> float:
    """How far (m) a disc of this radius (m) drives along an arc of this curvature (1/m) until it touches a point.

    x, y: the point from the disc's centre, m, x in the direction of travel. inf where the point is behind the centre,
    or farther from the arc than corridor (m).
    """
    if x <= 0.0:
        return np.inf
    turn_radius = 1.0 / abs(curvature) if abs(curvature) > 1e-6 else np.inf
    if turn_radius == np.inf:
        if abs(y) >= corridor:
            return np.inf
        return x - math.sqrt(max(0.0, radius * radius - y * y))
    # Polar coordinates about the centre of the turn, the angle counted from the robot onwards.
    inward = turn_radius - (y if curvature > 0.0 else -y)
    from_centre = math.hypot(x, inward)
    if abs(from_centre - turn_radius) >= corridor:
        return np.inf
    # The outline touches the point this much before the robot's centre is level with it.
    cos_early = (turn_radius**2 + from_centre**2 - radius**2) / (2.0 * turn_radius * from_centre)
    early = math.acos(max(-1.0, cos_early)) if cos_early < 1.0 else 0.0
    return turn_radius * (math.atan2(x, inward) - early)
