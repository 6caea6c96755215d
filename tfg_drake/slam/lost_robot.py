"""Finds a robot again that is suddenly elsewhere: after a slip, a push or a kidnapping.

All tags seen since the first frame that contradicts the pose are gathered, as one frame may show one or two only, which
do not tell a pose. The pose is looked for by all of them together. Once it is found, the tags gathered are mapped by
it, and the motion before the first contradiction counts as unknown.
"""

from __future__ import annotations

import logging

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, MapEstimate, TagDetections, replace
from tfg_drake.slam.estimator_state import KIDNAPPED, EstimatorState, OpenObservation, opened, unknown_way
from tfg_drake.slam.keyframe import rows_of
from tfg_drake.slam.keyframe_graph import decoupled
from tfg_drake.slam.localizer import Localizer, localized_pose, restart_localizer, without_local
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.missing_tags import renewed
from tfg_drake.slam.relocalization import Expected, disagreeing, relocalize
from tfg_drake.slam.shared import CAMERA_YAW, RANGE_SCALE, seen_from_body
from tfg_drake.slam.sightings import select

# A pose found no farther than this from the estimate, in squared deviations, is no other place.
SAME_PLACE = 16.0
# A tag seen this far from where it is mapped, m, contradicts the pose, however long the robot has driven blindly.
ELSEWHERE = 5.0
# Deviation of the motion of a robot that sees nothing, m/s, m/s, rad/s: it may be moved or misjudge its way. And of a
# push, m, m, rad.
CARRIES = np.array([0.05, 0.05, 0.05])
PUSHES = np.array([0.1, 0.1, 0.1])
# Tags that must contradict the pose where no other is found.
LEAST_AGAINST = 3

_log = logging.getLogger("tfg_drake.slam")


