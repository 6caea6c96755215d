"""Finds a robot again that is suddenly elsewhere: after a slip, a push or a kidnapping.

All tags seen since the first frame that contradicts the pose are gathered, as one frame may show one or two only, which
do not tell a pose. The pose is looked for by all of them together. Once it is found, the tags gathered are mapped by
it, and the motion before the first contradiction counts as unknown.

Relocalisation is by geometry, from mapped tags and how far the robot can have got. Any two tags with range and bearing
give a pose, and one gives a ring of them. Each is judged by how many tags agree with it and by how far from the
expected pose it is: beyond some distance that counts no more, as the robot may have been kidnapped. Wrong ids and
outliers are outvoted, and where there are several answers none is known.
"""

from __future__ import annotations

import itertools
import logging
import math
from typing import NamedTuple

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, TagDetections, replace
from tfg_drake.slam.estimator_state import (
    KIDNAPPED,
    EstimatorState,
    OpenObservation,
    newest_of,
    opened,
    reduced_now,
    unknown_way,
)
from tfg_drake.slam.evidence import renewed
from tfg_drake.slam.keyframe import Keyframe, is_unknown, rows_of
from tfg_drake.slam.keyframe_graph import KeyframeGraph, decoupled
from tfg_drake.slam.localizer import Localizer, localized_pose, placed_localizer, restart_localizer, without_local
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.place_search import Prior, find_places, is_elsewhere, seen_at_once, tells_place
from tfg_drake.slam.shared import CAMERA_YAW, RANGE_SCALE, seen_from_body
from tfg_drake.slam.surface_fit import map_points, surface_points
from tfg_drake.table import take

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
# Squared deviations of a tag from where it should be, beyond which they say no more: it is misread, or was moved.
GATE = 3.5**2
# A tag may be this far from where the map has it, m.
MAP_SIGMA = 0.05
# That the robot was moved at all costs as much as these squared deviations, and that it was moved anywhere at most as
# much as two tags that disagree: so without an expected pose three tags must agree.
MOVED = 9.0
ANYWHERE = 2.0 * GATE
# The share of the mapped tags that must agree.
LEAST_SHARE = 0.6
# A landmark whose place in the map is less certain than this, m, is not where it seems.
LOOSE = 10.0
# Two tags nearer than this to each other tell no heading, m.
LEAST_BASE = 0.4
# Headings that are tried for each tag by itself, and tags that are tried, the surest.
HEADINGS = 16
MOST_TAGS = 12
# Among walls the robot is looked for after so many more looks, where its pose is no likelier than this or no more than
# such a share of what it has seen fits it within so much, m, m, rad, and three deviations, and is elsewhere if it has
# not found itself for so long, s.
LOOKS, LIKELY, LEAST_LIKE, LONGEST_SEARCH = 5, 0.5, 0.65, 5.0
HERE = np.array([0.05, 0.05, 0.02])
# It is somewhere in what it has just mapped: there a place is believed that is wrong with such a probability.
WRONG = 0.01
# That it has drifted, with such deviations, m, m, rad, is likelier than that somebody has carried it: by so much, as a
# logarithm. Nobody carries it farther than this, m: the other end of a building, not mapped yet, may be alike.
DRIFTED, CARRIED, FARTHEST = np.array([0.5, 0.5, 0.17]), -3.0, 10.0
# Deviations of a pose found among walls, m, m, rad: far more than of that, which what is seen from it tells again.
PLACED = np.array([0.1, 0.1, 0.03])
# Steps to the least squares.
STEPS = 8
# A pose is known when its deviations are below these, m, rad, and the next that is another place costs this
# much more.
KNOWN = np.array([0.3, 0.3, 0.1])
AHEAD = 6.0

_log, _operator = logging.getLogger("tfg_drake.slam"), logging.getLogger("tfg_drake.operator")


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


