"""The keyframe graph: what was seen between one pose of the robot and the next, and where all that lies in the map.

Variables are the poses (nodes) N_0 .. N_k, N_0 the map's origin, and the landmarks L_i. Keyframe j ties N_j, N_j+1 and
the landmarks in it by one joint Gaussian, its own poses eliminated (the paper's sec. III). The graph is kept as plain
arrays; `map_solver` linearises and eliminates it.

Keyframes that follow each other and share landmarks are fused: the pose between them is marginalised out. So the graph
grows with the building, and little with the time that the robot drives about in it.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, Observation, message, replace
from tfg_drake.slam.camera_model import LEAST_SIGMA
from tfg_drake.slam.keyframe_kernels import fused_information

# Landmarks that two keyframes must share to be fused, or to tell without odometry how they lie to each other.
WITNESSES = 2
# Tags of a keyframe up to which others are fused with it.
FULL = 25
# Keyframes are fused only where they know the pose between them better than this, m: fusing linearises them about it.
MOST_DEVIATION = 0.02
# The newest keyframes stay as they are: a slip may still be found between them.
UNFUSED = 4
# Keyframes that fusing looks at, from the newest on.
RECENT = 64
# Range scales that differ by less are the same: a millimetre at ten metres.
SAME_SCALE = 1e-4


@message
class Keyframe:
    """The joint Gaussian, in A, of the tags seen from the pose A at its beginning to D at its end, and of D.

    ids: (n,) ascending, n may be 0: a way of which only odometry tells. p_AL: (n, 2), m. X_AD: (3,). information: (2n +
    3, 2n + 3) of (p_AL row by row, X_AD). range_scale: the error of scale taken out of its ranges. yaw: rad, the
    camera's in the body frame, all else given that; on_yaw: (2n + 3,) derivative of (p_AL row by row, X_AD) on it.
    on_error: (2n + 3, 2n) the same on the constant errors of range, m, and bearing, rad, of each of its tags.
    error_curvature: (2n, 2n) and error_slope: (2n,) of half its squared error over those: what it says of them alone.
    """

    ids: IntArray
    p_AL: FloatArray
    X_AD: FloatArray
    information: FloatArray
    range_scale: float
    yaw: float
    on_yaw: FloatArray
    on_error: FloatArray
    error_curvature: FloatArray
    error_slope: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """(2n + 3, 2n + 3), of (p_AL row by row, X_AD)."""
        covariance = np.linalg.inv(self.information)
        return 0.5 * (covariance + covariance.T)


Seen = TypeVar("Seen", Keyframe, Observation)


@message
class KeyframeGraph:
    """k keyframes, n landmarks, their current values, and how well the landmarks are known.

    keyframes: k. X_MN: (k + 1, 3) the poses between them. view_keyframe: (g,) the keyframe that each of g views
    lies in, X_AV: (g, 3) its arrival pose in that keyframe's frame. ids: (n,) ascending, p_ML: (n, 2), m.
    landmark_covariance: (n, 2, 2) of p_ML, where the landmark was not near at the last solve as it was before. entropy:
    of the landmarks, nats. pose_information: (3, 3) on the newest pose, given the landmarks; infinite at the origin.
    yaw: (2,) the camera's in the body frame, which all keyframes are given at, and its standard deviation, rad.
    yaw_prior: (2,) what each keyframe tells of it by itself. tag_error: (2,) standard deviation of the tags' constant
    errors, see `tag_error`.
    """

    keyframes: tuple[Keyframe, ...]
    X_MN: FloatArray
    view_keyframe: IntArray
    X_AV: FloatArray
    ids: IntArray
    p_ML: FloatArray
    landmark_covariance: FloatArray
    entropy: float
    pose_information: FloatArray
    yaw: FloatArray
    yaw_prior: FloatArray
    tag_error: FloatArray

    @property
    def X_MA(self) -> FloatArray:
        """(g, 3) arrival poses of the views."""
        return se2.compose(self.X_MN[self.view_keyframe], self.X_AV) if len(self.X_AV) else self.X_AV


def empty_graph(yaw: FloatArray | None = None) -> KeyframeGraph:
    """The graph before the first view. yaw: (2,) the camera's and its standard deviation, rad; none: it looks ahead."""
    none = np.empty(0, dtype=np.int64)
    yaw = np.array([0.0, LEAST_SIGMA]) if yaw is None else yaw
    return KeyframeGraph(
        keyframes=(),
        X_MN=np.zeros((1, 3)),
        view_keyframe=none,
        X_AV=np.empty((0, 3)),
        ids=none,
        p_ML=np.empty((0, 2)),
        landmark_covariance=np.empty((0, 2, 2)),
        entropy=0.0,
        pose_information=np.full((3, 3), np.inf),
        yaw=yaw,
        yaw_prior=yaw,
        tag_error=np.zeros(2),
    )


