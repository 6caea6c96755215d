"""The map: values of the whole keyframe graph and the joint Gaussian around a place.

The values are the maximum a posteriori (the paper's Sec. II), to rounding, and the Gaussian is Laplace's approximation
there (Sec. III-B), by nested dissection or by GTSAM.
"""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, MapEstimate, Observation, replace
from tfg_drake.slam.dissection import DissectionSolver, System
from tfg_drake.slam.keyframe import Keyframe, way
from tfg_drake.slam.keyframe_graph import KeyframeGraph, adrift
from tfg_drake.slam.map_update import distance_to, entropy_of, estimate_of
from tfg_drake.slam.shared import SHARED, Shared, scale_of
from tfg_drake.slam.solver import LEAST_DAMPING, Keyframes, Unknowns, Values
from tfg_drake.slam.tag_error import learnt, suspected

# Jointly known are the JOINT landmarks nearest to the robot and, after exploration, SPREAD others all over the map.
JOINT = 500
SPREAD = 600
# At the end of a mission all landmarks are jointly known, up to this number, whose covariance takes 200 MB.
MOST_JOINT = 2500
# Greatest number of steps of a solve. It has converged after a step whose largest component, m or rad, is below
# SMALL_STEP.
MOST_STEPS = 20
SMALL_STEP = 2e-5
# A step that raises the error is halved until it does not, at most MOST_HALVINGS times. A rise by the share ROUNDING of
# the error plus one is none.
MOST_HALVINGS = 10
ROUNDING = 1e-9
# If the information is not positive definite, the damping is multiplied by DAMPING_GROWTH, up to MOST_DAMPING.
DAMPING_GROWTH = 100.0
MOST_DAMPING = 1e10
# Deviations, m, m, rad, of the motion to an adrift part while it is held at its start.
HELD = np.array([1e-3, 1e-3, 1e-4])


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
    """Return the graph at its maximum a posteriori values, and the map with the joint Gaussian around a node.

    Args:
        graph: k keyframes, at least one.
        stamp: s, observation: of the newest view, with its trajectory; both go into the MapEstimate.
        node: the node with the pose X_MD, from 1 to k; by default the newest.
        also: (r,) rows of landmarks to be jointly known however far away.
        joint: number of jointly known landmarks next to the node. spread: number of others, spread over the map.
    """
    node = len(graph.keyframes) if node < 0 else node
    by_distance = np.argsort(distance_to(graph, graph.X_MN[node]), kind="stable")
    local = np.sort(by_distance[:joint])
    if spread:
        others = np.sort(by_distance[joint:])
        local = np.union1d(local, others[np.linspace(0, len(others) - 1, min(spread, len(others))).astype(np.int64)])
    local = local if also is None else np.union1d(local, also)
    graph, covariance = solved(graph, local, node)
    return graph, estimate_of(graph, stamp, observation, (graph.p_ML, graph.X_MN[node]), local, covariance)


def known_jointly(graph: KeyframeGraph) -> int:
    """Return the number of jointly known landmarks at the end of a mission."""
    return len(graph.ids) if len(graph.ids) <= MOST_JOINT else JOINT


