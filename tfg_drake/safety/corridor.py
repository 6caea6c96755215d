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
    aside = y if curvature > 0.0 else -y
    inward = turn_radius - aside
    from_centre = math.hypot(x, inward)
    # As differences of what may be large, these would be rounding of a hardly curved arc.
    off = (x * x - aside * (inward + turn_radius)) / (from_centre + turn_radius)
    if abs(off) >= corridor:
        return np.inf
    # The outline touches the point this much before the robot's centre is level with it.
    squared = (radius * radius - off * off) / (4.0 * turn_radius * from_centre)
    early = 2.0 * math.asin(math.sqrt(min(max(squared, 0.0), 1.0)))
    return turn_radius * (math.atan2(x, inward) - early)
