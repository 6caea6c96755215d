import dataclasses

import numpy as np
import pytest

from tests.arrays import frozen
from tfg_drake.config import OdometryConfig, TagSensorConfig
from tfg_drake.messages import replace
from tfg_drake.planning.exact_gain import Arrival, Known, New, exact_gain, share_seen
from tfg_drake.planning.information_gain import (
    departure_given_landmarks,
    sightings_of_turn,
    turn_noise,
)
from tfg_drake.planning.odometry_drift import odometry_covariance
from tfg_drake.slam.keyframe_graph import empty_map


def whitened(p_AL, noise):
    r = np.linalg.norm(p_AL)
    jacobian = np.array([[p_AL[0] / r, p_AL[1] / r], [-p_AL[1] / r**2, p_AL[0] / r**2]])
    return jacobian / np.array([[max(noise[0] + noise[1] * r, noise[2])], [noise[3]]])


def brute_force(point, Q, known, p_ML, X_MD, covariance, p_MU, count, prior_sigma, noise):
    """Log-determinant difference of the landmarks' marginal information, poses eliminated by Schur complements."""
    n, u = len(p_ML), int(sum(count))
    size = 2 * n + 2 * u
    information = np.zeros((size + 6, size + 6))  # landmarks, new landmarks, departure, arrival
    old = np.r_[0 : 2 * n, size : size + 3]
    information[np.ix_(old, old)] += np.linalg.inv(covariance)
    information[range(2 * n, size), range(2 * n, size)] += prior_sigma**-2
    F = np.eye(3)
    F[:2, 2] = [-(point[1] - X_MD[1]), point[0] - X_MD[0]]
    odometry = np.hstack([-F, np.eye(3)])
    information[size:, size:] += odometry.T @ np.linalg.inv(Q) @ odometry

    def marginal(matrix):
        return matrix[:size, :size] - matrix[:size, size:] @ np.linalg.solve(matrix[size:, size:], matrix[size:, :size])

    seen = [(2 * i, p_ML[i]) for i in known]
    seen += [(2 * n + 2 * k, p) for k, p in enumerate(np.repeat(p_MU, count.astype(int), axis=0))]
    after = information.copy()
    for column, p in seen:
        J = np.zeros((2, size + 6))
        J[:, column : column + 2] = whitened(p - point, noise)
        J[:, size + 3 : size + 5] = -J[:, column : column + 2]
        J[1, size + 5] = -1 / noise[3]
        after += J.T @ J
    return 0.5 * (np.linalg.slogdet(marginal(after))[1] - np.linalg.slogdet(marginal(information))[1])


def problem(seed, n=9, common=0.3):
    """Landmarks and a departure pose that move together by `common` metres, and by centimetres on their own."""
    rng = np.random.default_rng(seed)
    p_ML, X_MD = rng.uniform(-6, 6, (n, 2)), np.r_[rng.uniform(-2, 2, 2), rng.uniform(-3, 3)]
    together = np.zeros((2 * n + 3, 3))
    for i, p in enumerate([*p_ML, X_MD[:2]]):
        together[2 * i : 2 * i + 2] = [[1, 0, -p[1]], [0, 1, p[0]]]
    together[-1, 2] = 1
    loose = rng.normal(0, 0.02, (2 * n + 3, 2 * n + 3))
    loose[-1] *= 0.2
    covariance = common**2 * together @ np.diag([1, 1, 0.01]) @ together.T + loose @ loose.T + 1e-6 * np.eye(2 * n + 3)
    point = rng.uniform(-3, 3, 2)
    Q = odometry_covariance(X_MD, point[None], np.array([4.0]), np.array([9.0]), OdometryConfig())
    Q = Q + 1e-6 * np.eye(3)
    return rng, p_ML, X_MD, covariance, point, Q


# A sensor range at which every frontier point counts in full, m.
SEE_ALL = 1e9


def problem_of(point, Q, known, p_ML, X_MD, covariance, p_MU, count, prior_sigma):
    """The kernels' arguments for one candidate that sees some of the landmarks and all new ones."""
    n = 2 * len(p_ML)
    S = covariance
    given = S[n:, n:] - S[n:, :n] @ np.linalg.solve(S[:n, :n], S[:n, n:]) if n else S
    rows = np.asarray(known, dtype=np.int64)
    return (
        point[None],
        Arrival(frozen(X_MD), given, Q),
        Known(np.array([0, len(rows)]), rows, p_ML, frozen(S)),
        New(np.array([0, len(p_MU)]), np.arange(len(p_MU)), frozen(p_MU), count, prior_sigma, np.array([SEE_ALL, 1.0])),
    )


