"""Where to go next: the candidate with the most expected information per expected time."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.config import NODE_MARGIN, ExplorerConfig, OdometryConfig, RobotConfig, TagSensorConfig
from tfg_drake.geometry.distance import clearance
from tfg_drake.messages import BoolArray, FloatArray, GoalChoice, IntArray, MapEstimate, Roadmap, TfgMap, replace
from tfg_drake.planning.exact_gain import share_seen
from tfg_drake.planning.expected_view import View, expected_frontiers, expected_tags
from tfg_drake.planning.information_gain import Gains, frontier_reach, information_gain
from tfg_drake.tfg.drift import known_jointly
from tfg_drake.tfg.frontier import PUSH, ROOT

# Time lost at a goal besides the turn itself: settling, solving, planning, s.
OVERHEAD = 1.0
# After this many goals without a landmark or a surface there is no building here.
NOTHING_AFTER = 5
# The robot never turns again within this of where it has turned before, m: it would see the same once more.
APART = 0.3
# The robot could drive straight up to the edge of a frontier from a place this near, m.
AT_HAND = 1.0
# A place is judged anew where all landmarks within this share of the sensor's range are known jointly.
KNOWN_REACH = 0.5
# Less live frontier than this is not worth a visit, m.
ENOUGH_FRONTIER = 0.24


def empty_choice() -> GoalChoice:
    """Before the first choice."""
    none = np.zeros(0)
    return GoalChoice(
        stage=0,
        node=-1,
        p_MG=np.zeros(2),
        candidates=np.zeros(0, dtype=np.int64),
        exploitation=none,
        exploration=none,
        pose_price=none,
        gain=none,
        value=none,
        verdict="goal",
        reason="",
    )


def thin_candidates(nodes: IntArray, sees_frontier: IntArray, count: int) -> IntArray:
    """At most count of the nodes (n,), ascending, those that see a frontier (n,) first, evenly taken."""
    if len(nodes) <= count:
        return nodes
    seeing, others = nodes[sees_frontier > 0], nodes[sees_frontier == 0]

    def take(which: IntArray, number: int) -> IntArray:
        return which[np.linspace(0, len(which) - 1, number).astype(np.int64)] if len(which) > number else which

    seeing = take(seeing, count)
    return np.sort(np.append(seeing, take(others, count - len(seeing))))


def apart_from_goals(points: FloatArray, estimate: MapEstimate) -> BoolArray:
    """Which of the points (n, 2), m in M, are no past goal's place, (n,)."""
    distance, _ = cKDTree(estimate.X_MA[:, :2]).query(points)
    return np.asarray(distance >= APART)


def choose(
    estimate: MapEstimate,
    tfg: TfgMap,
    roadmap: Roadmap,
    sensor: TagSensorConfig,
    odometry: OdometryConfig,
    robot: RobotConfig,
    explorer: ExplorerConfig,
    previous: GoalChoice,
) -> GoalChoice:
    """The choice at one stage: estimate, tfg and roadmap are of the same stage, previous is the choice before.

    Candidates are the roadmap's reachable nodes, but for those next to past goals. Worth going to is what sees enough
    live frontier, whatever its gain, and what promises more than explorer.stop_gain. On a large map, a place where the
    landmarks are not known jointly with the robot's pose promises what it did when they last were: nothing has changed
    there since.
    """
    if estimate.stage >= NOTHING_AFTER and len(estimate.ids) == 0 and len(tfg.segments) == 0:
        reason = f"Neither a landmark nor a surface was seen from {estimate.stage} goals: there is nothing to map."
        return replace(empty_choice(), stage=estimate.stage, verdict="stuck", reason=reason)
    nodes = np.flatnonzero(roadmap.reachable & apart_from_goals(roadmap.points, estimate))
    seen = expected_frontiers(roadmap.points[nodes], tfg, sensor)
    here = known_jointly(roadmap.points[nodes], estimate, KNOWN_REACH * sensor.range)
    kept = ~here & np.isin(nodes, previous.candidates)
    asked = thin_candidates(nodes[~kept], seen.of(np.flatnonzero(~kept)).count, explorer.samples)
    candidates = np.union1d(asked, nodes[kept])
    frontiers = seen.of(np.searchsorted(nodes, candidates))

    def expected(points: FloatArray, time: FloatArray, frontiers: View) -> Gains:
        tags = expected_tags(points, estimate, tfg, sensor)
        distance = robot.max_speed * time
        return information_gain(points, distance, time, tags, frontiers, estimate, tfg, sensor, odometry, explorer)

    points, time = roadmap.points[candidates], roadmap.travel_time[candidates]
    enough = seen_length(points, frontiers, tfg, sensor) >= ENOUGH_FRONTIER
    ask = np.isin(candidates, asked)
    now = expected(points[ask], time[ask], frontiers.of(np.flatnonzero(ask)))
    gains = _filled(previous, candidates, ask, now, enough)
    value = gains.gain / (time + 2.0 * math.pi / explorer.turn_rate + OVERHEAD)
    best = pick(gains.gain, value, enough, explorer.stop_gain)
    if best >= 0:
        node, p_MG, verdict = int(candidates[best]), points[best], "goal"
        reason = f"{gains.gain[best]:.1f} nats are expected at the rate of {value[best]:.2f} nats per second."
    else:
        node, p_MG = -1, np.zeros(2)
        barred, barred_time = _barred(roadmap, robot.max_speed)
        barred_gains = expected(barred, barred_time, expected_frontiers(barred, tfg, sensor))
        _, home = cKDTree(roadmap.points).query(estimate.X_MA[0, :2])
        verdict, reason = why_end(
            bool(len(candidates)),
            float(barred_gains.gain.max(initial=0.0)),
            given_up_open(tfg, roadmap, robot.radius + NODE_MARGIN),
            float(tfg.frontier_length.sum()),
            not roadmap.reachable[home],
            explorer.stop_gain,
        )
    return GoalChoice(
        stage=estimate.stage,
        node=node,
        p_MG=p_MG,
        candidates=candidates,
        exploitation=gains.exploitation,
        exploration=gains.exploration,
        pose_price=gains.pose_price,
        gain=gains.gain,
        value=value,
        verdict=verdict,
        reason=reason,
    )