def solved(graph: KeyframeGraph, local: IntArray, node: int) -> tuple[KeyframeGraph, FloatArray]:
    """Return a graph of one keyframe or more at its maximum a posteriori values, and the joint covariance (2m + 16,
    2m + 16) of the landmarks in rows local (m,), the pose of a node, and the parameters. A part that is adrift keeps
    its start, which is unobservable and which rounding errors would move."""
    j = adrift(graph)
    if j >= 0:
        unknown = graph.keyframes[j]
        graph, _ = solved(_with_way(graph, j, way(unknown.y_AD, np.diag(HELD**2))), local, node)
        graph = _with_way(graph, j, unknown)
    tag_error, m = graph.tag_error, 2 * len(local)
    if graph.solver == "gtsam":
        # GTSAM is loaded only if it is asked for.
        from tfg_drake.slam import gtsam_solver

        values, covariance, log_information = gtsam_solver.solution(graph, local, node)
    else:
        values, covariance, log_information, tag_error = solution(graph, local, node)
    X_MN, p_ML = values.X_MN.copy(), values.p_ML
    X_MN[:, 2] = np.arctan2(np.sin(X_MN[:, 2]), np.cos(X_MN[:, 2]))
    entropy = of_local = entropy_of(covariance[:m, :m])
    if len(local) < len(p_ML):
        entropy = 0.5 * (2 * len(p_ML) * math.log(2.0 * math.pi * math.e) - log_information)
    each, rows = graph.landmark_covariance.copy(), np.arange(len(local))
    each[local] = covariance[:m, :m].reshape(m // 2, 2, m // 2, 2)[rows, :, rows, :]
    shared = Shared(values.shared, covariance[-SHARED:, -SHARED:].copy())
    graph = replace(
        graph,
        X_MN=X_MN,
        p_ML=p_ML,
        landmark_covariance=each,
        entropy=entropy,
        entropy_beyond=entropy - of_local,
        shared=shared,
        tag_error=tag_error,
    )
    return graph, covariance


def _with_way(graph: KeyframeGraph, j: int, one: Keyframe) -> KeyframeGraph:
    """Return the graph with keyframe j replaced by a motion that agrees with the graph's poses."""
    one = replace(one, y_AD=se2.between(graph.X_MN[j], graph.X_MN[j + 1]))
    return replace(graph, keyframes=(*graph.keyframes[:j], one, *graph.keyframes[j + 1 :]))


def solution(graph: KeyframeGraph, local: IntArray, node: int) -> tuple[Values, FloatArray, float, FloatArray]:
    """Return values and joint covariance, see `solved`, the log determinant of the information on all landmarks if
    local does not name them all, and the deviations of the tags' constant errors, by nested dissection."""
    solver, nothing = DissectionSolver(graph), np.zeros(graph.p_ML.shape)
    values, system = _converged(solver, Values(graph.X_MN.copy(), graph.p_ML.copy(), graph.shared.mean, nothing))
    u, m, has_errors = solver.unknowns, 2 * len(local), solver.factors.has_errors
    of_landmarks, of_errors = ((of[local][:, None] + [0, 1]).ravel() for of in (u.landmark_at, u.error_at))
    of_pose, of_shared = u.node_at[node] + np.arange(3), u.shared_at + np.arange(SHARED)
    at = np.concatenate([of_landmarks, of_pose, of_shared, of_errors if has_errors else of_errors[:0]])
    covariance = system.covariance(at)
    variance = np.diag(covariance)[m + 3 + SHARED :].reshape(-1, 2)
    covariance = covariance[: m + 3 + SHARED, : m + 3 + SHARED].copy()
    if has_errors:
        tag_error = learnt(graph.tag_error, values.errors[local], variance)
    else:
        tag_error = suspected(*_tag_pulls(solver.factors.keyframes, values, system.places))
    log_information = 0.0
    if len(local) < len(graph.ids):
        given_landmarks = _linearised(DissectionSolver(graph, landmarks=False), values)
        log_information = system.log_determinant - given_landmarks.log_determinant
    return values, covariance, log_information, tag_error


def _converged(solver: DissectionSolver, values: Values) -> tuple[Values, System]:
    """Return the values at the maximum a posteriori, and the system linearised where the last step began."""
    moved_since = math.inf
    for number in range(MOST_STEPS):
        anew = moved_since >= solver.keeps_for or number == MOST_STEPS - 1
        if anew:
            system, moved_since = _linearised(solver, values), 0.0
            gradient, error = system.gradient, system.error
        else:
            gradient, error = solver.gradient(values)
        step = system.solution(-gradient)
        length = float(np.max(np.abs(step)))
        there, share = _lowered(solver, error, values, step)
        if share < 1.0 and not anew:
            # A barely constrained unknown follows the error of a reused factorisation: factorise again.
            moved_since = math.inf
            continue
        values, moved_since = there, moved_since + (length if share == 1.0 else math.inf)
        if length < SMALL_STEP:
            if anew:
                break
            moved_since = math.inf
    return values, system


def _linearised(solver: DissectionSolver, values: Values) -> System:
    """Return the system at some values. If a part of the map is numerically unconstrained, the least sufficient damping
    is added."""
    damping = 0.0
    while True:
        try:
            return solver.linearised(values, damping)
        except np.linalg.LinAlgError:
            if damping > MOST_DAMPING:
                raise
            damping = max(DAMPING_GROWTH * damping, LEAST_DAMPING)


def _lowered(solver: DissectionSolver, error: float, values: Values, step: FloatArray) -> tuple[Values, float]:
    """Return the values moved by a step (u,), or by the share of it that lowers the error, and that share."""
    share = 1.0
    for _ in range(MOST_HALVINGS if np.max(np.abs(step)) >= SMALL_STEP else 1):
        there = moved(values, solver.unknowns, share * step)
        if solver.gradient(there)[1] <= error + ROUNDING * (1.0 + abs(error)):
            break
        share *= 0.5
    return there, share


def _tag_pulls(keyframes: Keyframes, values: Values, places: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the gradient (n, 2) of all keyframes on the constant errors of each tag at zero, and its variance (n, 2)
    by noise alone.

    The place of a tag absorbs the errors of keyframes that see it from one side only. Poses count as known.
    """
    keyframe = np.repeat(np.arange(len(keyframes.y_AD)), np.diff(keyframes.offsets))
    row, n = keyframes.rows, len(values.p_ML)
    heading, unit = values.X_MN[keyframe, 2], keyframes.unit
    scale = np.array([scale_of(one, values.shared) for one in unit])[keyframe]
    c, s = np.cos(heading) / scale, np.sin(heading) / scale
    by_error = np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1) @ keyframes.on_error
    own, force = places[:, :, :2], places[:, :, 2]
    pull, variance = np.zeros((n, 2)), np.zeros((n, 2))
    total, by_place = np.zeros((n, 2, 2)), np.zeros((n, 2, 2))
    np.add.at(total, row, own)
    np.add.at(by_place, row, own @ by_error)
    np.add.at(pull, row, np.einsum("eji,ej->ei", by_error, force))
    np.add.at(variance, row, np.einsum("eji,ejk,eki->ei", by_error, own, by_error))
    seen = np.flatnonzero(np.bincount(row, minlength=n))
    taken = np.einsum("nji,njk->nik", by_place[seen], np.linalg.solve(total[seen], by_place[seen]))
    variance[seen] = np.maximum(variance[seen] - np.einsum("nii->ni", taken), 0.0)
    return pull, variance


def moved(values: Values, unknowns: Unknowns, step: FloatArray) -> Values:
    """Return the values moved by a step (u,) of the unknowns."""
    X_MN, errors = values.X_MN.copy(), values.errors
    X_MN[1:] += step[unknowns.node_at[1:, None] + [0, 1, 2]]
    if np.any(unknowns.error_at >= 0):
        errors = errors + step[unknowns.error_at[:, None] + [0, 1]]
    shared = values.shared + step[unknowns.shared_at : unknowns.shared_at + SHARED]
    return Values(X_MN, values.p_ML + step[unknowns.landmark_at[:, None] + [0, 1]], shared, errors)
