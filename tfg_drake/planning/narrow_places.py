"""Places behind passages that are too narrow for the uncertainty of the map.

How much room a passage has and needs is known only near the robot. A passage may have seemed too narrow because of the
drift of a loop that has closed since. So before a mission ends, the robot goes back and looks once more.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.messages import FloatArray, IntArray, Roadmap
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.expected_view import expected_frontiers

# Nodes as near as this lie before the same passage, m.
SAME_PASSAGE = 2.0


@dataclasses.dataclass(frozen=True)
class NarrowPlaces:
    """Places that have room for the robot but lie behind a passage too narrow for its uncertainty.

    nodes: (b,) of the roadmap, entry: (b,) the last reachable node on the way to each. gain: (b,) nats, and
    time: (b,) s to get there, of each as if the passage were wide enough.
    """

    nodes: IntArray
    entry: IntArray
    gain: FloatArray
    time: FloatArray


def narrow_places(now: Situation) -> NarrowPlaces:
    """All such places of the roadmap, with their gains."""
    roadmap, parameters, judge = now.roadmap, now.parameters, now.turns
    nodes = np.flatnonzero((roadmap.entry >= 0) & ~roadmap.reachable)
    entry, points = roadmap.entry[nodes], roadmap.points[nodes]
    beyond = np.hypot(*(points - roadmap.points[entry]).T)
    distance = roadmap.travel_length[entry] + beyond
    time = roadmap.travel_time[entry] + beyond / parameters.robot.max_speed
    frontiers = expected_frontiers(points, now.tfg, parameters.sensor)
    gains = judge.gains(points, judge.arrival(points, distance, time), judge.seen(points), frontiers)
    return NarrowPlaces(nodes, entry, gains.gain, time)


def passages_revisited(narrow: NarrowPlaces, roadmap: Roadmap, p_MD: FloatArray, before: IntArray) -> IntArray:
    """Ids (t,) of nodes before narrow passages that the robot has gone back to: before (s,), those so far, and
    those near where it is now, p_MD (2,), m in M."""
    entry = np.unique(narrow.entry)
    here = np.hypot(*(roadmap.points[entry] - p_MD).T) < SAME_PASSAGE
    return np.union1d(before, roadmap.node_ids(entry[here]))


def worth_of_looking(
    narrow: NarrowPlaces, roadmap: Roadmap, stay: float, stop_gain: float, looked: IntArray
) -> FloatArray:
    """The value (b,), nats per second, of going back to the last reachable node before each place: 0 where the robot
    has been back already or too little gain lies behind.

    stay: s at it. stop_gain: nats that must lie behind. looked: (t,) node ids, see `passages_revisited`.
    """
    known = roadmap.nodes(looked)
    distance, _ = cKDTree(roadmap.points[known[known >= 0]]).query(roadmap.points[narrow.entry])
    return np.where((narrow.gain > stop_gain) & (distance >= SAME_PASSAGE), narrow.gain / (narrow.time + stay), 0.0)