def find_itself(state: EstimatorState, *, at_last: bool = False) -> EstimatorState:
    """The state after a search for the pose in the map: the robot is lost or too many frames contradict its pose.

    at_last: what has been seen is about to be mapped. By walls it is mapped as if the robot were where it seems to be,
    unless it is found elsewhere or is known to be.
    """
    estimate, suspect, stamp = state.map, state.suspect, state.stamp
    if estimate is None or suspect is None:
        return state
    if not any(rows_of(frame.detections.ids, estimate.ids)[1].any() for frame in suspect.frames):
        return _found_among_walls(state, estimate, suspect, at_last=at_last)
    anywhere = math.isnan(state.placed)
    if at_last:
        return _found_among_walls(state, estimate, suspect, at_last=True) if anywhere else state
    seen = gathered(state, suspect)
    way = se2.between(suspect.begin.X_OB, state.X_OB)
    moved = np.sqrt(suspect.sigma**2 + PUSHES**2 + (suspect.unwatched * CARRIES) ** 2)
    X_MB = se2.compose(suspect.X_MB, way)
    expected = Expected(X_MB, None, KIDNAPPED) if anywhere else Expected(X_MB, suspect.sigma, moved)
    found = relocalize(estimate, seen, expected)
    if found is None:
        if state.kidnapped or disagreeing(estimate, seen, expected.X_MB) < LEAST_AGAINST:
            return state
        _log.warning("%.2f s: the tags in view contradict the pose; the robot looks for itself", stamp)
        # Tags met before the robot was moved have another place relative to it now.
        return begun_elsewhere(
            replace(state, localizer=without_local(state.localizer)), replace(opened(state), sigma=KIDNAPPED)
        )
    tags = take(seen, found.agreeing)
    # As far from what was expected as the search took it to be: two tags may say no more of where it is on their ring.
    sigma = moved if found.is_near and not anywhere else KIDNAPPED
    begun = replace(suspect, X_MB=se2.compose(found.X_MB, se2.inverse(way)), sigma=sigma)
    if not found.is_known:
        if not state.lost:
            _log.warning("%.2f s: the tags in view contradict the pose; the robot looks for itself", stamp)
        localizer = _restarted(state, estimate, found.X_MB, tags)
        return begun_elsewhere(replace(state, localizer=localizer, lost=True), begun)
    X_MB = expected.X_MB if state.lost else localized_pose(state.localizer, state.noise.now.walks, np.zeros(3), 0.0)[0]
    error = found.X_MB - X_MB
    error[2] = se2.wrap_angle(error[2])
    if not state.lost and not anywhere and error @ np.linalg.solve(found.covariance, error) < SAME_PLACE:
        return replace(state, contradictions=0, suspect=None)
    _tell_place(state, found.X_MB, error, f"{len(tags.ids)} mapped tags")
    # The ties of the newest views to the others may be wrong as well.
    graph = state.graph if anywhere else decoupled(state.graph, np.diag(KIDNAPPED**2), tags.ids)
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
    return begun_elsewhere(replace(state, placed=stamp) if anywhere else state, begun)


def _found_among_walls(
    state: EstimatorState, estimate: MapEstimate, suspect: OpenObservation, *, at_last: bool
) -> EstimatorState:
    """The state after a search for the pose by the surfaces seen since the first contradiction, once a second and at
    last."""
    looks, stamp = sum(len(frame.lines) > 0 for frame in suspect.frames), state.stamp
    if looks % LOOKS and not at_last:
        return state
    newest = newest_of(suspect)
    seen = surface_points(reduced_now(state, newest).keyframe, state.graph.shared.mean)
    if not tells_place(seen):
        return state
    expected, anywhere = newest.X_MB, math.isnan(state.placed)
    prior = None if anywhere or state.kidnapped else Prior(expected, DRIFTED, CARRIED, FARTHEST)
    places = find_places(known_points(state.graph), seen_at_once(seen), prior)
    if places.near(expected, HERE + 3.0 * suspect.sigma, LEAST_LIKE) > LIKELY and not state.kidnapped:
        return replace(state, contradictions=0, suspect=None)
    X_MA = places.found(WRONG)
    if X_MA is None:
        if state.kidnapped or (stamp - suspect.begin.stamp < LONGEST_SEARCH and not at_last):
            return state
        _log.warning("%.2f s: the walls in view contradict the pose; the robot looks for itself", stamp)
        return begun_elsewhere(state, replace(opened(state), sigma=KIDNAPPED))
    _tell_place(state, X_MA, X_MA - expected, "the walls")
    X_MB = se2.compose(X_MA, se2.between(newest.begin.X_OB, state.X_OB))
    localizer = placed_localizer(estimate, state.walls, X_MB, PLACED)
    placed = stamp if anywhere else state.placed
    state = replace(state, localizer=localizer, placed=placed, contradictions=0, lost=False, suspect=None)
    return begun_elsewhere(state, replace(newest, X_MB=X_MA, sigma=PLACED))


def _tell_place(state: EstimatorState, X_MB: FloatArray, error: FloatArray, by: str) -> None:
    """Tells where in its map the robot has found itself, which was anywhere, or how far (3,) from where it was thought
    to be."""
    (x, y, _), (dx, dy, turn), stamp = X_MB, error, state.stamp
    if math.isnan(state.placed):
        _operator.warning("%.2f s: the robot has found itself at (%.2f, %.2f) m of its map, by %s", stamp, x, y, by)
        return
    message = "%.2f s: the robot is %.2f m and %.2f rad from where its wheels have brought it; %s say so"
    _log.warning(message, stamp, math.hypot(dx, dy), abs(float(se2.wrap_angle(turn))), by)


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


