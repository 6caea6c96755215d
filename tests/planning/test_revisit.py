import numpy as np
import pytest

from tests.planning.test_information_gain import problem, whitened
from tfg_drake.config import TagSensorConfig
from tfg_drake.planning.expected_view import View
from tfg_drake.planning.information_gain import turn_noise
from tfg_drake.planning.revisit import error_removed, squared_by_landmarks


def brute_force(point, Q, seen, p_ML, X_MD, covariance, noise):
    """How much the landmarks' variances fall, all together, by the information of landmarks, departure and arrival."""
    n = 2 * len(p_ML)
    information = np.zeros((n + 6, n + 6))
    information[: n + 3, : n + 3] = np.linalg.inv(covariance)
    F = np.eye(3)
    F[:2, 2] = [-(point[1] - X_MD[1]), point[0] - X_MD[0]]
    odometry = np.hstack([-F, np.eye(3)])
    information[n:, n:] += odometry.T @ np.linalg.inv(Q) @ odometry
    for i in seen:
        J = np.zeros((2, n + 6))
        J[:, 2 * i : 2 * i + 2] = whitened(p_ML[i] - point, noise)
        J[:, n + 3 : n + 5] = -J[:, 2 * i : 2 * i + 2]
        J[1, n + 5] = -1 / noise[3]
        information += J.T @ J
    return np.trace(covariance[:n, :n]) - np.trace(np.linalg.inv(information)[:n, :n])


NOISE = turn_noise(TagSensorConfig(), 20.0)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("seen", [1, 2, 5, 9])
def test_what_a_turn_takes_off_the_error_equals_brute_force(seed, seen):
    rng, p_ML, X_MD, covariance, point, Q = problem(seed)
    rows = np.sort(rng.permutation(len(p_ML))[:seen])
    removed = error_removed(
        point[None], Q, View(np.array([0, seen]), rows), p_ML, X_MD, covariance, squared_by_landmarks(covariance), NOISE
    )
    expected = brute_force(point, Q[0], rows, p_ML, X_MD, covariance, NOISE)
    assert removed[0] == pytest.approx(expected, abs=1e-9)
    assert 0.0 < removed[0] < np.trace(covariance[:-3, :-3])


@pytest.mark.parametrize("seed", range(5))
def test_places_judged_together_are_worth_what_each_is_by_itself(seed):
    rng, p_ML, X_MD, covariance, point, Q = problem(seed)
    squared = squared_by_landmarks(covariance)
    seen = [np.sort(rng.permutation(len(p_ML))[:k]) for k in (3, 0, 7, 1)]
    view = View(np.cumsum([0, 3, 0, 7, 1]), np.concatenate(seen))
    points, Q = point + rng.normal(0.0, 1.0, (4, 2)), np.repeat(Q, 4, axis=0) * np.arange(1, 5)[:, None, None]
    together = error_removed(points, Q, view, p_ML, X_MD, covariance, squared, NOISE)
    apart = [brute_force(p, q, rows, p_ML, X_MD, covariance, NOISE) for p, q, rows in zip(points, Q, seen, strict=True)]
    np.testing.assert_allclose(together, apart, atol=1e-9)
    assert together[1] == 0.0
