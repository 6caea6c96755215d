"""Where to go next: the candidate with the most expected information per expected time, or by another rule."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.config import NODE_MARGIN, ExplorerConfig, OdometryConfig, RobotConfig, TagSensorConfig
from tfg_drake.cpu_meter import metered
from tfg_drake.messages import BoolArray, FloatArray, GoalChoice, IntArray, MapEstimate, Roadmap, TfgMap, replace
from tfg_drake.planning.budget import budget_left, way_home
from tfg_drake.planning.exact_gain import share_seen
from tfg_drake.planning.expected_view import View, expected_frontiers, expected_tags, local_view
from tfg_drake.planning.goal_rules import gain_per_time, nearest_frontier, tour
from tfg_drake.planning.information_gain import Gains, frontier_reach, information_gain
from tfg_drake.planning.mission_end import ENOUGH_FRONTIER, barred_places, given_up_open, why_end
from tfg_drake.tfg.drift import known_jointly
from tfg_drake.tfg.star_polygon import looked_round

# Time lost at a goal besides the turn itself: settling, solving, planning, s.
OVERHEAD = 1.0
# After this many goals without a landmark or a surface there is no building here.
NOTHING_AFTER = 5
# The robot never turns again within this of where it has turned before, m: it would see the same once more.
APART = 0.3
# Nor where it has looked so often, whichever way: what is still open there does not show from there.
MOST_LOOKS = 6
# Candidates are screened by so many of the tags in view, and so many of the best, by each of two rules, judged by all.
SCREENING_TAGS = 32
EXACT = 60
# A place is judged anew where all landmarks that it sees within this share of the sensor's range are known jointly.
KNOWN_REACH = 0.5


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


def apart_from_goals(points: FloatArray, tfg: TfgMap, p_MD: FloatArray) -> BoolArray:
    """Which of the points (n, 2), m in M, are neither a place where the robot has looked all round or MOST_LOOKS times
    nor its own (2,)."""
    turned = looked_round(tfg.star_offsets, tfg.star_vertices, tfg.star_centers)
    distance, _ = cKDTree(np.vstack([tfg.star_centers[turned], p_MD])).query(points, distance_upper_bound=APART)
    if len(tfg.star_centers) < MOST_LOOKS:
        return np.asarray(np.isinf(distance))
    last, _ = cKDTree(tfg.star_centers).query(points, k=[MOST_LOOKS], distance_upper_bound=APART)
    return np.asarray(np.isinf(distance) & np.isinf(last[:, 0]))


def sees_known_jointly(points: FloatArray, estimate: MapEstimate, tfg: TfgMap, sensor: TagSensorConfig) -> BoolArray:
    """Whether what each of the points (n, 2), m in M, sees within KNOWN_REACH is known jointly with the departure pose,
    (n,). Behind walls it need not be, but beyond the sensor's range from that pose nothing else is asked."""
    reach = KNOWN_REACH * sensor.range
    known = known_jointly(points, estimate, reach)
    ask = np.flatnonzero(~known & (np.hypot(*(points - estimate.X_MD[:2]).T) < sensor.range))
    view = expected_tags(points[ask], estimate, tfg, dataclasses.replace(sensor, range=reach))
    known[ask] = local_view(view, estimate).count == view.count
    return known


