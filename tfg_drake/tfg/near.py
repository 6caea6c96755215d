"""What is near: on a large map a stage looks only at what lies round the newest view.

A map is large where not all of its landmarks are known jointly with the robot's pose (`slam/map_solver.py`). So a stage
costs what the robot's surroundings do, however large the building is.
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, MapEstimate

# On a large map places up to this distance from the newest view are near, m: twice as far as most sensors see, and as
# far as the order in which the frontiers are best visited depends on the map.
RADIUS = 20.0


def radius_of(estimate: MapEstimate) -> float:
    """Distance, m, from the newest view within which places are near; inf on a map that is known jointly."""
    return math.inf if estimate.is_joint else RADIUS


def within(points: FloatArray, place: FloatArray, radius: float) -> BoolArray:
    """Which points (n, 2) lie within a radius (m) of a place or pose (2 or 3,), (n,)."""
    return np.asarray(np.hypot(points[:, 0] - place[0], points[:, 1] - place[1]) <= radius)