def begun_elsewhere(state: EstimatorState, begun: OpenObservation) -> EstimatorState:
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


class Expected(NamedTuple):
    """The pose X_MB (3,) of a robot that nobody has moved. still: its deviations (3,), m, m, rad, None where it must
    have been moved; sigma: those of one that was moved as far as could go unnoticed."""

    X_MB: FloatArray
    still: FloatArray | None
    sigma: FloatArray


class Found(NamedTuple):
    """A pose X_MB (3,) and its covariance (3, 3), which of the tags (n,) agree with it, whether it was found near the
    expected one, and whether it is known: no other explains the tags as well."""

    X_MB: FloatArray
    covariance: FloatArray
    agreeing: BoolArray
    is_near: bool
    is_known: bool


class _Seen(NamedTuple):
    """Mapped tags (n, 2), m: in M and where they were seen in B, and the information (n, 2, 2) on the latter."""

    p_ML: FloatArray
    p_BL: FloatArray
    information: FloatArray


def relocalize(estimate: MapEstimate, detections: TagDetections, expected: Expected) -> Found | None:
    """The likeliest pose of a robot that has been moved, by a frame of tags; None where that says no more than that it
    has not."""
    seen, mapped = _mapped(estimate, detections)
    if not len(mapped):
        return None
    X, squared, cost, H = _refined(seen, _candidates(seen), expected)
    best = int(np.argmin(cost))
    agrees, unmoved = squared[best] < GATE, math.inf
    if expected.still is not None:
        still = expected._replace(sigma=expected.still)
        unmoved = float(_refined(seen, expected.X_MB[None], still)[2][0]) - MOVED
    if cost[best] >= unmoved or agrees.sum() < LEAST_SHARE * len(mapped):
        return None
    other = is_elsewhere(X, X[best])
    covariance = np.linalg.inv(H[best])
    known = np.all(np.diag(covariance) < KNOWN**2) and not np.any(cost[other] < cost[best] + AHEAD)
    inliers = np.zeros(len(detections.ids), dtype=bool)
    inliers[mapped[agrees]] = True
    near = bool(_distance(X[[best]], expected)[0] < ANYWHERE)
    return Found(X[best].copy(), covariance, inliers, near, bool(known))


def disagreeing(estimate: MapEstimate, detections: TagDetections, X_MB: FloatArray) -> int:
    """How many mapped tags of a frame are not where they should be, seen from a pose (3,)."""
    seen, _ = _mapped(estimate, detections)
    return int(np.count_nonzero(_squared(seen, X_MB[None]) >= GATE))


def _mapped(estimate: MapEstimate, detections: TagDetections) -> tuple[_Seen, IntArray]:
    """The mapped tags of a frame, and which of its tags (m,) these are."""
    row, known = rows_of(detections.ids, estimate.ids)
    mapped = np.flatnonzero(known)
    # Landmarks of a part that nothing ties tell nothing of the rest of the map.
    mapped = mapped[np.trace(estimate.landmark_covariance[row[mapped]], axis1=1, axis2=2) < LOOSE**2]
    r, b = detections.range[mapped], detections.bearing[mapped]
    direction = np.stack([np.cos(b), np.sin(b)], axis=1)
    across = direction[:, ::-1] * (-1.0, 1.0)
    along_information = 1.0 / (detections.sigma_range[mapped] ** 2 + MAP_SIGMA**2)
    across_information = 1.0 / ((r * detections.sigma_bearing[mapped]) ** 2 + MAP_SIGMA**2)
    information = along_information[:, None, None] * direction[:, :, None] * direction[:, None, :]
    information = information + across_information[:, None, None] * across[:, :, None] * across[:, None, :]
    return _Seen(estimate.p_ML[row[mapped]], r[:, None] * direction, information), mapped


def _candidates(seen: _Seen) -> FloatArray:
    """(k, 3) the poses that any two tags give, and some of those that each gives by itself."""
    tags = np.argsort(-np.linalg.det(seen.information), kind="stable")[:MOST_TAGS]
    pairs = np.array(list(itertools.combinations(tags, 2)), dtype=np.int64).reshape(-1, 2)
    i, j = pairs[np.hypot(*(seen.p_BL[pairs[:, 1]] - seen.p_BL[pairs[:, 0]]).T) >= LEAST_BASE].T
    in_M, in_B = seen.p_ML[j] - seen.p_ML[i], seen.p_BL[j] - seen.p_BL[i]
    theta = np.arctan2(in_M[:, 1], in_M[:, 0]) - np.arctan2(in_B[:, 1], in_B[:, 0])
    by_two = _placed(theta, 0.5 * (seen.p_ML[i] + seen.p_ML[j]), 0.5 * (seen.p_BL[i] + seen.p_BL[j]))
    theta = np.tile(np.arange(HEADINGS) * 2.0 * np.pi / HEADINGS, len(tags))
    by_one = _placed(theta, np.repeat(seen.p_ML[tags], HEADINGS, axis=0), np.repeat(seen.p_BL[tags], HEADINGS, axis=0))
    return np.concatenate([by_two, by_one])


