"""A planar graph of poses and landmarks tied by relative measurements, each with its own information, and its solution.

This is what a g2o file holds. It is no stream of range and bearing, so the online estimator cannot run on it. The
solution is that of sparse nonlinear least squares by the method of Levenberg and Marquardt, with g2o's error of a pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from tfg_drake.datasets.recording import OnProgress
from tfg_drake.geometry import se2
from tfg_drake.messages import BoolArray, FloatArray, IntArray, message, replace
from tfg_drake.notes import Note

# Greatest number of steps; it has converged after a step with a smaller relative decrease of the cost.
MOST_STEPS, SMALL_DECREASE = 100, 1e-10
# Damping as a share of the Hessian's diagonal: at the start, low as it hinders a long chain of poses from bending; the
# greatest of a converged solution; and the one at which no step lowers the cost any more.
FIRST_DAMPING, LITTLE_DAMPING, LARGEST_DAMPING = 1e-9, 1e-6, 1e9
# SuperLU for symmetric positive matrices whose factor is sparse all over.
SYMMETRIC = {"diag_pivot_thresh": 0.0, "panel_size": 1, "options": {"SymmetricMode": True}}
# Number of poses and landmarks added between two solves.
AT_ONCE = 50


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
    problem, rows = _problem(graph)
    return _cost(problem.linearised(_unknowns(graph.X_MB, graph.p_ML, rows))[0])


def solve_pose_graph(graph: PoseGraph, report: OnProgress = lambda _share: None) -> PoseGraph:
    """The graph at its least-squares values.

    The problem is not convex: it is solved from the values that the graph states, if it states all of them, and from
    values built up in the order of the ids, and the solution of the smaller error counts. Without a fixed pose
    the first one is held. report: called with the share of the work done, 0 to 1. Raises ValueError where a pose is
    tied to no earlier one, or a landmark was never seen.
    """
    problem, rows = _problem(graph)
    starts, k = [], len(graph.pose_ids)
    if np.isfinite(graph.X_MB).all() and np.isfinite(graph.p_ML).all():
        starts.append(_unknowns(graph.X_MB, graph.p_ML, rows))
    X_MB = np.where(problem.held[rows[:k], :1], graph.X_MB, np.nan)
    X_MB[0] = np.nan_to_num(X_MB[0])
    loose = np.setdiff1d(graph.pose_ids[np.isnan(X_MB[:, 0])], graph.edges.max(axis=1))
    unseen = np.setdiff1d(graph.landmark_ids, graph.sightings[:, 1])
    if not len(loose) and not len(unseen):
        X_M = _unknowns(X_MB, np.full_like(graph.p_ML, np.nan), rows)
        starts.append(problem.grown(X_M, lambda share: report(0.9 * share)))
    elif not starts:
        raise ValueError(
            f"pose {loose[0]} is tied to no earlier pose" if len(loose) else f"landmark {unseen[0]} has no sighting"
        )
    X_M, _ = min(map(problem.solved, starts), key=lambda one: one[1])
    report(1.0)
    X_MB, X_ML = np.split(X_M[rows], [k])
    return replace(graph, X_MB=np.column_stack([X_MB[:, :2], se2.wrap_angle(X_MB[:, 2])]), p_ML=X_ML[:, :2])


@dataclass(frozen=True)
class _Problem:
    """n poses and landmarks in the order in which the graph grows, and m measured poses of one in another. A landmark
    is a pose, too, whose heading stays 0 and is measured by nothing: so all measurements are of one kind.

    landmark: (n,) which are landmarks. held: (n, 3) which of their numbers stay as they are. first, second: (m,) rows
    of the poses, in the order of the later, then of the earlier. X_ij: (m, 3), the second in the first. whitener: (m,
    3, 3) of the error of X_ij.
    """

    landmark: BoolArray
    held: BoolArray
    first: IntArray
    second: IntArray
    X_ij: FloatArray
    whitener: FloatArray

    def linearised(self, X_M: FloatArray) -> tuple[FloatArray, sparse.csr_array]:
        """Whitened errors (3 m,) at poses X_M (n, 3), and their Jacobian (3 m, 3 n)."""
        d = X_M[self.second] - X_M[self.first]
        c, s = np.cos(X_M[self.first, 2]), np.sin(X_M[self.first, 2])
        R_BM = np.stack([c, s, -s, c], axis=1).reshape(-1, 2, 2)
        p = np.einsum("mij,mj->mi", R_BM, d[:, :2])
        error = np.column_stack([p - self.X_ij[:, :2], se2.wrap_angle(d[:, 2] - self.X_ij[:, 2])])
        jacobian = np.zeros((len(error), 3, 6))
        jacobian[:, :2, :2], jacobian[:, :2, 3:5] = -R_BM, R_BM
        jacobian[:, :2, 2] = np.column_stack([p[:, 1], -p[:, 0]])
        jacobian[:, 2, 2], jacobian[:, 2, 5] = -1.0, 1.0
        columns = 3 * np.repeat(np.column_stack([self.first, self.second]), 3, axis=1) + np.tile(np.arange(3), 2)
        rows, values = np.repeat(columns, 3, axis=0).ravel(), (self.whitener @ jacobian).ravel()
        shape = (3 * len(error), X_M.size)
        J = sparse.csr_array((values, rows, np.arange(0, len(values) + 1, 6)), shape)
        return np.einsum("mij,mj->mi", self.whitener, error).ravel(), J

    def _free(self) -> IntArray:
        """The numbers of X_M (n, 3) that are not held, by minimum degree: pose by pose, for that is found many times
        faster than one by one. Those that no measurement depends on stay as they are."""
        m, n = len(self.first), len(self.held)
        tied = np.column_stack([self.first, self.second])
        incidence = sparse.csr_array((np.ones(2 * m), tied.ravel(), np.arange(0, 2 * m + 1, 2)), (m, n))
        pattern = incidence.T @ incidence + sparse.eye_array(n)
        position = splu(pattern.tocsc(), permc_spec="MMD_AT_PLUS_A", **SYMMETRIC).perm_c
        free = ~self.held & np.isin(np.arange(n), tied)[:, None]
        order = np.argsort(position, kind="stable")
        return (3 * order[:, None] + np.arange(3))[free[order]]

    def solved(self, X_M: FloatArray, most_steps: int = MOST_STEPS) -> tuple[FloatArray, float]:
        """The poses of least cost that steps from X_M (n, 3) lead to, and their cost. What the measurements do not
        determine stays near its value."""
        residual, J = self.linearised(X_M)
        least, free = _cost(residual), self._free()
        damping, growth = FIRST_DAMPING, 2.0
        for _ in range(most_steps if len(free) else 0):
            J = J[:, free]
            hessian, gradient = (J.T @ J).tocsc(), J.T @ residual
            decrease = -math.inf
            while not decrease > 0.0:
                step, moved = _step(hessian, gradient, damping), X_M.copy()
                moved.flat[free] += step
                residual, J = self.linearised(moved)
                decrease = least - _cost(residual)
                if not decrease > 0.0:
                    if abs(decrease) <= SMALL_DECREASE * least or damping > LARGEST_DAMPING:
                        return X_M, least
                    damping, growth = growth * damping, 2.0 * growth
            X_M, least = moved, least - decrease
            if decrease <= SMALL_DECREASE * least and damping <= LITTLE_DAMPING:
                break
            # Nielsen's rule, by how much of the decrease came true that the quadratic model foretold.
            foretold = -(step @ gradient) - 0.5 * (step @ (hessian @ step))
            damping *= max(0.1, 1.0 - (2.0 * decrease / foretold - 1.0) ** 3)
            growth = 2.0
        return X_M, least

    def grown(self, X_M: FloatArray, report: OnProgress) -> FloatArray:
        """(n, 3) poses near the solution, each added by the measurement that ties it to the latest pose before it: dead
        reckoning alone would go far astray.

        X_M: (n, 3) those to begin from, at least the first; nan where a pose or landmark is to be added.
        """
        later, from_pose = np.maximum(self.first, self.second), ~self.landmark[np.minimum(self.first, self.second)]
        tie = np.zeros(len(self.held), dtype=np.int64)
        tie[later[from_pose]] = np.flatnonzero(from_pose)
        X_M = X_M.copy()
        for begin in range(0, len(tie), AT_ONCE):
            end = min(begin + AT_ONCE, len(tie))
            for i in np.flatnonzero(np.isnan(X_M[begin:end, 0])) + begin:
                first, second, X_ij = self.first[tie[i]], self.second[tie[i]], self.X_ij[tie[i]]
                X_M[i] = se2.compose(X_M[first], X_ij) if second == i else se2.compose(X_M[second], se2.inverse(X_ij))
                X_M[i, 2] *= not self.landmark[i]
            m = np.searchsorted(later, end)
            measured = {name: getattr(self, name)[:m] for name in ("first", "second", "X_ij", "whitener")}
            X_M, _ = replace(self, **measured).solved(X_M, most_steps=1)
            report(end / len(tie))
        return X_M


def _cost(residual: FloatArray) -> float:
    return 0.5 * float(np.sum(residual**2))


def _step(hessian: sparse.csc_array, gradient: FloatArray, damping: float) -> FloatArray:
    """The damped Gauss-Newton step, nan where the damped Hessian is singular."""
    damped = hessian + sparse.diags_array(damping * hessian.diagonal(), format="csc")
    try:
        factors = splu(damped, permc_spec="NATURAL", **SYMMETRIC)
    except RuntimeError:
        return np.full(len(gradient), np.nan)
    return np.asarray(factors.solve(-gradient))


def _unknowns(X_MB: FloatArray, p_ML: FloatArray, rows: IntArray) -> FloatArray:
    """(n, 3) poses and landmarks as they stand in these rows of a _Problem, poses first."""
    X_M = np.empty((len(rows), 3))
    X_M[rows] = np.vstack([X_MB, np.column_stack([p_ML, np.zeros(len(p_ML))])])
    return X_M


def _problem(graph: PoseGraph) -> tuple[_Problem, IntArray]:
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
    held = np.zeros((k + n, 3), dtype=np.bool_)
    held[:k] = np.isin(graph.pose_ids, graph.fixed if len(graph.fixed) else graph.pose_ids[:1])[:, None]
    held[k:, 2] = True
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
    return _Problem(order >= k, held[order], first, second, X_ij[growing], whitener[growing]), rows


def _root(information: FloatArray) -> FloatArray:
    """(m, d, d) W with W^T W the information (m, d, d)."""
    return np.asarray(np.linalg.cholesky(information).transpose(0, 2, 1))
