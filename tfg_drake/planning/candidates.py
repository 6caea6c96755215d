"""The candidates for the next goal and their expected gains."""

from __future__ import annotations

import dataclasses
import functools
import math

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.config import ExplorerConfig, RobotConfig, TagSensorConfig
from tfg_drake.geometry.segment_grid import segment_grid
from tfg_drake.messages import BoolArray, FloatArray, Hypotheses, IntArray, MapEstimate, Roadmap, TfgMap
from tfg_drake.planning.exact_gain import share_seen
from tfg_drake.planning.expected_view import Visibility, expected_tags
from tfg_drake.planning.information_gain import Gains, Turns, frontier_reach
from tfg_drake.planning.mission_end import ENOUGH_FRONTIER
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.pure_pursuit import PLANNED_SHARE
from tfg_drake.tfg.star_polygon import looked_round

# Time lost at a goal besides the turn itself: settling, solving, planning, s.
OVERHEAD = 1.0
# No candidate lies within this distance of an earlier turn, m, as it would see the same.
APART = 0.3
# Nor of this number of earlier looks in any direction: what is open there is not visible from there.
MOST_LOOKS = 6


@dataclasses.dataclass(frozen=True)
class Situation:
    """The input of a choice at one stage: map, TFG and roadmap of that stage, or their part nearby, and the parameters.
    landmarks: the map with or without its walls. is_large: not all tags of the map are jointly known. hypotheses: the
    places of a known map where the robot may be."""

    landmarks: MapEstimate
    tfg: TfgMap
    roadmap: Roadmap
    parameters: PlanningParameters
    is_large: bool = False
    hypotheses: Hypotheses | None = None

    @functools.cached_property
    def estimate(self) -> MapEstimate:
        """The map of the tags."""
        return self.landmarks.of_tags

    @functools.cached_property
    def turns(self) -> Turns:
        """The input of the gains."""
        return Turns(self.landmarks, self.tfg, self.parameters)


@dataclasses.dataclass(frozen=True)
class Candidates:
    """Candidates for the next goal.

    nodes: (c,) of the roadmap, ascending, node_ids: (c,) their ids. points: (c, 2) m in M, time: (c,) travel time, s.
    gains: (c,) of a full turn at each, paid: (c,) nats, the gain used by the rules, with or without the pose price.
    tags: (c,) number of known landmarks in view, -1 if not computed. open_ahead: (c, f) m that each sees of each live
    frontier point.
    """

    nodes: IntArray
    node_ids: IntArray
    points: FloatArray
    time: FloatArray
    gains: Gains
    paid: FloatArray
    tags: IntArray
    open_ahead: FloatArray

    @property
    def sees_enough(self) -> BoolArray:
        """A mask (c,) of the candidates that see enough live frontier to be worth a visit, whatever their gain."""
        return np.asarray(self.open_ahead.sum(axis=1) >= ENOUGH_FRONTIER)

    def worth(self, stop_gain: float, asked: BoolArray) -> BoolArray:
        """Return a mask (c,) of the candidates worth a visit: they see enough live frontier, or have a gain above
        stop_gain, nats. The gain counts only for those asked for (c,)."""
        return np.asarray(self.sees_enough | (asked & (self.gains.gain > stop_gain)))


def time_at_goal(sensor: TagSensorConfig, explorer: ExplorerConfig) -> float:
    """Return the expected time at a goal, s: the robot arrives facing part of the frontier and turns half around for
    the rest, on average."""
    return 0.5 * (time_all_round(sensor, explorer) - OVERHEAD) + OVERHEAD


def time_to_go_on(robot: RobotConfig) -> float:
    """Return the expected time to leave a goal, s: a quarter of a turn to the next way, on average, and the start."""
    return 0.5 * math.pi / (PLANNED_SHARE * robot.max_turn_rate) + robot.max_speed / robot.max_acceleration


def time_all_round(sensor: TagSensorConfig, explorer: ExplorerConfig) -> float:
    """Return the time at a goal where the robot looks all around, s."""
    return max(0.0, 2.0 * math.pi - sensor.field_of_view) / explorer.turn_rate + OVERHEAD


def judged(now: Situation) -> Candidates:
    """Return the candidates with their gains: reachable nodes that are not next to past views, at most
    explorer.samples."""
    estimate, tfg, roadmap = now.estimate, now.tfg, now.roadmap
    sensor, explorer = now.parameters.sensor, now.parameters.explorer
    sees = Visibility(roadmap.frontier_offsets, roadmap.frontier_index)
    nodes = places(roadmap, tfg, estimate.X_MD[:2])
    nodes = thin_candidates(nodes, sees.count[nodes], explorer.samples)
    points, time, frontiers_seen = roadmap.points.take(nodes, axis=0), roadmap.travel_time[nodes], sees.of(nodes)
    judge, grid = now.turns, segment_grid(tfg.segments)
    seen = judge.seen(points, grid)
    gains = judge.gains(points, judge.arrival(points, roadmap.travel_length[nodes], time), seen, frontiers_seen)
    gains = _found_again(gains, judge.targets.known_jointly(seen).count == seen.count)
    paid = gains.gain if explorer.pose_price else gains.gain + gains.pose_price
    in_view = np.full(len(nodes), -1)
    if explorer.least_tags:
        in_view = expected_tags(points, estimate, tfg, sensor, grid).count
    open_ahead = frontier_seen(points, frontiers_seen, tfg, sensor)
    return Candidates(nodes, roadmap.node_ids(nodes), points, time, gains, paid, in_view, open_ahead)


