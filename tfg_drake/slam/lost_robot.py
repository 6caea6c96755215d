"""A robot that is suddenly elsewhere: a slip, a push, a kidnapping."""

from __future__ import annotations

import logging

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import TagDetections, replace
from tfg_drake.slam.estimator_state import CARRIED, EstimatorState, opened, unknown_way
from tfg_drake.slam.keyframe_graph import loosened, rows_of
from tfg_drake.slam.localizer import Localizer, localized_pose, restart_localizer, without_local
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.relocalization import relocalize
from tfg_drake.slam.sightings import select

# A pose found by geometry no farther than this from the estimate, m and rad, is no other place.
SAME_PLACE = (0.1, 0.05)
# A tag seen this far from where it is mapped, m, contradicts the pose, however long the robot has driven blindly.
ELSEWHERE = 5.0

_log = logging.getLogger("tfg_drake.slam")


def mapped_elsewhere(state: EstimatorState, localizer: Localizer, seen: TagDetections) -> int:
    """How many of a frame's tags are mapped, though too far away to be considered, and seen metres from there."""
    row, mapped = rows_of(seen.ids, state.graph.ids)
    mapped &= ~rows_of(seen.ids, localizer.filter.map_ids)[1]
    if state.map is None or not mapped.any():
        return 0
    X_MB, _ = localized_pose(localizer, state.model, np.zeros(3), 0.0)
    angle = X_MB[2] + seen.bearing[mapped]
    p_ML = X_MB[:2] + seen.range[mapped, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return int(np.count_nonzero(np.hypot(*(p_ML - state.map.p_ML[row[mapped]]).T) > ELSEWHERE))


def look_for_itself(state: EstimatorState, seen: TagDetections) -> EstimatorState:
    """The state after a frame that contradicts the pose once too often: where does the robot stand?"""
    estimate = state.map
    if estimate is None:
        return state
    found = relocalize(estimate, seen)
    X_MB, _ = localized_pose(state.localizer, state.model, np.zeros(3), 0.0)
    if found is None:
        if not state.carried:
            _log.warning("%.2f s: the tags in view contradict the pose; the robot looks for itself", seen.stamp)
            # What it met before it was moved stands elsewhere, seen from here.
            state = _carried(replace(state, localizer=without_local(state.localizer)))
        return state
    pose, agreeing = found
    error = se2.between(X_MB, pose)
    distance, angle = float(np.hypot(error[0], error[1])), abs(float(error[2]))
    if distance < SAME_PLACE[0] and angle < SAME_PLACE[1]:
        return replace(state, contradictions=0)
    _log.warning(
        "%.2f s: the robot is %.2f m and %.2f rad from where its wheels have brought it; %d mapped tags say so",
        seen.stamp, distance, angle, int(np.count_nonzero(agreeing)),
    )  # fmt: skip
    # What joins the newest goals to the others may be wrong as well.
    graph = loosened(state.graph, np.diag(CARRIED) ** 2)
    if graph is not state.graph:
        _log.warning("%.2f s: nothing but that way ties the newest goals to the others: they hang loose", seen.stamp)
    tags = seen.ids[agreeing]
    witness = max(range(len(graph.keyframes)), key=lambda k: np.isin(tags, graph.keyframes[k].ids).sum())
    graph = replace(graph, p_ML=estimate.p_ML)
    _, nearby = solve(graph, estimate.stamp, estimate.observation, node=witness + 1)
    graph, estimate = solve(graph, estimate.stamp, estimate.observation)
    state = replace(state, graph=graph, solved=graph, map=estimate)
    localizer = restart_localizer(state.model, nearby, pose, select(seen, agreeing))
    return _carried(replace(state, localizer=localizer, contradictions=0))


def _carried(state: EstimatorState) -> EstimatorState:
    """The state with what was measured since the last goal given up: something moved the robot meanwhile."""
    begun = opened(state)
    if state.turn is None:
        return replace(state, carried=True, way=(), piece=begun)
    assert state.map is not None
    return replace(state, carried=True, way=(unknown_way(se2.between(state.map.X_MD, begun.X_MB)),), turn=begun)
