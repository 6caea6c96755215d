"""Joins a session's own map with the map that it began with, or separates them again.

The older map becomes a keyframe at the beginning of the graph and determines the frame from then on; its walls take the
ids of the session's walls that are the same. Removing this keyframe, and the way to the session's first one, restores
the session's map.
"""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.geometry.se2 import rotation
from tfg_drake.messages import FloatArray, is_tag, replace
from tfg_drake.slam.estimator_state import EstimatorState, KnownMap, Placed, unknown_way, with_map
from tfg_drake.slam.evidence import TagWatch
from tfg_drake.slam.keyframe import Keyframe, joined_reach, placed, rows_of, without_tags
from tfg_drake.slam.keyframe_graph import KeyframeGraph, extended, no_observation
from tfg_drake.slam.map_solver import known_jointly, solve
from tfg_drake.slam.walls import named, renamed
from tfg_drake.table import concat, take

# Index of the last keyframe of the known map in the joined graph: the map itself, then the motion to the session's
# start.
OF_KNOWN = 1


def with_known(state: EstimatorState, known: KnownMap, at: Placed) -> EstimatorState:
    """Return the state of a session joined with its known map, in the frame of that map. If tags did not decide, the
    join may be withdrawn."""
    graph, before = state.graph, state.map
    assert before is not None
    told = solve(graph, state.stamp, no_observation(), joint=known_jointly(graph))[1]
    one = without_tags(known.keyframe, at.moved)
    names, walls = renamed(one, state.walls, told, se2.inverse(at.X), at.covariance)
    way = unknown_way(se2.between(known.X_KD, at.X), np.sqrt(np.diag(at.covariance)))
    first = ((named(one, names), known.X_KD), (way, at.X))
    sessions = np.union1d(graph.sessions, known.sessions)
    both = _moved(replace(graph, p_ML=told.p_ML, sessions=sessions), at.X, first, 0)
    others = take(known.evidence, ~np.isin(known.evidence.ids, state.evidence.ids))
    state = replace(
        state,
        walls=walls,
        evidence=concat(state.evidence, others),
        watch=_turned(state.watch, at.X),
        known=None if at.tags else replace(known, since=before.stage),
        at=None if at.tags else Placed(np.zeros(3), np.zeros((3, 3))),
    )
    both, estimate = solve(both, state.stamp, before.observation)
    state = with_map(state, both, estimate, both)
    return replace(state, watch=_with_facing(state.watch, known))


def without_known(state: EstimatorState, known: KnownMap) -> EstimatorState:
    """Return the state of a session separated from its known map again, in its own frame, as the join was wrong."""
    begin = OF_KNOWN + 1
    assert state.map is not None
    X_SM = se2.inverse(state.graph.X_MN[begin])
    sessions = np.setdiff1d(state.graph.sessions, known.sessions)
    own = _moved(replace(state.graph, p_ML=state.map.p_ML, sessions=sessions), X_SM, (), begin)
    evidence = take(state.evidence, np.isin(state.evidence.ids, own.ids))
    own, estimate = solve(own, state.stamp, state.map.observation)
    state = replace(state, evidence=evidence, watch=_turned(state.watch, X_SM), known=replace(known, since=0))
    return with_map(state, own, estimate, own)


def _moved(
    graph: KeyframeGraph, X_FM: FloatArray, first: tuple[tuple[Keyframe, FloatArray], ...], begin: int
) -> KeyframeGraph:
    """Return the graph of the keyframes from `begin` on, in another frame F with M at X_FM (3,), after the keyframes
    `first`, each with the pose (3,) at its end.

    Surfaces and free space stay anchored to views, and to the walls that remain in the graph.
    """
    both = replace(take(graph, n=np.zeros(0, dtype=np.int64)), keyframes=(), X_MN=np.zeros((1, 3)))
    for one, X in (*first, *zip(graph.keyframes[begin:], se2.compose(X_FM, graph.X_MN[begin + 1 :]), strict=True)):
        both = extended(both, one, X, is_view=False)
    row, known = rows_of(both.ids, graph.ids)
    row, w = row[known], np.flatnonzero(known & ~is_tag(both.ids))
    p_ML, anchor, reach = both.p_ML.copy(), both.anchor.copy(), both.reach.copy()
    p_ML[known], anchor[known] = placed(X_FM, graph.ids[row], graph.p_ML[row], graph.anchor[row])
    nowhere = np.tile([np.inf, -np.inf], (len(w), 1))
    reach[w] = joined_reach(p_ML[w], anchor[w], nowhere, both.anchor[w], reach[w])
    view_keyframe = graph.view_keyframe + len(both.keyframes) - len(graph.keyframes)
    return replace(both, p_ML=p_ML, anchor=anchor, reach=reach, view_keyframe=view_keyframe)


def _turned(watch: TagWatch, X_FM: FloatArray) -> TagWatch:
    """Return the watch in another frame F, with M at X_FM (3,)."""
    return replace(watch, seen_from=watch.seen_from @ rotation(float(X_FM[2])).T)


def _with_facing(watch: TagWatch, known: KnownMap) -> TagWatch:
    """Return the watch over the tags of both maps, with the facing of those that only the older map has."""
    row, is_old = rows_of(watch.ids, known.estimate.of_tags.ids)
    only_old = is_old & ~watch.seen_from.any(axis=1)
    seen_from = watch.seen_from.copy()
    seen_from[only_old] = known.facing[row[only_old]]
    return replace(watch, seen_from=seen_from)