def _placed(theta: FloatArray, p_ML: FloatArray, p_BL: FloatArray) -> FloatArray:
    """(k, 3) the poses with headings (k,) from which what is at p_BL (k, 2) lies at p_ML (k, 2)."""
    c, s = np.cos(theta), np.sin(theta)
    x, y = p_BL.T
    return np.column_stack([p_ML[:, 0] - c * x + s * y, p_ML[:, 1] - s * x - c * y, theta])


def _in_body(seen: _Seen, X: FloatArray) -> FloatArray:
    """(k, n, 2) where the mapped tags are from poses X (k, 3)."""
    c, s = np.cos(X[:, 2, None]), np.sin(X[:, 2, None])
    dx, dy = seen.p_ML[:, 0] - X[:, 0, None], seen.p_ML[:, 1] - X[:, 1, None]
    return np.stack([c * dx + s * dy, -s * dx + c * dy], axis=-1)


def _squared(seen: _Seen, X: FloatArray) -> FloatArray:
    """(k, n) squared deviations of the tags from where they should be, seen from poses X (k, 3)."""
    error = _in_body(seen, X) - seen.p_BL
    return np.asarray(np.einsum("kni,nij,knj->kn", error, seen.information, error))


def _distance(X: FloatArray, expected: Expected) -> FloatArray:
    """(k,) squared deviations of poses X (k, 3) from the expected one."""
    off = X - expected.X_MB
    off[:, 2] = se2.wrap_angle(off[:, 2])
    return np.asarray(np.minimum(np.square(off / expected.sigma).sum(axis=1), ANYWHERE))


def _refined(seen: _Seen, X: FloatArray, expected: Expected) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Poses (k, 3) brought to the least squares of the tags that agree with them, the squared deviations (k, n) of all
    tags, their costs (k,) and the information (k, 3, 3) on them."""
    for _ in range(STEPS):
        q, agrees = _in_body(seen, X), _squared(seen, X) < GATE
        c, s = np.cos(X[:, 2]), np.sin(X[:, 2])
        J = np.empty((*q.shape, 3))
        J[:, :, 0, 0], J[:, :, 0, 1], J[:, :, 0, 2] = -c[:, None], -s[:, None], q[:, :, 1]
        J[:, :, 1, 0], J[:, :, 1, 1], J[:, :, 1, 2] = s[:, None], -c[:, None], -q[:, :, 0]
        weighted = agrees[:, :, None, None] * np.einsum("nij,knja->knia", seen.information, J)
        H = np.einsum("knia,knib->kab", J, weighted) + 1e-4 * np.eye(3)
        g = np.einsum("knia,kni->ka", weighted, q - seen.p_BL)
        near = _distance(X, expected) < ANYWHERE
        off = X - expected.X_MB
        off[:, 2] = se2.wrap_angle(off[:, 2])
        H += near[:, None, None] * np.diag(expected.sigma**-2)
        g += near[:, None] * off / expected.sigma**2
        X = X - np.linalg.solve(H, g[:, :, None])[:, :, 0]
        X[:, 2] = se2.wrap_angle(X[:, 2])
    squared = _squared(seen, X)
    return X, squared, np.minimum(squared, GATE).sum(axis=1) + _distance(X, expected) + MOVED, H


def adrift(graph: KeyframeGraph) -> int:
    """The last of the keyframes that is an unknown way, behind which the map is adrift; -1 for none."""
    return max((j for j, one in enumerate(graph.keyframes) if is_unknown(one)), default=-1)


def known_points(graph: KeyframeGraph) -> FloatArray:
    """(p, 4) points with normals, in M, of all that is not adrift."""
    j = adrift(graph)
    return map_points(graph, range(j) if j >= 0 else None)


def seen_by(graph: KeyframeGraph, keyframes: tuple[Keyframe, ...]) -> BoolArray:
    """Which landmarks (n,) some keyframes have seen."""
    seen = np.zeros(len(graph.ids), dtype=bool)
    for one in keyframes:
        seen[rows_of(one.ids, graph.ids)[0]] = True
    return seen