def mapped_elsewhere(state: EstimatorState, localizer: Localizer, seen: TagDetections) -> int:
    """The number of a frame's tags that are mapped too far away for the localiser and seen far from there."""
    row, mapped = rows_of(seen.ids, state.graph.ids)
    estimate = localizer.map
    mapped &= ~rows_of(seen.ids, estimate.ids[estimate.local])[1]
    if state.map is None or not mapped.any():
        return 0
    X_MB, _ = localized_pose(localizer, state.noise.now.walks, np.zeros(3), 0.0)
    seen = seen_from_body(seen, state.graph.shared)
    angle = X_MB[2] + seen.bearing[mapped]
    p_ML = X_MB[:2] + seen.range[mapped, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return int(np.count_nonzero(np.hypot(*(p_ML - state.map.p_ML[row[mapped]]).T) > ELSEWHERE))


def find_itself(state: EstimatorState, stamp: float) -> EstimatorState:
    """The state after a search for the pose in the map: the robot is lost or too many frames contradict its pose."""
    estimate, suspect = state.map, state.suspect
    if estimate is None or suspect is None:
        return state
    seen = gathered(state, suspect)
    way = se2.between(suspect.begin.X_OB, state.X_OB)
    moved = np.sqrt(suspect.sigma**2 + PUSHES**2 + (suspect.unwatched * CARRIES) ** 2)
    expected = Expected(se2.compose(suspect.X_MB, way), suspect.sigma, moved)
    found = relocalize(estimate, seen, expected)
    if found is None:
        if state.kidnapped or disagreeing(estimate, seen, expected.X_MB) < LEAST_AGAINST:
            return state
        _log.warning("%.2f s: the tags in view contradict the pose; the robot looks for itself", stamp)
        # Tags met before the robot was moved have another place relative to it now.
        return _kidnapped(
            replace(state, localizer=without_local(state.localizer)), replace(opened(state), sigma=KIDNAPPED)
        )
    tags = select(seen, found.agreeing)
    # As far from what was expected as the search took it to be: two tags may say no more of where it is on their ring.
    sigma = moved if found.is_near else KIDNAPPED
    begun = replace(suspect, X_MB=se2.compose(found.X_MB, se2.inverse(way)), sigma=sigma)
    if not found.is_known:
        if not state.lost:
            _log.warning("%.2f s: the tags in view contradict the pose; the robot looks for itself", stamp)
        localizer = _restarted(state, estimate, found.X_MB, tags)
        return _kidnapped(replace(state, localizer=localizer, lost=True), begun)
    X_MB = expected.X_MB if state.lost else localized_pose(state.localizer, state.noise.now.walks, np.zeros(3), 0.0)[0]
    error = found.X_MB - X_MB
    error[2] = se2.wrap_angle(error[2])
    distance, angle = float(np.hypot(error[0], error[1])), abs(float(error[2]))
    if not state.lost and error @ np.linalg.solve(found.covariance, error) < SAME_PLACE:
        return replace(state, contradictions=0, suspect=None)
    _log.warning(
        "%.2f s: the robot is %.2f m and %.2f rad from where its wheels have brought it; %d mapped tags say so",
        stamp, distance, angle, len(tags.ids),
    )  # fmt: skip
    # The ties of the newest views to the others may be wrong as well.
    graph = decoupled(state.graph, np.diag(KIDNAPPED**2), tags.ids)
    if graph is not state.graph:
        _log.warning(
            "%.2f s: nothing but that way ties the newest views to the others: they are not tied any longer", stamp
        )
    witness = max(range(len(graph.keyframes)), key=lambda k: np.isin(tags.ids, graph.keyframes[k].ids).sum())
    graph = replace(graph, p_ML=estimate.p_ML)
    _, nearby = solve(graph, estimate.stamp, estimate.observation, node=witness + 1)
    graph, estimate = solve(graph, estimate.stamp, estimate.observation)
    state = replace(
        state, graph=graph, solved=graph, map=estimate, watch=renewed(state.watch, estimate.ids), sources=()
    )
    localizer = _restarted(state, nearby, found.X_MB, tags)
    state = replace(state, localizer=localizer, contradictions=0, lost=False, suspect=None)
    return _kidnapped(state, begun)


def _restarted(
    state: EstimatorState, estimate: MapEstimate, X_MB: FloatArray, seen_from_body: TagDetections
) -> Localizer:
    """The localiser at a pose X_MB (3,) found by geometry; the tags as of `gathered`."""
    shared = estimate.shared
    tags = replace(
        seen_from_body,
        range=seen_from_body.range * (1.0 + shared[RANGE_SCALE]),
        bearing=seen_from_body.bearing - shared[CAMERA_YAW],
    )
    return restart_localizer(estimate, state.noise.now.walks, X_MB, tags)


def _kidnapped(state: EstimatorState, begun: OpenObservation) -> EstimatorState:
    """The state of a kidnapped robot: the motion from the last view to the observation that has begun is unknown."""
    if state.turn is None:
        return replace(state, kidnapped=True, way=(), piece=begun)
    assert state.map is not None
    if begun.begin.stamp < state.turn.begin.stamp:
        begun = replace(opened(state), sigma=begun.sigma)
    way = unknown_way(se2.between(state.map.X_MD, begun.X_MB), begun.sigma)
    return replace(state, kidnapped=True, way=(way,), turn=begun)


def gathered(state: EstimatorState, since: OpenObservation) -> TagDetections:
    """All tags seen since an observation began, each once, as seen from where the robot is now. Their deviations
    include the error of odometry since they were seen."""
    walks, sigma, ids, p_BL, variance = state.noise.now.walks, state.graph.shared.sigma, [], [], []
    for frame in since.frames:
        seen = seen_from_body(frame.detections, state.graph.shared)
        if not len(seen.ids):
            continue
        way = se2.between(state.X_OB, frame.X_OB)
        distance, dt = float(np.hypot(way[0], way[1])), state.clock - frame.clock
        turned = float(np.sum(np.square([walks[1] * dt**0.5, *(sigma[1:3] * (dt, way[2]))])))
        driven = walks[0] ** 2 * distance + (sigma[0] * distance) ** 2
        lever = seen.range + distance
        ids.append(seen.ids)
        direction = np.column_stack([np.cos(seen.bearing), np.sin(seen.bearing)])
        p_BL.append(se2.transform(way, seen.range[:, None] * direction))
        across = (seen.range * seen.sigma_bearing) ** 2 + lever**2 * turned + driven
        variance.append(np.column_stack([seen.sigma_range**2 + driven, across]))
    names, tag = np.unique(np.concatenate(ids), return_inverse=True)
    points, variances = np.concatenate(p_BL), np.concatenate(variance)
    weight = 1.0 / variances.sum(axis=1)
    total = np.bincount(tag, weight)
    mean = np.column_stack([np.bincount(tag, weight * points[:, i]) / total for i in range(2)])
    # Frames in a row have their errors in common: many say no more than the best.
    best = np.full((len(names), 2), np.inf)
    np.minimum.at(best, tag, variances)
    distance = np.hypot(*mean.T)
    return TagDetections(
        stamp=state.stamp,
        ids=names,
        range=distance,
        bearing=np.arctan2(mean[:, 1], mean[:, 0]),
        sigma_range=np.sqrt(best[:, 0]),
        sigma_bearing=np.sqrt(best[:, 1]) / np.maximum(distance, 0.1),
    )
