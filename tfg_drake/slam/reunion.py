"""Brings two parts of a map together that nothing but an unknown way ties, by the walls that both have.

A robot that seemed to be elsewhere, and mapped on before it had found itself, has mapped walls anew that the map has:
these are known to metres for ever, however long it looks. Where those of the newer part lie on the older part's, as
`tfg_drake.slam.wall_search` finds a robot, they are given the older ones' names; then a solve knows the way.
"""

from __future__ import annotations

import logging

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, is_tag, replace
from tfg_drake.slam.estimator_state import EstimatorState
from tfg_drake.slam.evidence import with_doubts
from tfg_drake.slam.keyframe import rows_of
from tfg_drake.slam.keyframe_graph import forget
from tfg_drake.slam.localizer import start_localizer
from tfg_drake.slam.lost_robot import adrift, seen_by
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.wall_search import find_place, matched
from tfg_drake.slam.walls import Names, directions, named

_log = logging.getLogger("tfg_drake.slam")


def reunited(state: EstimatorState) -> EstimatorState:
    """The state with the part of the map since the last unknown way tied to the part before, where its walls tell the
    place; as it was where no part is adrift or they do not."""
    graph, estimate, walls, shared = state.graph, state.map, state.walls, state.graph.shared.mean
    j = adrift(graph)
    if j < 0 or estimate is None or not state.placed < np.inf:
        return state
    row, known = rows_of(walls.first, graph.ids)
    row[~known] = 0
    before, since = seen_by(graph, graph.keyframes[:j])[row], seen_by(graph, graph.keyframes[j + 1 :])[row]
    old, new = np.flatnonzero(known & before & ~since), np.flatnonzero(known & since & ~before)
    if not (len(old) and len(new)) or (known & before & since).any():
        return state
    points = estimate.p_ML[row[:, None] + [0, 1]]
    along, _, _ = directions(points)
    ends = points[:, :1] + walls.reach[:, :, None] * along[:, None]
    X_MN = graph.X_MN[j + 1]
    seen = se2.transform(se2.inverse(X_MN), ends[new].reshape(-1, 2)).reshape(-1, 2, 2)
    X, _ = find_place(seen, points[old], walls.reach[old], X_MN)
    if X is None:
        return state
    _log.warning("%.2f s: what was mapped since the robot looked for itself is tied to the map before", state.stamp)
    on = matched(X, seen, points[old], walls.reach[old])
    again, of = new[on >= 0], old[on[on >= 0]]
    move = se2.compose(X, se2.inverse(X_MN))
    p_ML, poses = estimate.p_ML.copy(), graph.X_MN.copy()
    fresh = seen_by(graph, graph.keyframes[j + 1 :]) & ~seen_by(graph, graph.keyframes[:j])
    p_ML[fresh] = se2.transform(move, p_ML[fresh])
    poses[j + 1 :] = se2.compose(move, poses[j + 1 :])
    keyframes, met = list(graph.keyframes), set(walls.first[old].tolist())
    name = dict(zip(walls.first[again].tolist(), walls.first[of].tolist(), strict=True))
    for k in range(j + 1, len(keyframes)):
        firsts = keyframes[k].ids[~is_tag(keyframes[k].ids)][::2]
        called = np.array([name.get(first, first) for first in firsts.tolist()], dtype=np.int64)
        # Of two that are one wall the first seen is it.
        keep = np.isin(np.arange(len(called)), np.unique(called, return_index=True)[1])
        names = _names(
            firsts[keep], called[keep], met, poses[k], p_ML[rows_of(called[keep], graph.ids)[0][:, None] + [0, 1]]
        )
        keyframes[k] = named(keyframes[k], names, shared)
        met |= set(called.tolist())
    reach = walls.reach.copy()
    for a, b in zip(again, of, strict=True):
        at = np.sum((se2.transform(move, ends[a]) - points[b, 0]) * along[b], axis=1)
        reach[b] = min(reach[b, 0], at[0]), max(reach[b, 1], at[1])
    stays = ~np.isin(walls.first, walls.first[again])
    walls = replace(walls, first=walls.first[stays], reach=reach[stays])
    gone = np.append(list(name), np.array(list(name)) + 1).astype(np.int64)
    graph = forget(replace(graph, keyframes=tuple(keyframes), X_MN=poses, p_ML=p_ML), gone)
    graph, estimate = solve(graph, estimate.stamp, estimate.observation)
    estimate = with_doubts(replace(estimate, frame_worth=state.map.frame_worth), state.evidence, graph)
    return replace(
        state,
        graph=graph,
        solved=graph,
        map=estimate,
        published=estimate.of_tags,
        walls=walls,
        localizer=start_localizer(estimate, walls),
        sources=(),
    )


def _names(provisional: IntArray, first: IntArray, met: set[int], X_MN: FloatArray, p_ML: FloatArray) -> Names:
    """The names of a keyframe's walls (v,), by their points p_ML (v, 2, 2) in M; met: walls that others hold."""
    p_AL = se2.transform(se2.inverse(X_MN), p_ML.reshape(-1, 2)).reshape(-1, 2, 2)
    return Names(provisional, first, p_AL, np.array([one not in met for one in first.tolist()], dtype=bool))
