"""The map: a factor graph of goals and landmarks, one joint factor a goal, one between-factor a segment.

Variables: arrival pose A_k and departure pose D_k of every goal, landmarks L_i; A_0 is the map's origin. The graph is
kept as plain arrays. The map estimate is its MAP value and marginal covariance (the paper's sec. III).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import gtsam
import numpy as np
import scipy.linalg
from gtsam.symbol_shorthand import A, D, L
from numba import njit

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, GoalObservation, IntArray, MapEstimate, message
from tfg_drake.slam.odometry_model import wrap

# Squared Mahalanobis distance of a known tag from what all others say, beyond which the tag is left out.
REJECTED = 49.0
# Steps of one solve, at most, and the largest component (m, rad) of a step after which no other is needed.
MOST_STEPS = 20
SMALL_STEP = 1e-3


@message
class GoalGraph:
    """The factors and current values of k goals and n landmarks.

    observations: k, without the turns' trajectories. X_DA: (k - 1, 3) and segment_covariance: (k - 1, 3, 3), the
    segments from D_j to A_j+1, of (x, y) in D and theta. information: k, inverses of the observations' covariances.
    X_MA, X_MD: (k, 3). ids: (n,) ascending, p_ML: (n, 2).
    """

    observations: tuple[GoalObservation, ...]
    information: tuple[FloatArray, ...]
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
        information=(),
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
) -> tuple[GoalGraph, IntArray]:
    """The graph with one goal more, not yet solved, and the ids of the known tags left out of it.

    map_estimate: of the graph so far. X_DA (3,), segment_covariance (3, 3): the segment that led here, not used at
    the first goal. A known tag that grossly contradicts the map, given the segment and all other tags, is left out of
    the observation.
    """
    rejected = np.empty(0, dtype=np.int64)
    if map_estimate is None:
        X_MA = np.zeros(3)
    else:
        X_MA, rejected = _arrival(map_estimate, observation, X_DA, segment_covariance)
        observation = _without(observation, rejected)
        graph = dataclasses.replace(
            graph,
            X_DA=np.vstack([graph.X_DA, X_DA]),
            segment_covariance=np.concatenate([graph.segment_covariance, segment_covariance[None]]),
        )
    new = ~np.isin(observation.ids, graph.ids)
    ids = np.concatenate([graph.ids, observation.ids[new]])
    p_ML = np.vstack([graph.p_ML, se2.transform(X_MA, observation.p_AL[new])])
    order = np.argsort(ids)
    information = _inverse(_cholesky(observation.covariance.copy()))
    information.flags.writeable = False
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
            information=(*graph.information, information),
            X_DA=graph.X_DA,
            segment_covariance=graph.segment_covariance,
            X_MA=np.vstack([graph.X_MA, X_MA]),
            X_MD=np.vstack([graph.X_MD, se2.compose(X_MA, observation.X_AD)]),
            ids=ids[order],
            p_ML=p_ML[order],
        ),
        rejected,
    )


def solve(graph: GoalGraph, stamp: float, observation: GoalObservation) -> tuple[GoalGraph, MapEstimate]:
    """The graph at its maximum a posteriori values, and the map: their joint Gaussian.

    stamp: s, observation: the newest goal's, with its trajectory; both go into the MapEstimate. Gauss-Newton steps on
    the dense normal equations: with every goal tying its tags together little of them is zero, and BLAS takes a fifth
    of the time of a sparse elimination. GTSAM's Levenberg-Marquardt where a step fails to lower the error.
    """
    information, gradient, error = _normal_equations(graph)
    factor = _cholesky(information)
    for _ in range(MOST_STEPS):
        step = -scipy.linalg.cho_solve((factor, True), gradient, check_finite=False)
        moved = _moved(graph, step)
        information, gradient, moved_error = _normal_equations(moved)
        if not moved_error <= error + 1e-6 * (1.0 + error):
            moved = _optimised_by_gtsam(graph)
            information, gradient, moved_error = _normal_equations(moved)
            if not moved_error <= error + 1e-6 * (1.0 + error):
                break
        graph, error, factor = moved, moved_error, _cholesky(information)
        if np.max(np.abs(step)) < SMALL_STEP:
            break
    landmarks = 2 * len(graph.ids)
    kept = factor[-landmarks - 3 :, -landmarks - 3 :]
    return graph, MapEstimate(
        stage=len(graph.observations),
        stamp=stamp,
        ids=graph.ids,
        p_ML=graph.p_ML,
        X_MD=graph.X_MD[-1],
        covariance=_inverse(kept),
        X_MA=graph.X_MA,
        observation=observation,
        entropy=_entropy(kept),
    )


def _rows_of_poses(k: int, landmarks: int) -> tuple[IntArray, IntArray]:
    """First rows of A_k and D_k (k,) each in the normal equations: A_1 .. A_k-1, D_0 .. D_k-2, the landmarks'
    coordinates, D_k-1. What the map keeps is last; A_0 is known and has none: -1."""
    rows = 3 * np.arange(2 * k - 2)
    return np.append(-1, rows[: k - 1]), np.append(rows[k - 1 :], 6 * (k - 1) + landmarks)


def _normal_equations(graph: GoalGraph) -> tuple[FloatArray, FloatArray, float]:
    """Information matrix (d, d), gradient (d,) and error (half chi-square) at the graph's values.

    Poses move by (x, y, theta) in M. The rows are those of `_rows_of_poses`.
    """
    k, landmarks = len(graph.observations), 2 * len(graph.ids)
    rows_A, rows_D = _rows_of_poses(k, landmarks)
    size = 6 * (k - 1) + landmarks + 3
    # LAPACK's order: nothing is copied on the way.
    information, gradient = np.zeros((size, size), order="F"), np.zeros(size)
    error = 0.0
    no_points, no_rows = np.empty((0, 2)), np.empty(0, dtype=np.int64)
    for i, observation in enumerate(graph.observations):
        tags = np.searchsorted(graph.ids, observation.ids)
        error += _add_relative(
            information, gradient, graph.X_MA[i], graph.X_MD[i], graph.p_ML[tags], observation.X_AD,
            observation.p_AL, graph.information[i], rows_A[i], rows_D[i], 6 * (k - 1) + 2 * tags,
        )  # fmt: skip
    for j, X_DA in enumerate(graph.X_DA):
        error += _add_relative(
            information, gradient, graph.X_MD[j], graph.X_MA[j + 1], no_points, X_DA,
            no_points, np.linalg.inv(graph.segment_covariance[j]), rows_D[j], rows_A[j + 1], no_rows,
        )  # fmt: skip
    return information, gradient, error


@njit(cache=True)
def _add_relative(
    information: FloatArray,
    gradient: FloatArray,
    X_MA: FloatArray,
    X_MB: FloatArray,
    p_ML: FloatArray,
    X_AB: FloatArray,
    p_AL: FloatArray,
    weight: FloatArray,
    row_A: int,
    row_B: int,
    rows_L: IntArray,
) -> float:
    """Add what a measurement of n points p_AL and a pose X_AB in A says; returns its half chi-square.

    weight: (2n + 3, 2n + 3), the inverse of its covariance. row_A, row_B, rows_L (n,): first rows of the variables,
    row_A -1 for a known pose.
    The residual is taken in M, so that its Jacobian is one on points and B, and the weight is turned into M instead.
    """
    n = len(p_AL)
    m = 2 * n + 3
    c, s = math.cos(X_MA[2]), math.sin(X_MA[2])
    rows = np.empty(m, dtype=np.int64)
    residual = np.empty(m)
    on_A = np.zeros((m, 3))
    for i in range(n + 1):
        x, y = (p_ML[i, 0], p_ML[i, 1]) if i < n else (X_MB[0], X_MB[1])
        u, v = (p_AL[i, 0], p_AL[i, 1]) if i < n else (X_AB[0], X_AB[1])
        first = rows_L[i] if i < n else row_B
        rows[2 * i], rows[2 * i + 1] = first, first + 1
        dx, dy = x - X_MA[0], y - X_MA[1]
        residual[2 * i], residual[2 * i + 1] = dx - (c * u - s * v), dy - (s * u + c * v)
        on_A[2 * i, 0] = on_A[2 * i + 1, 1] = -1.0
        on_A[2 * i, 2], on_A[2 * i + 1, 2] = dy, -dx
    rows[m - 1] = row_B + 2
    residual[m - 1] = wrap(X_MB[2] - X_MA[2] - X_AB[2])
    on_A[m - 1, 2] = -1.0

    turned = weight.copy()
    for a in range(m):
        for i in range(n + 1):
            u, v = turned[a, 2 * i], turned[a, 2 * i + 1]
            turned[a, 2 * i], turned[a, 2 * i + 1] = c * u - s * v, s * u + c * v
    for i in range(n + 1):
        for b in range(m):
            u, v = turned[2 * i, b], turned[2 * i + 1, b]
            turned[2 * i, b], turned[2 * i + 1, b] = c * u - s * v, s * u + c * v

    error = 0.0
    for a in range(m):
        weighted = 0.0
        for b in range(m):
            weighted += turned[a, b] * residual[b]
            information[rows[b], rows[a]] += turned[a, b]
        error += 0.5 * residual[a] * weighted
        gradient[rows[a]] += weighted
        if row_A >= 0:
            for e in range(3):
                gradient[row_A + e] += on_A[a, e] * weighted
    if row_A < 0:
        return error
    weighted_A = np.zeros((m, 3))
    for a in range(m):
        for e in range(3):
            for b in range(m):
                weighted_A[a, e] += turned[a, b] * on_A[b, e]
            information[rows[a], row_A + e] += weighted_A[a, e]
            information[row_A + e, rows[a]] += weighted_A[a, e]
    for e in range(3):
        for f in range(3):
            for a in range(m):
                information[row_A + e, row_A + f] += on_A[a, e] * weighted_A[a, f]
    return error


def _moved(graph: GoalGraph, step: FloatArray) -> GoalGraph:
    """The graph with its values moved by a step (d,) of the normal equations."""
    k, landmarks = len(graph.observations), 2 * len(graph.ids)
    rows_A, rows_D = _rows_of_poses(k, landmarks)
    X_MA, X_MD = graph.X_MA.copy(), graph.X_MD + step[rows_D[:, None] + np.arange(3)]
    X_MA[1:] += step[rows_A[1:, None] + np.arange(3)]
    X_MA[:, 2], X_MD[:, 2] = se2.wrap_angle(X_MA[:, 2]), se2.wrap_angle(X_MD[:, 2])
    p_ML = graph.p_ML + step[6 * (k - 1) : 6 * (k - 1) + landmarks].reshape(-1, 2)
    return dataclasses.replace(graph, X_MA=X_MA, X_MD=X_MD, p_ML=p_ML)


def _optimised_by_gtsam(graph: GoalGraph) -> GoalGraph:
    values = gtsam.LevenbergMarquardtOptimizer(factor_graph(graph), _values(graph)).optimize()
    k = len(graph.observations)
    X_MA = np.array([_pose(values, A(i)) for i in range(k)])
    X_MA[0] = 0.0
    return dataclasses.replace(
        graph,
        X_MA=X_MA,
        X_MD=np.array([_pose(values, D(i)) for i in range(k)]),
        p_ML=np.array([values.atPoint2(L(int(tag))) for tag in graph.ids]).reshape(-1, 2),
    )


def _cholesky(information: FloatArray) -> FloatArray:
    return np.asarray(scipy.linalg.cholesky(information, lower=True, overwrite_a=True, check_finite=False))


def _inverse(factor: FloatArray) -> FloatArray:
    """The inverse of a symmetric matrix (n, n) from its lower Cholesky factor."""
    return np.asarray(_mirrored(scipy.linalg.lapack.dpotri(factor, lower=True)[0].T))


@njit(cache=True)
def _mirrored(upper: FloatArray) -> FloatArray:
    """A symmetric matrix of which only the upper triangle was set, completed in place."""
    for i in range(len(upper)):
        for j in range(i):
            upper[i, j] = upper[j, i]
    return upper


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
        segment = GoalObservation(
            ids=np.empty(0, dtype=np.int64),
            p_AL=np.empty((0, 2)),
            X_AD=X_DA,
            covariance=graph.segment_covariance[j],
            stamps=np.empty(0),
            X_AB=np.empty((0, 3)),
        )
        keys = [D(j), A(j + 1)]
        factors.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(3), keys, _goal_error(keys, segment)))
    return factors


ErrorFunction = Callable[[gtsam.CustomFactor, gtsam.Values, "list[FloatArray] | None"], FloatArray]


def _goal_error(keys: list[int], observation: GoalObservation) -> ErrorFunction:
    """Whitened error of a goal's joint observation on (A, D, L_1 .. L_n), n may be 0:
    [R_A^T (L_i - t_A) - p_AL_i; A^-1 D - X_AD]."""
    n = len(observation.ids)
    whitener = scipy.linalg.solve_triangular(
        np.linalg.cholesky(observation.covariance), np.eye(2 * n + 3), lower=True, check_finite=False
    )
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


def _entropy(factor: FloatArray) -> float:
    """1/2 log|2 pi e Sigma_L|, nats, of the landmarks, from the Cholesky factor of the information on (landmarks, D).

    |Sigma_L| = |Sigma| / |Sigma_D|L|, and D's own block of the information is the inverse of Sigma_D|L.
    """
    n = len(factor) - 3
    information_D = factor[n:] @ factor[n:].T
    log_determinant = np.linalg.slogdet(information_D)[1] - 2.0 * np.sum(np.log(np.diag(factor)))
    return float(0.5 * (log_determinant + n * math.log(2.0 * math.pi * math.e)))


def _arrival(
    map_estimate: MapEstimate, observation: GoalObservation, X_DA: FloatArray, segment_covariance: FloatArray
) -> tuple[FloatArray, IntArray]:
    """X_MA (3,) of a new goal as map, segment and its known tags have it, and the ids of tags that contradict them.

    Iterated updates of (known tags, A) by the observation; each tag is then compared with what all others predict of
    it, and the worst leaves until none is too far off. The pose serves as an initial value only.
    """
    X_MA = se2.compose(map_estimate.X_MD, X_DA)
    common, in_map, in_goal = np.intersect1d(map_estimate.ids, observation.ids, return_indices=True)
    kept = np.arange(len(common))
    while len(kept) > 0:
        pose, distance = _align(map_estimate, observation, X_DA, segment_covariance, in_map[kept], in_goal[kept])
        if np.max(distance) <= REJECTED:
            X_MA = pose
            break
        kept = np.delete(kept, np.argmax(distance))
    return X_MA, np.setdiff1d(common, common[kept])


def _align(
    map_estimate: MapEstimate,
    observation: GoalObservation,
    X_DA: FloatArray,
    segment_covariance: FloatArray,
    in_map: IntArray,
    in_goal: IntArray,
) -> tuple[FloatArray, FloatArray]:
    """X_MA (3,) by an iterated Kalman update, and (m,) squared Mahalanobis distance of each tag from the others."""
    m = len(in_map)
    rows = np.repeat(2 * in_map, 2) + np.tile([0, 1], m)
    rows = np.concatenate([rows, np.arange(3) + len(map_estimate.covariance) - 3])
    prior = map_estimate.covariance[np.ix_(rows, rows)]
    X_MD = map_estimate.X_MD
    X_0 = se2.compose(X_MD, X_DA)
    R_MD = se2.rotation(float(X_MD[2]))
    # From (tags, D) to (tags, A).
    T = np.eye(2 * m + 3)
    T[-3, -1], T[-2, -1] = -(X_0[1] - X_MD[1]), X_0[0] - X_MD[0]
    G = np.eye(3)
    G[:2, :2] = R_MD
    prior = T @ prior @ T.T
    prior[-3:, -3:] += G @ segment_covariance @ G.T
    rows = np.repeat(2 * in_goal, 2) + np.tile([0, 1], m)
    noise = observation.covariance[np.ix_(rows, rows)]
    x_0 = np.concatenate([map_estimate.p_ML[in_map].ravel(), X_0])
    x = x_0
    for _ in range(4):
        R_MA = se2.rotation(float(x[-1]))
        in_A = (x[:-3].reshape(-1, 2) - x[-3:-1]) @ R_MA
        H = np.zeros((2 * m, 2 * m + 3))
        for i in range(m):
            H[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = R_MA.T
            H[2 * i : 2 * i + 2, -3:-1] = -R_MA.T
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
    X_MA = x[-3:].copy()
    X_MA[2] = math.remainder(X_MA[2], 2.0 * math.pi)
    return X_MA, distance


def _without(observation: GoalObservation, ids: IntArray) -> GoalObservation:
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
