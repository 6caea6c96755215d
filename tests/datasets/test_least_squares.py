"""Sparse least squares against scipy's dense solver, on problems that know nothing of robots."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from tfg_drake.datasets.least_squares import Rows, cost, minimise

POINTS = np.random.default_rng(3).uniform(-5.0, 5.0, (12, 2))
PAIRS = np.array([(i, j) for i in range(12) for j in range(i) if (i + j) % 3])
DISTANCE = np.linalg.norm(POINTS[PAIRS[:, 0]] - POINTS[PAIRS[:, 1]], axis=1)
DISTANCE = DISTANCE + 0.1 * np.random.default_rng(4).standard_normal(len(PAIRS))
DISTANCE[::9] += 2.0
HELD = np.array([0, 1, 2])
BLOCKS = np.repeat(np.arange(12), 2)


def distances(x):
    """Points in the plane by some of their distances."""
    p = x.reshape(-1, 2)
    d = p[PAIRS[:, 0]] - p[PAIRS[:, 1]]
    length = np.linalg.norm(d, axis=1)
    columns = np.concatenate([2 * PAIRS[:, :1] + (0, 1), 2 * PAIRS[:, 1:] + (0, 1)], axis=1)
    toward = (d / length[:, None])[:, None]
    jacobian = np.concatenate([toward, -toward], axis=2) / 0.1
    return Rows(((length - DISTANCE) / 0.1)[:, None], columns, jacobian)


def test_the_values_are_those_of_a_dense_solver():
    start = (POINTS + 0.3 * np.random.default_rng(5).standard_normal(POINTS.shape)).ravel()
    x, least = minimise(distances, start, HELD, BLOCKS)
    free = np.setdiff1d(np.arange(24), HELD)

    def residual(values):
        moved = start.copy()
        moved[free] = values
        return distances(moved).residual[:, 0]

    dense = least_squares(residual, start[free], xtol=1e-14, ftol=1e-14, gtol=1e-12)
    assert least == pytest.approx(dense.cost, rel=1e-6)
    np.testing.assert_allclose(x[free], dense.x, atol=2e-5)
    np.testing.assert_array_equal(x[HELD], start[HELD])
    assert least == pytest.approx(cost(distances(x)))


def test_an_unknown_that_nothing_determines_stays_near_its_value():
    """The sum of two unknowns is measured, a third is measured by nothing."""

    def linearise(x):
        return Rows(np.array([[x[0] + x[1] - 3.0]]), np.array([[0, 1]]), np.ones((1, 1, 2)))

    x, least = minimise(linearise, np.array([1.0, 1.0, 7.0]), np.empty(0, dtype=np.int64), np.arange(3))
    np.testing.assert_allclose(x, [1.5, 1.5, 7.0], atol=1e-6)
    assert least < 1e-12


def test_where_all_is_held_nothing_moves():
    start = POINTS.ravel()
    x, least = minimise(distances, start, np.arange(24), BLOCKS)
    np.testing.assert_array_equal(x, start)
    assert least > 0.0
