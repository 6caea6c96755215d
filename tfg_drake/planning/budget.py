"""The budget of time and distance, and the goals that it allows (the paper's q(u) <= c)."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from tfg_drake.config import ExplorerConfig
from tfg_drake.messages import BoolArray, FloatArray, IntArray, Roadmap

# Factor by which ways may exceed their expected time and length; time, s, and length, m, reserved for detours.
MARGIN = 1.15
RESERVE_TIME = 20.0
RESERVE_DISTANCE = 3.0
# The robot is home, or at its goal, within this distance, m.
THERE = 0.3


@dataclasses.dataclass(frozen=True)
class Budget:
    """The remaining budget: end of the mission, s, time left, s, and distance left, m; inf without a budget. stay:
    duration of the observation at a goal, s. recalled: no budget may be spent on goals."""

    end: float
    time: float
    distance: float
    stay: float
    recalled: bool = False

    def affords(self, roadmap: Roadmap, nodes: IntArray) -> BoolArray:
        """Return a mask of the nodes (c,) of the roadmap from which the robot could observe and still return home."""
        if self.recalled:
            return np.zeros(len(nodes), dtype=np.bool_)
        home_time, home_length = _home(roadmap)
        time, length = roadmap.travel_time[nodes] + home_time[nodes], roadmap.travel_length[nodes] + home_length[nodes]
        in_time = MARGIN * time + self.stay + RESERVE_TIME <= self.time
        return np.asarray(in_time & (MARGIN * length + RESERVE_DISTANCE <= self.distance))

    def latest_arrival(self, roadmap: Roadmap, node: int) -> float:
        """Return the latest time, s, to arrive at a node, observe there and be home in time."""
        if not self.limited:
            return math.inf
        return self.end - MARGIN * float(_home(roadmap)[0][node]) - self.stay - RESERVE_TIME

    def longest_way(self, roadmap: Roadmap, node: int) -> float:
        """Return the longest way to a node, m, from which the robot can return home."""
        if not self.limited:
            return math.inf
        return self.distance - MARGIN * float(_home(roadmap)[1][node]) - RESERVE_DISTANCE

    @property
    def limited(self) -> bool:
        """Whether there is a budget of time or distance."""
        return math.isfinite(self.time) or math.isfinite(self.distance)

    def spent(self) -> str:
        """The reason for the end of a mission whose budget does not allow any worthwhile goal."""
        if self.recalled:
            return "The robot was called back before all was explored."
        return f"{self} of the budget were too little for another goal."

    def __str__(self) -> str:
        limits = ((max(self.time, 0.0), "s"), (max(self.distance, 0.0), "m"))
        parts = [f"{left:.0f} {unit}" for left, unit in limits if left < math.inf]
        return " and ".join(parts)


def _home(roadmap: Roadmap) -> tuple[FloatArray, FloatArray]:
    """Return time, s, and length, m, of the way home from each node, both (n,).

    Both are 0 if the robot need not return home, or while no reachable place leads home, as the budget then serves to
    find a way.
    """
    if leads_home(roadmap):
        return roadmap.home_time, roadmap.home_length
    return np.zeros(len(roadmap.points)), np.zeros(len(roadmap.points))


def leads_home(roadmap: Roadmap) -> bool:
    """Return whether a way home is known from any reachable place."""
    return len(roadmap.home_time) > 0 and bool(np.isfinite(roadmap.home_time[roadmap.reachable]).any())


def budget_left(
    explorer: ExplorerConfig, stamp: float, driven: float, stay: float, *, recalled: bool = False
) -> Budget:
    """Return the budget at a time stamp (s) after driven (m). recalled: the robot was called back."""
    end = explorer.budget_time or math.inf
    return Budget(end, end - stamp, (explorer.budget_distance or math.inf) - driven, stay, recalled)


def way_home(roadmap: Roadmap, p_MH: FloatArray, p_MB: FloatArray) -> int:
    """Return the node at home (2,), m in M, -1 if the robot (2,) is there already."""
    node = int(np.argmin(np.hypot(*(roadmap.points - p_MH).T)))
    there = np.hypot(*(p_MB - p_MH)) <= max(float(np.hypot(*(roadmap.points[node] - p_MH))), THERE)
    return -1 if there else node
