"""The map: a factor graph of goals and landmarks, one joint factor a goal, one between-factor a segment.

Variables: arrival pose A_k and departure pose D_k of every goal, landmarks L_i; A_0 is the map's origin. The graph is
kept as plain arrays and built in GTSAM for each solve. The map estimate is its MAP value and marginal covariance
(the paper's sec. III).
"""

from __future__ import annotations

import contextlib
import math
import weakref
from collections.abc import Callable

import gtsam
import numpy as np
import scipy.linalg
from gtsam.symbol_shorthand import A, D, L

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, GoalObservation, IntArray, MapEstimate, message, replace
from tfg_drake.slam.departure_frame import in_departure_frame

# Squared Mahalanobis distance of a known tag from what all others say, beyond which the tag is left out.
REJECTED = 49.0
# Steps of one solve, at most, and the largest component (m, rad) of a step after which no other is needed.
MOST_STEPS = 20
SMALL_STEP = 1e-3
# Covariance of what joins two pieces of one way: nothing lies between them.
JOINT = np.eye(3) * 1e-10
# As good as zero.
NOTHING = 1e-150


@message
class GoalGraph:
    """The factors and current values of k goals and n landmarks.

    A piece of the way between two goals that is mapped too (a path keyframe) is kept as a goal is. observations: k,
    without the trajectories. is_goal: (k,) False for such pieces. X_DA: (k - 1, 3) and segment_covariance: (k - 1, 3,
    3), the segments from D_j to A_j+1, of (x, y) in D and theta. X_MA, X_MD: (k, 3). ids: (n,) ascending, p_ML: (n, 2).
    """

    observations: tuple[GoalObservation, ...]
    is_goal: BoolArray
    X_DA: FloatArray
    segment_covariance: FloatArray
    X_MA: FloatArray
    X_MD: FloatArray
    ids: IntArray
    p_ML: FloatArray


def empty_graph() -> GoalGraph:
    """The graph before the first goal."""
    return GoalGraph(
        observations=(),
        is_goal=np.empty(0, dtype=bool),
        X_DA=np.empty((0, 3)),
        segment_covariance=np.empty((0, 3, 3)),
        X_MA=np.empty((0, 3)),
        X_MD=np.empty((0, 3)),
        ids=np.empty(0, dtype=np.int64),
        p_ML=np.empty((0, 2)),
    )


def add_goal(
    graph: GoalGraph,
    map_estimate: MapEstimate | None,
    observation: GoalObservation,
    X_DA: FloatArray,
    segment_covariance: FloatArray,
    way: tuple[GoalObservation, ...] = (),
) -> tuple[GoalGraph, IntArray]:
    """The graph with one goal more, not yet solved, and the ids of the known tags left out of that goal.

    map_estimate: of the graph so far. X_DA (3,), segment_covariance (3, 3): the segment that led here, not used at
    the first goal. way: the pieces mapped on the way, which begin where the last goal ended and take the segment's
    place. A known tag that grossly contradicts the map, given the way there and all other tags, is left out.
    """
    travelled, uncertainty = X_DA, segment_covariance
    if way:
        travelled, uncertainty = np.zeros(3), np.zeros((3, 3))
    for piece in way:
        graph, _ = _append(graph, map_estimate, piece, travelled, uncertainty + JOINT, np.zeros(3), JOINT, False)
        travelled, uncertainty = _further(travelled, uncertainty, piece)
    if way:
        X_DA, segment_covariance = np.zeros(3), JOINT
        uncertainty = uncertainty + JOINT
    return _append(graph, map_estimate, observation, travelled, uncertainty, X_DA, segment_covariance, True)


def _append(
    graph: GoalGraph,
    map_estimate: MapEstimate | None,
    observation: GoalObservation,
    travelled: FloatArray,
    uncertainty: FloatArray,
    X_DA: FloatArray,
    segment_covariance: FloatArray,
    is_goal: bool,
) -> tuple[GoalGraph, IntArray]:
    """The graph with one piece more, X_DA (3,) after the last one and travelled (3,) from the map's last departure."""
    rejected = np.empty(0, dtype=np.int64)
    X_MA = np.zeros(3)
    if map_estimate is not None:
        X_MA, rejected = _arrival(map_estimate, observation, travelled, uncertainty)
        observation = without_tags(observation, rejected)
    elif graph.observations:
        X_MA = se2.compose(graph.X_MD[-1], X_DA)
    first = not graph.observations
    new = ~np.isin(observation.ids, graph.ids)
    ids = np.concatenate([graph.ids, observation.ids[new]])
    p_ML = np.vstack([graph.p_ML, se2.transform(X_MA, observation.p_AL[new])])
    order = np.argsort(ids)
    kept = GoalObservation(
        ids=observation.ids,
        p_AL=observation.p_AL,
        X_AD=observation.X_AD,
        covariance=observation.covariance,
        stamps=np.empty(0),
        X_AB=np.empty((0, 3)),
    )
    return (
        GoalGraph(
            observations=(*graph.observations, kept),
            is_goal=np.append(graph.is_goal, is_goal),
            X_DA=graph.X_DA if first else np.vstack([graph.X_DA, X_DA]),
            segment_covariance=graph.segment_covariance
            if first
            else np.concatenate([graph.segment_covariance, segment_covariance[None]]),
            X_MA=np.vstack([graph.X_MA, X_MA]),
            X_MD=np.vstack([graph.X_MD, se2.compose(X_MA, observation.X_AD)]),
            ids=ids[order],
            p_ML=p_ML[order],
        ),
        rejected,
    )


