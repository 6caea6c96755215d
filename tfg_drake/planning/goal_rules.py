"""The rules for the choice of the next goal, selected by explorer.goal.

Every rule gives the candidates a value; the one of most value among those worth a visit is the next goal.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy.sparse.csgraph import dijkstra

from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.messages import BoolArray, FloatArray, IntArray, Roadmap
from tfg_drake.planning.routes import edge_lengths
from tfg_drake.planning.shortest_ways import joined

# Greatest number of stops of a tour, whose best order is found exactly within milliseconds.
TOUR_GOALS = 11
# A place stands for a stop of the tour if it sees this share of the stop's frontier.
AS_GOOD_AS_ALL = 0.95


def gain_per_time(gain: FloatArray, time: FloatArray) -> FloatArray:
    """Return nats (c,) per second (c,), a greedy rule that learns fast at first."""
    return np.asarray(gain / time)


def nearest_frontier(time: FloatArray, frontier_distance: FloatArray) -> FloatArray:
    """Return minus the time (c,), s, to each place that is the nearest to a frontier point it sees, -inf for the
    others.

    frontier_distance: (c, f) m, inf if a place does not see a frontier point. If none sees any, minus the time.
    """
    if not np.isfinite(frontier_distance).any():
        return -time
    seen = np.isfinite(frontier_distance).any(axis=0)
    value = np.full(len(time), -np.inf)
    before = np.argmin(frontier_distance[:, seen], axis=0)
    value[before] = -time[before]
    return value


def tour(
    gain: FloatArray,
    time: FloatArray,
    stay: float,
    frontier: FloatArray,
    least: float,
    nodes: IntArray,
    roadmap: Roadmap,
    speed: float,
) -> tuple[FloatArray, BoolArray]:
    """Return the value (c,) of each candidate by a short tour, and a mask of the frontier points (f,) of its first
    goal.

    The value is minus the time, s, until a goal of the tour is done, so the first goal is best; -inf for candidates
    that are not in it.

    1. Goals are chosen one after the other. The next one maximises the metres of new frontier, seen by no earlier goal,
       over the time, s, by which it lengthens the tour of the goals chosen so far, including the stay, s.
    2. They are visited in the order of least time that ends at the goal farthest from the robot, from where exploration
       continues.
    3. The first goal is replaced by the candidate with the least detour on the way to the second, among those that see
       almost all frontier that the first was chosen for.

    gain: (c,) nats. time: (c,) s, from the robot to each. frontier: (c, f) m that each candidate sees of each frontier
    point. least: m, least frontier worth a goal. nodes: (c,) of the roadmap; speed: m/s. If no frontier is left, gain
    per time decides.
    """
    way = _TimesTo(time, nodes, roadmap, speed)
    goals, looked_at, order = _most_by_time(frontier, least, stay, way)
    if not order:
        return gain_per_time(gain, time + stay), np.ones(frontier.shape[1], dtype=np.bool_)
    value, arrival, to_next = np.full(len(time), -np.inf), 0.0, time
    for k in order:
        arrival += to_next[goals[k]] + stay
        value[goals[k]], to_next = -arrival, way.from_goal(goals[k])
    first, look = goals[order[0]], looked_at[order[0]]
    wanted = frontier[first, look]
    sees_it = np.minimum(frontier[:, look], wanted).sum(axis=1) >= AS_GOOD_AS_ALL * wanted.sum()
    onward = way.from_goal(goals[order[1]]) if len(order) > 1 else np.zeros(len(time))
    best = int(np.argmin(np.where(sees_it, time + onward, np.inf)))
    value[first], value[best] = -np.inf, value[first]
    return value, look


class _TimesTo:
    """Travel times between the candidates along a roadmap, computed once for each goal. Arguments as of `tour`."""

    def __init__(self, time: FloatArray, nodes: IntArray, roadmap: Roadmap, speed: float) -> None:
        length = np.maximum(edge_lengths(roadmap.points, roadmap.edges), 1e-9)
        self._graph = joined(roadmap.edges, length, len(roadmap.points))
        self.time, self._nodes, self._speed = time, nodes, speed
        self._found: dict[int, FloatArray] = {}

    def from_goal(self, goal: int) -> FloatArray:
        """Return the travel times (c,), s, between one candidate and each, by the shortest way."""
        if goal not in self._found:
            along = dijkstra(self._graph, indices=self._nodes[goal])[self._nodes] / self._speed
            # From a place that only the robot is joined to, as it stands near it, the way leads back past the robot.
            self._found[goal] = np.minimum(along, self.time[goal] + self.time)
        return self._found[goal]


def stops(value: FloatArray, first: int) -> IntArray:
    """Return the candidates (s,) that a tour visits, in its order, from the values (c,) that it gave them; none if the
    first of them is not `first`, or if no tour was planned."""
    order = np.argsort(-value)[: np.count_nonzero(np.isfinite(value))]
    return order if value[first] < 0.0 and order[0] == first else order[:0]


def _most_by_time(
    frontier: FloatArray, least: float, stay: float, way: _TimesTo
) -> tuple[list[int], list[BoolArray], list[int]]:
    """Return the goals of a tour, at most TOUR_GOALS, masks of the frontier points (f,) that each is the first to see,
    and the order of the visits.

    Step 1 of `tour`. frontier: (c, f) m that each candidate sees of each frontier point. stay: s at each goal. least:
    m, as of `tour`.
    """
    detour = way.time
    left = np.ones(frontier.shape[1], dtype=np.bool_)
    goals: list[int] = []
    looked_at: list[BoolArray] = []
    order: list[int] = []
    while len(goals) < TOUR_GOALS:
        new = frontier @ left
        rate = np.where(new >= least, new / (detour + stay), 0.0)
        if rate.max(initial=0.0) == 0.0:
            break
        goal = int(np.argmax(rate))
        goals.append(goal)
        looked_at.append(left & (frontier[goal] > 0.0))
        left = left & ~looked_at[-1]
        between = np.array([way.from_goal(one) for one in goals])
        first = way.time[goals]
        order = shortest_order(first, between[:, goals], int(np.argmax(first)))
        # On the way from each stop, the robot's place first, to the next; or behind the last.
        before, after = np.array([way.time, *between[order[:-1]]]), between[order]
        saved = before[np.arange(len(order)), np.array(goals)[order]]
        detour = np.maximum(0.0, (before + after - saved[:, None]).min(axis=0, initial=np.inf))
        detour = np.minimum(detour, after[-1])
    return goals, looked_at, order


@read_only_arguments
@njit(cache=True)
def shortest_order(first: FloatArray, between: FloatArray, last: int) -> list[int]:
    """Return the order of n places in which the given last one is reached soonest: first (n,) s to each from the start,
    between (n, n) s. By dynamic programming over subsets (Held and Karp)."""
    n = len(first)
    cost = np.full((1 << n, n), np.inf)
    before = np.full((1 << n, n), -1)
    for k in range(n):
        cost[1 << k, k] = first[k]
    for visited in range(1, 1 << n):
        for at in range(n):
            here = cost[visited, at]
            if not here < np.inf:
                continue
            for k in range(n):
                if visited & (1 << k):
                    continue
                then = visited | (1 << k)
                if here + between[at, k] < cost[then, k]:
                    cost[then, k], before[then, k] = here + between[at, k], at
    visited = (1 << n) - 1
    order = []
    while last >= 0:
        order.append(last)
        last, visited = before[visited, last], visited & ~(1 << last)
    return order[::-1]
