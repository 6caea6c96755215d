"""Values and joint covariance of the whole keyframe graph: maximum a posteriori (the paper's sec. III), to rounding.

Where all landmarks are to be known jointly GTSAM eliminates the poses (`small_system`); what is left is dense, and its
inverse is the joint covariance. A large map, of which only those nearest to a place are, is eliminated by nested
dissection (`large_system`).
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.messages import FloatArray, IntArray, MapEstimate, Observation, replace
from tfg_drake.slam.factors import Factors, Linear, Solved, Values, at_other_yaw, factors_of, squared_error
from tfg_drake.slam.keyframe_graph import KeyframeGraph, at_yaw
from tfg_drake.slam.keyframe_kernels import YAW_STEP, chain, tag_pulls
from tfg_drake.slam.large_system import Parts, parts_of
from tfg_drake.slam.small_system import Cells, cells_of
from tfg_drake.slam.tag_error import learnt, suspected

# Landmarks known jointly: those nearest to the robot; and so many of all others once everything is explored.
JOINT = 400
SPREAD = 600
# At the end of a mission those of the whole map are, if they are no more than this: their covariance has 200 MB then.
MOST_JOINT = 2500
# Steps of one solve, at most, and the largest component (m, rad) of a step after which no other is needed.
MOST_STEPS = 20
SMALL_STEP = 2e-5
# A step that fails to lower the error is halved, so many times at most.
MOST_HALVINGS = 10


def solve(
    graph: KeyframeGraph,
    stamp: float,
    observation: Observation,
    *,
    node: int = -1,
    also: IntArray | None = None,
    joint: int = JOINT,
    spread: int = 0,
) -> tuple[KeyframeGraph, MapEstimate]:
    """The graph at its maximum a posteriori values, and the map with the joint Gaussian round a node.

    Args:
        graph: k keyframes, at least one.
        stamp: s, observation: the newest view's, with its trajectory; both go into the MapEstimate.
        node: whose pose X_MD is, from 1 to k; the newest by default.
        also: (r,) rows of landmarks that are to be known jointly however far away.
        joint: how many landmarks next to the node are known jointly. spread: and how many of the others.
    """
    factors = factors_of(graph)
    node = len(graph.keyframes) if node < 0 else node
    by_distance = np.argsort(np.hypot(*(graph.p_ML - graph.X_MN[node, :2]).T), kind="stable")
    local = np.sort(by_distance[:joint])
    if spread:
        others = np.sort(by_distance[joint:])
        local = np.union1d(local, others[np.linspace(0, len(others) - 1, min(spread, len(others))).astype(np.int64)])
    local = local if also is None else np.union1d(local, also)
    values = Values(graph.X_MN.copy(), graph.p_ML.copy(), np.zeros(graph.p_ML.shape))
    is_small = len(local) == len(graph.ids) <= JOINT
    system = cells_of(graph, factors, node) if is_small else parts_of(graph, factors)
    values, linear, solved = _converged(factors, system, values)
    covariance, of_errors = _covariance(system, solved, local, node)
    tag_error = graph.tag_error
    if tag_error.any():
        tag_error = learnt(tag_error, values.errors[local], of_errors)
    else:
        tag_error = suspected(*tag_pulls(factors.keyframes, factors.on_errors, values.X_MN, values.p_ML))
    yaw = graph.yaw
    if any(one.on_yaw.any() for one in graph.keyframes):
        yaw, on_yaw = _yaw(graph, factors, system, linear, values)
        values = _moved(system, values, (yaw[0] - graph.yaw[0]) * on_yaw)
        at = _joint_at(system, local, node)
        covariance += yaw[1] ** 2 * np.outer(on_yaw[at], on_yaw[at])
    X_MN, p_ML = values.X_MN.copy(), values.p_ML
    X_MN[:, 2] = np.arctan2(np.sin(X_MN[:, 2]), np.cos(X_MN[:, 2]))
    log_of_chain, pose_information = chain(np.full((3, 3), np.inf), linear.poses)
    log_of_rest = log_of_chain + float(np.linalg.slogdet(pose_information)[1])
    if factors.tag_error.any():
        log_of_rest = linear.log_determinant_of_rest()
    log_information = solved.log_determinant - log_of_rest
    entropy = 0.5 * (2 * len(p_ML) * math.log(2.0 * math.pi * math.e) - log_information) if len(p_ML) else 0.0
    graph = replace(
        graph,
        X_MN=X_MN,
        p_ML=p_ML,
        landmark_covariance=with_local(graph.landmark_covariance, local, covariance),
        entropy=entropy,
        pose_information=pose_information,
        keyframes=tuple(at_yaw(one, float(yaw[0])) for one in graph.keyframes),
        yaw=yaw,
        tag_error=tag_error,
    )
    return graph, estimate_of(graph, stamp, observation, p_ML, X_MN[node], local, covariance)


def _converged(factors: Factors, system: Cells | Parts, values: Values) -> tuple[Values, Linear, Solved]:
    """Values at the maximum a posteriori, the system linearised where the last step began, and its solution."""
    moved_since = math.inf
    for number in range(MOST_STEPS):
        anew = moved_since >= system.keeps_for or number == MOST_STEPS - 1
        if anew:
            linear, moved_since = system.linearised(factors, values), 0.0
        else:
            linear = system.again(linear, factors, values)
        solved = linear.solved(linear.gradient)
        length = float(np.max(np.abs(solved.step)))
        moved, share = _lowered(factors, system, linear, values, solved.step)
        if share < 1.0 and not anew:
            # What hangs on next to nothing takes a gradient that is not quite the system's for a pull at it.
            moved_since = math.inf
            continue
        values, moved_since = moved, moved_since + (length if share == 1.0 else math.inf)
        if length < SMALL_STEP:
            if anew:
                break
            moved_since = math.inf
    return values, linear, solved


def _lowered(
    factors: Factors, system: Cells | Parts, linear: Linear, values: Values, step: FloatArray
) -> tuple[Values, float]:
    """Values moved by a step (u,), or by the share of it that lowers the error, and that share."""
    share = 1.0
    for _ in range(MOST_HALVINGS if np.max(np.abs(step)) >= SMALL_STEP else 1):
        moved = _moved(system, values, share * step)
        if squared_error(factors, moved) <= linear.error + 1e-9 * (1.0 + abs(linear.error)):
            break
        share *= 0.5
    return moved, share


def _moved(cells: Cells | Parts, values: Values, step: FloatArray) -> Values:
    """Values moved by a step (u,) of the unknowns."""
    X_MN, errors = values.X_MN.copy(), values.errors
    X_MN[1:] += step[cells.node_at[1:, None] + [0, 1, 2]]
    if np.any(cells.error_at >= 0):
        errors = errors + step[cells.error_at[:, None] + [0, 1]]
    return Values(X_MN, values.p_ML + step[cells.landmark_at[:, None] + [0, 1]], errors)


def _yaw(
    graph: KeyframeGraph, factors: Factors, system: Cells | Parts, linear: Linear, values: Values
) -> tuple[FloatArray, FloatArray]:
    """The camera's yaw and its deviation (2,), rad, by all keyframes, at the values that are the best given the yaw of
    the graph; and the derivative (u,) of the unknowns on it.

    The error is a parabola in the yaw, for what was seen is linear in it.
    """

    def error(change: float) -> float:
        return squared_error(at_other_yaw(graph, factors, change), values)

    before, here, after = error(-YAW_STEP), error(0.0), error(YAW_STEP)
    slope, curvature = (after - before) / (4.0 * YAW_STEP), (before - 2.0 * here + after) / (2.0 * YAW_STEP**2)
    linear = system.again(linear, factors, values)
    shifted = system.again(linear, at_other_yaw(graph, factors, YAW_STEP), values).gradient
    by_yaw = (shifted - linear.gradient) / YAW_STEP
    on_yaw = linear.solved(by_yaw).step
    prior, sigma = graph.yaw_prior
    information = curvature + float(by_yaw @ on_yaw) + sigma**-2
    yaw = graph.yaw[0] - (slope + (graph.yaw[0] - prior) / sigma**2) / information
    return np.array([yaw, information**-0.5]), on_yaw


def known_jointly(graph: KeyframeGraph) -> int:
    """How many landmarks are known jointly at the end of a mission."""
    return len(graph.ids) if len(graph.ids) <= MOST_JOINT else JOINT


def with_local(landmark_covariance: FloatArray, local: IntArray, covariance: FloatArray) -> FloatArray:
    """The covariance of each landmark (n, 2, 2), with those in rows local (m,) as their joint covariance has them."""
    each, m = landmark_covariance.copy(), np.arange(len(local))
    each[local] = covariance[:-3, :-3].reshape(len(m), 2, len(m), 2)[m, :, m, :]
    return each


def estimate_of(
    graph: KeyframeGraph,
    stamp: float,
    observation: Observation,
    p_ML: FloatArray,
    X_MD: FloatArray,
    local: IntArray,
    covariance: FloatArray,
) -> MapEstimate:
    """The message of a graph, at some values of its landmarks and newest pose, and their joint covariance."""
    return MapEstimate(
        stage=len(graph.view_keyframe),
        stamp=stamp,
        ids=graph.ids,
        p_ML=p_ML,
        X_MD=X_MD,
        local=local,
        covariance=covariance,
        landmark_covariance=graph.landmark_covariance,
        X_MA=graph.X_MA,
        observation=observation,
        entropy=graph.entropy,
        tag_error=graph.tag_error,
    )


def _joint_at(cells: Cells | Parts, local: IntArray, node: int) -> IntArray:
    """(2m + 3,) where landmarks in rows local (m,) and a node's pose are among the unknowns."""
    return np.append((cells.landmark_at[local][:, None] + [0, 1]).ravel(), cells.node_at[node] + np.arange(3))


def _covariance(cells: Cells | Parts, solved: Solved, local: IntArray, node: int) -> tuple[FloatArray, FloatArray]:
    """(2m + 3, 2m + 3) covariance of the landmarks in rows local (m,) and of a node's pose, and (m, 2) the variances of
    the errors of those, zero where they have none."""
    at = _joint_at(cells, local, node)
    if not np.any(cells.error_at >= 0):
        return solved.covariance(at), np.zeros((len(local), 2))
    covariance = solved.covariance(np.append(at, cells.error_at[local][:, None] + [0, 1]))
    return covariance[: len(at), : len(at)].copy(), np.diag(covariance)[len(at) :].reshape(-1, 2)
