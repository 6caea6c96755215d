"""Which part of a large map is solved and known jointly at a time, and how its pieces hang together outside.

What a goal tells of the map reaches only so far. On a large map the goals nearest to a place, some dozens, make a
window; its size does not depend on the map's. Where the window's goals are not consecutive, a link takes the place of
the way between them: the covariance that the robot's travel added up, each leg of it as known on arrival by all tags
then in view. So two rooms on either side of a loop that is about to close are known to lie as loosely to each other as
they do.
"""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, replace
from tfg_drake.slam.goal_graph import GoalGraph, rows_of

# Up to this many landmarks, and sightings of them counted once for each goal, a map is solved as a whole.
SMALL = 400
SMALL_SIGHTINGS = 12_000
# A window's goals have seen this many tags at most, counted once for each goal, and its poses count like some more.
SIGHTINGS = 1200
POSES = 3
# Goals of a block of the way, whose legs are told anew together.
BLOCK = 8


def window_goals(graph: GoalGraph, place: FloatArray) -> IntArray:
    """The goals (w,), ascending, nearest to a place (2,), m in M, the newest with the pieces of the way to it, and the
    one before; all of a small map's."""
    k = len(graph.observations)
    if len(graph.ids) <= SMALL and graph.sightings.sum() <= SMALL_SIGHTINGS:
        return np.arange(k)
    before = np.flatnonzero(graph.is_goal[:-1])
    chosen = _within_budget(graph, _by_distance(graph.X_MA, place))
    return np.union1d(chosen, np.arange(before[-1] if len(before) else 0, k))


def nearest_goal(graph: GoalGraph, place: FloatArray) -> int:
    """The goal that ended nearest to a place (2,), m in M."""
    return int(_by_distance(graph.X_MD, place)[0])


def nearest_observer(graph: GoalGraph, row: int) -> int:
    """The goal nearest to the landmark in some row of those that have seen it."""
    order = _by_distance(graph.X_MA, graph.p_ML[row])
    return next(int(k) for k in order if graph.ids[row] in graph.observations[k].ids)


def _by_distance(X: FloatArray, place: FloatArray) -> IntArray:
    return np.argsort(np.hypot(*(X[:, :2] - place).T), kind="stable")


def boundary_goals(graph: GoalGraph, goals: IntArray, place: FloatArray) -> IntArray:
    """Of the other goals, those (b,), ascending, nearest to a place (2,), m in M, that have seen a landmark of the
    window's goals (w,); none of a window that is the whole map."""
    order = _by_distance(graph.X_MA, place)
    order = order[~np.isin(order, goals)][: 4 * len(goals)]
    seen = seen_by(graph, goals)
    shares = [bool(seen[rows_of(graph.observations[k].ids, graph.ids)[0]].any()) for k in order]
    return np.sort(_within_budget(graph, order[np.array(shares, dtype=bool)]))


def seen_by(graph: GoalGraph, goals: IntArray) -> BoolArray:
    """Which landmarks (n,) some goals (w,) have seen."""
    seen = np.zeros(len(graph.ids), dtype=bool)
    for k in goals:
        seen[rows_of(graph.observations[k].ids, graph.ids)[0]] = True
    return seen


def _within_budget(graph: GoalGraph, order: IntArray) -> IntArray:
    """The first of the goals in this order, as many as SIGHTINGS allows."""
    total = 0
    for count, k in enumerate(order):
        total += len(graph.observations[k].ids) + POSES
        if total > SIGHTINGS:
            return order[:count]
    return order


def anchor_goal(graph: GoalGraph, goals: IntArray) -> int:
    """Of the goals (w,) but the newest, the one whose departure pose is known best."""
    older = goals[goals < len(graph.observations) - 1]
    position = graph.departure_covariance[older][:, [0, 1], [0, 1]].sum(axis=1)
    return int(older[np.argmin(position)])


def travelled_covariance(graph: GoalGraph) -> FloatArray:
    """(k, 3, 3) what travel has added up to at each departure pose: covariance of the turns and shifts of the map
    before a pose, about M's origin, (x, y) in M and theta. The difference of two rows is that of one pose against the
    other."""
    steps = np.zeros((len(graph.X_MD), 3, 3))
    steps[1:] = _about_origin(graph.travel_covariance, graph.X_MD[:-1, 2], graph.X_MD[1:, :2])
    return np.asarray(np.cumsum(steps, axis=0))