def empty_map() -> MapEstimate:
    """The map of stage 0: no landmark, the robot at the origin, known exactly."""
    none = np.empty(0, dtype=np.int64)
    nothing = Observation(
        ids=none,
        p_AL=np.empty((0, 2)),
        X_AD=np.zeros(3),
        covariance=np.zeros((3, 3)),
        stamps=np.empty(0),
        X_AB=np.empty((0, 3)),
    )
    return MapEstimate(
        stage=0,
        stamp=0.0,
        ids=none,
        p_ML=np.empty((0, 2)),
        X_MD=np.zeros(3),
        local=none,
        covariance=np.zeros((3, 3)),
        landmark_covariance=np.empty((0, 2, 2)),
        X_MA=np.empty((0, 3)),
        observation=nothing,
        entropy=0.0,
    )


def rows_of(ids: IntArray, known: IntArray) -> tuple[IntArray, BoolArray]:
    """Rows (m,) of some ids among the known ones (n,), ascending, and which of them are known (m,)."""
    if len(known) == 0:
        return np.zeros(len(ids), dtype=np.int64), np.zeros(len(ids), dtype=bool)
    row = np.minimum(np.searchsorted(known, ids), len(known) - 1)
    return row, np.asarray(known[row] == ids)


def keyframe(observation: Observation) -> Keyframe:
    """The keyframe of an observation. Raises numpy.linalg.LinAlgError where its covariance is singular."""
    root = np.linalg.inv(np.linalg.cholesky(observation.covariance))
    n = len(observation.ids)
    on_yaw = observation.on_yaw if len(observation.on_yaw) else np.zeros(2 * n + 3)
    on_error = np.zeros((2 * n + 3, 2 * n))
    if len(observation.on_error):
        on_error[:-3].reshape(n, 2, n, 2)[np.arange(n), :, np.arange(n)] = observation.on_error
    return Keyframe(
        observation.ids,
        observation.p_AL,
        observation.X_AD,
        root.T @ root,
        observation.range_scale,
        observation.yaw,
        on_yaw,
        on_error,
        np.zeros((2 * n, 2 * n)),
        np.zeros(2 * n),
    )


def at_yaw(one: Seen, yaw: float) -> Seen:
    """The same with the camera's yaw taken to be another one, rad."""
    if not len(one.on_yaw) or one.yaw == yaw:
        return replace(one, yaw=yaw)
    change = (yaw - one.yaw) * one.on_yaw
    return replace(one, p_AL=one.p_AL + change[:-3].reshape(-1, 2), X_AD=one.X_AD + change[-3:], yaw=yaw)


def without_tags(observation: Observation, ids: IntArray) -> Observation:
    """The observation with some tags marginalised out."""
    if len(ids) == 0:
        return observation
    keep = ~np.isin(observation.ids, ids)
    rows = np.concatenate([np.repeat(keep, 2), np.ones(3, dtype=bool)])
    return Observation(
        ids=observation.ids[keep],
        p_AL=observation.p_AL[keep],
        X_AD=observation.X_AD,
        covariance=observation.covariance[np.ix_(rows, rows)],
        stamps=observation.stamps,
        X_AB=observation.X_AB,
        range_scale=observation.range_scale,
        yaw=observation.yaw,
        on_yaw=observation.on_yaw[rows] if len(observation.on_yaw) else observation.on_yaw,
        on_error=observation.on_error[keep] if len(observation.on_error) else observation.on_error,
    )


def extended(graph: KeyframeGraph, observation: Observation, X_MD: FloatArray, *, is_view: bool) -> KeyframeGraph:
    """The graph with one keyframe more, which ends at X_MD (3,). New landmarks lie where it saw them.

    is_view: a turn or glance, whose arrival pose is looked up later; not a piece of the way.
    """
    k, X_MA = len(graph.keyframes), graph.X_MN[-1]
    _, known = rows_of(observation.ids, graph.ids)
    ids = np.concatenate([graph.ids, observation.ids[~known]])
    order = np.argsort(ids, kind="stable")
    new = int(np.count_nonzero(~known))
    return replace(
        graph,
        keyframes=(*graph.keyframes, keyframe(at_yaw(observation, float(graph.yaw[0])))),
        X_MN=np.vstack([graph.X_MN, X_MD]),
        view_keyframe=np.append(graph.view_keyframe, k) if is_view else graph.view_keyframe,
        X_AV=np.vstack([graph.X_AV, np.zeros(3)]) if is_view else graph.X_AV,
        ids=ids[order],
        p_ML=np.vstack([graph.p_ML, se2.transform(X_MA, observation.p_AL[~known])])[order],
        landmark_covariance=np.concatenate([graph.landmark_covariance, np.zeros((new, 2, 2))])[order],
    )


