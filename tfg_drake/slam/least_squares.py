"""Sparse nonlinear least squares by the method of Levenberg and Marquardt.

Whoever calls it linearises all residuals of one kind at once, in arrays; the normal equations are factored by SuperLU.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from tfg_drake.messages import BoolArray, FloatArray, IntArray

# Steps of one solve that lower the cost, at most, and the relative decrease of the cost after which no other is needed.
MOST_STEPS = 100
SMALL_DECREASE = 1e-9
# Damping, as a share of the Hessian's diagonal: at first next to none, for it would keep a long chain of poses from
# bending as a whole; what a solution may end with; and what shows that no step lowers the cost any more.
FIRST_DAMPING = 1e-9
LITTLE_DAMPING = 1e-6
LARGEST_DAMPING = 1e9
# For symmetric positive matrices whose factor is sparse all over.
_SUPERLU = {
    "permc_spec": "MMD_AT_PLUS_A",
    "diag_pivot_thresh": 0.0,
    "panel_size": 1,
    "options": {"SymmetricMode": True},
}


@dataclass(frozen=True)
class Rows:
    """m residuals of one kind, linearised.

    residual: (m, d), whitened. columns: (m, w), the unknowns that each depends on. jacobian: (m, d, w). huber: the length
    beyond which a residual costs in proportion to its length.
    """

    residual: FloatArray
    columns: IntArray
    jacobian: FloatArray
    huber: float = math.inf


# The residuals at values (n,) of all unknowns.
Linearise = Callable[[FloatArray], Sequence[Rows]]


def cost(rows: Sequence[Rows]) -> float:
    """Half the sum of the squared lengths of all residuals, Huber's function of those that have a threshold."""
    total = 0.0
    for one in rows:
        length = np.linalg.norm(one.residual, axis=1)
        inside = np.minimum(length, one.huber)
        total += float(np.sum(inside * (length - 0.5 * inside)))
    return total


def minimise(
    linearise: Linearise, x: FloatArray, held: IntArray, most_steps: int = MOST_STEPS
) -> tuple[FloatArray, float]:
    """The values of least cost that steps from x (n,) lead to, and their cost.

    held: unknowns that stay as they are; so do those that no residual depends on. An unknown that the residuals do not
    determine stays near its value.
    """
    rows = linearise(x)
    least = cost(rows)
    free = np.zeros(len(x), dtype=bool)
    for one in rows:
        free[one.columns] = True
    free[held] = False
    damping, growth = FIRST_DAMPING, 2.0
    for _ in range(most_steps):
        hessian, gradient = _normal_equations(rows, free)
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


def _normal_equations(rows: Sequence[Rows], free: BoolArray) -> tuple[sparse.csc_array, FloatArray]:
    """J^T J and J^T r by the free unknowns, each residual weighted as its Huber function asks."""
    residuals, data, columns, widths = [], [], [], []
    for one in rows:
        length = np.linalg.norm(one.residual, axis=1)
        weight = (
            np.sqrt(one.huber / np.maximum(length, one.huber)) if math.isfinite(one.huber) else np.ones(len(length))
        )
        m, d, w = one.jacobian.shape
        residuals.append((weight[:, None] * one.residual).ravel())
        data.append((weight[:, None, None] * one.jacobian).ravel())
        columns.append(np.repeat(one.columns, d, axis=0).ravel())
        widths.append(np.full(m * d, w))
    residual = np.concatenate(residuals)
    ends = np.append(0, np.cumsum(np.concatenate(widths)))
    shape = (len(residual), len(free))
    J = sparse.csr_array((np.concatenate(data), np.concatenate(columns), ends), shape=shape)[:, free]
    return (J.T @ J).tocsc(), J.T @ residual


def _step(hessian: sparse.csc_array, gradient: FloatArray, damping: float) -> FloatArray:
    """The damped Gauss-Newton step, nan where the damped Hessian is singular."""
    damped = hessian + sparse.diags_array(damping * hessian.diagonal(), format="csc")
    try:
        factors = splu(damped, **_SUPERLU)
    except RuntimeError:
        return np.full(len(gradient), np.nan)
    return np.asarray(factors.solve(-gradient))