def _further(travelled: FloatArray, uncertainty: FloatArray, piece: GoalObservation) -> tuple[FloatArray, FloatArray]:
    """The way travelled (3,) and its covariance (3, 3) with a piece more."""
    X = se2.compose(travelled, piece.X_AD)
    by_way, by_piece = np.eye(3), np.eye(3)
    by_way[:2, 2] = -(X[1] - travelled[1]), X[0] - travelled[0]
    by_piece[:2, :2] = se2.rotation(float(travelled[2]))
    return X, by_way @ uncertainty @ by_way.T + by_piece @ piece.covariance[-3:, -3:] @ by_piece.T


def forget(graph: GoalGraph, ids: IntArray) -> GoalGraph:
    """The graph without some landmarks, as if they had never been seen: they stand elsewhere now."""
    keep = ~np.isin(graph.ids, ids)
    return replace(
        graph,
        observations=tuple(without_tags(observation, ids) for observation in graph.observations),
        ids=graph.ids[keep],
        p_ML=graph.p_ML[keep],
    )


def solve(graph: GoalGraph, stamp: float, observation: GoalObservation) -> tuple[GoalGraph, MapEstimate]:
    """The graph at its maximum a posteriori values, and the map: their joint Gaussian.

    stamp: s, observation: the newest goal's, with its trajectory; both go into the MapEstimate. Gauss-Newton steps by
    GTSAM's multifrontal elimination; Levenberg-Marquardt where a step fails to lower the error.
    """
    factors, values = factor_graph(graph), _values(graph)
    ordering = gtsam.Ordering.ColamdNonlinearFactorGraph(factors)
    error = factors.error(values)
    for _ in range(MOST_STEPS):
        linear = factors.linearize(values)
        step, moved = None, values
        # Without landmarks a long chain of loose segments from an exact origin may look singular to the elimination.
        with contextlib.suppress(RuntimeError):
            step = linear.optimize(ordering)
            moved = values.retract(step)
        moved_error = factors.error(moved)
        if step is None or not moved_error <= error + 1e-6 * (1.0 + error):
            moved = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
            moved_error = factors.error(moved)
            if not moved_error <= error + 1e-6 * (1.0 + error):
                break
        values, error = moved, moved_error
        if step is None or np.max(np.abs(step.vector())) < SMALL_STEP:
            break
    k = len(graph.observations)
    X_MA = np.array([_pose(values, A(i)) for i in range(k)])
    X_MA[0] = 0.0
    graph = replace(
        graph,
        X_MA=X_MA,
        X_MD=np.array([_pose(values, D(i)) for i in range(k)]),
        p_ML=np.array([values.atPoint2(L(int(tag))) for tag in graph.ids]).reshape(-1, 2),
    )
    covariance = _covariance(graph, factors.linearize(_values(graph)))
    landmarks = 2 * len(graph.ids)
    return graph, MapEstimate(
        stage=int(np.count_nonzero(graph.is_goal)),
        stamp=stamp,
        ids=graph.ids,
        p_ML=graph.p_ML,
        X_MD=graph.X_MD[-1],
        covariance=covariance,
        X_MA=graph.X_MA[graph.is_goal],
        observation=observation,
        entropy=_entropy(covariance[:landmarks, :landmarks]),
    )


