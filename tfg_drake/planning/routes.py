"""The cheapest ways through a roadmap, with their travel times and risks."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from numba import njit
from scipy.sparse import csr_array

from tfg_drake.config import NODE_MARGIN, RobotConfig
from tfg_drake.geometry.distance import clearance
from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.messages import BoolArray, FloatArray, IntArray, Roadmap, TfgMap
from tfg_drake.planning.chance_constraint import TRACKING_DEVIATION, collision_probability, required_clearance
from tfg_drake.planning.parameters import COMFORT, PlanningParameters
from tfg_drake.planning.pure_pursuit import PLANNED_SHARE, TURN_ABOVE
from tfg_drake.planning.roadmap import (
    ACCEPTED,
    EDGE_LENGTH,
    NEIGHBOURS,
    RETURN_OFF,
    TIGHT,
    RoadmapState,
    components,
    in_free_space,
    room_needed,
)
from tfg_drake.planning.shortest_ways import Ways, joined, shortest_ways

# Length after which the robot's deviation from its path is independent, m.
INDEPENDENT = 0.5
# Detour, m, that is preferred to the whole risk of a path; the second value if too few places are reachable with the
# first.
RISK_LENGTHS = (20.0, 2000.0)


@dataclasses.dataclass(frozen=True)
class Routes:
    """Cheapest ways from the robot to all nodes of a roadmap.

    cost: (n,) m weighted by clearance, inf if unreachable. predecessor: (n,) node before each, n for the robot itself,
    -1 if unreachable. length: (n,) m. time: (n,) expected travel time, s, turns included.
    """

    cost: FloatArray
    predecessor: IntArray
    length: FloatArray
    time: FloatArray


def routes(
    state: RoadmapState,
    tfg: TfgMap,
    X_MB: FloatArray,
    parameters: PlanningParameters,
    obstacles: FloatArray | None = None,
) -> Routes:
    """Return the cheapest ways from the robot's pose X_MB (3,) to every node.

    With planner.risk "path" risk also adds to the cost, with the weight that reaches most nodes, and nodes not reached
    within planner.collision_probability count as unreachable; ways kept open although too narrow are exempt. obstacles:
    (b, 4) segments met at this stage that the map does not hold, m in M. A robot that stands too near a surface may
    still leave if it hardly comes nearer, or by the way with the most room if there is no other.
    """
    n = len(state.points)
    if n == 0:
        none = np.zeros(0)
        return Routes(none, np.zeros(0, dtype=np.int64), none, none)
    edges, robot, planner, cost = state.edges, parameters.robot, parameters.planner, parameters.cost
    has, is_open = edges.clearance, edges.usable
    if obstacles is not None and len(obstacles):
        room = np.full(len(edges), np.inf)
        room[is_open] = clearance(state.points[edges.nodes[is_open]].reshape(-1, 4), obstacles, COMFORT)
        has, is_open = np.minimum(has, room), is_open & (room >= robot.radius + RETURN_OFF)
    length = edge_lengths(state.points, edges.nodes)
    at_ease = required_clearance(robot.radius, state.sigma, planner.collision_probability)[edges.nodes].max(axis=1)
    lacks = np.maximum(0.0, at_ease - edges.clearance)
    weight = np.where(is_open, cost(length, has) + TIGHT * np.ceil(lacks / NODE_MARGIN), np.inf)
    leads = np.zeros(n, dtype=np.bool_)
    leads[edges.nodes[is_open]] = True
    links, links_has = _connect(state, tfg, X_MB, robot, obstacles, leads)
    links_length = np.hypot(*(state.points[links] - X_MB[:2]).T)
    links_weight = cost(links_length, links_has)
    if planner.risk == "path":
        sigma = np.append(state.sigma[edges.nodes].max(axis=1), state.sigma[links])
        risk = _edge_risk(np.append(length, links_length), np.append(has, links_has), sigma, robot.radius)
        # Open though too narrow, as the robot came by it and nothing else leads back: no risk that it has a choice of.
        forced = np.append(edges.travelled, links_has < robot.radius + NODE_MARGIN)
        risk[forced] = 0.0
        ways = _cheapest_within(planner.collision_probability, risk, edges.nodes, weight, links, links_weight, n)
    else:
        ways = shortest_ways(edges.nodes, weight, n, links, links_weight)
    stop = robot.max_speed / robot.max_acceleration
    speed = robot.max_speed, robot.max_turn_rate
    length, time = _travel(state.points, X_MB, ways.predecessor, ways.order, *speed, stop)
    time[ways.order] += stop
    return Routes(ways.cost, ways.predecessor, length, time)


def edge_lengths(points: FloatArray, edges: IntArray) -> FloatArray:
    """Return the length (e,), m, of edges (e, 2) between points (n, 2), m."""
    d = points.take(edges[:, 0], axis=0) - points.take(edges[:, 1], axis=0)
    return np.asarray(np.hypot(d[:, 0], d[:, 1]))


def _cheapest_within(
    probability: float,
    risk: FloatArray,
    edges: IntArray,
    weight: FloatArray,
    links: IntArray,
    links_weight: FloatArray,
    n: int,
) -> Ways:
    """The ways from the robot, along links (l,) to nodes and edges (e, 2), whose steps' risks (e + l,) add up to this
    probability at most: the cheapest of the tree that is found.

    A tree of ways weighs all risks alike, so the one that reaches most is taken, of equals the one of least detour.
    """
    most, risks = -1, joined(edges, risk[: len(edges)], n, links, risk[len(edges) :])
    for detour in RISK_LENGTHS:
        costs = detour * risk / probability
        ways = shortest_ways(edges, weight + costs[: len(edges)], n, links, links_weight + costs[len(edges) :])
        kept = _risk_to(ways, risks) <= probability
        if kept.sum() > most:
            cost, predecessor = np.where(kept, ways.cost, np.inf), np.where(kept, ways.predecessor, -1)
            most, found = int(kept.sum()), Ways(cost, predecessor, ways.order[kept[ways.order]])
        if most == len(ways.order):
            break
    return found


def _risk_to(ways: Ways, risk: csr_array) -> FloatArray:
    """At most the probability (n,) of a collision anywhere on the way to each node; risk: of each step, `joined`."""
    total = np.append(np.full(len(ways.cost), np.inf), 0.0)
    step = risk[ways.predecessor[ways.order], ways.order]
    for i, of_step in zip(ways.order, step, strict=True):
        total[i] = total[ways.predecessor[i]] + of_step
    return total[:-1]


def _edge_risk(length: FloatArray, gap: FloatArray, sigma: FloatArray, radius: float) -> FloatArray:
    """At most the probability (e,) of a collision somewhere on edges of a length (e,), m, with a clearance of gap (e,),
    m, and a deviation sigma (e,), m: that at a point, for every INDEPENDENT metres. Beyond COMFORT there is none."""
    risk = collision_probability(gap, radius, sigma) * np.ceil(length / INDEPENDENT)
    return np.where(gap < COMFORT, risk, 0.0)


@read_only_arguments
@njit(cache=True)
def _travel(
    points: FloatArray,
    X_MB: FloatArray,
    predecessor: IntArray,
    order: IntArray,
    speed: float,
    turn_rate: float,
    stop: float,
) -> tuple[FloatArray, FloatArray]:
    """Length (m) and time (s) along the tree of routes; order: nodes by increasing cost.

    stop: s that it costs to stop and start again, as a robot must that does not face its way. It turns in place then,
    and on the way it rounds corners.
    """
    n = len(points)
    length, time, heading = np.full(n, np.inf), np.full(n, np.inf), np.zeros(n)
    for i in order:
        before = predecessor[i]
        if before < 0:
            continue
        at_robot = before == n
        x, y = (X_MB[0], X_MB[1]) if at_robot else (points[before, 0], points[before, 1])
        dx, dy = points[i, 0] - x, points[i, 1] - y
        step = math.sqrt(dx * dx + dy * dy)
        heading[i] = math.atan2(dy, dx)
        turn = heading[i] - (X_MB[2] if at_robot else heading[before])
        turn = abs(math.atan2(math.sin(turn), math.cos(turn)))
        length[i] = step + (0.0 if at_robot else length[before])
        if at_robot:
            time[i] = step / speed + turn / (PLANNED_SHARE * turn_rate) + (stop if turn > TURN_ABOVE else 0.0)
        else:
            time[i] = step / speed + turn / turn_rate + time[before]
    return length, time


def _connect(
    state: RoadmapState,
    tfg: TfgMap,
    X_MB: FloatArray,
    robot: RobotConfig,
    obstacles: FloatArray | None,
    leads: BoolArray,
) -> tuple[IntArray, FloatArray]:
    """Nodes the robot can drive to directly (l,), and the clearance of the way there (l,), m. leads: (n,) mask of the
    nodes from which it can go on."""
    here = X_MB[:2]
    distance = np.hypot(*(state.points - here).T)
    near = np.flatnonzero(distance <= EDGE_LENGTH)
    near = near[np.argsort(distance[near], kind="stable")[: 3 * NEIGHBOURS]]
    segments = tfg.obstacles if obstacles is None else np.vstack([tfg.obstacles, obstacles])
    # No surface can pass through where the robot stands.
    apart = clearance(segments, np.concatenate([here, here])[None], np.inf)
    segments = segments[apart > 0.02]
    own = float(apart[apart > 0.02].min(initial=np.inf))
    lines = np.hstack([np.broadcast_to(here, (len(near), 2)), state.points[near]])
    has = clearance(lines, segments, COMFORT)
    ok = has >= min(robot.radius + NODE_MARGIN, 0.95 * own)
    on = leads[near]
    was_met = obstacles is not None and len(obstacles) > 0  # That is forgotten instead.
    if not (ok & on).any() and not was_met:
        ok |= on & (has == has[on].max(initial=0.0)) & (has >= robot.radius)
    free = ok.copy()
    free[ok] = in_free_space(lines[ok], tfg)
    # Outside the space it has seen the robot may still drive where no surface is in the way.
    chosen = free if (free & on).any() else ok
    return near[chosen].astype(np.int64), has[chosen]


def _joined(state: RoadmapState, edges: BoolArray, reachable: BoolArray) -> BoolArray:
    """Nodes (n,) that some edges (e,) join to any of the reachable ones (n,)."""
    label = components(state.edges.nodes, edges, len(reachable))
    joined = np.zeros(len(reachable), dtype=np.bool_)
    joined[label[reachable]] = True
    return np.asarray(joined[label])


def _entries(state: RoadmapState, ways: Routes, fits: BoolArray) -> IntArray:
    """The last reachable node (n,) on the way to each node by edges that the robot fits through (e,), -1 where there is
    no such way."""
    reachable = np.isfinite(ways.cost)
    entry = np.where(reachable, np.arange(len(reachable)), -1)
    beyond = _joined(state, fits, reachable) & ~reachable
    if beyond.any():
        a, b = state.edges.nodes.T
        nodes = state.edges.nodes.compress(fits & (beyond[a] | beyond[b]), axis=0)
        doors = np.unique(nodes[reachable[nodes]])
        length = edge_lengths(state.points, nodes)
        from_doors = shortest_ways(nodes, length, len(entry), doors, np.zeros(len(doors)))
        for i in from_doors.order:
            if beyond[i]:
                entry[i] = entry[from_doors.predecessor[i]]
    return entry


def _uncrossed(state: RoadmapState, tfg: TfgMap) -> BoolArray:
    """The edges (e,) that lie in free space and that no surface crosses, however narrow they are."""
    open_ = state.edges.clearance > 0.0
    ask = np.flatnonzero(open_ & ~state.edges.free)
    open_[ask] = in_free_space(state.points[state.edges.nodes[ask]].reshape(-1, 4), tfg)
    return np.asarray(open_)


def roadmap_message(
    state: RoadmapState,
    ways: Routes,
    tfg: TfgMap,
    parameters: PlanningParameters,
    driven: float = 0.0,
    home: Routes | None = None,
) -> Roadmap:
    """Return the message of a roadmap and the routes through it, for goal selector and display.

    driven: m, so far. home: the routes from the start, to which the robot must return.
    """
    # Whatever a robot would try that knows its place as well as it ever does.
    least = room_needed(parameters, np.array(TRACKING_DEVIATION), ACCEPTED)
    fits = state.edges.usable | state.edges.with_room(least)
    entry = _entries(state, ways, fits)
    # A surface that crosses what was free, and had room, was not there then: a door that shut, unless it left a gap.
    reachable = np.isfinite(ways.cost)
    shut = _joined(state, fits | state.edges.free & (state.edges.clearance == 0.0), reachable) & (entry < 0)
    if shut.any():
        shut &= ~_joined(state, _uncrossed(state, tfg), reachable)
    return Roadmap(
        stage=state.stage,
        points=state.points,
        edges=state.edges.nodes.compress(state.edges.usable, axis=0),
        reachable=reachable,
        enterable=entry >= 0,
        entry=entry,
        travel_time=ways.time,
        travel_length=ways.length,
        home_time=np.zeros(0) if home is None else home.time,
        home_length=np.zeros(0) if home is None else home.length,
        driven=driven,
        ids=state.ids,
        once_open=shut,
        need=room_needed(parameters, state.sigma, ACCEPTED),
    )


def node_path(state: RoadmapState, ways: Routes, X_MB: FloatArray, node: int) -> FloatArray:
    """Return the way from the robot to a node as a polyline (k, 2), m in M, from the robot on; empty if unreachable."""
    if not 0 <= node < len(state.points) or not np.isfinite(ways.cost[node]):
        return np.zeros((0, 2))
    return np.vstack([X_MB[:2], state.points[nodes_to(ways, node)]])


def nodes_to(ways: Routes, node: int) -> list[int]:
    """Return the nodes on the way from the robot to a reachable node, in order."""
    reverse = []
    while node < len(ways.cost):
        reverse.append(node)
        node = int(ways.predecessor[node])
    return reverse[::-1]
