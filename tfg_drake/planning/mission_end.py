"""The verdict and reason of a mission's end when no candidate is worth a visit."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.config import TagSensorConfig
from tfg_drake.geometry.distance import clearance
from tfg_drake.geometry.star import inside_any
from tfg_drake.messages import FloatArray, IntArray, Roadmap, TfgMap
from tfg_drake.planning.expected_view import expected_frontiers
from tfg_drake.planning.promises import LEAST_KEPT, MOST_BROKEN
from tfg_drake.tfg.frontier import PUSH, ROOT

# The robot can drive straight to the edge of a frontier from a place within this distance, m.
AT_HAND = 1.0
# Least live frontier that is worth a visit, m, the width of a TurtleBot. It holds for wider robots, too: an edge that a
# robot does not fit through is no frontier (`tfg.frontier.find_frontiers`).
ENOUGH_FRONTIER = 0.36
# A mission is not complete with more frontier than this, m, behind passages that have, or had, room for the robot.
MOST_LEFT = 2.0
# A place within this distance of the reachable ones, m, may be cut off by a wall that was mapped twice, not by a door.
DRIFTED = 1.5
# Why a frontier is left, by the easiest place that sees it: reachable, but not worth the way; behind passages with room
# for the robot but not for its uncertainty; free when it was seen, but not by the newest map; without room for the
# robot; the same in a map with keep-out areas.
REASONS = (
    "not worth the way",
    "behind passages too narrow for the uncertainty of the map",
    "behind a door that shut",
    "where the robot does not fit",
    "where the robot does not fit or must not enter",
)
NOT_WORTH, TOO_UNCERTAIN, SHUT, TOO_NARROW, KEPT_OUT = range(len(REASONS))
# It was tried too often; the mission ended before the robot looked at a frontier that it can reach.
IN_VAIN, UNSEEN = "tried in vain", "the mission ended before"


def given_up_open(tfg: TfgMap, roadmap: Roadmap, need: float) -> float:
    """Return the length (m) of frontier that was tried in vain although a robot that needs this room (m) to every side
    could drive up to it and through.

    Frontier seen only through a crack does not prevent a complete mission.
    """
    places = roadmap.points[roadmap.enterable]
    before = tfg.given_up + (PUSH + ROOT) * tfg.given_up_normal
    if not len(places) or not len(before):
        return 0.0
    near = cKDTree(places).query_ball_point(before, AT_HAND)
    point = np.repeat(np.arange(len(before)), [len(rows) for rows in near])
    ways = np.hstack([places[np.concatenate([np.array(rows, dtype=np.int64) for rows in near])], before[point]])
    reached = np.unique(point[clearance(ways, tfg.obstacles, need) >= need])
    through = np.hstack([before, tfg.given_up])[reached]
    return float(tfg.given_up_length[reached[clearance(through, tfg.obstacles, need) >= need]].sum())


def frontier_left(tfg: TfgMap, roadmap: Roadmap, sensor: TagSensorConfig, radius: float) -> FloatArray:
    """Return the length (5,), m, of live frontier for each of REASONS that keep the robot from it. Arguments as of
    `hindrances`."""
    why = hindrances(tfg, roadmap, sensor, radius)
    return np.bincount(why, tfg.frontier_length, minlength=len(REASONS)).astype(np.float64)


def hindrances(tfg: TfgMap, roadmap: Roadmap, sensor: TagSensorConfig, radius: float) -> IntArray:
    """Return the row (f,) of REASONS that keeps the robot from each live frontier point: that of the place of the
    roadmap, among those that see the point, which is easiest to reach. radius: of the robot, m."""
    elsewhere = KEPT_OUT if len(tfg.keep_out) else TOO_NARROW
    hindrance = np.full(len(roadmap.points), elsewhere)
    shut = np.flatnonzero(roadmap.once_open)
    # Free space narrower than the robot was seen by rays past a wall that the map has merged.
    outline = radius * np.array([[-1, 0], [1, 0], [0, -1], [0, 1]])
    free = inside_any((roadmap.points[shut, None] + outline).reshape(-1, 2), tfg.star_offsets, tfg.star_vertices)
    shut = shut[free.reshape(-1, 4).all(axis=1)]
    apart, _ = cKDTree(roadmap.points[roadmap.reachable]).query(roadmap.points[shut])
    hindrance[shut[apart > DRIFTED]] = SHUT
    hindrance[roadmap.enterable] = TOO_UNCERTAIN
    hindrance[roadmap.reachable] = NOT_WORTH
    seen = expected_frontiers(roadmap.points, tfg, sensor)
    least = np.full(len(tfg.frontiers), elsewhere)
    np.minimum.at(least, seen.index, np.repeat(hindrance, seen.count))
    return least


def why_end(
    candidates: bool, narrow_gain: float, given_up_length: float, left: FloatArray, stop_gain: float
) -> tuple[str, str]:
    """Return verdict and reason if no candidate is worth a visit. What is left open is told by `openings`.

    candidates: True if there are any, or keep-out areas, which may be why there are none. narrow_gain: nats, of the
    best place behind a passage too narrow for the robot's uncertainty. given_up_length: m of open frontier that was
    tried too often. left: the remaining live frontier, see `frontier_left`.
    """
    if not candidates and left.sum() > MOST_LEFT:
        return "stuck", "The robot cannot reach any other place, and frontier is left."
    if left[TOO_UNCERTAIN] + left[SHUT] > MOST_LEFT:
        why = TOO_UNCERTAIN if left[TOO_UNCERTAIN] >= left[SHUT] else SHUT
        return "stuck", f"Frontier is left {REASONS[why]}."
    if narrow_gain > stop_gain:
        return "stuck", f"{narrow_gain:.1f} nats lie behind a passage too narrow for the uncertainty of the map."
    if given_up_length > 0.0:
        return "stuck", f"{given_up_length:.1f} m of open frontier were tried again and again in vain."
    if math.isinf(stop_gain):
        return "complete", f"Places give less than {LEAST_KEPT:.0%} of what they promise, {MOST_BROKEN} times in a row."
    return "complete", f"No place promises more than {stop_gain:g} nats."
