"""Sparse nonlinear least squares by the method of Levenberg and Marquardt.

Whoever calls it linearises all residuals at once, in arrays; the normal equations are factored by SuperLU.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from tfg_drake.messages import FloatArray, IntArray

# Steps of one solve that lower the cost, at most, and the relative decrease of the cost after which no other is needed.
MOST_STEPS = 100
SMALL_DECREASE = 1e-10
# Damping, as a share of the Hessian's diagonal: at first next to none, for it would keep a long chain of poses from
# bending as a whole; what a solution may end with; and what shows that no step lowers the cost any more.
FIRST_DAMPING = 1e-9
LITTLE_DAMPING = 1e-6
LARGEST_DAMPING = 1e9
# SuperLU for symmetric positive matrices whose factor is sparse all over.
SYMMETRIC = {"diag_pivot_thresh": 0.0, "panel_size": 1, "options": {"SymmetricMode": True}}


@dataclass(frozen=True)
class Rows:
    """m residuals, linearised.

    residual: (m, d), whitened. columns: (m, w), the unknowns that each depends on. jacobian: (m, d, w).
    """

    residual: FloatArray
    columns: IntArray
    jacobian: FloatArray


# The residuals at values (n,) of all unknowns.
Linearise = Callable[[FloatArray], Rows]


def cost(rows: Rows) -> float:
    """Half the sum of the squared lengths of all residuals."""
    return 0.5 * float(np.sum(rows.residual**2))


def minimise(
    linearise: Linearise, x: FloatArray, held: IntArray, blocks: IntArray, most_steps: int = MOST_STEPS
) -> tuple[FloatArray, float]:
    """The values of least cost that steps from x (n,) lead to, and their cost.

    held: unknowns that stay as they are; so do those that no residual depends on. An unknown that the residuals do not
    determine stays near its value. blocks: (n,) the number of the pose, landmark or other that each unknown is part of.
    """
    rows = linearise(x)
    least = cost(rows)
    free = _elimination_order(rows, held, blocks)
    if not len(free):
        return x, least
    damping, growth = FIRST_DAMPING, 2.0
    for _ in range(most_steps):
        hessian, gradient = _normal_equations(rows, free, len(x))
        decrease = -math.inf
        while not decrease > 0.0:
            step = _step(hessian, gradient, damping)
            moved = x.copy()
            moved[free] += step
            rows = linearise(moved)
            decrease = least - cost(rows)
            if not decrease > 0.0:
                if abs(decrease) <= SMALL_DECREASE * least or damping > LARGEST_DAMPING:
                    return x, least
                damping, growth = growth * damping, 2.0 * growth
        x, least = moved, least - decrease
        if decrease <= SMALL_DECREASE * least and damping <= LITTLE_DAMPING:
            break
        # Nielsen's rule, by how much of the decrease came true that the quadratic model foretold.
        foretold = -(step @ gradient) - 0.5 * (step @ (hessian @ step))
        damping *= max(0.1, 1.0 - (2.0 * decrease / foretold - 1.0) ** 3)
        growth = 2.0
    return x, least


def _elimination_order(rows: Rows, held: IntArray, blocks: IntArray) -> IntArray:
    """The free unknowns, by minimum degree: block by block, for that is found many times faster than one by one."""
    free = np.zeros(len(blocks), dtype=bool)
    free[rows.columns] = True
    free[held] = False
    count, ties = int(blocks.max()) + 1, blocks[rows.columns]
    incidence = _matrix(np.ones((len(ties), 1, ties.shape[1])), ties, count)
    pattern = incidence.T @ incidence + sparse.eye_array(count)
    position = splu(pattern.tocsc(), permc_spec="MMD_AT_PLUS_A", **SYMMETRIC).perm_c
    unknowns = np.flatnonzero(free)
    return unknowns[np.argsort(position[blocks[unknowns]], kind="stable")]


def _normal_equations(rows: Rows, free: IntArray, n: int) -> tuple[sparse.csc_array, FloatArray]:
    """J^T J and J^T r by the free ones of n unknowns."""
    J = _matrix(rows.jacobian, rows.columns, n)[:, free]
    return (J.T @ J).tocsc(), J.T @ rows.residual.ravel()


def _matrix(values: FloatArray, at: IntArray, n: int) -> sparse.csr_array:
    """The sparse matrix of n columns with dense rows (m, d, w) at columns (m, w)."""
    m, d, w = values.shape
    return sparse.csr_array((values.ravel(), np.repeat(at, d, axis=0).ravel(), w * np.arange(m * d + 1)), (m * d, n))


def _step(hessian: sparse.csc_array, gradient: FloatArray, damping: float) -> FloatArray:
    """The damped Gauss-Newton step, nan where the damped Hessian is singular."""
    damped = hessian + sparse.diags_array(damping * hessian.diagonal(), format="csc")
    try:
        factors = splu(damped, permc_spec="NATURAL", **SYMMETRIC)
    except RuntimeError:
        return np.full(len(gradient), np.nan)
    return np.asarray(factors.solve(-gradient))
