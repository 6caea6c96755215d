"""Realigns the part of the map made since a kidnapping, once tags of both parts are seen together.

Nothing ties such a part of the map to the rest; its place and heading are a guess. An observation of tags of both parts
measures their relative pose, but the guess may be wrong by more than a linearisation allows. So the newer part is first
moved as a whole; then the observation is added like any other.
"""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.geometry.alignment import align
from tfg_drake.messages import BoolArray, FloatArray, MapEstimate, replace
from tfg_drake.slam.keyframe import Keyframe, rows_of
from tfg_drake.slam.keyframe_graph import WITNESSES, KeyframeGraph
from tfg_drake.slam.map_solver import solve

# A keyframe of the way whose heading deviates this much or more, rad, ties nothing.
OPEN_HEADING = 1.0
# Tags of either part that a view must see, and how well they must fit, m: an id may have been misread.
LEAST_TAGS = 3
FIT = 0.3


def realigned(graph: KeyframeGraph, estimate: MapEstimate, observation: Keyframe) -> tuple[KeyframeGraph, MapEstimate]:
    """Graph and estimate with the part mapped since the last kidnapping moved to fit an observation that is not yet in
    them. They are returned as they were where no part is adrift or the observation does not tell its place."""
    keyframes = graph.keyframes
    loose = [j for j, one in enumerate(keyframes) if not len(one.ids) and one.information[2, 2] <= OPEN_HEADING**-2]
    if not loose or not len(graph.ids):
        return graph, estimate
    j = loose[-1]
    before, since = _seen_by(graph, keyframes[:j]), _seen_by(graph, keyframes[j + 1 :])
    row, known = rows_of(observation.ids, graph.ids)
    old, new = known & before[row] & ~since[row], known & since[row] & ~before[row]
    if (before & since).sum() >= WITNESSES or min(old.sum(), new.sum()) < LEAST_TAGS:
        return graph, estimate
    p_AL, p_ML = observation.given(graph.shared.mean)[0], estimate.p_ML[row]
    by_old, by_new = align(p_ML[old], p_AL[old]), align(p_ML[new], p_AL[new])
    if max(_misfit(by_old, p_AL[old], p_ML[old]), _misfit(by_new, p_AL[new], p_ML[new])) > FIT:
        return graph, estimate
    move = se2.compose(by_old, se2.inverse(by_new))
    X_MN, p_ML = graph.X_MN.copy(), estimate.p_ML.copy()
    X_MN[j + 1 :] = se2.compose(move, X_MN[j + 1 :])
    p_ML[since & ~before] = se2.transform(move, p_ML[since & ~before])
    # The unknown way is given the motion that leads there.
    way = replace(keyframes[j], y_AD=se2.between(X_MN[j], X_MN[j + 1]))
    graph = replace(graph, keyframes=(*keyframes[:j], way, *keyframes[j + 1 :]), X_MN=X_MN, p_ML=p_ML)
    return solve(graph, estimate.stamp, estimate.observation)


def _seen_by(graph: KeyframeGraph, keyframes: tuple[Keyframe, ...]) -> BoolArray:
    """Which landmarks (n,) some keyframes have seen."""
    seen = np.zeros(len(graph.ids), dtype=bool)
    for one in keyframes:
        seen[rows_of(one.ids, graph.ids)[0]] = True
    return seen


def _misfit(X_MA: FloatArray, p_AL: FloatArray, p_ML: FloatArray) -> float:
    """How far (m) the worst of the points p_AL (n, 2), seen from X_MA (3,), is from where the map has it, (n, 2)."""
    return float(np.hypot(*(se2.transform(X_MA, p_AL) - p_ML).T).max())
