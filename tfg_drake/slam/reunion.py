"""Ties what follows an unknown way to the map before, by the tags or surfaces that are seen on both sides.

A robot that seemed to be elsewhere maps on, perhaps before it has found itself. All that follows is known to metres for
ever then, however long it looks: walls are recognised where it is known where they must be. So as long as the newest
part of the map is adrift each view is asked where it is: by tags of the map before, or as a robot finds itself
(`tfg_drake.slam.place_search`). The newest part is moved there as a whole, farther than a linearisation reaches.
"""

from __future__ import annotations

import logging

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.geometry.alignment import align
from tfg_drake.messages import BoolArray, FloatArray, MapEstimate, is_tag, replace
from tfg_drake.slam.estimator_state import EstimatorState, Source, unknown_way
from tfg_drake.slam.evidence import Sighted
from tfg_drake.slam.keyframe import Keyframe, is_unknown, rows_of
from tfg_drake.slam.keyframe_graph import KeyframeGraph, moved_part
from tfg_drake.slam.lost_robot import PLACED, WRONG, adrift, known_points, seen_by
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.place_search import find_places, nothing_seen, seen_by_views
from tfg_drake.slam.surface_fit import surface_points

Ways = tuple[tuple[Sighted, Source | None], ...]

# Tags of the map before that a view must see, and how well they must fit, m: an id may have been misread.
LEAST_TAGS, FIT = 3, 0.3

_log = logging.getLogger("tfg_drake.slam")


def found_again(state: EstimatorState, way: Ways, view: Keyframe) -> tuple[KeyframeGraph, MapEstimate, Ways]:
    """Graph and map before a view, and the way to it, known where they were not but what the view sees tells where it
    is."""
    graph, estimate = state.graph, state.map or state.localizer.map
    j, lost = adrift(graph), any(is_unknown(one.keyframe) for one, _ in way)
    if not (lost or j >= 0) or not state.placed < np.inf:
        return graph, estimate, way
    before, since = seen_by(graph, graph.keyframes[:j]), seen_by(graph, graph.keyframes[j + 1 :])
    before = before if j >= 0 else since
    if not lost and (before & since).any():
        return graph, estimate, way
    at = estimate.X_MD
    for one, _ in way:
        at = se2.compose(at, one.keyframe.y_AD)
    X = None if lost else _by_tags(graph, estimate, view, before & ~since)
    if X is None:
        # Of what is adrift all views tell together where it is.
        seen = nothing_seen() if lost else seen_by_views(graph, j)
        seen = seen.with_look(surface_points(view, graph.shared.mean), at)
        found = find_places(known_points(graph), seen).found(WRONG)
        if found is None:
            return graph, estimate, way
        X = se2.compose(found, at)
    move = se2.compose(X, se2.inverse(at))
    _log.warning("%.2f s: the robot has found itself; what follows is tied to the map before", state.stamp)
    if lost:
        return graph, estimate, (unknown_way(se2.between(estimate.X_MD, X), PLACED),)
    poses = graph.X_MN.copy()
    poses[j + 1 :] = se2.compose(move, poses[j + 1 :])
    tie, _ = unknown_way(se2.between(poses[j], poses[j + 1]), PLACED)
    keyframes = (*graph.keyframes[:j], tie.keyframe, *graph.keyframes[j + 1 :])
    graph = moved_part(replace(graph, keyframes=keyframes, X_MN=poses, p_ML=estimate.p_ML), since, move)
    return *solve(graph, estimate.stamp, estimate.observation), way


def _by_tags(graph: KeyframeGraph, estimate: MapEstimate, view: Keyframe, before: BoolArray) -> FloatArray | None:
    """The pose X_MA (3,) of a view by the tags mapped before, (n,) of the graph's; None where they do not tell it."""
    row, known = rows_of(view.ids, graph.ids)
    old = known & is_tag(view.ids)
    old[old] = before[row[old]]
    if np.count_nonzero(old) < LEAST_TAGS:
        return None
    p_AL, p_ML = view.given(graph.shared.mean)[0][old], estimate.p_ML[row[old]]
    X_MA = align(p_ML, p_AL)
    return X_MA if np.hypot(*(se2.transform(X_MA, p_AL) - p_ML).T).max() < FIT else None
