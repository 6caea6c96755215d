"""The candidates for the next goal and their expected gains."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.config import ExplorerConfig, OdometryConfig, RobotConfig, TagSensorConfig
from tfg_drake.geometry.segment_grid import segment_grid
from tfg_drake.messages import BoolArray, FloatArray, GoalChoice, IntArray, MapEstimate, Roadmap, TfgMap
from tfg_drake.planning.exact_gain import share_seen
from tfg_drake.planning.expected_gains import ExpectedGains
from tfg_drake.planning.expected_view import Visibility, expected_tags, local_visibility
from tfg_drake.planning.information_gain import Gains, frontier_reach, turns
from tfg_drake.planning.mission_end import ENOUGH_FRONTIER
from tfg_drake.tfg.drift import known_jointly
from tfg_drake.tfg.star_polygon import looked_round

# Time lost at a goal besides the turn itself: settling, solving, planning, s.
OVERHEAD = 1.0
# The robot never turns again within this of where it has turned before, m: it would see the same once more.
APART = 0.3
# Nor where it has looked so often, whichever way: what is still open there does not show from there.
MOST_LOOKS = 6
# A place is judged anew where all landmarks that it sees within this share of the sensor's range are known jointly.
KNOWN_REACH = 0.5


@dataclasses.dataclass(frozen=True)
class GoalParameters:
    """The parameters of robot, sensors and explorer for the choice of a goal, and the seed of the rule `random`."""

    robot: RobotConfig
    sensor: TagSensorConfig
    odometry: OdometryConfig
    explorer: ExplorerConfig
    seed: int = 0


@dataclasses.dataclass(frozen=True)
class Situation:
    """The input of a choice at one stage: map, TFG and roadmap of that stage, or their active part, and the
    parameters."""

    estimate: MapEstimate
    tfg: TfgMap
    roadmap: Roadmap
    parameters: GoalParameters


@dataclasses.dataclass(frozen=True)
class Candidates:
    """Places to go to next.

    nodes: (c,) of the roadmap, ascending, node_ids: (c,) theirs. points: (c, 2) m in M, time: (c,) s to get there.
    expected_gains: (c,) of a full turn at each. tags: (c,) known landmarks in view, -1 where they were not looked up.
    open_ahead: (c, f) m that each sees of each live frontier point.
    """

    nodes: IntArray
    node_ids: IntArray
    points: FloatArray
    time: FloatArray
    expected_gains: ExpectedGains
    tags: IntArray
    open_ahead: FloatArray

    @property
    def sees_enough(self) -> BoolArray:
        """Which (c,) see enough live frontier to be worth a visit, whatever their gain."""
        return np.asarray(self.open_ahead.sum(axis=1) >= ENOUGH_FRONTIER)

    def worth(self, stop_gain: float, asked: BoolArray) -> BoolArray:
        """Which (c,) are worth a visit: they see enough live frontier, or have a gain above stop_gain, nats. The
        gain counts only where it is asked for (c,)."""
        enough = self.sees_enough
        self.expected_gains.ask(np.flatnonzero(asked & ~enough & (self.expected_gains.gains.gain > stop_gain)))
        return np.asarray(enough | (asked & (self.expected_gains.gains.gain > stop_gain)))


def time_at_goal(sensor: TagSensorConfig, explorer: ExplorerConfig) -> float:
    """s. The robot arrives facing some of what it came for, and turns half round for the rest, on average."""
    return 0.5 * (time_all_round(sensor, explorer) - OVERHEAD) + OVERHEAD


def time_all_round(sensor: TagSensorConfig, explorer: ExplorerConfig) -> float:
    """s, at a goal where the robot looks all round."""
    return max(0.0, 2.0 * math.pi - sensor.field_of_view) / explorer.turn_rate + OVERHEAD


def judged(now: Situation, previous: GoalChoice) -> Candidates:
    """The roadmap's reachable nodes, but for those next to past views, at most explorer.samples of them judged now.

    On a large map, a place whose landmarks are not known jointly with the robot's pose keeps the gain of the previous
    choice (see `goal_choice.remember`): nothing has changed there since they last were.
    """
    estimate, tfg, roadmap = now.estimate, now.tfg, now.roadmap
    sensor, explorer = now.parameters.sensor, now.parameters.explorer
    nodes = places(roadmap, tfg, estimate.X_MD[:2])
    sees = Visibility(roadmap.frontier_offsets, roadmap.frontier_index)
    here = sees_known_jointly(roadmap.points[nodes], estimate, tfg, sensor)
    kept = ~here & np.isin(roadmap.node_ids(nodes), previous.candidates)
    # Far away, where nothing was worth remembering, only what sees frontier is asked.
    ask = ~kept & (here | (sees.count[nodes] > 0))
    asked = thin_candidates(nodes[ask], sees.count[nodes[ask]], explorer.samples)
    candidates = np.union1d(asked, nodes[kept]) if kept.any() else asked
    ask = np.isin(candidates, asked)
    here = here[np.searchsorted(nodes, candidates)]
    points, time, node_ids = roadmap.points[candidates], roadmap.travel_time[candidates], roadmap.node_ids(candidates)
    frontiers_seen = sees.of(candidates)
    open_ahead = frontier_seen(points, frontiers_seen, tfg, sensor)
    judge = turns(estimate, tfg, sensor, now.parameters.odometry, explorer)
    arrival = judge.arrival(points, roadmap.travel_length[candidates], time)
    grid = segment_grid(tfg.segments)

    def expected(rows: IntArray) -> Gains:
        tags, frontiers = expected_tags(points[rows], estimate, tfg, sensor, grid), frontiers_seen.of(rows)
        arriving = arrival._replace(odometry=arrival.odometry[rows])
        return _found_again(judge.gains(points[rows], arriving, tags, frontiers), here[rows])

    # What is remembered has to be known, and the most that a place can bring is known of the exact gain alone.
    all_at_once = not estimate.is_joint or explorer.gain != "exact" or not explorer.pose_price
    judged_now = expected(np.flatnonzero(ask)) if all_at_once else judge.most(points, arrival, frontiers_seen)
    gains = _filled(previous, node_ids, ask, judged_now, open_ahead.sum(axis=1) >= ENOUGH_FRONTIER)
    expected_gains = ExpectedGains(gains, ~ask | all_at_once, expected, pay=explorer.pose_price)
    in_view = np.full(len(candidates), -1)
    if explorer.least_tags:
        in_view[ask] = expected_tags(points[ask], estimate, tfg, sensor, grid).count
    return Candidates(candidates, node_ids, points, time, expected_gains, in_view, open_ahead)


def turn_gains(nodes: IntArray, tags: Visibility, now: Situation) -> Gains:
    """The gains (c,) of a full turn at each of the nodes (c,) of the roadmap. tags: the landmarks visible from
    them."""
    roadmap, parameters = now.roadmap, now.parameters
    points, distance, time = roadmap.points[nodes], roadmap.travel_length[nodes], roadmap.travel_time[nodes]
    frontiers = Visibility(roadmap.frontier_offsets, roadmap.frontier_index).of(nodes)
    judge = turns(now.estimate, now.tfg, parameters.sensor, parameters.odometry, parameters.explorer)
    return judge.gains(points, judge.arrival(points, distance, time), tags, frontiers)


def places(roadmap: Roadmap, tfg: TfgMap, p_MD: FloatArray) -> IntArray:
    """The nodes, ascending, that the robot at p_MD (2,), m in M, can reach and that are apart from past views."""
    return np.flatnonzero(roadmap.reachable & apart_from_views(roadmap.points, tfg, p_MD))


def thin_candidates(nodes: IntArray, sees_frontier: IntArray, count: int) -> IntArray:
    """At most count of the nodes (n,), ascending, those that see a frontier (n,) first, evenly taken."""
    if len(nodes) <= count:
        return nodes
    seeing, others = nodes[sees_frontier > 0], nodes[sees_frontier == 0]

    def take(which: IntArray, number: int) -> IntArray:
        return which[np.linspace(0, len(which) - 1, number).astype(np.int64)] if len(which) > number else which

    seeing = take(seeing, count)
    return np.sort(np.append(seeing, take(others, count - len(seeing))))


def apart_from_views(points: FloatArray, tfg: TfgMap, p_MD: FloatArray) -> BoolArray:
    """Which of the points (n, 2), m in M, are neither a place where the robot has looked all round or MOST_LOOKS times
    nor its own (2,)."""
    turned = looked_round(tfg.star_offsets, tfg.star_vertices, tfg.star_centers)
    done = cKDTree(np.append(tfg.star_centers[turned], p_MD[None], axis=0))
    looks = cKDTree(tfg.star_centers).query_ball_point(points, APART, return_length=True)
    return np.asarray((done.query(points)[0] >= APART) & (looks < MOST_LOOKS))


def sees_known_jointly(points: FloatArray, estimate: MapEstimate, tfg: TfgMap, sensor: TagSensorConfig) -> BoolArray:
    """Whether what each of the points (n, 2), m in M, sees within KNOWN_REACH is known jointly with the departure pose,
    (n,): what stands behind walls does not matter. Out of the sensor's range from that pose all that is as near counts,
    seen or not."""
    reach = KNOWN_REACH * sensor.range
    known = known_jointly(points, estimate, reach)
    if known.all():
        return known
    ask = np.flatnonzero(~known & (np.hypot(*(points - estimate.X_MD[:2]).T) < sensor.range))
    visible = expected_tags(points[ask], estimate, tfg, dataclasses.replace(sensor, range=reach))
    known[ask] = local_visibility(visible, estimate).count == visible.count
    return known


def _found_again(gains: Gains, known: BoolArray) -> Gains:
    """The gains (c,) without the pose's price where the landmarks are not known (c,) jointly with the pose here: on its
    way there the robot will find its place by what it sees, not by odometry from here."""
    price = np.where(known, 0.0, gains.pose_price)
    return Gains(gains.exploitation, gains.exploration + price, gains.pose_price - price)


def _filled(
    previous: GoalChoice, candidates: IntArray, asked: BoolArray, gains: Gains, sees_frontier: BoolArray
) -> Gains:
    """The gains of all candidates (c,), by node id: the new gains of those asked for (c,), the previous gains of the
    others, whose exploration is 0 where they see no frontier (c,) any more."""
    row = np.searchsorted(previous.candidates, candidates[~asked])

    def fill(now: FloatArray, before: FloatArray) -> FloatArray:
        filled = np.empty(len(candidates))
        filled[asked], filled[~asked] = now, before[row]
        return filled

    exploration = fill(gains.exploration, previous.exploration)
    exploration[~asked & ~sees_frontier] = 0.0
    return Gains(
        exploitation=fill(gains.exploitation, previous.exploitation),
        exploration=exploration,
        pose_price=fill(gains.pose_price, previous.pose_price),
    )


def frontier_in_sight(roadmap: Roadmap, tfg: TfgMap, sensor: TagSensorConfig) -> tuple[bool, bool]:
    """Whether a new place that the robot can reach sees enough live frontier, and whether any other where it would
    fit."""
    _, total = _each_seen(roadmap.points, Visibility(roadmap.frontier_offsets, roadmap.frontier_index), tfg, sensor)
    enough = total >= ENOUGH_FRONTIER
    return bool(enough[roadmap.reachable].any()), bool(enough[~roadmap.reachable].any())


def frontier_seen(points: FloatArray, frontiers: Visibility, tfg: TfgMap, sensor: TagSensorConfig) -> FloatArray:
    """Length (c, f), m, that each of the points (c, 2), m in M, sees of each live frontier point, less where the view
    ends soon behind it."""
    seen, _ = _each_seen(points, frontiers, tfg, sensor)
    length = np.zeros((len(points), len(tfg.frontiers)))
    length[np.repeat(np.arange(len(points)), frontiers.count), frontiers.index] = seen
    return length


def _each_seen(
    points: FloatArray, frontiers: Visibility, tfg: TfgMap, sensor: TagSensorConfig
) -> tuple[FloatArray, FloatArray]:
    """Of each entry of `frontiers` the length, m, as of `frontier_seen`, and the sum of each of the points (c,)."""
    point = np.repeat(np.arange(len(points)), frontiers.count)
    distance = np.hypot(*(tfg.frontiers[frontiers.index] - points[point]).T)
    seen = tfg.frontier_length[frontiers.index] * share_seen(distance, frontier_reach(sensor))
    return seen, np.bincount(point, weights=seen, minlength=len(points)).astype(np.float64)
