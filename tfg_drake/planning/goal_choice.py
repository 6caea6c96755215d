"""Chooses the next goal among the candidates by the rule `explorer.goal`, or ends the mission."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from tfg_drake.config import NODE_MARGIN, ExplorerConfig, RobotConfig
from tfg_drake.messages import BoolArray, FloatArray, GoalChoice, IntArray, Roadmap, TfgMap, replace
from tfg_drake.planning.budget import Budget, budget_left, way_home
from tfg_drake.planning.candidates import (
    Candidates,
    Situation,
    frontier_in_sight,
    judged,
    places,
    time_all_round,
    time_at_goal,
    time_to_go_on,
    turn_gains,
)
from tfg_drake.planning.errands import doubtful_tags, narrow_places
from tfg_drake.planning.goal_rules import AS_GOOD_AS_ALL, gain_per_time, nearest_frontier, stops, tour
from tfg_drake.planning.information_gain import Gains
from tfg_drake.planning.mission_end import ENOUGH_FRONTIER, frontier_left, given_up_open, why_end
from tfg_drake.planning.revisit import worth_revisiting
from tfg_drake.planning.which_place import LEAST_TOLD, place_information
from tfg_drake.table import empty

# A mission ends after this many sensor ranges of way without a landmark or a surface: there is no building.
NOTHING_WITHIN = 5.0
# Greatest factor on the turns of the first look, if the noise of tags is correlated from frame to frame.
MOST_FIRST_TURNS = 2.0
# An empty set of node ids.
NOWHERE = np.zeros(0, dtype=np.int64)


def empty_choice() -> GoalChoice:
    """Return the state before the first choice."""
    return empty(GoalChoice, node=-1, verdict="goal")


def choose(now: Situation, previous: GoalChoice, *, recalled: bool = False, kept: float = 1.0) -> GoalChoice:
    """Return the choice at one stage; previous is the choice before it. recalled: the robot was called back, so that no
    goal but home is worth a visit. kept: see `promises.Promise`.

    If the tags' errors are correlated, the robot first makes `more_first_turns`. A candidate is worth a visit if it
    sees enough live frontier, or has a gain above explorer.stop_gain. If none sees enough, the robot looks again where
    the accuracy of the map gains most (`tfg_drake.planning.revisit`); on a large map it first looks around once, and
    the choice's `is_explored` makes landmarks all over it jointly known. If none is worth a visit, the remaining
    errands are done (`tfg_drake.planning.errands`).
    """
    estimate, roadmap, explorer, sensor = now.estimate, now.roadmap, now.parameters.explorer, now.parameters.sensor
    is_empty = len(estimate.ids) == 0 and len(now.tfg.segments) == 0
    if is_empty and roadmap.driven >= NOTHING_WITHIN * sensor.range:
        reason = f"Neither a landmark nor a surface was seen on {roadmap.driven:.0f} m of way: there is nothing to map."
        return _choice(now, *_homewards(now, "stuck", reason, previous.looked_again))
    if estimate.stage <= more_first_turns(estimate.frame_worth, explorer) and not recalled:
        reason = "The tags' errors go on from frame to frame: it turns once more before it drives."
        return _choice(now, -1, "look", reason)
    open_left = frontier_in_sight(roadmap, now.tfg, sensor)
    looks_again = explorer.revisit and explorer.goal == "tour" and not recalled
    if looks_again and not open_left:
        again = _second_look(now, previous, kept)
        if again is not None:
            return again
    ranked = _ranked(now, previous, recalled=recalled)
    if ranked.best >= 0:
        return _to_the_best(now, ranked, previous, open_left=open_left)
    explored, looked = _explored(now, previous, open_left=open_left), previous.looked_again
    if ranked.any_worth:
        node, verdict, reason = -1, "budget", ranked.budget.spent()
    else:
        node, verdict, reason, looked = _last(now, bool(len(ranked.candidates.nodes)), ranked.budget, looked)
        explored = min(previous.explored, estimate.stamp) if verdict == "complete" else math.inf
        if verdict == "complete" and looks_again and open_left and now.is_large:
            again = _second_look(now, previous, kept)
            if again is not None:
                return again
    if verdict != "goal":
        node, verdict, reason, looked = _homewards(now, verdict, reason, looked)
    return _among(_choice(now, node, verdict, reason, looked, explored, ranked.budget), now, ranked)


def choose_near(now: Situation, previous: GoalChoice, radius: float, *, recalled: bool = False) -> GoalChoice | None:
    """Return the choice among goals near the robot on a large map, by a way within a radius (m), or none.

    There is none if nothing near is worth a visit, if the way is longer than that to a possible goal elsewhere, or
    while the robot is on such a long way, when all candidates are compared with its goal. Other arguments as of
    `choose`.
    """
    if previous.node >= 0 and not now.roadmap.reaches(np.array([previous.node]), radius)[0]:
        return None
    ranked = _ranked(now, previous, recalled=recalled)
    if ranked.best < 0 or now.roadmap.travel_length[ranked.candidates.nodes[ranked.best]] > radius:
        return None
    open_left = frontier_in_sight(now.roadmap, now.tfg, now.parameters.sensor)
    return _to_the_best(now, ranked, previous, open_left=open_left)


@dataclasses.dataclass(frozen=True)
class _Ranked:
    """The candidates with their values (c,), and the best of them, -1 if none may be chosen; look: (f,) mask of the
    live frontier points to look at from there. any_worth: some are worth a visit, within the budget or not.
    """

    candidates: Candidates
    budget: Budget
    value: FloatArray
    best: int
    look: BoolArray
    any_worth: bool


def _ranked(now: Situation, previous: GoalChoice, *, recalled: bool) -> _Ranked:
    """Return the candidates ranked by the rule explorer.goal. Arguments as of `choose`."""
    estimate, tfg, roadmap, parameters = now.estimate, now.tfg, now.roadmap, now.parameters
    explorer, stay = parameters.explorer, time_at_goal(parameters.sensor, parameters.explorer)
    budget = budget_left(explorer, estimate.stamp, roadmap.driven, stay, recalled=recalled)
    candidates = judged(now)
    affordable = budget.affords(roadmap, candidates.nodes)
    worth = candidates.worth(explorer.stop_gain, _in_question(candidates, affordable, explorer))
    # As long as any place is worth going to, every place will do for a goal drawn at random.
    anywhere = explorer.goal == "random" and bool(worth.any())
    open_to = preferred(affordable if anywhere else worth & affordable, candidates.tags, explorer.least_tags)
    telling = np.zeros(len(open_to))
    telling[open_to] = place_information(candidates.points[open_to], now.hypotheses, parameters.scan_range)
    value, look = _values(candidates, stay, open_to, tfg, roadmap, parameters.robot, explorer)
    if anywhere:
        value = np.random.default_rng((parameters.seed, estimate.stage)).random(len(candidates.nodes))
        # It goes all the way there: what it comes to is no candidate any more.
        value[candidates.node_ids == previous.node] = 1.0
    if (telling > LEAST_TOLD).any():
        value, look = telling / (candidates.time + stay), np.ones(len(tfg.frontiers), dtype=np.bool_)
    best = pick(value, open_to, candidates.time)
    if explorer.goal == "tour" and best >= 0 and now.is_large:
        nearer = _nearer_before(best, candidates, open_to, previous)
        if nearer >= 0:
            best, look = nearer, candidates.open_ahead[nearer] > 0.0
    return _Ranked(candidates, budget, value, best, look, bool(worth.any()))


def _to_the_best(now: Situation, ranked: _Ranked, previous: GoalChoice, *, open_left: bool) -> GoalChoice:
    """Return the choice of the best candidate. open_left: places see enough live frontier."""
    best, candidates = ranked.best, ranked.candidates
    gain = candidates.gains.gain[best]
    rate = gain / (candidates.time[best] + ranked.budget.stay)
    reason = f"{gain:.1f} nats are expected at the rate of {rate:.2f} nats per second."
    explored = _explored(now, previous, open_left=open_left)
    node, looked = int(candidates.nodes[best]), previous.looked_again
    return _among(_choice(now, node, "goal", reason, looked, explored, ranked.budget), now, ranked)


def _explored(now: Situation, previous: GoalChoice, *, open_left: bool) -> float:
    """Return since when nothing has been left to explore, s. On a large map this is not checked again if only nats
    attract the robot."""
    return previous.explored if now.is_large and not open_left else math.inf


def _choice(
    now: Situation,
    node: int,
    verdict: str,
    reason: str,
    looked: IntArray = NOWHERE,
    explored: float = math.inf,
    budget: Budget | None = None,
) -> GoalChoice:
    """Return the choice of a node of the roadmap, -1 for none, without candidates. looked: (t,) node ids, see `_last`.
    budget: within which a goal must be reached."""
    choice = replace(
        empty_choice(),
        stage=now.estimate.stage,
        verdict=verdict,
        reason=reason,
        looked_again=looked,
        explored=explored,
    )
    if node < 0:
        return choice
    choice = replace(choice, node=int(now.roadmap.node_ids(np.array([node]))[0]), p_MG=now.roadmap.points[node])
    if verdict != "goal" or budget is None:
        return choice
    latest, longest = budget.latest_arrival(now.roadmap, node), budget.longest_way(now.roadmap, node)
    return replace(choice, latest_arrival=latest, longest_way=longest)


def _of_candidates(choice: GoalChoice, node_ids: IntArray, gains: Gains, value: FloatArray) -> GoalChoice:
    """Return the choice as one of candidates with these ids, gains and values, all (c,)."""
    return replace(choice, candidates=node_ids, **vars(gains), gain=gains.gain, value=value)


def _among(choice: GoalChoice, now: Situation, ranked: _Ranked) -> GoalChoice:
    """Return the choice as one among ranked candidates, with the directions to look in and the tour that it begins."""
    candidates, best = ranked.candidates, ranked.best
    choice = _of_candidates(choice, candidates.node_ids, candidates.gains, ranked.value)
    if best < 0:
        return choice
    d = now.tfg.frontiers[_seen(candidates.open_ahead[best], ranked.look)] - choice.p_MG
    is_tour = now.parameters.explorer.goal == "tour"
    return replace(
        choice,
        look=np.arctan2(d[:, 1], d[:, 0]),
        tour=candidates.node_ids[stops(ranked.value, best)] if is_tour else choice.tour,
    )


def _nearer_before(best: int, candidates: Candidates, open_to: BoolArray, previous: GoalChoice) -> int:
    """Return the candidate that was the previous goal if it is nearer than the best and still open; otherwise -1.

    On a large map only the part nearby is considered: far frontier that enters it, and would be the end of the tour,
    must not turn the robot around before the nearer goals are done.
    """
    before = np.flatnonzero((candidates.node_ids == previous.node) & open_to & candidates.sees_enough)
    return int(before[0]) if len(before) and candidates.time[before[0]] < candidates.time[best] else -1


def more_first_turns(frame_worth: float, explorer: ExplorerConfig) -> int:
    """Return the number of further turns at the start of the mission: the accuracy of the initial heading grows with
    the root of a frame's worth, and everything mapped later inherits its error."""
    return round(explorer.first_turns * (min(1.0 / math.sqrt(frame_worth), MOST_FIRST_TURNS) - 1.0))


