"""What a robot spent its time on: standing, turning in place, driving slowly, and driving at all."""

from __future__ import annotations

import dataclasses

import numpy as np

from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.messages import FloatArray
from tfg_drake.planning.pure_pursuit import REST_SPEED, REST_TURN_RATE


@dataclasses.dataclass(frozen=True)
class TimeSpent:
    """Parts of a time, s, that add up to it.

    standing, turning: in place. slower: how much longer it drove than it would have at full speed. driving: its way at
    full speed.
    """

    standing: float
    turning: float
    slower: float
    driving: float


def time_spent(stamps: FloatArray, X_WB: FloatArray, max_speed: float) -> TimeSpent:
    """Of a robot that was at poses X_WB (n, 3) at stamps (n,), s, and may drive at max_speed, m/s."""
    dt = np.diff(stamps)
    metres = np.hypot(*np.diff(X_WB[:, :2], axis=0).T)
    turned = np.abs(wrap_angle(np.diff(X_WB[:, 2])))
    drives = metres > REST_SPEED * dt
    turns = ~drives & (turned > REST_TURN_RATE * dt)
    driving = float(metres.sum()) / max_speed
    return TimeSpent(
        float(dt[~drives & ~turns].sum()), float(dt[turns].sum()), float(dt[drives].sum()) - driving, driving
    )
