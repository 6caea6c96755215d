"""The keyframe graph: keyframes, their poses and landmarks in the map, and the shared parameters.

Unknowns are the poses (nodes) N_0 .. N_k, N_0 the map's origin, the landmarks L_i and the shared parameters. Keyframe j
ties N_j, N_j+1, its landmarks and the parameters by one Gaussian. `map_solver` finds the values.

Consecutive keyframes that share landmarks are fused: the pose between them is marginalised out. So the graph grows with
the building, and hardly with the driving time.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from typing import Annotated

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, Observation, message, replace
from tfg_drake.slam.keyframe import Keyframe, fusion, is_unknown, joined_reach, placed, rows_of, without_tags
from tfg_drake.slam.shared import Shared
from tfg_drake.slam.surfaces import Ties, no_ties
from tfg_drake.table import empty, take

# Number of common landmarks with which two keyframes can be fused, or determine their relative pose without odometry.
WITNESSES = 2
# A keyframe with this number of landmarks is full and is not fused any more.
FULL = 25
# Two keyframes are fused if they determine the pose between them within MOST_DEVIATION, m, about which they are
# linearised; if both have scan points, within WITH_POINTS, m, as the points' relative position is fixed from then on,
# and half of its error must be small against `surfaces.FLOOR`.
MOST_DEVIATION, WITH_POINTS = 0.02, 0.005
# Number of the newest keyframes that are not fused, as a slip may still be found between them.
UNFUSED = 4


@message
class KeyframeGraph:
    """k keyframes, n landmarks, their current values, and the uncertainty of the landmarks.

    keyframes: k. X_MN: (k + 1, 3) the poses between them. view_keyframe: (g,) the keyframe that each of g views lies
    in, X_AV: (g, 3) its arrival pose in that keyframe's frame. ids: (n,) ascending, p_ML, anchor, reach: (n, 2), see
    `messages.MapEstimate`. landmark_covariance: (n, 2, 2) of p_ML; that of landmarks not near at the last solve is
    older. entropy: of all landmarks, nats, entropy_beyond: the part to add to that of the jointly known landmarks; zero
    if all are. prior: of the shared parameters, without the keyframes. shared: their estimate. tag_error: (2,) standard
    deviations of the tags' constant errors, see `tag_error`. solver: one of `config.SOLVERS`, ties: of loops while a
    path is bent; not part of a saved map. unevenness: m, see `scan_lines.unevenness_after`. sessions: (s,) the
    recordings or missions in the graph, each by a digest of its first view.
    """

    keyframes: Annotated[tuple[Keyframe, ...], "k"]
    X_MN: Annotated[FloatArray, "k+1", 3]
    view_keyframe: Annotated[IntArray, "g"]
    X_AV: Annotated[FloatArray, "g", 3]
    ids: Annotated[IntArray, "n"]
    p_ML: Annotated[FloatArray, "n", 2]
    anchor: Annotated[FloatArray, "n", 2]
    reach: Annotated[FloatArray, "n", 2]
    landmark_covariance: Annotated[FloatArray, "n", 2, 2]
    entropy: float
    entropy_beyond: float
    prior: Shared
    shared: Shared
    tag_error: Annotated[FloatArray, 2]
    solver: str = dataclasses.field(default="dissection", metadata={"kept": False})
    ties: Ties = dataclasses.field(default_factory=no_ties, metadata={"kept": False})
    unevenness: float = 0.0
    sessions: Annotated[IntArray, "s"] = dataclasses.field(default_factory=lambda: np.empty(0, dtype=np.int64))

    @property
    def X_MA(self) -> FloatArray:
        """The arrival poses (g, 3) of the views."""
        return se2.compose(self.X_MN[self.view_keyframe], self.X_AV) if len(self.X_AV) else self.X_AV

    @property
    def unknowns(self) -> dict[str, int]:
        """Number of scalar unknowns of the factor graph: of tags and walls, of poses but the origin, and shared."""
        return {"landmarks": self.p_ML.size, "poses": self.X_MN[1:].size, "calibration": len(self.shared.mean)}


def empty_graph(prior: Shared, solver: str = "dissection") -> KeyframeGraph:
    """Return the graph before the first view."""
    return empty(KeyframeGraph, prior=prior, shared=prior, solver=solver)


def empty_map(prior: Shared | None = None) -> MapEstimate:
    """Return the map of stage 0: no landmarks, the robot exactly at the origin, the shared parameters by their prior,
    or omitted without one."""
    shared, covariance = (prior.mean, prior.covariance) if prior is not None else (np.zeros(0), np.zeros((0, 0)))
    return empty(MapEstimate, shared=shared, with_shared=np.vstack([np.zeros((3, len(shared))), covariance]))


def no_observation() -> Observation:
    """Return an empty observation."""
    return empty(Observation)


def extended(graph: KeyframeGraph, one: Keyframe, X_MD: FloatArray, *, is_view: bool) -> KeyframeGraph:
    """Return the graph with one keyframe more, which ends at X_MD (3,), and with new landmarks where it saw them.

    is_view: True for a turn or glance, whose arrival pose is needed later; False for a piece of the way.
    """
    k, X_MA = len(graph.keyframes), graph.X_MN[-1]
    row, known = rows_of(one.ids, graph.ids)
    p_ML, anchor = placed(X_MA, one.ids, one.given(graph.shared.mean)[0], one.anchor)
    ids = np.concatenate([graph.ids, one.ids[~known]])
    order = np.argsort(ids, kind="stable")
    new, reach, again = int(np.count_nonzero(~known)), graph.reach.copy(), np.flatnonzero(known[: one.walls])
    at = row[again]
    sessions = _session(one) if is_view and not len(graph.sessions) else graph.sessions
    reach[at] = joined_reach(graph.p_ML[at], graph.anchor[at], reach[at], anchor[again], one.reach[again])
    return replace(
        graph,
        keyframes=(*graph.keyframes, one),
        X_MN=np.vstack([graph.X_MN, X_MD]),
        view_keyframe=np.append(graph.view_keyframe, k) if is_view else graph.view_keyframe,
        X_AV=np.vstack([graph.X_AV, np.zeros(3)]) if is_view else graph.X_AV,
        ids=ids[order],
        p_ML=np.vstack([graph.p_ML, p_ML[~known]])[order],
        anchor=np.vstack([graph.anchor, anchor[~known]])[order],
        reach=np.vstack([reach, one.reach[~known]])[order],
        landmark_covariance=np.concatenate([graph.landmark_covariance, np.zeros((new, 2, 2))])[order],
        sessions=sessions,
    )


def _session(first: Keyframe) -> IntArray:
    """Return the digest (1,) of a session's first view; no two sessions see the same to the bit."""
    digest = hashlib.blake2b(first.y_AL.tobytes() + first.information.tobytes(), digest_size=8).digest()
    return np.frombuffer(digest, dtype=np.int64)


