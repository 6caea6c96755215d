"""Errands: places from which the robot looks again before a mission ends.

The clearance that a passage has and needs is known only near the robot: a passage may have seemed too narrow because of
the drift of a loop that has closed since. And a tag may be doubtful.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.geometry.segment_grid import segment_grid
from tfg_drake.messages import BoolArray, FloatArray, IntArray, Roadmap
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.expected_view import SURFACE_TOLERANCE, Visibility, expected_frontiers, visible_targets
from tfg_drake.tfg.polyline import nearest

# A passage counts as looked at again from within this distance, m, of its place.
SAME_PLACE = 2.0
# A doubtful tag within this distance, m, of a certain one is that tag with a misread id.
MISREAD = 0.3
# A doubtful tag counts as looked at again from within this distance, m, of the best place.
AT_TAG = 0.5


class Errands(NamedTuple):
    """Errands of one kind: the reachable node at (e,) of the roadmap for each, its worth (e,), which determines only
    the order, 0 for none, the gain (e,), nats, that it promises, and its reason. near: m, distance within which the
    robot does it."""

    at: IntArray
    worth: FloatArray
    gain: FloatArray
    reasons: list[str]
    near: float

    def looked_from(self, roadmap: Roadmap, p_MD: FloatArray, before: IntArray) -> IntArray:
        """Return the ids (t,) of nodes from which the robot has looked again: before (s,), and those of errands at its
        current place p_MD (2,), m in M."""
        here = (self.worth > 0.0) & (np.hypot(*(roadmap.points[self.at] - p_MD).T) < self.near)
        return np.union1d(before, roadmap.node_ids(self.at[here]))

    def left(self, roadmap: Roadmap, looked: IntArray) -> BoolArray:
        """Return a mask (e,) of the errands that are not near any of the nodes, by ids (t,), from which it has
        looked."""
        known = roadmap.nodes(looked)
        distance, _ = cKDTree(roadmap.points[known[known >= 0]]).query(roadmap.points[self.at])
        return np.asarray((self.worth > 0.0) & (distance >= SAME_PLACE))


def narrow_places(now: Situation, stay: float) -> Errands:
    """Return the errands at passages that have room for the robot but not for its uncertainty, if more than stop_gain
    lies behind: the last reachable node on the way there, worth nats per second as if the passage were wide enough.

    stay: duration of each, s.
    """
    roadmap, parameters = now.roadmap, now.parameters
    nodes = np.flatnonzero((roadmap.entry >= 0) & ~roadmap.reachable)
    entry, points = roadmap.entry[nodes], roadmap.points[nodes]
    beyond = np.hypot(*(points - roadmap.points[entry]).T)
    distance = roadmap.travel_length[entry] + beyond
    time = roadmap.travel_time[entry] + beyond / parameters.robot.max_speed
    frontiers = expected_frontiers(points, now.tfg, parameters.sensor)
    gain = now.turns.at(points, distance, time, frontiers).gain
    worth = np.where(gain > parameters.explorer.stop_gain, gain / (time + stay), 0.0)
    lies = "{:.1f} nats lie behind a passage that was too narrow: it looks once more."
    return Errands(entry, worth, gain, [lies.format(one) for one in gain], SAME_PLACE)


def doubtful_tags(now: Situation) -> Errands:
    """Return the errands for doubtful tags, each at the reachable node from which it appears largest: near and head-on.

    A tag is assumed on the surface nearest to where it was seen. If another tag hangs there, its id was misread.
    """
    estimate, tfg, roadmap, sensor = now.estimate, now.tfg, now.roadmap, now.parameters.sensor
    places = estimate.doubtful_places
    nodes = np.flatnonzero(roadmap.reachable)
    if not (len(places) and len(nodes) and len(tfg.segments)):
        return Errands(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0), [], AT_TAG)
    _, _, _, normals = nearest(places, 2 * np.arange(len(tfg.segments) + 1), tfg.segments.reshape(-1, 2))
    points = roadmap.points[nodes]
    size = np.zeros((len(places), len(nodes)))
    surfaces = tfg.segments, segment_grid(tfg.segments)
    within = sensor.range, sensor.max_incidence, SURFACE_TOLERANCE
    for facing in (normals, -normals):
        sees = Visibility(*visible_targets(points, places, facing, *surfaces, *within, 0.0, 0.0))
        node, tag = np.repeat(np.arange(len(nodes)), sees.count), sees.index
        way = points[node] - places[tag]
        # Its width in the picture goes with the cosine of the incidence over the range.
        width = np.sum(way * facing[tag], axis=1) / np.sum(way**2, axis=1)
        size[tag, node] = np.where(_another_hangs(places, facing, now)[tag], 0.0, width)
    in_sight = (size.max(axis=1) > 0.0).astype(np.float64)
    reasons = [f"Tag {tag} is doubtful: it looks at it once more." for tag in estimate.doubtful]
    return Errands(nodes[np.argmax(size, axis=1)], in_sight, np.zeros(len(places)), reasons, AT_TAG)


def _another_hangs(places: FloatArray, facing: FloatArray, now: Situation) -> BoolArray:
    """Return a mask of the places (d, 2) on surfaces that face (d, 2) where the map has a tag that is not doubtful."""
    certain = ~now.estimate.is_doubtful
    apart = np.linalg.norm(places[:, None] - now.estimate.p_ML[certain], axis=2)
    return np.asarray(np.any((apart < MISREAD) & (facing @ now.tfg.facing[certain].T > 0.0), axis=1))
