"""A mission that begins with a map: what its estimator knows then."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tfg_drake.geometry.star import inside_any
from tfg_drake.mapfile.placement import seen_in
from tfg_drake.mapfile.saved_map import SavedMap, as_one_keyframe
from tfg_drake.messages import BoolArray, SaidPose, replace
from tfg_drake.slam.estimator_state import EstimatorState, KnownMap
from tfg_drake.slam.keyframe_graph import forget, no_observation
from tfg_drake.slam.map_solver import known_jointly, solve
from tfg_drake.slam.relocalizer import said_to_be
from tfg_drake.slam.walls import known_walls


def begun_with(saved: SavedMap, state: EstimatorState, at: Sequence[float] = ()) -> EstimatorState:
    """The state of an estimator that has a map before its first message, and does not know where in it the robot is: it
    maps apart until it does.

    state: without it, see `initial_state`. The map becomes one keyframe: so its file does not grow from one session to
    the next. Its poses go, and walls of which nothing is left. at: as of `config.ExplorerConfig.known_at`.
    """
    stood, _, _ = known_walls(saved.graph)
    graph = forget(saved.graph, stood[_gone(saved)])
    graph, estimate = solve(graph, 0.0, no_observation(), joint=known_jointly(graph))
    known = KnownMap(
        keyframe=as_one_keyframe(estimate, state.sheet).keyframes[0],
        X_KD=estimate.X_MD,
        estimate=estimate,
        seen=seen_in(saved),
        evidence=saved.evidence,
        facing=saved.facing,
        X_WK=saved.X_WM,
        sessions=saved.graph.sessions,
    )
    state = replace(state, known=known)
    if len(at):
        state = said_to_be(state, SaidPose(X_WB=np.array(at[:3]), sigma=np.array(at[3:])), np.zeros(3))
    return state


def _gone(saved: SavedMap) -> BoolArray:
    """Which walls (w,) the newest session has looked through: no surface hangs on them, and their middle is free."""
    stood, ends, _ = known_walls(saved.graph)
    free = inside_any(ends.mean(axis=1), saved.tfg.star_offsets, saved.tfg.star_vertices)
    return np.asarray(free & ~np.isin(stood, saved.tfg_graph.surfaces.ids))