@metered("goal")
def choose(
    estimate: MapEstimate,
    tfg: TfgMap,
    roadmap: Roadmap,
    sensor: TagSensorConfig,
    odometry: OdometryConfig,
    robot: RobotConfig,
    explorer: ExplorerConfig,
    previous: GoalChoice,
    seed: int = 0,
) -> GoalChoice:
    """The choice at one stage: estimate, tfg and roadmap are of the same stage, previous is the choice before. seed: of
    the rule that goes anywhere.

    Candidates are the roadmap's reachable nodes, but for those next to past goals. Worth going to is what sees enough
    live frontier, whatever its gain, and what promises more than explorer.stop_gain. On a large map, a place where the
    landmarks are not known jointly with the robot's pose promises what it did when they last were (see `remember`):
    nothing has changed there since. Candidates that come nowhere near the best promise what SCREENING_TAGS of their
    tags do, a little less than they would, as long as any sees frontier: before the mission ends, all are judged in
    full.
    """
    if estimate.stage >= NOTHING_AFTER and len(estimate.ids) == 0 and len(tfg.segments) == 0:
        reason = f"Neither a landmark nor a surface was seen from {estimate.stage} goals: there is nothing to map."
        return replace(empty_choice(), stage=estimate.stage, verdict="stuck", reason=reason)
    nodes = np.flatnonzero(roadmap.reachable & apart_from_goals(roadmap.points, tfg, estimate.X_MD[:2]))
    sees = View(roadmap.frontier_offsets, roadmap.frontier_index)
    here = sees_known_jointly(roadmap.points[nodes], estimate, tfg, sensor)
    kept = ~here & np.isin(roadmap.names(nodes), previous.candidates)
    # Far away, where nothing was worth remembering, only what sees frontier is asked.
    ask = ~kept & (here | (sees.count[nodes] > 0))
    asked = thin_candidates(nodes[ask], sees.count[nodes[ask]], explorer.samples)
    candidates = np.union1d(asked, nodes[kept])
    ask = np.isin(candidates, asked)

    def expected(points: FloatArray, time: FloatArray, tags: View, frontiers: View) -> Gains:
        distance = robot.max_speed * time
        return information_gain(points, distance, time, tags, frontiers, estimate, tfg, sensor, odometry, explorer)

    def expected_of(rows: IntArray, tags: View) -> Gains:
        nodes = asked[rows]
        return expected(roadmap.points[nodes], roadmap.travel_time[nodes], tags, sees.of(nodes))

    points, time = roadmap.points[candidates], roadmap.travel_time[candidates]
    # The robot arrives facing some of what it came for, and turns half round for the rest, on average.
    stay = 0.5 * max(0.0, 2.0 * math.pi - sensor.field_of_view) / explorer.turn_rate + OVERHEAD
    open_ahead = frontier_seen(points, sees.of(candidates), tfg, sensor)
    enough = open_ahead.sum(axis=1) >= ENOUGH_FRONTIER
    tags = expected_tags(points[ask], estimate, tfg, sensor)
    if explorer.gain == "exact" and len(asked) > 2 * EXACT and enough[ask].any():
        now = _screened(expected_of, tags, time[ask] + stay)
    else:
        now = expected_of(np.arange(len(asked)), tags)
    now = _found_again(now, here[np.isin(nodes, asked)])
    gains = _filled(previous, roadmap.names(candidates), ask, now, enough)
    known = np.full(len(candidates), explorer.least_tags)
    known[ask] = tags.count

    budget = budget_left(explorer, estimate.stamp, roadmap.driven, stay)
    worth = enough | (gains.gain > explorer.stop_gain)
    affordable = budget.affords(roadmap, candidates)
    open_to = worth & affordable
    value, look = _values(gains, time, stay, open_ahead, open_to, candidates, tfg, roadmap, robot, explorer)
    if explorer.goal == "random" and worth.any():
        # As long as any place is worth going to, every place will do.
        open_to, value = affordable, np.random.default_rng((seed, estimate.stage)).random(len(candidates))
        # It goes all the way there: what it comes to is no candidate any more.
        value[roadmap.names(candidates) == previous.node] = 1.0
    best = pick(value, open_to, known >= explorer.least_tags)
    if explorer.goal == "tour" and best >= 0 and len(estimate.local) < len(estimate.ids):
        before = np.flatnonzero((roadmap.names(candidates) == previous.node) & open_to & enough)
        # Of a large map only what is near is in sight: what comes into it far away, and would be the end of the tour,
        # must not turn the robot round before it is done with what is nearer.
        if len(before) and time[before[0]] < time[best]:
            best = int(before[0])
            look = open_ahead[best] > 0.0
    if best >= 0:
        node, p_MG, verdict = int(candidates[best]), points[best], "goal"
        rate = gains.gain[best] / (time[best] + stay)
        reason = f"{gains.gain[best]:.1f} nats are expected at the rate of {rate:.2f} nats per second."
    else:
        if worth.any():
            verdict, reason = "budget", f"{budget} of the budget are left: too little for another goal."
        else:
            barred, barred_time = barred_places(roadmap, robot.max_speed)
            views = expected_tags(barred, estimate, tfg, sensor), expected_frontiers(barred, tfg, sensor)
            _, home = cKDTree(roadmap.points).query(estimate.X_MA[0, :2])
            verdict, reason = why_end(
                bool(len(candidates)),
                float(expected(barred, barred_time, *views).gain.max(initial=0.0)),
                given_up_open(tfg, roadmap, robot.radius + NODE_MARGIN),
                float(tfg.frontier_length.sum()),
                not roadmap.reachable[home],
                explorer.stop_gain,
            )
        node = way_home(roadmap, estimate.X_MA[0, :2], estimate.X_MD[:2]) if explorer.return_home else -1
        p_MG = roadmap.points[node] if node >= 0 else np.zeros(2)
    return GoalChoice(
        stage=estimate.stage,
        node=int(roadmap.names(np.array([node]))[0]) if node >= 0 else -1,
        p_MG=p_MG,
        candidates=roadmap.names(candidates),
        exploitation=gains.exploitation,
        exploration=gains.exploration,
        pose_price=gains.pose_price,
        gain=gains.gain,
        value=value,
        verdict=verdict,
        reason=reason,
        latest_arrival=budget.latest_arrival(roadmap, node) if verdict == "goal" else math.inf,
        look=_directions(tfg.frontiers[_seen(sees, candidates[best], look)] - p_MG) if best >= 0 else np.zeros(0),
    )


