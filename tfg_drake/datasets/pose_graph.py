"""A planar graph of poses and landmarks tied by relative measurements, each with its own information.

This is what a g2o file holds. It is no stream of range and bearing, so the online estimator cannot run on it.
"""

from __future__ import annotations

import numpy as np

from tfg_drake.datasets.least_squares import cost
from tfg_drake.datasets.planar_graph import PlanarGraph
from tfg_drake.datasets.recording import OnProgress
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, message, replace
from tfg_drake.notes import Note

# Steps that show which of two starts is the better one.
STEPS_TO_COMPARE = 10


@message
class PoseGraph:
    """pose_ids: (k,) ascending, X_MB: (k, 3). landmark_ids: (n,) ascending, p_ML: (n, 2) m; a value that the graph does
    not state is nan. fixed: (f,) ids of poses held at their values.

    edges: (e, 2) ids of poses i, j; X_ij: (e, 3) the pose of j in i; edge_information: (e, 3, 3) of (x, y, theta) of
    X_ij^-1 X_i^-1 X_j. sightings: (s, 2) ids of pose and landmark; p_BL: (s, 2) m; sighting_information: (s, 2, 2).
    notes: what a user should know of the data.
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
    notes: tuple[Note, ...] = ()


def half_chi_square(graph: PoseGraph) -> float:
    """Half the sum of squared whitened errors at the graph's values."""
    planar, rows = _planar(graph)
    return cost(planar.linearise(_unknowns(graph.X_MB, graph.p_ML, rows)))


def solve_pose_graph(graph: PoseGraph, report: OnProgress = lambda _share: None) -> PoseGraph:
    """The graph at its least-squares values.

    The problem is not convex: it is solved from the values that the graph states, if it states all of them, or from
    values built up in the order of the ids, whichever have the smaller error after a few steps. Without a fixed pose
    the first one is held. report: called with the share of the work done, 0 to 1. Raises ValueError where a pose is
    tied to no earlier one, or a landmark was never seen.
    """
    planar, rows = _planar(graph)
    starts, k = [], len(graph.pose_ids)
    if np.isfinite(graph.X_MB).all() and np.isfinite(graph.p_ML).all():
        starts.append(_unknowns(graph.X_MB, graph.p_ML, rows))
    X_MB = np.where(planar.held[rows[:k], None], graph.X_MB, np.nan)
    X_MB[0] = np.nan_to_num(X_MB[0])
    loose = np.setdiff1d(graph.pose_ids[np.isnan(X_MB[:, 0])], graph.edges.max(axis=1))
    unseen = np.setdiff1d(graph.landmark_ids, graph.sightings[:, 1])
    if not len(loose) and not len(unseen):
        x = _unknowns(X_MB, np.full_like(graph.p_ML, np.nan), rows)
        starts.append(planar.grown(x, lambda share: report(0.9 * share)))
    elif not starts:
        raise ValueError(
            f"pose {loose[0]} is tied to no earlier pose" if len(loose) else f"landmark {unseen[0]} has no sighting"
        )
    x, _ = min((planar.solved(start, STEPS_TO_COMPARE) for start in starts), key=lambda one: one[1])
    x, _ = planar.solved(x)
    report(1.0)
    X_MB, X_ML = np.split(x.reshape(-1, 3)[rows], [k])
    return replace(graph, X_MB=np.column_stack([X_MB[:, :2], se2.wrap_angle(X_MB[:, 2])]), p_ML=X_ML[:, :2])


def _unknowns(X_MB: FloatArray, p_ML: FloatArray, rows: IntArray) -> FloatArray:
    """The vector of poses and landmarks that stand in these rows of a PlanarGraph, poses first."""
    X_M = np.empty((len(rows), 3))
    X_M[rows] = np.vstack([X_MB, np.column_stack([p_ML, np.zeros(len(p_ML))])])
    return X_M.ravel()


def _planar(graph: PoseGraph) -> tuple[PlanarGraph, IntArray]:
    """The graph as it grows, each landmark after the pose that sees it first, and the rows of its poses, then of its
    landmarks."""
    k, n = len(graph.pose_ids), len(graph.landmark_ids)
    ends = np.searchsorted(graph.pose_ids, graph.edges)
    pose = np.searchsorted(graph.pose_ids, graph.sightings[:, 0])
    landmark = np.searchsorted(graph.landmark_ids, graph.sightings[:, 1])
    first_seen = np.full(n, k)
    np.minimum.at(first_seen, landmark, pose)
    order = np.argsort(np.append(np.arange(k), first_seen), kind="stable")
    rows = np.argsort(order)
    fixed = graph.fixed if len(graph.fixed) else graph.pose_ids[:1]
    # g2o has the error as it is seen from the measured pose.
    R_ji = np.zeros_like(graph.edge_information)
    c, s = np.cos(graph.X_ij[:, 2]), np.sin(graph.X_ij[:, 2])
    R_ji[:, 0, 0], R_ji[:, 0, 1], R_ji[:, 1, 0], R_ji[:, 1, 1], R_ji[:, 2, 2] = c, s, -s, c, 1.0
    whitener = np.zeros((len(ends) + len(pose), 3, 3))
    whitener[: len(ends)] = _root(graph.edge_information) @ R_ji
    whitener[len(ends) :, :2, :2] = _root(graph.sighting_information)
    X_ij = np.vstack([graph.X_ij, np.column_stack([graph.p_BL, np.zeros(len(pose))])])
    measured = rows[np.vstack([ends, np.column_stack([pose, k + landmark])])]
    growing = np.lexsort((measured.min(axis=1), measured.max(axis=1)))
    first, second = measured[growing].T
    held = np.append(np.isin(graph.pose_ids, fixed), np.zeros(n, dtype=np.bool_))[order]
    return PlanarGraph(order >= k, held, first, second, X_ij[growing], whitener[growing]), rows


def _root(information: FloatArray) -> FloatArray:
    """(m, d, d) W with W^T W the information (m, d, d)."""
    return np.asarray(np.linalg.cholesky(information).transpose(0, 2, 1))