def fused(graph: KeyframeGraph) -> KeyframeGraph:
    """The graph with the poses marginalised out between recent keyframes that share landmarks.

    Two become one as long as it has no more than FULL landmarks; the newest UNFUSED stay. Fusing linearises only how
    the two lie to each other, and that is known to millimetres and milliradians.
    """
    keyframes, X_MN = list(graph.keyframes), graph.X_MN
    view_keyframe, X_AV, yaw_prior = graph.view_keyframe.copy(), graph.X_AV.copy(), graph.yaw_prior
    j = max(len(keyframes) - RECENT, 0)
    while j < len(keyframes) - UNFUSED - 1:
        both = _fusion(keyframes[j], keyframes[j + 1])
        if both is None:
            j += 1
            continue
        keyframes[j : j + 2] = [both[0]]
        yaw_prior = _with_parabola(yaw_prior, float(graph.yaw[0]), *both[2])
        X_MN = np.delete(X_MN, j + 1, axis=0)
        inside = view_keyframe == j + 1
        X_AV[inside] = se2.compose(both[1], X_AV[inside])
        view_keyframe[view_keyframe > j] -= 1
    if len(keyframes) == len(graph.keyframes):
        return graph
    return replace(
        graph,
        keyframes=tuple(keyframes),
        X_MN=X_MN,
        view_keyframe=view_keyframe,
        X_AV=X_AV,
        yaw_prior=yaw_prior,
    )


def _with_parabola(prior: FloatArray, yaw: float, slope: float, curvature: float) -> FloatArray:
    """A mean and standard deviation (2,), rad, with what an error says that has this slope and curvature at a yaw."""
    information = prior[1] ** -2 + curvature
    return np.array([prior[0] + (curvature * (yaw - prior[0]) - slope) / information, information**-0.5])


def _fusion(first: Keyframe, second: Keyframe) -> tuple[Keyframe, FloatArray, tuple[float, float]] | None:
    """Two keyframes as one, the pose (3,) between them in its frame, and slope and curvature of their own error over
    the camera's yaw; None where they are to stay two."""
    if min(len(first.ids), len(second.ids)) < WITNESSES or max(len(first.ids), len(second.ids)) > FULL:
        return None
    ids = np.union1d(first.ids, second.ids)
    if len(ids) > FULL or len(first.ids) + len(second.ids) - len(ids) < WITNESSES:
        return None
    rows = np.searchsorted(ids, first.ids), np.searchsorted(ids, second.ids)
    p_AL = np.empty((len(ids), 2))
    p_AL[rows[1]] = se2.transform(first.X_AD, second.p_AL)
    p_AL[rows[0]] = first.p_AL
    p_AL, X_AB, X_AD, information, on, curvature, slope, deviation = fused_information(
        rows[0],
        first.p_AL,
        first.X_AD,
        first.information,
        *_over_yaw_and_errors(first),
        rows[1],
        second.p_AL,
        second.X_AD,
        second.information,
        *_over_yaw_and_errors(second),
        p_AL,
    )
    if deviation > MOST_DEVIATION:
        return None
    of_errors = on[:, 1:].copy(), curvature[1:, 1:].copy(), slope[1:].copy()
    both = Keyframe(ids, p_AL, X_AD, information, second.range_scale, second.yaw, on[:, 0].copy(), *of_errors)
    return both, X_AB, (float(slope[0]), max(float(curvature[0, 0]), 0.0))