def remember(before: GoalChoice, choice: GoalChoice, roadmap: Roadmap, stop_gain: float) -> GoalChoice:
    """The choice, with those candidates of the ones before it that were out of its reach, by its roadmap, and that
    promised more than stop_gain, nats."""
    old = (
        (before.gain > stop_gain) & ~roadmap.reaches(before.candidates) & ~np.isin(before.candidates, choice.candidates)
    )
    names = np.append(before.candidates[old], choice.candidates)
    order = np.argsort(names)

    def both(then: FloatArray, now: FloatArray) -> FloatArray:
        return np.append(then[old], now)[order]

    return replace(
        choice,
        candidates=names[order],
        exploitation=both(before.exploitation, choice.exploitation),
        exploration=both(before.exploration, choice.exploration),
        pose_price=both(before.pose_price, choice.pose_price),
        gain=both(before.gain, choice.gain),
        value=both(before.value, choice.value),
    )


def _seen(sees: View, node: int, look: BoolArray) -> IntArray:
    """The frontier points that a node sees, of these only those to look at (f,) if it sees any of them."""
    seen = sees.of(np.array([node])).index
    return seen[look[seen]] if look[seen].any() else seen


def _directions(d: FloatArray) -> FloatArray:
    """Headings (n,), rad, of displacements (n, 2), m."""
    return np.arctan2(d[:, 1], d[:, 0])


def _screened(expected: Callable[[IntArray, View], Gains], tags: View, time: FloatArray) -> Gains:
    """The gains of candidates by SCREENING_TAGS of the tags they see, those of the best by all.

    expected: the gains of some rows of them that see these tags. time: (c,) s that each takes.
    """
    gains = expected(np.arange(len(time)), tags.thinned(SCREENING_TAGS))
    best = _best(gains, time)
    return _replaced(gains, best, expected(best, tags.of(best)))