def _homewards(now: Situation, verdict: str, reason: str, looked: IntArray) -> tuple[int, str, str, IntArray]:
    """Return the end of a mission with this verdict and reason, at home if required: the node, -1 for the current
    place; verdict and reason; and the node ids (t,), see `_last`.

    If the way home is too narrow, the robot looks at it again from as near as possible; if that does not help, it is
    stuck.
    """
    estimate, roadmap = now.estimate, now.roadmap
    returns = now.parameters.explorer.return_home
    home = way_home(roadmap, estimate.X_MA[0, :2], estimate.X_MD[:2]) if returns else -1
    if home < 0 or roadmap.reachable[home]:
        return home, verdict, reason, looked
    before = int(roadmap.entry[home])
    name = roadmap.node_ids(np.array([before]))
    if before >= 0 and not np.isin(name, looked).any():
        return before, "goal", "The way home is too narrow: it looks once more.", np.union1d(looked, name)
    return -1, "stuck", f"{reason} But the robot cannot get back to where it began.", looked


def _second_look(now: Situation, previous: GoalChoice, kept: float) -> GoalChoice | None:
    """Return the choice of a second look if no place sees enough live frontier but the map can become more accurate;
    otherwise none. On a large map the robot first looks around where it stands, to know the gains of all places.

    The chosen place is the only candidate, as the choice does not depend on nats.
    """
    estimate, roadmap = now.estimate, now.roadmap
    sensor, explorer = now.parameters.sensor, now.parameters.explorer
    budget = budget_left(explorer, estimate.stamp, roadmap.driven, time_all_round(sensor, explorer))
    explored = min(previous.explored, estimate.stamp)
    nodes = places(roadmap, now.tfg, estimate.X_MD[:2])
    affordable = budget.affords(roadmap, nodes)
    looked = previous.looked_again
    if now.is_large and not previous.is_explored:
        if not affordable.any():
            return None
        reason = "All is explored: it looks round once while it works out where the map can grow more accurate."
        return _choice(now, -1, "look", reason, looked, explored)
    value = kept * worth_revisiting(nodes, now) * affordable
    best = pick(value, value > 1.0, roadmap.travel_time[nodes])
    if best < 0:
        return None
    reason = "All is explored, but the map grows more accurate yet: it looks round once more."
    choice = _choice(now, int(nodes[best]), "goal", reason, looked, explored, budget)
    asked = nodes[[best]]
    return _of_candidates(choice, roadmap.node_ids(asked), turn_gains(asked, now), value[[best]])


