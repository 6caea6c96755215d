"""A planar graph of poses and landmarks tied by relative measurements, each with its own information, solved by GTSAM.

This is what a g2o file holds. It is no stream of range and bearing, so the online estimator cannot run on it.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, message
from tfg_drake.slam.batch_smoother import converge

# A fixed pose is where its vertex says.
FIXED_SIGMA = 1e-6
# Poses that enter iSAM2 at a time.
POSES_AT_ONCE = 10


@message
class PoseGraph:
    """pose_ids: (k,) ascending, X_MB: (k, 3). landmark_ids: (n,) ascending, p_ML: (n, 2) m; a value that the graph does
    not state is nan. fixed: (f,) ids of poses held at their values.

    edges: (e, 2) ids of poses i, j; X_ij: (e, 3) the pose of j in i; edge_information: (e, 3, 3) of (x, y, theta) of
    X_ij^-1 X_i^-1 X_j. sightings: (s, 2) ids of pose and landmark; p_BL: (s, 2) m; sighting_information: (s, 2, 2).
    """

    pose_ids: IntArray
    X_MB: FloatArray
    landmark_ids: IntArray
    p_ML: FloatArray
    fixed: IntArray
    edges: IntArray
    X_ij: FloatArray
    edge_information: FloatArray
    sightings: IntArray
    p_BL: FloatArray
    sighting_information: FloatArray


def half_chi_square(graph: PoseGraph) -> float:
    """Half the sum of squared whitened errors at the graph's values."""
    i, j = (np.searchsorted(graph.pose_ids, graph.edges[:, side]) for side in (0, 1))
    error = se2.between(graph.X_ij, se2.between(graph.X_MB[i], graph.X_MB[j]))
    i = np.searchsorted(graph.pose_ids, graph.sightings[:, 0])
    j = np.searchsorted(graph.landmark_ids, graph.sightings[:, 1])
    d = graph.p_ML[j] - graph.X_MB[i, :2]
    c, s = np.cos(graph.X_MB[i, 2]), np.sin(graph.X_MB[i, 2])
    offset = np.column_stack([c * d[:, 0] + s * d[:, 1], -s * d[:, 0] + c * d[:, 1]]) - graph.p_BL
    return 0.5 * float(
        np.einsum("ei,eij,ej", error, graph.edge_information, error)
        + np.einsum("ei,eij,ej", offset, graph.sighting_information, offset)
    )


def solve_pose_graph(graph: PoseGraph) -> PoseGraph:
    """The graph at its least-squares values.

    The problem is not convex: it is solved from the values that the graph states, if it states all of them, and from
    values built up by iSAM2 in the order of the ids, and the better solution is kept. Without a fixed pose the first
    one is held. Raises ValueError where a pose is tied to no earlier one, or a landmark was never seen.
    """
    fixed = graph.fixed if len(graph.fixed) else graph.pose_ids[:1]
    starts = []
    if np.isfinite(graph.X_MB).all() and np.isfinite(graph.p_ML).all():
        starts.append(_stated(graph))
    try:
        starts.append(_incremental(graph, fixed))
    except ValueError:
        if not starts:
            raise
    solutions = []
    for start in starts:
        factors = _held(graph, start, fixed)
        _add_factors(factors, graph, range(len(graph.edges)), range(len(graph.sightings)))
        solutions.append(_with_values(graph, converge(factors, start)))
    return min(solutions, key=half_chi_square)


def _stated(graph: PoseGraph) -> gtsam.Values:
    values = gtsam.Values()
    for i, X_MB in zip(graph.pose_ids, graph.X_MB, strict=True):
        values.insert(X(int(i)), gtsam.Pose2(*X_MB))
    for i, p_ML in zip(graph.landmark_ids, graph.p_ML, strict=True):
        values.insert(L(int(i)), p_ML)
    return values


def _held(graph: PoseGraph, values: gtsam.Values, fixed: IntArray) -> gtsam.NonlinearFactorGraph:
    """Priors on the fixed poses at their values."""
    factors = gtsam.NonlinearFactorGraph()
    noise = gtsam.noiseModel.Isotropic.Sigma(3, FIXED_SIGMA)
    for i in fixed:
        factors.add(gtsam.PriorFactorPose2(X(int(i)), values.atPose2(X(int(i))), noise))
    return factors


