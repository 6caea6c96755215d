"""The linear system of a small keyframe graph: all landmarks are known jointly, GTSAM eliminates the poses.

What is left is dense: its solution gives the rest by back-substitution, its inverse is the joint covariance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from functools import partial

import gtsam
import numpy as np
import scipy.linalg
import scipy.sparse
from scipy.sparse.linalg import splu

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.factors import Factors, Linear, Solved, Values, at_errors, error_of_errors
from tfg_drake.slam.keyframe_graph import KeyframeGraph
from tfg_drake.slam.keyframe_kernels import InCells, Unknowns, assemble, assemble_tag_errors
from tfg_drake.slam.least_squares import SYMMETRIC

# Where no step can be made, every unknown is held to its place by this information, and a hundred times as much each
# time. The first holds what hangs on nothing by 100 m, or rad.
LEAST_DAMPING = 1e-4
DAMPING_GROWTH = 100.0
MOST_DAMPING = 1e10
# Unknowns of a cell: what GTSAM handles as one variable.
CELL = 48


@dataclasses.dataclass(frozen=True)
class Cells:
    """Where the unknowns are: landmarks and nodes near each other make a cell; the first `kept` cells are kept.

    Arrays as in `keyframe_kernels.Unknowns` and `InCells`. pairs: (p, 2) cells that share a keyframe, bounds: (p + 1,)
    of their blocks. dense: unknowns kept.
    """

    landmark_at: IntArray
    node_at: IntArray
    error_at: IntArray
    cell: IntArray
    first: IntArray
    size: IntArray
    block_at: IntArray
    pairs: IntArray
    bounds: IntArray
    kept: int
    dense: int

    # Each step is of a system linearised anew.
    keeps_for = 0.0

    def linearised(self, factors: Factors, values: Values) -> Linear:
        """The system at some values."""
        blocks, gradient, error, poses = _linearised(factors, self, values)

        def solved(gradient: FloatArray) -> Solved:
            eliminated, root = _factorised(self, blocks, gradient)
            log_determinant = eliminated.log_determinant + 2.0 * float(np.sum(np.log(np.diag(root))))
            return Solved(_step(self, eliminated, root), partial(_covariance, root), log_determinant)

        return Linear(solved, gradient, error, poses, lambda: _log_determinant_of_rest(self, blocks))

    def again(self, _: Linear, factors: Factors, values: Values) -> Linear:
        """The same of other values or factors."""
        return self.linearised(factors, values)


@dataclasses.dataclass(frozen=True)
class _Eliminated:
    """What is left when all but the kept unknowns are eliminated. information: (d, d), vector: (d,) of the kept.
    conditionals: those of the others given the kept, None without any. log_determinant: of the information on the
    others given the kept."""

    information: FloatArray
    vector: FloatArray
    conditionals: gtsam.GaussianBayesNet | None
    log_determinant: float


def _bisected(points: FloatArray, index: IntArray, most: int) -> Iterable[IntArray]:
    """Some of the points (n, 2), by their index (i,), in groups of at most so many that lie together."""
    if len(index) <= most:
        return [index] if len(index) else []
    some = points[index]
    order = index[np.argsort(some[:, np.argmax(np.ptp(some, axis=0))], kind="stable")]
    half = len(order) // 2
    return [*_bisected(points, order[:half], most), *_bisected(points, order[half:], most)]


def cells_of(graph: KeyframeGraph, factors: Factors, node: int) -> Cells:
    """The cells of a graph, all landmarks and a node kept."""
    n, k = len(graph.ids), len(graph.keyframes)
    inner = np.delete(np.arange(1, k + 1), node - 1)
    has_errors = bool(factors.tag_error.any())
    near = list(_bisected(graph.p_ML, np.arange(n), CELL // 2))
    poses = list(_bisected(graph.X_MN[:, :2], inner, CELL // 3))
    landmark_at, error_at, node_at = np.full(n, -1), np.full(n, -1), np.full(k + 1, -1)
    landmark_cell, error_cell, node_cell = np.full(n, -1), np.full(n, -1), np.full(k + 1, -1)
    landmark, error, pose = (landmark_at, landmark_cell, 2), (error_at, error_cell, 2), (node_at, node_cell, 3)
    groups = [(group, landmark) for group in near] + [(np.array([node]), pose)]
    groups += [(group, error) for group in near if has_errors]
    kept = len(groups)
    groups += [(group, pose) for group in poses]

    size = np.array([width * len(group) for group, (_, _, width) in groups])
    first = np.cumsum(size) - size
    for number, (group, (at, of, width)) in enumerate(groups):
        at[group] = first[number] + width * np.arange(len(group))
        of[group] = number
    together = np.zeros((k, len(groups)), dtype=bool)
    keyframe = np.repeat(np.arange(k), np.diff(factors.keyframes.offsets))
    together[keyframe, landmark_cell[factors.keyframes.rows]] = True
    if has_errors:
        together[keyframe, error_cell[factors.keyframes.rows]] = True
    together[np.arange(k), node_cell[1:]] = True
    together[np.arange(1, k), node_cell[1:k]] = True
    shared = together.T.astype(np.float32) @ together.astype(np.float32)
    pairs = np.argwhere(np.triu(shared > 0.0))
    bounds = np.append(0, np.cumsum(size[pairs[:, 0]] * size[pairs[:, 1]]))
    block_at = np.full((len(groups), len(groups)), -1)
    block_at[pairs[:, 0], pairs[:, 1]] = bounds[:-1]
    return Cells(
        landmark_at=landmark_at,
        node_at=node_at,
        error_at=error_at,
        cell=np.repeat(np.arange(len(groups)), size),
        first=first,
        size=size,
        block_at=block_at,
        pairs=pairs,
        bounds=bounds,
        kept=kept,
        dense=int(size[:kept].sum()),
    )


def _linearised(factors: Factors, cells: Cells, values: Values) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Blocks and gradient (u,) at some values, the weighted squared error there, and the blocks of the poses."""
    blocks, gradient = np.zeros(cells.bounds[-1]), np.zeros(len(cells.cell))
    seen, every = at_errors(factors, values.errors).keyframes, np.arange(len(factors.keyframes.X_AD))
    at = Unknowns(cells.landmark_at, cells.node_at, cells.error_at)
    in_cells = InCells(cells.cell, cells.first, cells.size, cells.block_at)
    error, poses = assemble(every, seen, values.X_MN, values.p_ML, at, in_cells, blocks, gradient)
    if factors.tag_error.any():
        where = values.X_MN, values.p_ML, values.errors
        assemble_tag_errors(every, seen, factors.on_errors, *where, at, in_cells, blocks, gradient)
        own, prior = cells.error_at[:, None] + [0, 1], factors.tag_error**-2
        cell = cells.cell[own]
        entry = own - cells.first[cell]
        blocks[cells.block_at[cell, cell] + entry * (cells.size[cell] + 1)] += prior
        gradient[own] += prior * values.errors
        error += error_of_errors(factors, values.errors)
    return blocks, gradient, error, poses


