"""Moving the base behind its wheels' back: wheel slip and pushes."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence

import numpy as np

from tfg_drake.config import DisturbanceConfig
from tfg_drake.messages import FloatArray, message

_log = logging.getLogger("tfg_drake.operator")


def displacement(disturbances: Sequence[DisturbanceConfig], begin: float, end: float) -> FloatArray:
    """How far the base is moved between two instants (s): (4,) ahead and left in B, m, turned, rad, and the part of
    that turn that the gyro feels.

    Every disturbance moves it evenly over its duration.
    """
    total = np.zeros(4)
    for one in disturbances:
        overlap = min(end, one.time + one.duration) - max(begin, one.time)
        if overlap > 0.0:
            felt = one.turn if one.gyro_feels else 0.0
            total += overlap / one.duration * np.array([one.ahead, one.left, one.turn, felt])
    return total


@message
class Pushes:
    """How the base was pushed so far, besides what the scenario says."""

    pushes: tuple[DisturbanceConfig, ...] = ()


def with_push(before: Pushes, time: float) -> Pushes:
    """With one push more: somebody pushes the base half a metre to its left and turns it by 30 degrees, from a time on,
    s."""
    _log.info("%.2f s: push", time)
    return Pushes((*before.pushes, DisturbanceConfig(time=time, duration=0.5, left=0.5, turn=math.pi / 6.0)))


def with_pushes(scripted: Sequence[DisturbanceConfig], pushes: Pushes | None) -> Sequence[DisturbanceConfig]:
    """The disturbances of the scenario and, where somebody can push, his."""
    return scripted if pushes is None else (*scripted, *pushes.pushes)