def _values(
    gains: Gains,
    time: FloatArray,
    stay: float,
    open_ahead: FloatArray,
    open_to: BoolArray,
    candidates: IntArray,
    tfg: TfgMap,
    roadmap: Roadmap,
    robot: RobotConfig,
    explorer: ExplorerConfig,
) -> tuple[FloatArray, BoolArray]:
    """What each of the candidates (c,) is worth by the rule explorer.goal, and which of the live frontier points (f,)
    are to be looked at from the best.

    time: (c,) s to get there, stay: s at each. open_ahead: (c, f) m that each sees of each live frontier point.
    open_to: (c,) those that may be chosen.
    """
    all_of_it = np.ones(len(tfg.frontiers), dtype=np.bool_)
    paid = gains.gain if explorer.pose_price else gains.gain + gains.pose_price
    if explorer.goal == "argmax":
        return paid, all_of_it
    if explorer.goal == "nearest_frontier":
        apart = np.hypot(*(roadmap.points[candidates][:, None] - tfg.frontiers[None]).transpose(2, 0, 1))
        enough = open_to & (open_ahead.sum(axis=1) >= ENOUGH_FRONTIER)
        return nearest_frontier(time, np.where((open_ahead > 0.0) & enough[:, None], apart, np.inf)), all_of_it
    if explorer.goal == "tour":
        ahead = np.where(open_to[:, None], open_ahead, 0.0)
        return tour(paid, time, stay, ahead, ENOUGH_FRONTIER, candidates, roadmap, robot.max_speed)
    return gain_per_time(paid, time + stay), all_of_it


def _best(gains: Gains, time: FloatArray) -> IntArray:
    """The rows, ascending, of the EXACT candidates of most gain per time (c,), s, and of as many of most gain."""
    return np.union1d(np.argsort(-gains.gain / time)[:EXACT], np.argsort(-gains.gain - gains.pose_price)[:EXACT])


def _replaced(gains: Gains, rows: IntArray, exact: Gains) -> Gains:
    """The gains (c,) with those of some rows (r,) put in the place of what they were."""

    def put(all_of: FloatArray, some: FloatArray) -> FloatArray:
        result = all_of.copy()
        result[rows] = some
        return result

    return Gains(
        exploitation=put(gains.exploitation, exact.exploitation),
        exploration=put(gains.exploration, exact.exploration),
        pose_price=put(gains.pose_price, exact.pose_price),
    )


def _found_again(gains: Gains, known: BoolArray) -> Gains:
    """The gains (c,) without the pose's price where the landmarks are not known (c,) jointly with the pose here: on its
    way there the robot will find its place by what it sees, not by odometry from here."""
    price = np.where(known, 0.0, gains.pose_price)
    return Gains(gains.exploitation, gains.exploration + price, gains.pose_price - price)


def _filled(
    previous: GoalChoice, candidates: IntArray, asked: BoolArray, gains: Gains, sees_frontier: BoolArray
) -> Gains:
    """The gains of all candidates (c,), by name: those of the ones asked for (c,) now, of the others as they were
    before, but for what they promised of a frontier that they do not see (c,) any more."""
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


def frontier_seen(points: FloatArray, frontiers: View, tfg: TfgMap, sensor: TagSensorConfig) -> FloatArray:
    """Length (c, f), m, that each of the points (c, 2), m in M, sees of each live frontier point, less where the view
    ends soon behind it."""
    point = np.repeat(np.arange(len(points)), frontiers.count)
    distance = np.hypot(*(tfg.frontiers[frontiers.index] - points[point]).T)
    length = np.zeros((len(points), len(tfg.frontiers)))
    length[point, frontiers.index] = tfg.frontier_length[frontiers.index] * share_seen(distance, frontier_reach(sensor))
    return length


def pick(value: FloatArray, worth: BoolArray, preferred: BoolArray) -> int:
    """The candidate (c,) of most value, the first of equals, among those worth going to (c,), if possible a preferred
    one (c,); -1 if none is worth it."""
    among = worth & preferred if (worth & preferred).any() else worth
    among = among & (value > -np.inf) if (among & (value > -np.inf)).any() else among
    return int(np.argmax(np.where(among, value, -np.inf))) if among.any() else -1
