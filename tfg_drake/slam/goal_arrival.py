"""A new goal joins the graph: its first place in the map, and which of its tags contradict what is known."""

from __future__ import annotations

import math

import numpy as np
import scipy.linalg

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, GoalObservation, IntArray, MapEstimate
from tfg_drake.slam.departure_frame import in_departure_frame
from tfg_drake.slam.goal_graph import GoalGraph, goal_factor, rows_of, without_tags
from tfg_drake.slam.map_solver import with_landmarks

# Squared Mahalanobis distance of a known tag from what all others say, beyond which the tag is left out: of one seen
# often, which has then been moved or is tied to the wrong place, and of one hardly seen, perhaps a misread id (99 %).
REJECTED = 49.0
HARDLY_SEEN_REJECTED = 9.2
# Covariance of what joins two pieces of one way: nothing lies between them.
JOINT = np.eye(3) * 1e-10
NO_IDS = np.empty(0, dtype=np.int64)


def add_goal(
    graph: GoalGraph,
    map_estimate: MapEstimate | None,
    observation: GoalObservation,
    X_DA: FloatArray,
    segment_covariance: FloatArray,
    way: tuple[GoalObservation, ...] = (),
    hardly_seen: BoolArray | None = None,
) -> tuple[GoalGraph, IntArray]:
    """The graph with one goal more, not yet solved, and the ids of the known tags left out of that goal.

    map_estimate: of the graph so far. X_DA (3,), segment_covariance (3, 3): the segment that led here, not used at
    the first goal. way: the pieces mapped on the way, which begin where the last goal ended and take the segment's
    place. A known tag that grossly contradicts the map, given the way there and all other tags, is left out; one of the
    observation's (n,) tags that was hardly_seen, by default none, if it contradicts the map at all.
    """
    limit = np.full(len(observation.ids), REJECTED)
    if hardly_seen is not None:
        limit[hardly_seen] = HARDLY_SEEN_REJECTED
    if map_estimate is None:
        X_MA = se2.compose(graph.X_MD[-1], X_DA) if graph.observations else np.zeros(3)
        return _append(graph, observation, X_MA, X_DA, segment_covariance, segment_covariance, True), NO_IDS
    solved, travelled, uncertainty = graph, X_DA, segment_covariance
    if way:
        travelled, uncertainty = np.zeros(3), JOINT
        X_DA, segment_covariance = travelled, JOINT
    for piece in way:
        gross = np.full(len(piece.ids), REJECTED)
        X_MA, _, rejected = _arrival(solved, map_estimate, piece, gross, travelled, uncertainty)
        graph = _append(graph, without_tags(piece, rejected), X_MA, np.zeros(3), JOINT, JOINT, False)
        travelled, uncertainty = _further(travelled, uncertainty, piece)
        uncertainty = uncertainty + JOINT
    X_MA, travel_covariance, rejected = _arrival(solved, map_estimate, observation, limit, travelled, uncertainty)
    if way:
        travel_covariance = JOINT
    observation = without_tags(observation, rejected)
    return _append(graph, observation, X_MA, X_DA, segment_covariance, travel_covariance, True), rejected


def _append(
    graph: GoalGraph,
    observation: GoalObservation,
    X_MA: FloatArray,
    X_DA: FloatArray,
    segment_covariance: FloatArray,
    travel_covariance: FloatArray,
    is_goal: bool,
) -> GoalGraph:
    """The graph with one piece more, at X_MA (3,): X_DA (3,) after the last one, with the covariances (3, 3) of the
    segment and of the way as far as all that is known."""
    row, known = rows_of(observation.ids, graph.ids)
    sightings = graph.sightings.copy()
    sightings[row[known]] += 1
    ids = np.concatenate([graph.ids, observation.ids[~known]])
    order = np.argsort(ids, kind="stable")
    new = int(np.count_nonzero(~known))
    _, travel_covariance = _further(X_DA, travel_covariance, observation)
    first = not graph.observations
    return GoalGraph(
        observations=(*graph.observations, goal_factor(observation)),
        is_goal=np.append(graph.is_goal, is_goal),
        X_DA=graph.X_DA if first else np.vstack([graph.X_DA, X_DA]),
        segment_covariance=_append_to(graph.segment_covariance, segment_covariance, not first),
        X_MA=np.vstack([graph.X_MA, X_MA]),
        X_MD=np.vstack([graph.X_MD, se2.compose(X_MA, observation.X_AD)]),
        ids=ids[order],
        p_ML=np.vstack([graph.p_ML, se2.transform(X_MA, observation.p_AL[~known])])[order],
        sightings=np.append(sightings, np.ones(new, dtype=np.int64))[order],
        travel_covariance=_append_to(graph.travel_covariance, travel_covariance, not first),
        departure_covariance=_append_to(graph.departure_covariance, np.full((3, 3), np.inf)),
        landmark_covariance=np.concatenate([graph.landmark_covariance, np.zeros((new, 2, 2))])[order],
        entropy=graph.entropy,
    )


