"""The area near the newest view, to which each stage is limited on a large map.

A map is large if not all of its landmarks are jointly known with the robot's pose (`slam/map_solver.py`). So the cost
of a stage depends on the robot's surroundings, not on the size of the building.
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, MapEstimate

# On a large map places within this distance of the newest view are near, m: twice the range of most sensors; the best
# order of the frontiers does not depend on farther ones.
RADIUS = 20.0


def radius_of(estimate: MapEstimate) -> float:
    """Return the distance, m, from the newest view within which places are near; inf on a jointly known map."""
    return math.inf if estimate.is_joint else RADIUS


def within(points: FloatArray, place: FloatArray, radius: float) -> BoolArray:
    """Return a mask (n,) of the points (n, 2) within a radius (m) of a place or pose (2 or 3,)."""
    return np.asarray(np.hypot(points[:, 0] - place[0], points[:, 1] - place[1]) <= radius)