def moved_part(graph: KeyframeGraph, landmarks: BoolArray, move: FloatArray) -> KeyframeGraph:
    """Return the graph with some landmarks (n,) moved by a pose (3,) in M; its poses stay."""
    p_ML, anchor = graph.p_ML.copy(), graph.anchor.copy()
    p_ML[landmarks], anchor[landmarks] = placed(move, graph.ids[landmarks], p_ML[landmarks], anchor[landmarks])
    return replace(graph, p_ML=p_ML, anchor=anchor)


def fused(graph: KeyframeGraph, tried: int = 0) -> KeyframeGraph:
    """Return the graph with recent keyframes that share landmarks fused: the poses between them are marginalised out.

    A fused keyframe has at most FULL landmarks; the newest UNFUSED keyframes stay. Fusing linearises only the relative
    pose of the two, which is known to millimetres and milliradians. tried: number of keyframes at the last call.
    """
    keyframes, X_MN = list(graph.keyframes), graph.X_MN
    view_keyframe, X_AV = graph.view_keyframe.copy(), graph.X_AV.copy()
    j = max(tried - UNFUSED - 2, 0)
    while j < len(keyframes) - UNFUSED - 1:
        first, second = keyframes[j], keyframes[j + 1]
        shared = len(np.intersect1d(first.ids, second.ids))
        may = first.unit == second.unit and shared >= WITNESSES and len(first.ids) + len(second.ids) - shared <= FULL
        both, X_AB, deviation = fusion(first, second, graph.shared.mean) if may else (first, np.zeros(3), math.inf)
        if deviation > (WITH_POINTS if len(first.points) and len(second.points) else MOST_DEVIATION):
            j += 1
            continue
        keyframes[j : j + 2] = [both]
        X_MN = np.delete(X_MN, j + 1, axis=0)
        inside = view_keyframe == j + 1
        X_AV[inside] = se2.compose(X_AB, X_AV[inside])
        view_keyframe[view_keyframe > j] -= 1
    if len(keyframes) == len(graph.keyframes):
        return graph
    return replace(graph, keyframes=tuple(keyframes), X_MN=X_MN, view_keyframe=view_keyframe, X_AV=X_AV)


def forget(graph: KeyframeGraph, ids: IntArray) -> KeyframeGraph:
    """Return the graph without some landmarks, as if they had never been seen, as they have moved."""
    keep = ~np.isin(graph.ids, ids)
    lost = np.linalg.slogdet(2.0 * math.pi * math.e * graph.landmark_covariance[~keep])[1]
    keyframes = tuple(without_tags(one, ids) for one in graph.keyframes)
    return replace(take(graph, n=keep), keyframes=keyframes, entropy=graph.entropy - 0.5 * float(np.sum(lost)))


def taken_back(graph: KeyframeGraph, tag: int, keyframe: int) -> KeyframeGraph:
    """Return the graph as if the keyframe of an index had not seen a landmark, which others have seen."""
    one = without_tags(graph.keyframes[keyframe], np.array([tag]))
    return replace(graph, keyframes=(*graph.keyframes[:keyframe], one, *graph.keyframes[keyframe + 1 :]))


def adrift(graph: KeyframeGraph) -> int:
    """Return the index of the last keyframe of unknown motion after which the map is adrift, that is no landmark was
    seen both before and since; -1 for none."""
    j = max((j for j, one in enumerate(graph.keyframes) if is_unknown(one)), default=-1)
    tied = j >= 0 and (seen_by(graph, graph.keyframes[:j]) & seen_by(graph, graph.keyframes[j + 1 :])).any()
    return -1 if tied else j


def seen_by(graph: KeyframeGraph, keyframes: tuple[Keyframe, ...]) -> BoolArray:
    """Return a mask (n,) of the landmarks that some keyframes have seen."""
    seen = np.zeros(len(graph.ids), dtype=bool)
    for one in keyframes:
        seen[rows_of(one.ids, graph.ids)[0]] = True
    return seen


def tied(graph: KeyframeGraph) -> BoolArray:
    """Return a mask (n,) of the landmarks tied to the newest pose: all, or only those of the newest part of the map if
    that is adrift."""
    j = adrift(graph)
    return seen_by(graph, graph.keyframes[j + 1 :]) if j >= 0 else np.ones(len(graph.ids), dtype=np.bool_)


def of_tied(estimate: MapEstimate, graph: KeyframeGraph) -> MapEstimate:
    """Return the map of a graph with walls not tied to the newest pose out of reach, as they may be anywhere."""
    return replace(estimate, reach=np.where(tied(graph)[:, None], estimate.reach, [np.inf, -np.inf]))
