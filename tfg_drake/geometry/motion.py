"""Motion of a differential-drive base: the wheels' speeds make an arc."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.messages import FloatArray


@njit(cache=True)
def advance(pose: FloatArray, speed: float, turn_rate: float, duration: float) -> FloatArray:
    """The pose (3,) after an arc at constant speed (m/s) and turn rate (rad/s); exact; duration (s) may be negative."""
    half = 0.5 * turn_rate * duration
    chord = speed * duration * (math.sin(half) / half if abs(half) > 1e-8 else 1.0)
    heading = pose[2] + half
    theta = pose[2] + 2.0 * half
    theta = math.pi - (math.pi - theta) % (2.0 * math.pi)
    return np.array([pose[0] + chord * math.cos(heading), pose[1] + chord * math.sin(heading), theta])