def _about_origin(covariance: FloatArray, theta: FloatArray, end: FloatArray) -> FloatArray:
    """Covariances (n, 3, 3) of motions, of (x, y) in frames of heading theta (n,) and of the turn, which end at end (n,
    2): of the map's turn about its origin, and its shift, that each error amounts to."""
    T = _to_origin(theta, end)
    return np.asarray(T @ covariance @ T.transpose(0, 2, 1))


def _to_origin(theta: FloatArray, end: FloatArray) -> FloatArray:
    """(n, 3, 3), see _about_origin."""
    T = np.zeros((len(theta), 3, 3))
    c, s = np.cos(theta), np.sin(theta)
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1] = c, -s, s, c
    T[:, 0, 2], T[:, 1, 2], T[:, 2, 2] = end[:, 1], -end[:, 0], 1.0
    return T


def smoothed_block(graph: GoalGraph, goals: IntArray) -> tuple[int, ...]:
    """Where the newest block of the way begins and ends that a window's goals (w,) know well, by what came before and
    after, behind where the block before it began, if they hold that too; none but once a block, when the robot is a
    block farther on."""
    last, before = ((int(k) // BLOCK - 1) * BLOCK for k in np.append(0, np.flatnonzero(graph.is_goal))[[-1, -2]])
    begin, first = last - BLOCK, last - 2 * BLOCK
    if last == before or begin < 0 or not _holds(goals, begin, len(graph.observations)):
        return ()
    return (first, begin, last) if first >= 0 and _holds(goals, first, begin) else (begin, last)


def _holds(goals: IntArray, i: int, j: int) -> bool:
    """Whether all goals from i to before j are among some (w,)."""
    return bool(np.isin(np.arange(i, j), goals).all())


def travelled_about_origin(graph: GoalGraph, i: int, j: int, covariance: FloatArray) -> FloatArray:
    """(3, 3) what travel from D_i to D_j adds up to, about M's origin, where its covariance is (3, 3), of (x, y) in D_i
    and theta."""
    return np.asarray(_about_origin(covariance[None], graph.X_MD[i : i + 1, 2], graph.X_MD[j : j + 1, :2])[0])


def with_travel(graph: GoalGraph, i: int, j: int, whole: FloatArray) -> GoalGraph:
    """The graph with travel from D_i to D_j, i < j, that adds up to this covariance (3, 3) about M's origin: each leg
    keeps its share. As it was where rounding leaves no covariance, as of what hangs on nothing."""
    theta, end = graph.X_MD[i:j, 2], graph.X_MD[i + 1 : j + 1, :2]
    T = _to_origin(theta, end)
    legs = T @ graph.travel_covariance[i:j] @ T.transpose(0, 2, 1)
    try:
        A = np.linalg.cholesky(whole) @ np.linalg.inv(np.linalg.cholesky(legs.sum(axis=0)))
    except np.linalg.LinAlgError:
        return graph
    back = np.linalg.inv(T) @ A
    travel_covariance = graph.travel_covariance.copy()
    travel_covariance[i:j] = back @ legs @ back.transpose(0, 2, 1)
    return replace(graph, travel_covariance=travel_covariance)


def link(graph: GoalGraph, travelled: FloatArray, i: int, j: int) -> tuple[FloatArray, FloatArray]:
    """X_DA (3,) from D_i to A_j, i + 1 < j, at the graph's values, and its covariance (3, 3), of (x, y) in D and theta.

    travelled: of `travelled_covariance`. The turn at j counts with the way to it, and again in its own factor: what it
    adds to the way, known by all tags on arrival, may be less than it has by itself, and cannot be taken off.
    """
    X_DA = se2.between(graph.X_MD[i], graph.X_MA[j])
    x, y = graph.X_MA[j, :2]
    at_end = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    to_D = np.eye(3)
    to_D[:2, :2] = se2.rotation(float(graph.X_MD[i, 2])).T
    J = to_D @ at_end
    covariance = J @ (travelled[j] - travelled[i]) @ J.T
    return X_DA, 0.5 * (covariance + covariance.T)
