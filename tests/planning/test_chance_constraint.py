import numpy as np
import pytest
from scipy.stats import norm

from tfg_drake.planning.chance_constraint import localised_deviation, required_clearance


def deviation(targets, frames=4.0):
    targets = np.asarray(targets, dtype=float)
    n = len(targets)
    return localised_deviation(np.zeros((1, 2)), np.array([0, n]), np.arange(n), targets, 0.02, 0.01, 0.01, frames)[0]


@pytest.mark.parametrize("seed", range(5))
def test_deviation_is_the_inverse_information_with_heading_unknown(seed):
    targets = np.random.default_rng(seed).uniform(-5, 5, (4, 2))
    information = np.zeros((3, 3))
    for p in targets:
        r = np.linalg.norm(p)
        J = np.array([[-p[0] / r, -p[1] / r, 0], [p[1] / r**2, -p[0] / r**2, -1]])
        information += 4.0 * J.T @ np.diag([(0.02 + 0.01 * r) ** -2, 0.01**-2]) @ J
    worst = np.linalg.eigvalsh(np.linalg.inv(information)[:2, :2])[-1] ** 0.5
    assert deviation(targets) == pytest.approx(worst, rel=1e-9)


def test_one_landmark_does_not_localise():
    assert deviation([[1, 0]]) == np.inf
    assert deviation([[1, 0], [0, 1]]) < 0.05


def test_required_clearance_keeps_the_collision_probability():
    sigma = np.array([0.03])
    need = required_clearance(0.18, sigma, 0.01)
    assert norm.cdf((0.18 - need) / sigma) == pytest.approx(0.01)