def _over_yaw_and_errors(one: Keyframe) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What `fused_information` takes of a keyframe over the camera's yaw and its tags' errors."""
    size = 1 + len(one.error_slope)
    curvature = np.zeros((size, size))
    curvature[1:, 1:] = one.error_curvature
    return np.column_stack([one.on_yaw, one.on_error]), curvature, np.append(0.0, one.error_slope)


def rescaled(graph: KeyframeGraph, range_scale: float) -> KeyframeGraph:
    """The graph with the error of range scale, as it is known now, taken out of all keyframes.

    What a keyframe saw grows or shrinks about A. So does its way: the ranges tell its length better than the wheels.
    """

    def again(one: Keyframe) -> Keyframe:
        if abs(one.range_scale - range_scale) < SAME_SCALE:
            return one
        share = (1.0 + one.range_scale) / (1.0 + range_scale)
        X_AD = one.X_AD * np.array([share, share, 1.0])
        return replace(one, p_AL=one.p_AL * share, X_AD=X_AD, range_scale=range_scale)

    keyframes = tuple(again(one) for one in graph.keyframes)
    if all(new is old for new, old in zip(keyframes, graph.keyframes, strict=True)):
        return graph
    return replace(graph, keyframes=keyframes)


def forget(graph: KeyframeGraph, ids: IntArray) -> KeyframeGraph:
    """The graph without some landmarks, as if they had never been seen: they stand elsewhere now."""
    keep = ~np.isin(graph.ids, ids)
    lost = np.linalg.slogdet(2.0 * math.pi * math.e * graph.landmark_covariance[~keep])[1]
    return replace(
        graph,
        keyframes=tuple(_forgetting(one, ids) for one in graph.keyframes),
        ids=graph.ids[keep],
        p_ML=graph.p_ML[keep],
        landmark_covariance=graph.landmark_covariance[keep],
        entropy=graph.entropy - 0.5 * float(np.sum(lost)),
    )


def taken_back(graph: KeyframeGraph, tag: int, keyframe: int) -> KeyframeGraph:
    """The graph as if one of its keyframes, by its index, had not seen a landmark that others have seen."""
    one = _forgetting(graph.keyframes[keyframe], np.array([tag]))
    return replace(graph, keyframes=(*graph.keyframes[:keyframe], one, *graph.keyframes[keyframe + 1 :]))


def _forgetting(one: Keyframe, ids: IntArray) -> Keyframe:
    """The keyframe with some tags marginalised out, and with them what it says of errors by itself."""
    keep = ~np.isin(one.ids, ids)
    if keep.all():
        return one
    rows = np.concatenate([np.repeat(keep, 2), np.ones(3, dtype=bool)])
    W = one.information
    gone = np.linalg.solve(W[np.ix_(~rows, ~rows)], W[np.ix_(~rows, rows)])
    information = W[np.ix_(rows, rows)] - W[np.ix_(rows, ~rows)] @ gone
    information = 0.5 * (information + information.T)
    return replace(
        one,
        ids=one.ids[keep],
        p_AL=one.p_AL[keep],
        information=information,
        on_yaw=one.on_yaw[rows],
        on_error=one.on_error[np.ix_(rows, rows[:-3])],
        error_curvature=np.zeros((2 * keep.sum(), 2 * keep.sum())),
        error_slope=np.zeros(2 * keep.sum()),
    )


def decoupled(graph: KeyframeGraph, covariance: FloatArray, found_by: IntArray) -> KeyframeGraph:
    """The graph with the newest keyframes decoupled: where only odometry ties them to those before, this covariance
    (3, 3) takes the place of odometry's, as odometry has been found wrong there.

    It goes back to the newest keyframe that shares WITNESSES landmarks with those before it, or that saw one of the
    landmarks found_by (f,), by which the robot has found itself.
    """
    for j in range(len(graph.keyframes) - 1, 0, -1):
        one = graph.keyframes[j]
        before = np.concatenate([other.ids for other in graph.keyframes[:j]])
        if np.isin(one.ids, before).sum() >= WITNESSES or np.isin(one.ids, found_by).any():
            break
        if not len(one.ids):
            loose = replace(one, information=np.asarray(np.linalg.inv(covariance)), on_yaw=np.zeros(3))
            graph = replace(graph, keyframes=(*graph.keyframes[:j], loose, *graph.keyframes[j + 1 :]))
        elif len(graph.keyframes[j - 1].ids):
            nothing = np.empty(0, dtype=np.int64)
            loose = replace(
                one,
                ids=nothing,
                p_AL=np.empty((0, 2)),
                X_AD=np.zeros(3),
                information=np.asarray(np.linalg.inv(covariance)),
                on_yaw=np.zeros(3),
                on_error=np.zeros((3, 0)),
                error_curvature=np.zeros((0, 0)),
                error_slope=np.zeros(0),
            )
            later = graph.view_keyframe >= j
            graph = replace(
                graph,
                keyframes=(*graph.keyframes[:j], loose, *graph.keyframes[j:]),
                X_MN=np.insert(graph.X_MN, j, graph.X_MN[j], axis=0),
                view_keyframe=graph.view_keyframe + later,
            )
    return graph