def turn_gains(nodes: IntArray, now: Situation) -> Gains:
    """Return the gains (c,) of a full turn at each of the nodes (c,) of the roadmap."""
    roadmap = now.roadmap
    frontiers = Visibility(roadmap.frontier_offsets, roadmap.frontier_index).of(nodes)
    return now.turns.at(roadmap.points[nodes], roadmap.travel_length[nodes], roadmap.travel_time[nodes], frontiers)


def places(roadmap: Roadmap, tfg: TfgMap, p_MD: FloatArray) -> IntArray:
    """Return the nodes, ascending, that a robot at p_MD (2,), m in M, can reach and that are apart from past views."""
    return np.flatnonzero(roadmap.reachable & apart_from_views(roadmap.points, tfg, p_MD))


def thin_candidates(nodes: IntArray, sees_frontier: IntArray, count: int) -> IntArray:
    """Return at most count of the nodes (n,), ascending, evenly taken, with those that see a frontier (n,) first."""
    if len(nodes) <= count:
        return nodes
    seeing, others = nodes[sees_frontier > 0], nodes[sees_frontier == 0]

    def take(which: IntArray, number: int) -> IntArray:
        return which[np.linspace(0, len(which) - 1, number).astype(np.int64)] if len(which) > number else which

    seeing = take(seeing, count)
    return np.sort(np.append(seeing, take(others, count - len(seeing))))


def apart_from_views(points: FloatArray, tfg: TfgMap, p_MD: FloatArray) -> BoolArray:
    """Return a mask of the points (n, 2), m in M, where the robot has not looked all around or MOST_LOOKS times, and
    does not stand now (2,)."""
    turned = looked_round(tfg.star_offsets, tfg.star_vertices, tfg.star_centers)
    looks = np.where(np.append(turned, True), MOST_LOOKS, 1)
    before = cKDTree(np.append(tfg.star_centers, p_MD[None], axis=0))
    near = before.sparse_distance_matrix(cKDTree(points), APART, output_type="ndarray")
    return np.asarray(np.bincount(near["j"], looks[near["i"]], len(points)) < MOST_LOOKS)


def _found_again(gains: Gains, known: BoolArray) -> Gains:
    """Return the gains (c,) without the pose price if not all landmarks in view are known (c,) jointly with the current
    pose: on its way there the robot will localise by landmarks, not by odometry from here."""
    price = np.where(known, 0.0, gains.pose_price)
    return Gains(gains.exploitation, gains.exploration + price, gains.pose_price - price)


def frontier_in_sight(roadmap: Roadmap, tfg: TfgMap, sensor: TagSensorConfig) -> bool:
    """Return whether a new reachable place sees enough live frontier."""
    _, total = _each_seen(roadmap.points, Visibility(roadmap.frontier_offsets, roadmap.frontier_index), tfg, sensor)
    return bool((total[roadmap.reachable] >= ENOUGH_FRONTIER).any())


def frontier_seen(points: FloatArray, frontiers: Visibility, tfg: TfgMap, sensor: TagSensorConfig) -> FloatArray:
    """Return the length (c, f), m, that each of the points (c, 2), m in M, sees of each live frontier point, reduced if
    the view ends soon behind it."""
    seen, _ = _each_seen(points, frontiers, tfg, sensor)
    length = np.zeros((len(points), len(tfg.frontiers)))
    length[np.repeat(np.arange(len(points)), frontiers.count), frontiers.index] = seen
    return length


def _each_seen(
    points: FloatArray, frontiers: Visibility, tfg: TfgMap, sensor: TagSensorConfig
) -> tuple[FloatArray, FloatArray]:
    """The length of each entry of `frontiers`, m, as of `frontier_seen`, and the sum of each of the points (c,)."""
    point = np.repeat(np.arange(len(points)), frontiers.count)
    d = tfg.frontiers.take(frontiers.index, axis=0) - points.take(point, axis=0)
    distance = np.hypot(d[:, 0], d[:, 1])
    seen = tfg.frontier_length[frontiers.index] * share_seen(distance, frontier_reach(sensor))
    return seen, np.bincount(point, weights=seen, minlength=len(points)).astype(np.float64)