def _append_to(covariances: FloatArray, covariance: FloatArray, wanted: bool = True) -> FloatArray:
    return np.concatenate([covariances, covariance[None]]) if wanted else covariances


def _further(travelled: FloatArray, uncertainty: FloatArray, piece: GoalObservation) -> tuple[FloatArray, FloatArray]:
    """The way travelled (3,) and its covariance (3, 3) with a piece more."""
    X = se2.compose(travelled, piece.X_AD)
    by_way, by_piece = np.eye(3), np.eye(3)
    by_way[:2, 2] = -(X[1] - travelled[1]), X[0] - travelled[0]
    by_piece[:2, :2] = se2.rotation(float(travelled[2]))
    covariance = by_way @ uncertainty @ by_way.T + by_piece @ piece.covariance[-3:, -3:] @ by_piece.T
    return X, 0.5 * (covariance + covariance.T)


def _arrival(
    graph: GoalGraph,
    map_estimate: MapEstimate,
    observation: GoalObservation,
    limit: FloatArray,
    X_DA: FloatArray,
    segment_covariance: FloatArray,
) -> tuple[FloatArray, FloatArray, IntArray]:
    """X_MA (3,) of a new goal as map, segment and its known tags have it, the covariance (3, 3) of the way there from
    the last departure, of (x, y) in D and theta, and the ids of tags that contradict them.

    Iterated updates of (known tags, A), in the last departure frame D, by the observation; each tag is then compared
    with what all others predict of it, and the worst leaves until none is farther off than its limit (n,). The pose
    serves as an initial value only.
    """
    row, known = rows_of(observation.ids, map_estimate.ids)
    elsewhere = ~np.isin(row[known], map_estimate.local)
    if elsewhere.any():
        place = se2.compose(map_estimate.X_MD, X_DA)[:2]
        map_estimate = with_landmarks(graph, map_estimate, row[known][elsewhere], place)
    in_goal = np.flatnonzero(known)
    p_DL, prior = in_departure_frame(map_estimate, row[known])
    kept = np.arange(len(in_goal))
    covariance = segment_covariance
    while len(kept) > 0:
        rows = np.repeat(2 * kept, 2) + np.tile([0, 1], len(kept))
        aligned, posterior, distance = _align(
            p_DL[kept], prior[np.ix_(rows, rows)], X_DA, segment_covariance, observation, in_goal[kept]
        )
        excess = distance / limit[in_goal[kept]]
        if np.max(excess) <= 1.0:
            X_DA, covariance = aligned, posterior
            break
        kept = np.delete(kept, np.argmax(excess))
    rejected = np.setdiff1d(observation.ids[in_goal], observation.ids[in_goal[kept]])
    return se2.compose(map_estimate.X_MD, X_DA), covariance, rejected


def _align(
    p_DL: FloatArray,
    tag_covariance: FloatArray,
    X_DA: FloatArray,
    segment_covariance: FloatArray,
    observation: GoalObservation,
    in_goal: IntArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """X_DA (3,) by an iterated Kalman update, its covariance (3, 3), and (m,) squared Mahalanobis distance of each tag
    from the others.

    p_DL (m, 2) with covariance (2m, 2m): the known tags in D. in_goal: (m,) their rows in the observation.
    """
    m = len(in_goal)
    prior = scipy.linalg.block_diag(tag_covariance, segment_covariance)
    rows = np.repeat(2 * in_goal, 2) + np.tile([0, 1], m)
    noise = observation.covariance[np.ix_(rows, rows)]
    x_0 = np.concatenate([p_DL.ravel(), X_DA])
    x = x_0
    for _ in range(4):
        R_DA = se2.rotation(float(x[-1]))
        in_A = (x[:-3].reshape(-1, 2) - x[-3:-1]) @ R_DA
        H = np.zeros((2 * m, 2 * m + 3))
        for i in range(m):
            H[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = R_DA.T
            H[2 * i : 2 * i + 2, -3:-1] = -R_DA.T
        H[0::2, -1], H[1::2, -1] = in_A[:, 1], -in_A[:, 0]
        step = x_0 - x
        step[-1] = math.remainder(step[-1], 2.0 * math.pi)
        innovation = (observation.p_AL[in_goal] - in_A).ravel() - H @ step
        information = np.linalg.inv(H @ prior @ H.T + noise)
        weighted = information @ innovation
        x = x_0 + prior @ H.T @ weighted
    distance = np.array(
        [
            weighted[2 * i : 2 * i + 2]
            @ np.linalg.solve(information[2 * i : 2 * i + 2, 2 * i : 2 * i + 2], weighted[2 * i : 2 * i + 2])
            for i in range(m)
        ]
    )
    aligned = x[-3:].copy()
    aligned[2] = math.remainder(aligned[2], 2.0 * math.pi)
    by_sightings = H @ prior[:, -3:]
    posterior = prior[-3:, -3:] - by_sightings.T @ information @ by_sightings
    return aligned, 0.5 * (posterior + posterior.T), distance