def kernel(point, Q, known, p_ML, X_MD, covariance, p_MU, count, prior_sigma, noise):
    return exact_gain(*problem_of(point, Q, known, p_ML, X_MD, covariance, p_MU, count, prior_sigma), noise)[0]


NOISE = turn_noise(TagSensorConfig(), sightings_of_turn(TagSensorConfig(), 1.0))


@pytest.mark.parametrize(("distance", "share"), [(1.0, 1.0), (5.0, 1.0), (7.5, 0.5), (10.0, 0.0), (12.0, 0.0)])
def test_a_frontier_counts_by_the_depth_of_view_behind_it(distance, share):
    assert share_seen(distance, np.array([10.0, 5.0])) == pytest.approx(share)


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(("seen", "new"), [(5, 0), (5, 3), (0, 4), (1, 2), (0, 0)])
def test_gain_equals_brute_force(seed, seen, new):
    rng, p_ML, X_MD, covariance, point, Q = problem(seed)
    known = np.sort(rng.permutation(len(p_ML))[:seen])
    p_MU, count = rng.uniform(-8, 8, (new, 2)), rng.integers(1, 4, new).astype(float)
    exploitation, exploration, _ = kernel(point, Q, known, p_ML, X_MD, covariance, p_MU, count, 10.0, NOISE)
    arguments = (point, Q[0], known, p_ML, X_MD, covariance)
    assert exploitation == pytest.approx(brute_force(*arguments, p_MU[:0], count[:0], 10.0, NOISE), abs=1e-9)
    assert exploitation + exploration == pytest.approx(brute_force(*arguments, p_MU, count, 10.0, NOISE), abs=1e-9)


def test_pose_price_vanishes_with_a_known_pose_and_grows_with_its_uncertainty():
    rng, p_ML, X_MD, covariance, point, Q = problem(3)
    covariance = covariance.copy()
    covariance[-3:, :] = covariance[:, -3:] = 0.0
    p_MU, count = rng.uniform(-8, 8, (3, 2)), np.ones(3)
    prices = [
        kernel(point, scale * Q, range(9), p_ML, X_MD, covariance, p_MU, count, 10.0, NOISE)[2]
        for scale in (0.0, 0.01, 1.0, 100.0)
    ]
    assert prices[0] == pytest.approx(0.0, abs=1e-9)
    assert prices == sorted(prices)


def test_fractions_of_a_landmark_interpolate():
    rng, p_ML, X_MD, covariance, point, Q = problem(5)
    p_MU = rng.uniform(-8, 8, (1, 2))
    gains = [
        kernel(point, Q, [0, 1, 2], p_ML, X_MD, covariance, p_MU, np.array([count]), 10.0, NOISE)[1]
        for count in (0.0, 0.5, 1.0, 1.5, 2.0)
    ]
    assert gains[0] == pytest.approx(0.0, abs=1e-9)
    assert gains == sorted(gains)


def test_a_departure_given_the_landmarks_is_as_certain_as_what_it_does_not_share_with_them():
    shared = np.zeros((9, 2))
    shared[[0, 2, 4, 6], 0] = shared[[1, 3, 5, 7], 1] = 1.0
    S = shared @ shared.T + 1e-4 * np.eye(9)
    estimate = replace(empty_map(), ids=np.arange(3), p_ML=np.zeros((3, 2)), local=np.arange(3), covariance=S)
    np.testing.assert_allclose(departure_given_landmarks(estimate), np.linalg.inv(np.linalg.inv(S)[6:, 6:]), atol=1e-9)


def test_a_turn_sees_a_tag_as_often_as_it_is_detected_while_in_view():
    sensor = dataclasses.replace(TagSensorConfig(), detection_probability=0.5, rate=10.0, field_of_view=1.2)
    assert sightings_of_turn(sensor, 0.6) == pytest.approx(10.0)
    few, many = turn_noise(sensor, 4.0), turn_noise(sensor, 1e9)
    np.testing.assert_allclose(few, [0.01, 0.005, 0.01, 0.005])
    np.testing.assert_allclose(many[2:], [0.01, 0.002])