def _filled(
    previous: GoalChoice, candidates: IntArray, asked: BoolArray, gains: Gains, sees_frontier: BoolArray
) -> Gains:
    """The gains of all candidates (c,): those of the ones asked for (c,) now, of the others as they were before, but
    for what they promised of a frontier that they do not see (c,) any more."""
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


def _barred(roadmap: Roadmap, speed: float) -> tuple[FloatArray, FloatArray]:
    """Places (b, 2), m in M, with room for the robot but which it may not try to reach, and how long (b,), s, it would
    take at the speed (m/s), were it surer of its own place and the map's."""
    if not roadmap.reachable.any():
        return np.zeros((0, 2)), np.zeros(0)
    points = roadmap.points[roadmap.roomy & ~roadmap.reachable]
    distance, nearest = cKDTree(roadmap.points[roadmap.reachable]).query(points)
    return points, roadmap.travel_time[roadmap.reachable][nearest] + distance / speed


def given_up_open(tfg: TfgMap, roadmap: Roadmap, need: float) -> float:
    """Length (m) of the frontier that was tried in vain though a robot that needs so much room (m) to every side could
    drive up to it and through.

    What it only ever saw through a crack does not keep the mission from being complete.
    """
    places = roadmap.points[roadmap.enterable]
    before = tfg.given_up + (PUSH + ROOT) * tfg.given_up_normal
    if not len(places) or not len(before):
        return 0.0
    near = cKDTree(places).query_ball_point(before, AT_HAND)
    point = np.repeat(np.arange(len(before)), [len(rows) for rows in near])
    ways = np.hstack([places[np.concatenate([np.array(rows, dtype=np.int64) for rows in near])], before[point]])
    reached = np.unique(point[clearance(ways, tfg.segments, need) >= need])
    through = np.hstack([before, tfg.given_up])[reached]
    return float(tfg.given_up_length[reached[clearance(through, tfg.segments, need) >= need]].sum())


def seen_length(points: FloatArray, frontiers: View, tfg: TfgMap, sensor: TagSensorConfig) -> FloatArray:
    """Length (c,), m, of the live frontier that each of the points (c, 2), m in M, sees, less where the view ends soon
    behind it."""
    point = np.repeat(np.arange(len(points)), frontiers.count)
    distance = np.hypot(*(tfg.frontiers[frontiers.index] - points[point]).T)
    length = tfg.frontier_length[frontiers.index] * share_seen(distance, frontier_reach(sensor))
    return np.asarray(np.bincount(point, length, minlength=len(points)), dtype=np.float64)


def pick(gain: FloatArray, value: FloatArray, sees_frontier: BoolArray, stop_gain: float) -> int:
    """The candidate (c,) of most value, the first of equals, among those worth going to; -1 if none is."""
    worth = sees_frontier | (gain > stop_gain)
    return int(np.argmax(np.where(worth, value, -np.inf))) if worth.any() else -1


def why_end(
    candidates: bool,
    barred_gain: float,
    given_up_length: float,
    frontier_length: float,
    cut_off: bool,
    stop_gain: float,
) -> tuple[str, str]:
    """Verdict and reason where no candidate is worth going to.

    candidates: there are any. barred_gain: nats that a place promises that has room for the robot but that it may not
    try to reach. given_up_length: m of open frontier that was tried too often. frontier_length: m of live frontier,
    seen or not: what remains when nothing else does is closed to this robot. cut_off: the robot cannot get back to
    where it began.
    """
    if not candidates:
        return "stuck", "The robot cannot reach any other place."
    if cut_off and frontier_length >= ENOUGH_FRONTIER:
        left = f"{frontier_length:.1f} m of frontier are left"
        return "stuck", f"The robot cannot get back to where it began, and {left}."
    if barred_gain > stop_gain:
        return "stuck", f"{barred_gain:.1f} nats lie behind a passage too narrow for the uncertainty of the map."
    if given_up_length > 0.0:
        return "stuck", f"{given_up_length:.1f} m of open frontier were tried again and again in vain."
    but = f" but {frontier_length:.1f} m out of reach or not worth it," if frontier_length > 0.0 else ""
    return "complete", f"No frontier is left{but} and no place promises more than {stop_gain:g} nats."