def _last(now: Situation, any_left: bool, budget: Budget, looked: IntArray) -> tuple[int, str, str, IntArray]:
    """Return the choice if no candidate is worth a visit: the node of an errand, -1 if the mission ends; verdict and
    reason; and the ids (t,) of nodes from which the robot has looked again.

    any_left: there are candidates. looked: (s,) node ids so far.
    """
    estimate, roadmap, stop_gain = now.estimate, now.roadmap, now.parameters.explorer.stop_gain
    narrow = narrow_places(now, budget.stay)
    for errands in (narrow, doubtful_tags(now)):
        looked = errands.looked_from(roadmap, estimate.X_MD[:2], looked)
        left = errands.left(roadmap, looked)
        best = pick(errands.worth, left & budget.affords(roadmap, errands.at), roadmap.travel_time[errands.at])
        if best >= 0:
            return int(errands.at[best]), "goal", errands.reasons[best], looked
        if errands.gain[left].any():
            return -1, "budget", budget.spent(), looked
    verdict, reason = why_end(
        any_left or len(now.tfg.keep_out) > 0,
        float(narrow.gain.max(initial=0.0)),
        given_up_open(now.tfg, roadmap, now.parameters.robot.radius + NODE_MARGIN),
        frontier_left(now.tfg, roadmap, now.parameters.sensor, now.parameters.robot.radius),
        stop_gain,
    )
    return -1, verdict, reason, looked


