"""Relative uncertainty of what was mapped, against samples of the joint Gaussian."""

import numpy as np

from tfg_drake.geometry.se2 import inverse, rotation, transform
from tfg_drake.messages import MapEstimate, replace
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.tfg.drift import MOST_DRIFT, drift_from_robot, known_jointly


def _estimate(p_ML: np.ndarray, X_MD: np.ndarray, covariance: np.ndarray) -> MapEstimate:
    empty = empty_map()
    ids = np.arange(len(p_ML))
    own = np.zeros((len(ids), 2, 2))
    none, X_MA = np.zeros((len(ids), 2)), np.zeros((1, 3))
    return MapEstimate(1, 0.0, ids, p_ML, none, none, X_MD, ids, covariance, own, X_MA, empty.observation, 0.0)


def test_drift_from_the_robot_is_that_of_what_it_would_see() -> None:
    rng = np.random.default_rng(0)
    p_ML, X_MD = rng.uniform(-5.0, 5.0, (3, 2)), np.array([1.0, -2.0, 0.7])
    root = 1e-3 * rng.standard_normal((9, 9))
    covariance = root @ root.T
    samples = np.concatenate([p_ML.ravel(), X_MD]) + rng.multivariate_normal(np.zeros(9), covariance, 100_000)
    seen = np.array([transform(inverse(x[6:]), x[:6].reshape(3, 2)) for x in samples])
    in_M = seen @ rotation(float(X_MD[2])).T
    drift = drift_from_robot(_estimate(p_ML, X_MD, covariance), np.arange(3))
    for i in range(3):
        np.testing.assert_allclose(drift[i], np.cov(in_M[:, i].T), rtol=0.03, atol=0.03 * drift[i].max())


def test_an_error_that_all_share_is_no_drift() -> None:
    p_ML = np.array([[0.0, 2.0], [1.0, 2.0], [9.0, 9.0]])
    shared = np.concatenate([np.tile(np.eye(2), (3, 1)), [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]])
    estimate = _estimate(p_ML, np.zeros(3), shared @ shared.T)
    np.testing.assert_allclose(drift_from_robot(estimate, np.arange(3)), 0.0, atol=1e-12)


def test_of_a_large_map_only_the_neighbourhood_speaks() -> None:
    p_ML = np.array([[0.0, 0.0], [0.0, 0.3], [30.0, 0.0], [30.0, 0.3]])
    whole = _estimate(p_ML, np.zeros(3), np.diag([1e-4, 0.01, 1e-4, 0.02, 1e-4, 0.03, 1e-4, 0.04, 0.0, 0.0, 0.0]))
    local = replace(whole, local=np.array([2, 3]), covariance=whole.covariance[4:, 4:])
    points = p_ML[[0, 2]]
    np.testing.assert_array_equal(drift_from_robot(local, np.array([3, 2])), drift_from_robot(whole, np.array([3, 2])))
    np.testing.assert_array_equal(drift_from_robot(local, np.arange(2)), np.tile(MOST_DRIFT**2 * np.eye(2), (2, 1, 1)))
    assert known_jointly(points, local).tolist() == [False, True]
    assert known_jointly(points, whole).tolist() == [True, True]
    # Far from any landmark nothing can drift.
    assert known_jointly(np.array([[15.0, 0.0]]), local).tolist() == [True]