def _covariance(graph: GoalGraph, linear: gtsam.GaussianFactorGraph) -> FloatArray:
    """(2n + 3, 2n + 3) covariance of all landmarks and the last departure pose.

    The other poses, a chain, are eliminated from GTSAM's linear system by a Schur complement and the rest is inverted:
    a third of the time of gtsam.Marginals at n = 274. The origin's rows are left out: it is known.
    """
    k, n = len(graph.observations), len(graph.ids)
    ordering = gtsam.Ordering()
    for i in range(k):
        ordering.push_back(A(i))
        if i < k - 1:
            ordering.push_back(D(i))
    for tag in graph.ids:
        ordering.push_back(L(int(tag)))
    ordering.push_back(D(k - 1))
    information = linear.hessian(ordering)[0][3:, 3:]
    split = len(information) - 2 * n - 3
    reduced = information[split:, split:]
    if split > 0:
        # Only consecutive poses share a factor.
        band = np.zeros((6, split))
        for i in range(min(6, split)):
            band[i, : split - i] = np.diagonal(information[:split, :split], -i)
        factor = scipy.linalg.cholesky_banded(band, lower=True, check_finite=False)
        half, _ = scipy.linalg.lapack.dtbtrs(factor, information[:split, split:], uplo="L")
        # What a goal says of landmarks far behind dies out; numbers with squares too small for a double cost most time.
        half[np.abs(half) < NOTHING] = 0.0
        reduced = reduced - half.T @ half
    upper, _ = scipy.linalg.lapack.dpotri(scipy.linalg.cholesky(reduced, check_finite=False))
    covariance = upper + upper.T
    np.fill_diagonal(covariance, np.diag(upper))
    # Pose2 increments are in the body's frame.
    R_MD = se2.rotation(float(graph.X_MD[-1, 2]))
    covariance[-3:-1] = R_MD @ covariance[-3:-1]
    covariance[:, -3:-1] = covariance[:, -3:-1] @ R_MD.T
    return np.asarray(covariance)


def empty_map() -> MapEstimate:
    """The map of stage 0: no landmark, the robot at the origin, known exactly."""
    nothing = GoalObservation(
        ids=np.empty(0, dtype=np.int64),
        p_AL=np.empty((0, 2)),
        X_AD=np.zeros(3),
        covariance=np.zeros((3, 3)),
        stamps=np.empty(0),
        X_AB=np.empty((0, 3)),
    )
    return MapEstimate(
        stage=0,
        stamp=0.0,
        ids=np.empty(0, dtype=np.int64),
        p_ML=np.empty((0, 2)),
        X_MD=np.zeros(3),
        covariance=np.zeros((3, 3)),
        X_MA=np.empty((0, 3)),
        observation=nothing,
        entropy=0.0,
    )


def factor_graph(graph: GoalGraph) -> gtsam.NonlinearFactorGraph:
    """The graph in GTSAM: A(k), D(k) as Pose2, L(id) as Point2, the origin tied by a tight prior on A(0)."""
    factors = gtsam.NonlinearFactorGraph()
    factors.add(gtsam.PriorFactorPose2(A(0), gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-7)))
    for k, observation in enumerate(graph.observations):
        keys = [A(k), D(k), *(L(int(tag)) for tag in observation.ids)]
        unit = gtsam.noiseModel.Unit.Create(2 * len(observation.ids) + 3)
        factors.add(gtsam.CustomFactor(unit, keys, _goal_error(keys, observation)))
    for j, X_DA in enumerate(graph.X_DA):
        R = se2.rotation(float(X_DA[2]))
        covariance = graph.segment_covariance[j].copy()
        covariance[:2] = R.T @ covariance[:2]
        covariance[:, :2] = covariance[:, :2] @ R
        noise = gtsam.noiseModel.Gaussian.Covariance(0.5 * (covariance + covariance.T))
        factors.add(gtsam.BetweenFactorPose2(D(j), A(j + 1), gtsam.Pose2(*X_DA), noise))
    return factors


ErrorFunction = Callable[[gtsam.CustomFactor, gtsam.Values, "list[FloatArray] | None"], FloatArray]


def _goal_error(keys: list[int], observation: GoalObservation) -> ErrorFunction:
    """Whitened error of a goal's joint observation on (A, D, L_1 .. L_n), n may be 0:
    [R_A^T (L_i - t_A) - p_AL_i; A^-1 D - X_AD]."""
    n = len(observation.ids)
    whitener = _whitener(observation)
    p_AL, X_AD = observation.p_AL, observation.X_AD

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[FloatArray] | None) -> FloatArray:
        X_MA, X_MD = values.atPose2(keys[0]), values.atPose2(keys[1])
        points = np.empty((n + 1, 2))
        for i in range(n):
            points[i] = values.atPoint2(keys[2 + i])
        points[n] = X_MD.x(), X_MD.y()
        R_MA = se2.rotation(X_MA.theta())
        in_A = (points - (X_MA.x(), X_MA.y())) @ R_MA
        turn = X_MD.theta() - X_MA.theta()
        residual = np.empty(2 * n + 3)
        residual[: 2 * n] = (in_A[:n] - p_AL).ravel()
        residual[2 * n : 2 * n + 2] = in_A[n] - X_AD[:2]
        residual[2 * n + 2] = math.remainder(turn - X_AD[2], 2.0 * math.pi)
        if jacobians is not None:
            # Pose2 moves in its own frame: X (+) d = X Exp(d).
            on_A = np.zeros((2 * n + 3, 3))
            on_A[0:-1:2, 0] = on_A[1:-1:2, 1] = on_A[-1, 2] = -1.0
            on_A[0:-1:2, 2], on_A[1:-1:2, 2] = in_A[:, 1], -in_A[:, 0]
            jacobians[0] = whitener @ on_A
            jacobians[1] = np.hstack([whitener[:, 2 * n : 2 * n + 2] @ se2.rotation(turn), whitener[:, -1:]])
            on_points = whitener[:, : 2 * n].reshape(-1, 2) @ R_MA.T
            on_points = on_points.reshape(2 * n + 3, 2 * n)
            for i in range(n):
                jacobians[2 + i] = on_points[:, 2 * i : 2 * i + 2]
        return np.asarray(whitener @ residual)

    return error