def _factorised(cells: Cells, blocks: FloatArray, gradient: FloatArray) -> tuple[_Eliminated, FloatArray]:
    """The system with all but the kept eliminated, and the lower Cholesky factor of what is left.

    Where some part of the map hangs on nothing that a double can tell, all is held by as little as it takes.
    """
    damping = 0.0
    while True:
        try:
            eliminated = _eliminated(cells, blocks, gradient, damping)
            return eliminated, scipy.linalg.cholesky(eliminated.information, lower=True, check_finite=False)
        except (RuntimeError, scipy.linalg.LinAlgError):
            if damping > MOST_DAMPING:
                raise
            damping = max(DAMPING_GROWTH * damping, LEAST_DAMPING)


def _eliminated(cells: Cells, blocks: FloatArray, gradient: FloatArray, damping: float) -> _Eliminated:
    first, size, kept = cells.first.tolist(), cells.size.tolist(), cells.kept
    information, vector = damping * np.eye(cells.dense), -gradient[: cells.dense]
    sparse, touched = gtsam.GaussianFactorGraph(), set()
    zero = {one: (np.zeros((one, one)), np.zeros(one)) for one in set(size)}
    for (i, j), start, end in zip(cells.pairs.tolist(), cells.bounds[:-1], cells.bounds[1:], strict=True):
        block = blocks[start:end].reshape(size[i], size[j])
        if j < kept:
            information[first[i] : first[i] + size[i], first[j] : first[j] + size[j]] += block
            if i != j:
                information[first[j] : first[j] + size[j], first[i] : first[i] + size[i]] += block.T
        elif i == j:
            held = block + damping * np.eye(size[i]) if damping else block
            sparse.push_back(gtsam.HessianFactor(i, held, -gradient[first[i] : first[i] + size[i]], 0.0))
        else:
            (G_i, g_i), (G_j, g_j) = zero[size[i]], zero[size[j]]
            sparse.push_back(gtsam.HessianFactor(i, j, G_i, block, g_i, G_j, g_j, 0.0))
            if i < kept:
                touched.add(i)
    if len(size) == kept:
        return _Eliminated(information, vector, None, 0.0)
    last = sorted(touched)
    everything = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(sparse, last, False)
    before, after = gtsam.Ordering(), gtsam.Ordering()
    for place in range(len(size) - kept):
        before.push_back(everything.at(place))
    for i in last:
        after.push_back(i)
    conditionals, left = sparse.eliminatePartialSequential(before)
    if last:
        of_last, vector_of_last = left.hessian(after)
        at = np.concatenate([np.arange(first[i], first[i] + size[i]) for i in last])
        # As a rule all kept cells are touched; to pick them by their numbers takes a quarter of the elimination's time.
        touched_at = np.ix_(at, at) if len(at) < cells.dense else np.s_[:, :]
        information[touched_at] += of_last
        vector[at] += vector_of_last
    roots = (conditionals.at(place).R() for place in range(conditionals.size()))
    log_determinant = 2.0 * sum(float(np.sum(np.log(np.abs(np.diag(root))))) for root in roots)
    return _Eliminated(information, vector, conditionals, log_determinant)


