"""A mission that begins with a map: what its estimator knows then."""

from __future__ import annotations

import numpy as np

from tfg_drake.geometry.star import inside_any
from tfg_drake.mapfile.saved_map import SavedMap, as_one_keyframe
from tfg_drake.messages import BoolArray, replace
from tfg_drake.slam.estimator import carried
from tfg_drake.slam.estimator_state import EstimatorState, FirstLook
from tfg_drake.slam.evidence import renewed
from tfg_drake.slam.keyframe_graph import forget, no_observation
from tfg_drake.slam.localizer import start_localizer
from tfg_drake.slam.map_solver import known_jointly, solve
from tfg_drake.slam.walls import known_walls


def begun_with(saved: SavedMap, state: EstimatorState) -> EstimatorState:
    """The state of an estimator that has a map before its first message, and does not know where in it the robot is.

    state: without it, see `initial_state`. The map becomes one keyframe, as long as all of it is known jointly: so its
    file does not grow from one session to the next. Its poses go, and walls of which nothing is left.
    """
    stood, _, _ = known_walls(saved.graph)
    graph = forget(saved.graph, stood[_gone(saved)])
    graph, estimate = solve(graph, 0.0, no_observation(), joint=known_jointly(graph))
    if estimate.is_joint:
        graph = as_one_keyframe(estimate, state.sheet)
    none = np.empty(0, dtype=np.int64)
    graph = replace(graph, prior=state.sheet, view_keyframe=none, X_AV=np.empty((0, 3)), solver=state.graph.solver)
    graph, estimate = solve(graph, 0.0, no_observation(), joint=known_jointly(graph))
    state = replace(
        state,
        graph=graph,
        solved=graph,
        map=estimate,
        published=estimate.of_tags,
        evidence=saved.evidence,
        watch=replace(renewed(state.watch, saved.ids), seen_from=saved.facing),
        localizer=start_localizer(estimate, state.walls),
    )
    state = carried(state)
    return replace(state, look=FirstLook(state))


def _gone(saved: SavedMap) -> BoolArray:
    """Which walls (w,) the newest session has looked through: no surface hangs on them, and their middle is free."""
    stood, ends, _ = known_walls(saved.graph)
    free = inside_any(ends.mean(axis=1), saved.tfg.star_offsets, saved.tfg.star_vertices)
    return np.asarray(free & ~np.isin(stood, saved.tfg_graph.surfaces.ids))
