"""What was mapped after the robot had been carried, put in its place once tags from before are seen with it.

Nothing ties such a part of the map to the rest; its place and heading are a guess. A goal that sees tags of both parts
says how they lie to each other, but by more than a linearisation about the guess can follow: its covariance is that of
small turns. So the newer part is moved first, as a whole; the goal then joins as any other.
"""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, GoalObservation, MapEstimate, replace
from tfg_drake.metrics import align
from tfg_drake.slam.goal_graph import WITNESSES, GoalGraph, rows_of
from tfg_drake.slam.map_solver import restored
from tfg_drake.slam.map_window import seen_by

# A segment that leaves the heading as open as this, rad, ties nothing.
OPEN_HEADING = 1.0
# Tags of either part that a goal must see, and how well they must fit, m: an id may have been misread.
LEAST_TAGS = 3
FIT = 0.3


def rejoined(
    graph: GoalGraph, estimate: MapEstimate | None, observation: GoalObservation
) -> tuple[GoalGraph, MapEstimate | None]:
    """The graph, and its estimate, with what was mapped since the robot was carried moved to where an observation, not
    yet in it, says; as they were where nothing is adrift or the observation does not say."""
    open_segments = np.flatnonzero(graph.segment_covariance[:, 2, 2] >= OPEN_HEADING**2)
    if estimate is None or not len(open_segments):
        return graph, estimate
    first = int(open_segments[-1]) + 1
    k = len(graph.observations)
    before, since = seen_by(graph, np.arange(first)), seen_by(graph, np.arange(first, k))
    row, known = rows_of(observation.ids, graph.ids)
    old, new = known & before[row] & ~since[row], known & since[row] & ~before[row]
    if (before & since).sum() >= WITNESSES or min(old.sum(), new.sum()) < LEAST_TAGS:
        return graph, estimate
    p_AL, p_ML = observation.p_AL, graph.p_ML[row]
    by_old, by_new = align(p_ML[old], p_AL[old]), align(p_ML[new], p_AL[new])
    if max(_misfit(by_old, p_AL[old], p_ML[old]), _misfit(by_new, p_AL[new], p_ML[new])) > FIT:
        return graph, estimate
    move = se2.compose(by_old, se2.inverse(by_new))
    X_MA, X_MD, p_ML = graph.X_MA.copy(), graph.X_MD.copy(), graph.p_ML.copy()
    X_MA[first:], X_MD[first:] = se2.compose(move, X_MA[first:]), se2.compose(move, X_MD[first:])
    p_ML[since & ~before] = se2.transform(move, p_ML[since & ~before])
    graph = replace(graph, X_MA=X_MA, X_MD=X_MD, p_ML=p_ML)
    return graph, restored(graph, estimate.stamp, estimate.observation)


def _misfit(X_MA: FloatArray, p_AL: FloatArray, p_ML: FloatArray) -> float:
    """How far (m) the worst of the points p_AL (n, 2), seen from X_MA (3,), is from where the map has it, (n, 2)."""
    return float(np.hypot(*(se2.transform(X_MA, p_AL) - p_ML).T).max())
