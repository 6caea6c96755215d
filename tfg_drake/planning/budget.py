"""Time and distance left of a mission's budget, and what they allow (the paper's q(u) <= c)."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from tfg_drake.config import ExplorerConfig
from tfg_drake.messages import BoolArray, FloatArray, IntArray, Roadmap

# Ways take this much more time and length than expected, at most; and seconds and metres kept for detours.
MARGIN = 1.15
RESERVE_TIME = 20.0
RESERVE_DISTANCE = 3.0
# A robot this near to where it began is home, and this near to its goal is there, m.
THERE = 0.3


@dataclasses.dataclass(frozen=True)
class Budget:
    """The rest: until when the mission may last, s, how much time, s, and how far the robot may drive, m; inf where
    there is no budget. stay: s that a goal costs besides the way to it. recalled: none of it may be spent on a goal."""

    end: float
    time: float
    distance: float
    stay: float
    recalled: bool = False

    def affords(self, roadmap: Roadmap, nodes: IntArray) -> BoolArray:
        """Whether the robot could go to each of the nodes (c,) of the roadmap, observe, and come home if it must."""
        if self.recalled:
            return np.zeros(len(nodes), dtype=np.bool_)
        home_time, home_length = _home(roadmap)
        time, length = roadmap.travel_time[nodes] + home_time[nodes], roadmap.travel_length[nodes] + home_length[nodes]
        in_time = MARGIN * time + self.stay + RESERVE_TIME <= self.time
        return np.asarray(in_time & (MARGIN * length + RESERVE_DISTANCE <= self.distance))

    def latest_arrival(self, roadmap: Roadmap, node: int) -> float:
        """When the robot must be at a node at the latest, s, to observe there and be home in time."""
        if not self.limited:
            return math.inf
        return self.end - MARGIN * float(_home(roadmap)[0][node]) - self.stay - RESERVE_TIME

    def longest_way(self, roadmap: Roadmap, node: int) -> float:
        """How long the way to a node may be at the most, m, for the robot to come home from there."""
        if not self.limited:
            return math.inf
        return self.distance - MARGIN * float(_home(roadmap)[1][node]) - RESERVE_DISTANCE

    @property
    def limited(self) -> bool:
        """Whether there is a budget of time or distance."""
        return math.isfinite(self.time) or math.isfinite(self.distance)

    def spent(self) -> str:
        """Why there is no other goal where there is more worth going to than it allows."""
        if self.recalled:
            return "The battery is low: the robot was called back before all was explored."
        return f"{self} of the budget were too little for another goal."

    def __str__(self) -> str:
        limits = ((max(self.time, 0.0), "s"), (max(self.distance, 0.0), "m"))
        parts = [f"{left:.0f} {unit}" for left, unit in limits if left < math.inf]
        return " and ".join(parts)


def _home(roadmap: Roadmap) -> tuple[FloatArray, FloatArray]:
    """Time, s, and length, m, of the way home from each node, both (n,).

    Nothing where the robot need not come home, nor while no way leads there from any place that it can reach: then what
    is left is for finding one.
    """
    if leads_home(roadmap):
        return roadmap.home_time, roadmap.home_length
    return np.zeros(len(roadmap.points)), np.zeros(len(roadmap.points))


def leads_home(roadmap: Roadmap) -> bool:
    """Whether a way home is known from any place that the robot can reach."""
    return len(roadmap.home_time) > 0 and bool(np.isfinite(roadmap.home_time[roadmap.reachable]).any())


def budget_left(
    explorer: ExplorerConfig, stamp: float, driven: float, stay: float, *, recalled: bool = False
) -> Budget:
    """The budget at a time stamp (s) after driven (m). recalled: the robot was called back."""
    end = explorer.budget_time or math.inf
    return Budget(end, end - stamp, (explorer.budget_distance or math.inf) - driven, stay, recalled)


def way_home(roadmap: Roadmap, p_MH: FloatArray, p_MB: FloatArray) -> int:
    """The node at home (2,), m in M, -1 where the robot (2,) is there already."""
    node = int(np.argmin(np.hypot(*(roadmap.points - p_MH).T)))
    there = np.hypot(*(p_MB - p_MH)) <= max(float(np.hypot(*(roadmap.points[node] - p_MH))), THERE)
    return -1 if there else node
