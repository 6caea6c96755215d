"""The goal graph in GTSAM: one joint factor a goal, one between-factor a segment."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import gtsam
import numpy as np
import scipy.linalg
from gtsam.symbol_shorthand import A, D, L

from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.slam.goal_graph import GoalFactor, GoalGraph, rows_of

# Deviation of a pose that is held where it is, m and rad.
HELD = 1e-7

ErrorFunction = Callable[[gtsam.CustomFactor, gtsam.Values, "list[FloatArray] | None"], FloatArray]


def joint_factor(
    graph: GoalGraph,
    k: int,
    pose_free: bool = True,
    free: BoolArray | None = None,
    observation: GoalFactor | None = None,
) -> gtsam.CustomFactor:
    """Goal k's joint observation, or the part of it that is given, whitened, on (A_k, D_k, its landmarks): see
    `_goal_error`.

    Unless pose_free, A_k and D_k are held at their values; free: (n,) which of the graph's landmarks are not held, by
    default all. What is held is none of the factor's variables.
    """
    observation = graph.observations[k] if observation is None else observation
    row, _ = rows_of(observation.ids, graph.ids)
    loose = np.ones(len(row), dtype=bool) if free is None else free[row]
    keys = [A(k), D(k)] if pose_free else []
    keys += [L(int(tag)) for tag in observation.ids[loose]]
    error = _goal_error(
        observation, keys, graph.X_MA[k], graph.X_MD[k], graph.p_ML[row], pose_free, np.flatnonzero(loose)
    )
    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(2 * len(row) + 3), keys, error)


def _goal_error(
    observation: GoalFactor,
    keys: list[int],
    X_MA: FloatArray,
    X_MD: FloatArray,
    p_ML: FloatArray,
    pose_free: bool,
    free: IntArray,
) -> ErrorFunction:
    """Whitened error of a goal's joint observation on (A, D, L_1 .. L_n), n may be 0:
    [R_A^T (L_i - t_A) - p_AL_i; A^-1 D - X_AD].

    keys: those of A and D, if pose_free, and of the landmarks in the rows free (f,) of p_ML (n, 2). The others have the
    values given.
    """
    n = len(observation.ids)
    whitener = _whitener(observation)
    p_AL, X_AD = observation.p_AL, observation.X_AD
    poses = 2 if pose_free else 0
    held = np.vstack([p_ML, X_MD[:2]])
    a_x, a_y, a_theta = (float(x) for x in X_MA)
    d_theta = float(X_MD[2])

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[FloatArray] | None) -> FloatArray:
        x, y, theta, end = a_x, a_y, a_theta, d_theta
        points = held.copy()
        if pose_free:
            arrival, departure = values.atPose2(keys[0]), values.atPose2(keys[1])
            x, y, theta, end = arrival.x(), arrival.y(), arrival.theta(), departure.theta()
            points[n] = departure.x(), departure.y()
        for slot, i in enumerate(free):
            points[i] = values.atPoint2(keys[poses + slot])
        R_MA = se2.rotation(theta)
        in_A = (points - (x, y)) @ R_MA
        turn = end - theta
        residual = np.empty(2 * n + 3)
        residual[: 2 * n] = (in_A[:n] - p_AL).ravel()
        residual[2 * n : 2 * n + 2] = in_A[n] - X_AD[:2]
        residual[2 * n + 2] = math.remainder(turn - X_AD[2], 2.0 * math.pi)
        if jacobians is not None:
            if pose_free:
                # Pose2 moves in its own frame: X (+) d = X Exp(d).
                on_A = np.zeros((2 * n + 3, 3))
                on_A[0:-1:2, 0] = on_A[1:-1:2, 1] = on_A[-1, 2] = -1.0
                on_A[0:-1:2, 2], on_A[1:-1:2, 2] = in_A[:, 1], -in_A[:, 0]
                jacobians[0] = whitener @ on_A
                jacobians[1] = np.hstack([whitener[:, 2 * n : 2 * n + 2] @ se2.rotation(turn), whitener[:, -1:]])
            on_points = whitener[:, : 2 * n].reshape(-1, 2) @ R_MA.T
            on_points = on_points.reshape(2 * n + 3, 2 * n)
            for slot, i in enumerate(free):
                jacobians[poses + slot] = on_points[:, 2 * i : 2 * i + 2]
        return np.asarray(whitener @ residual)

    return error


# One inversion a goal, not one a goal and solve, for as many goals as one solve may want.
@functools.lru_cache(maxsize=1024)
def _whitener(observation: GoalFactor) -> FloatArray:
    """W (2n + 3, 2n + 3) with W^T W the inverse of the observation's covariance."""
    whitener, _ = scipy.linalg.lapack.dtrtri(observation.cholesky, lower=1)
    return np.asarray(whitener)


def segment_factor(j: int, k: int, X_DA: FloatArray, covariance: FloatArray) -> gtsam.BetweenFactorPose2:
    """The way from D_j to A_k: X_DA (3,) and the covariance (3, 3) of (x, y) in D and theta."""
    covariance = _in_body(covariance, float(X_DA[2]))
    return gtsam.BetweenFactorPose2(D(j), A(k), gtsam.Pose2(*X_DA), gtsam.noiseModel.Gaussian.Covariance(covariance))


def pose_prior(key: int, X: FloatArray, covariance: FloatArray) -> gtsam.PriorFactorPose2:
    """A pose X (3,) known with the covariance (3, 3) of its (x, y) in M and theta."""
    noise = gtsam.noiseModel.Gaussian.Covariance(_in_body(covariance, float(X[2])))
    return gtsam.PriorFactorPose2(key, gtsam.Pose2(*X), noise)


def held_pose(key: int, X: FloatArray) -> gtsam.PriorFactorPose2:
    """A pose held at X (3,)."""
    return gtsam.PriorFactorPose2(key, gtsam.Pose2(*X), gtsam.noiseModel.Isotropic.Sigma(3, HELD))


def _in_body(covariance: FloatArray, theta: float) -> FloatArray:
    """The covariance (3, 3) of a pose of heading theta in its own frame, as GTSAM takes it."""
    R = se2.rotation(theta)
    covariance = np.array(covariance)
    covariance[:2] = R.T @ covariance[:2]
    covariance[:, :2] = covariance[:, :2] @ R
    return 0.5 * (covariance + covariance.T)


def factor_graph(graph: GoalGraph) -> gtsam.NonlinearFactorGraph:
    """The whole graph in GTSAM: A(k), D(k) as Pose2, L(id) as Point2, the origin held at A(0)."""
    factors = gtsam.NonlinearFactorGraph()
    factors.add(held_pose(A(0), np.zeros(3)))
    for k in range(len(graph.observations)):
        factors.add(joint_factor(graph, k))
    for j, X_DA in enumerate(graph.X_DA):
        factors.add(segment_factor(j, j + 1, X_DA, graph.segment_covariance[j]))
    return factors


def values_of(graph: GoalGraph) -> gtsam.Values:
    """The values of all its variables."""
    values = gtsam.Values()
    for k in range(len(graph.observations)):
        values.insert(A(k), gtsam.Pose2(*graph.X_MA[k]))
        values.insert(D(k), gtsam.Pose2(*graph.X_MD[k]))
    for tag, point in zip(graph.ids, graph.p_ML, strict=True):
        values.insert(L(int(tag)), point)
    return values