def _seen(open_ahead: FloatArray, look: BoolArray) -> IntArray:
    """Return the frontier points that a place sees, by lengths (f,); only those to look at (f,) if it sees any of
    them."""
    seen = np.flatnonzero(open_ahead > 0.0)
    return seen[look[seen]] if look[seen].any() else seen


def _in_question(candidates: Candidates, affordable: BoolArray, explorer: ExplorerConfig) -> BoolArray:
    """Return a mask of the candidates (c,) whose gain alone may make them worth a visit.

    While places see enough live frontier, a tour visits only these, or others that see nearly the same frontier.
    """
    if explorer.goal != "tour" or explorer.least_tags or not (candidates.sees_enough & affordable).any():
        return np.ones(len(candidates.nodes), dtype=np.bool_)
    return np.asarray(candidates.open_ahead.sum(axis=1) >= AS_GOOD_AS_ALL * ENOUGH_FRONTIER)


def _values(
    candidates: Candidates,
    stay: float,
    open_to: BoolArray,
    tfg: TfgMap,
    roadmap: Roadmap,
    robot: RobotConfig,
    explorer: ExplorerConfig,
) -> tuple[FloatArray, BoolArray]:
    """Return the value of each of the candidates (c,) by the rule explorer.goal, and a mask of the live frontier points
    (f,) to look at from the best.

    stay: s at each. open_to: (c,) those that may be chosen.
    """
    paid, time, open_ahead = candidates.paid, candidates.time, candidates.open_ahead
    all_of_it = np.ones(len(tfg.frontiers), dtype=np.bool_)
    if explorer.goal == "nearest_frontier":
        apart = np.hypot(*(candidates.points[:, None] - tfg.frontiers[None]).transpose(2, 0, 1))
        asked = (open_ahead > 0.0) & (open_to & candidates.sees_enough)[:, None]
        return nearest_frontier(time, np.where(asked, apart, np.inf)), all_of_it
    if explorer.goal == "tour":
        ahead = np.where(open_to[:, None], open_ahead, 0.0)
        stop = stay + time_to_go_on(robot)
        return tour(paid, time, stop, ahead, ENOUGH_FRONTIER, candidates.nodes, roadmap, robot.max_speed)
    spent = np.ones(len(time)) if explorer.goal == "argmax" else time + stay
    return gain_per_time(paid, spent), all_of_it


def preferred(open_to: BoolArray, tags: IntArray, least_tags: int) -> BoolArray:
    """Return those of the candidates open to choice (c,) that see least_tags known tags, all if none does.

    tags: (c,) number of known tags in view, -1 if unknown.
    """
    sees_enough = open_to & ((tags < 0) | (tags >= least_tags))
    return sees_enough if sees_enough.any() else open_to


def pick(value: FloatArray, worth: BoolArray, time: FloatArray) -> int:
    """Return the candidate of most value (c,), among equals the one reached soonest (c,), s, of those worth a visit
    (c,); -1 if there is none."""
    most = value[worth].max(initial=-np.inf)
    equals = worth & (value == most)
    return int(np.argmin(np.where(equals, time, np.inf))) if equals.any() else -1