# One inversion a goal, not one a goal and solve.
_whiteners: weakref.WeakKeyDictionary[GoalObservation, FloatArray] = weakref.WeakKeyDictionary()


def _whitener(observation: GoalObservation) -> FloatArray:
    """W (2n + 3, 2n + 3) with W^T W the inverse of the observation's covariance."""
    if observation not in _whiteners:
        factor = np.linalg.cholesky(observation.covariance)
        _whiteners[observation] = scipy.linalg.solve_triangular(
            factor, np.eye(len(factor)), lower=True, check_finite=False
        )
    return _whiteners[observation]


def _values(graph: GoalGraph) -> gtsam.Values:
    values = gtsam.Values()
    for k in range(len(graph.observations)):
        values.insert(A(k), gtsam.Pose2(*graph.X_MA[k]))
        values.insert(D(k), gtsam.Pose2(*graph.X_MD[k]))
    for tag, point in zip(graph.ids, graph.p_ML, strict=True):
        values.insert(L(int(tag)), point)
    return values


def _pose(values: gtsam.Values, key: int) -> tuple[float, float, float]:
    pose = values.atPose2(key)
    return pose.x(), pose.y(), pose.theta()


def _entropy(covariance: FloatArray) -> float:
    """1/2 log|2 pi e Sigma|, nats."""
    if len(covariance) == 0:
        return 0.0
    diagonal = np.diag(scipy.linalg.cholesky(covariance, check_finite=False))
    return float(np.sum(np.log(diagonal)) + 0.5 * len(covariance) * math.log(2.0 * math.pi * math.e))


def _arrival(
    map_estimate: MapEstimate, observation: GoalObservation, X_DA: FloatArray, segment_covariance: FloatArray
) -> tuple[FloatArray, IntArray]:
    """X_MA (3,) of a new goal as map, segment and its known tags have it, and the ids of tags that contradict them.

    Iterated updates of (known tags, A), in the last departure frame D, by the observation; each tag is then compared
    with what all others predict of it, and the worst leaves until none is too far off. The pose serves as an initial
    value only.
    """
    common, in_map, in_goal = np.intersect1d(map_estimate.ids, observation.ids, return_indices=True)
    p_DL, prior = in_departure_frame(map_estimate, in_map)
    kept = np.arange(len(common))
    while len(kept) > 0:
        rows = np.repeat(2 * kept, 2) + np.tile([0, 1], len(kept))
        aligned, distance = _align(
            p_DL[kept], prior[np.ix_(rows, rows)], X_DA, segment_covariance, observation, in_goal[kept]
        )
        if np.max(distance) <= REJECTED:
            X_DA = aligned
            break
        kept = np.delete(kept, np.argmax(distance))
    return se2.compose(map_estimate.X_MD, X_DA), np.setdiff1d(common, common[kept])


def _align(
    p_DL: FloatArray,
    tag_covariance: FloatArray,
    X_DA: FloatArray,
    segment_covariance: FloatArray,
    observation: GoalObservation,
    in_goal: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """X_DA (3,) by an iterated Kalman update, and (m,) squared Mahalanobis distance of each tag from the others.

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
    return aligned, distance


def without_tags(observation: GoalObservation, ids: IntArray) -> GoalObservation:
    """The observation with some tags marginalised out."""
    if len(ids) == 0:
        return observation
    keep = ~np.isin(observation.ids, ids)
    rows = np.concatenate([np.repeat(keep, 2), np.ones(3, dtype=bool)])
    return GoalObservation(
        ids=observation.ids[keep],
        p_AL=observation.p_AL[keep],
        X_AD=observation.X_AD,
        covariance=observation.covariance[np.ix_(rows, rows)],
        stamps=observation.stamps,
        X_AB=observation.X_AB,
    )