def _step(cells: Cells, eliminated: _Eliminated, root: FloatArray) -> FloatArray:
    """(u,) the step of Gauss and Newton."""
    step = np.empty(len(cells.cell))
    step[: cells.dense] = scipy.linalg.cho_solve((root, True), eliminated.vector, check_finite=False)
    if eliminated.conditionals is not None:
        known = gtsam.VectorValues()
        for i, size in enumerate(cells.size[: cells.kept].tolist()):
            known.insert(i, step[cells.first[i] : cells.first[i] + size])
        found = eliminated.conditionals.optimize(known)
        for i in range(cells.kept, len(cells.size)):
            step[cells.first[i] : cells.first[i] + cells.size[i]] = found.at(i)
    return step


def _covariance(root: FloatArray, at: IntArray) -> FloatArray:
    """(c, c) the joint covariance of kept unknowns (c,). root: (d, d) lower Cholesky factor of the information."""
    lower, _ = scipy.linalg.lapack.dpotri(root, lower=1)
    whole = np.tril(lower) + np.tril(lower, -1).T
    return np.asarray(whole[np.ix_(at, at)])


def _log_determinant_of_rest(cells: Cells, blocks: FloatArray) -> float:
    """Of the information on all unknowns but the landmarks, given these."""
    in_rest = np.ones(len(cells.size), dtype=np.bool_)
    in_rest[cells.cell[cells.landmark_at]] = False
    size, first = cells.size, np.cumsum(cells.size * in_rest) - cells.size * in_rest
    rows, columns, entries = [], [], []
    for (i, j), start, end in zip(cells.pairs.tolist(), cells.bounds[:-1], cells.bounds[1:], strict=True):
        if not (in_rest[i] and in_rest[j]):
            continue
        block = blocks[start:end].reshape(size[i], size[j])
        row, column = np.indices(block.shape)
        # Of a block on the diagonal the upper half counts.
        upper = column >= row if i == j else np.ones(block.shape, dtype=np.bool_)
        rows.append(first[i] + row[upper])
        columns.append(first[j] + column[upper])
        entries.append(block[upper])
    row, column, entry = (np.concatenate(parts) for parts in (rows, columns, entries))
    off = row != column
    both = np.append(entry, entry[off]), (np.append(row, column[off]), np.append(column, row[off]))
    # GTSAM refuses what a robot that was kidnapped is all but untied by as indeterminate.
    matrix = scipy.sparse.csc_matrix(both, shape=(int(size[in_rest].sum()),) * 2)
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", **SYMMETRIC)
    return float(np.sum(np.log(np.abs(factor.U.diagonal()))))
