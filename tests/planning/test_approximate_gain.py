import math

import numpy as np
import pytest

from tests.arrays import frozen
from tests.planning.test_information_gain import NOISE, kernel, problem, problem_of, whitened
from tfg_drake.planning.approximate_gain import AUTHORS_NATS, AUTHORS_WEIGHT, authors_gain, limit_gain, paper_gain


def limit(point, Q, known, p_ML, X_MD, covariance, p_MU, count, prior_sigma):
    return limit_gain(*problem_of(point, Q, known, p_ML, X_MD, covariance, p_MU, count, prior_sigma), NOISE)[0]


def without_arrival(point, known, p_ML, covariance, p_MU, count):
    """The arguments of the gains that take no notice of the way to a candidate."""
    points, _, seen, new = problem_of(point, np.eye(3)[None], known, p_ML, np.zeros(3), covariance, p_MU, count, 10.0)
    return points, seen, new


def blocks(points, point):
    """G (2m, 2m) and K (2m, 3) of the landmarks at points (m, 2) seen from point (2,)."""
    m = len(points)
    G, K = np.zeros((2 * m, 2 * m)), np.zeros((2 * m, 3))
    for i, p in enumerate(points):
        G[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = whitened(p - point, NOISE)
        K[2 * i : 2 * i + 2, :2] = -G[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
        K[2 * i + 1, 2] = -1 / NOISE[3]
    return G, K


def logdet(matrix):
    sign, value = np.linalg.slogdet(matrix)
    assert sign > 0
    return value


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(("seen", "new"), [(5, 0), (5, 3), (0, 4), (1, 2)])
def test_limit_is_the_corrected_theorem(seed, seen, new):
    rng, p_ML, X_MD, covariance, point, Q = problem(seed)
    known = np.sort(rng.permutation(len(p_ML))[:seen])
    p_MU, count = rng.uniform(-8, 8, (new, 2)), rng.integers(1, 4, new).astype(float)
    S = covariance
    n = 2 * len(p_ML)
    given = S[n:, n:] - S[n:, :n] @ np.linalg.solve(S[:n, :n], S[:n, n:])
    F = np.eye(3)
    F[:2, 2] = [-(point[1] - X_MD[1]), point[0] - X_MD[0]]
    Pi = np.linalg.inv(F @ given @ F.T + Q[0])
    rows = np.ravel([[2 * i, 2 * i + 1] for i in known]).astype(int)
    Sigma = S[np.ix_(rows, rows)]
    G, K = blocks(p_ML[known], point)
    B = K.T @ K + Pi
    old = np.eye(2 * seen) + Sigma @ G.T @ G - Sigma @ G.T @ K @ np.linalg.solve(B, K.T @ G)
    every = np.repeat(p_MU, count.astype(int), axis=0)
    G_u, K_u = blocks(every, point)
    exploitation = 0.5 * logdet(old) if seen else 0.0
    new_nats = 0.5 * logdet(np.eye(2 * len(every)) + 100.0 * G_u @ G_u.T) if new else 0.0
    exploration = new_nats - 0.5 * (logdet(B + K_u.T @ K_u) - logdet(B))
    gains = limit(point, Q, known, p_ML, X_MD, covariance, p_MU, count, 10.0)
    assert gains[:2] == pytest.approx([exploitation, exploration], abs=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_limit_is_near_exact_where_the_pose_is_independent_of_the_map(seed):
    rng, p_ML, X_MD, covariance, point, Q = problem(seed)
    covariance = covariance.copy()
    covariance[-3:, :-3] = covariance[:-3, -3:] = 0.0
    p_MU, count = rng.uniform(-8, 8, (3, 2)), np.ones(3)
    exact = kernel(point, Q, range(9), p_ML, X_MD, covariance, p_MU, count, 10.0, NOISE)
    near = limit(point, Q, range(9), p_ML, X_MD, covariance, p_MU, count, 10.0)
    assert near == pytest.approx(exact, abs=5e-3)
    narrow = limit(point, Q, range(9), p_ML, X_MD, covariance, p_MU, count, 0.3)
    assert narrow[1] < kernel(point, Q, range(9), p_ML, X_MD, covariance, p_MU, count, 0.3, NOISE)[1]


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize(("seen", "new"), [(5, 3), (2, 0), (0, 4), (1, 2)])
def test_paper_is_theorem_1_with_the_sigma_that_its_proof_lost(seed, seen, new):
    rng, p_ML, _, covariance, point, _ = problem(seed)
    known = np.sort(rng.permutation(len(p_ML))[:seen])
    p_MU = rng.uniform(-8, 8, (new, 2))
    rows = np.ravel([[2 * i, 2 * i + 1] for i in known]).astype(int)
    Sigma = covariance[np.ix_(rows, rows)]
    G, K = blocks(p_ML[known], point)
    G_u, K_u = blocks(p_MU, point)
    B = K.T @ K + K_u.T @ K_u
    old = np.eye(2 * seen) + Sigma @ G.T @ G - Sigma @ G.T @ K @ np.linalg.solve(B, K.T @ G)
    expected = [logdet(old) if seen else 0.0, logdet(np.eye(2 * new) + 100.0 * G_u @ G_u.T) if new else 0.0]
    gains = paper_gain(*without_arrival(point, known, p_ML, covariance, p_MU, np.ones(new)), NOISE)[0]
    assert gains[:2] == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("known", [[], [3]])
def test_paper_promises_nothing_where_the_pose_is_not_determined(known):
    _, p_ML, _, covariance, point, _ = problem(0)
    p_MU = np.zeros((1 - len(known), 2))
    gains = paper_gain(*without_arrival(point, known, p_ML, covariance, p_MU, np.ones(len(p_MU))), NOISE)
    assert gains.tolist() == [[0.0, 0.0, 0.0]]


@pytest.mark.parametrize("seen", [3, 9])
def test_authors_gain_is_that_of_their_program(seen):
    _, p_ML, _, covariance, point, _ = problem(1)
    A = AUTHORS_WEIGHT * np.kron(np.eye(seen) - np.full((seen, seen), 1 / seen), np.eye(2))
    Sigma = covariance[: 2 * seen, : 2 * seen]
    p_MU = (point + np.array([4.0, 0.0]))[None]
    normal = np.array([[-math.cos(0.5), math.sin(0.5)]])
    gains = authors_gain(
        *without_arrival(point, range(seen), p_ML, covariance, p_MU, np.array([2.0 * 0.4])), frozen(normal)
    )[0]
    assert gains[0] == pytest.approx(logdet(np.eye(2 * seen) + Sigma @ A), abs=1e-9)
    assert gains[1] == pytest.approx(AUTHORS_NATS * 2.0 * 0.4 * math.cos(0.5) / 4.0)


def test_authors_program_does_not_look_at_places_that_see_two_tags():
    _, p_ML, _, covariance, point, _ = problem(1)
    p_MU = (point + np.array([4.0, 0.0]))[None]
    arguments = without_arrival(point, [0, 1], p_ML, covariance, p_MU, np.ones(1))
    gains = authors_gain(*arguments, frozen([[-1.0, 0.0]]))
    assert gains.tolist() == [[0.0, 0.0, 0.0]]