def _incremental(graph: PoseGraph, fixed: IntArray) -> gtsam.Values:
    """Values built up pose by pose, each measurement entering with its later pose."""
    order = {int(i): row for row, i in enumerate(graph.pose_ids)}
    edges_at: list[list[int]] = [[] for _ in order]
    for e, (i, j) in enumerate(graph.edges.tolist()):
        edges_at[max(order[i], order[j])].append(e)
    sightings_at: list[list[int]] = [[] for _ in order]
    for s, i in enumerate(graph.sightings[:, 0].tolist()):
        sightings_at[order[i]].append(s)

    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")
    solver = gtsam.ISAM2(parameters)
    factors, new, estimate = gtsam.NonlinearFactorGraph(), gtsam.Values(), gtsam.Values()
    seen: set[int] = set()
    for row, (pose_id, X_MB) in enumerate(zip(graph.pose_ids.tolist(), graph.X_MB, strict=True)):

        def value(i: int, new: gtsam.Values = new, estimate: gtsam.Values = estimate) -> FloatArray:
            return _pose(new if new.exists(X(i)) else estimate, i)

        hold = pose_id in fixed
        if not hold or not np.isfinite(X_MB).all():
            X_MB = _first_value(graph, edges_at[row], pose_id, value) if row > 0 else np.zeros(3)
        new.insert(X(pose_id), gtsam.Pose2(*X_MB))
        if hold:
            factors.push_back(_held(graph, new, np.array([pose_id])))
        for s in sightings_at[row]:
            landmark = int(graph.sightings[s, 1])
            if landmark not in seen:
                seen.add(landmark)
                new.insert(L(landmark), se2.transform(X_MB, graph.p_BL[s]))
        _add_factors(factors, graph, edges_at[row], sightings_at[row])
        if (row + 1) % POSES_AT_ONCE == 0 or row == len(order) - 1:
            solver.update(factors, new)
            factors, new = gtsam.NonlinearFactorGraph(), gtsam.Values()
            estimate = solver.calculateEstimate()
    unseen = [i for i in graph.landmark_ids.tolist() if i not in seen]
    if unseen:
        raise ValueError(f"landmark {unseen[0]} has no sighting")
    return estimate


def _first_value(graph: PoseGraph, edges: list[int], pose_id: int, value: Callable[[int], FloatArray]) -> FloatArray:
    """X_MB (3,) of a new pose by its edge to the latest of the earlier poses."""
    if not edges:
        raise ValueError(f"pose {pose_id} is tied to no earlier pose")
    e = max(edges, key=lambda e: int(min(graph.edges[e])))
    i, j = graph.edges[e].tolist()
    return se2.compose(value(i), graph.X_ij[e]) if j == pose_id else se2.compose(value(j), se2.inverse(graph.X_ij[e]))


def _add_factors(
    factors: gtsam.NonlinearFactorGraph, graph: PoseGraph, edges: list[int] | range, sightings: list[int] | range
) -> None:
    # Pose2's chart at the origin is (x, y, theta): the error of BetweenFactorPose2 is g2o's.
    for e in edges:
        i, j = graph.edges[e].tolist()
        noise = gtsam.noiseModel.Gaussian.Information(graph.edge_information[e].copy())
        factors.add(gtsam.BetweenFactorPose2(X(i), X(j), gtsam.Pose2(*graph.X_ij[e]), noise))
    for s in sightings:
        pose, landmark = graph.sightings[s].tolist()
        noise = gtsam.noiseModel.Gaussian.Information(graph.sighting_information[s].copy())
        keys = [X(pose), L(landmark)]
        factors.add(gtsam.CustomFactor(noise, keys, _sighting_error(keys, graph.p_BL[s])))


ErrorFunction = Callable[[gtsam.CustomFactor, gtsam.Values, "list[FloatArray] | None"], FloatArray]


def _sighting_error(keys: list[int], p_BL: FloatArray) -> ErrorFunction:
    """R_MB^T (p_ML - p_MB) - p_BL."""

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[FloatArray] | None) -> FloatArray:
        X_MB, p_ML = values.atPose2(keys[0]), values.atPoint2(keys[1])
        c, s = math.cos(X_MB.theta()), math.sin(X_MB.theta())
        dx, dy = p_ML[0] - X_MB.x(), p_ML[1] - X_MB.y()
        x, y = c * dx + s * dy, -s * dx + c * dy
        if jacobians is not None:
            jacobians[0] = np.array([[-1.0, 0.0, y], [0.0, -1.0, -x]])
            jacobians[1] = np.array([[c, s], [-s, c]])
        return np.array([x - p_BL[0], y - p_BL[1]])

    return error


def _pose(values: gtsam.Values, i: int) -> FloatArray:
    pose = values.atPose2(X(i))
    return np.array([pose.x(), pose.y(), pose.theta()])


def _with_values(graph: PoseGraph, values: gtsam.Values) -> PoseGraph:
    return PoseGraph(
        pose_ids=graph.pose_ids,
        X_MB=np.array([_pose(values, i) for i in graph.pose_ids.tolist()]).reshape(-1, 3),
        landmark_ids=graph.landmark_ids,
        p_ML=np.array([values.atPoint2(L(i)) for i in graph.landmark_ids.tolist()]).reshape(-1, 2),
        fixed=graph.fixed,
        edges=graph.edges,
        X_ij=graph.X_ij,
        edge_information=graph.edge_information,
        sightings=graph.sightings,
        p_BL=graph.p_BL,
        sighting_information=graph.sighting_information,
    )
