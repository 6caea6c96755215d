"""A robot that is suddenly elsewhere: a slip, a push, a kidnapping."""

from __future__ import annotations

import logging

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import TagDetections, replace
from tfg_drake.slam import goal_graph
from tfg_drake.slam.estimator_state import CARRIED, EstimatorState, OpenTurn, instant, open_piece, travelled
from tfg_drake.slam.localizer import Localizer, localized_pose, restart_localizer, without_local
from tfg_drake.slam.map_solver import seen_from, solve
from tfg_drake.slam.relocalization import relocalize
from tfg_drake.slam.segment import start_segment
from tfg_drake.slam.sightings import select

# A pose found by geometry no farther than this from the estimate, m and rad, is no other place.
SAME_PLACE = (0.1, 0.05)
# A tag seen this far from where it is mapped, m, contradicts the pose, however long the robot has driven blindly.
ELSEWHERE = 5.0

_log = logging.getLogger("tfg_drake.slam")


def mapped_elsewhere(state: EstimatorState, localizer: Localizer, seen: TagDetections) -> int:
    """How many of a frame's tags are mapped, though too far away to be considered, and seen metres from there."""
    row, mapped = goal_graph.rows_of(seen.ids, state.graph.ids)
    mapped &= ~goal_graph.rows_of(seen.ids, localizer.filter.map_ids)[1]
    if not mapped.any():
        return 0
    X_MB, _ = localized_pose(localizer, state.model, np.zeros(3), 0.0)
    angle = X_MB[2] + seen.bearing[mapped]
    p_ML = X_MB[:2] + seen.range[mapped, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return int(np.count_nonzero(np.hypot(*(p_ML - state.graph.p_ML[row[mapped]]).T) > ELSEWHERE))


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
    graph = goal_graph.loosened(state.graph, np.diag(CARRIED) ** 2)
    if not np.array_equal(graph.segment_covariance, state.graph.segment_covariance):
        _log.warning("%.2f s: nothing but that way ties the newest goals to the others: they hang loose", seen.stamp)
        graph, estimate = solve(graph, estimate.stamp, estimate.observation)
        state = replace(state, graph=graph, map=estimate)
    tags = seen.ids[agreeing]
    witness = max(range(len(graph.observations)), key=lambda k: np.isin(tags, graph.observations[k].ids).sum())
    nearby = seen_from(graph, estimate, witness)
    localizer = restart_localizer(state.model, nearby, pose, select(seen, agreeing))
    return _carried(replace(state, localizer=localizer, contradictions=0))


def _carried(state: EstimatorState) -> EstimatorState:
    """The state with what was measured since the last goal given up: something moved the robot meanwhile."""
    state = replace(state, carried=True, way=(), segment=start_segment(state.model))
    if state.turn is not None:
        state = replace(state, turn=OpenTurn(instant(state), (), *travelled(state)))
    return replace(state, piece=None) if state.piece is None else open_piece(state)
