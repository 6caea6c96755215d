import numpy as np
import pytest

from tests.slam.rings import built, dense_solution, reckoned, ring, with_ways
from tfg_drake.geometry import se2
from tfg_drake.messages import replace
from tfg_drake.slam import map_solver
from tfg_drake.slam.keyframe_graph import at_yaw, empty_graph, fused
from tfg_drake.slam.map_solver import known_jointly, solve

# Standard deviations of the tags' constant errors, m and rad.
TAG_ERROR = np.array([0.03, 0.01])


def assert_dense(graph, solved, estimate, node=None, *, entropy=True):
    """The solution and its joint covariance are a dense solution's, to a millionth."""
    X_MN, p_ML, covariance, _ = dense_solution(graph)
    size = np.abs(p_ML).max()
    assert np.abs(solved.p_ML - p_ML).max() < 1e-6 * size
    assert np.abs(se2.wrap_angle(solved.X_MN[:, 2] - X_MN[:, 2])).max() < 1e-6
    assert np.abs(solved.X_MN[:, :2] - X_MN[:, :2]).max() < 1e-6 * size
    node = len(graph.keyframes) if node is None else node
    first = 2 * len(graph.ids) + 3 * (node - 1)
    at = np.append((2 * estimate.local[:, None] + [0, 1]).ravel(), np.arange(first, first + 3))
    expected = covariance[np.ix_(at, at)]
    assert np.linalg.norm(estimate.covariance - expected) < 1e-6 * np.linalg.norm(expected)
    deviation = np.sqrt(np.diag(expected))
    assert np.abs((estimate.covariance - expected) / np.outer(deviation, deviation)).max() < 1e-6
    assert estimate.entropy == solved.entropy
    if not entropy:
        return
    landmarks = covariance[: 2 * len(graph.ids), : 2 * len(graph.ids)]
    entropy = 0.5 * np.linalg.slogdet(2.0 * np.pi * np.e * landmarks)[1]
    assert abs(solved.entropy - entropy) < 1e-6 * abs(entropy)


def test_exact_without_noise():
    observations, p_ML, X_MN = ring(1, noise=0.0)
    graph, estimate = solve(reckoned(observations), 7.0, observations[-1])
    np.testing.assert_allclose(estimate.p_ML, p_ML[estimate.ids - 100], atol=1e-9)
    np.testing.assert_allclose(se2.between(X_MN, graph.X_MN), np.zeros((len(X_MN), 3)), atol=1e-9)
    assert estimate.stage == 24
    assert estimate.stamp == 7.0


@pytest.mark.parametrize("joint", [400, 30, 0])
def test_a_ring_just_closed_is_a_dense_solution(joint):
    """From dead reckoning, a metre and more off where the loop closes."""
    observations, _, _ = ring(2, laps=1.05)
    graph = reckoned(observations)
    solved, estimate = solve(graph, 0.0, observations[-1], joint=joint)
    assert len(estimate.local) == min(joint, len(graph.ids))
    assert np.abs(solved.X_MN[-1] - graph.X_MN[-1]).max() > 0.5
    assert_dense(graph, solved, estimate)


def test_round_another_place_and_pose():
    observations, _, _ = ring(3, laps=1.05)
    graph = reckoned(observations)
    also = np.array([0, 5])
    solved, estimate = solve(graph, 0.0, observations[-1], node=20, joint=25, also=also)
    assert np.isin(also, estimate.local).all()
    np.testing.assert_array_equal(estimate.X_MD, solved.X_MN[20])
    assert_dense(graph, solved, estimate, node=20)


def test_landmarks_all_over_the_map_are_known_jointly_too():
    observations, _, _ = ring(2, laps=1.05)
    graph = reckoned(observations)
    solved, estimate = solve(graph, 0.0, observations[-1], joint=20, spread=30)
    _, near = solve(graph, 0.0, observations[-1], joint=20)
    assert len(estimate.local) == 50
    assert np.isin(near.local, estimate.local).all()
    assert np.diff(np.setdiff1d(estimate.local, near.local)).max() <= 2 + len(graph.ids) // 30
    assert_dense(graph, solved, estimate)
    assert len(solve(graph, 0.0, observations[-1], joint=20, spread=1000)[1].local) == len(graph.ids)


def test_a_graph_whose_keyframes_are_fused_is_a_dense_solution_too():
    observations, _, _ = ring(4, views=60, laps=1.1)
    joined = with_ways(observations)
    graph = fused(reckoned(joined))
    assert len(graph.keyframes) < 0.7 * len(joined)
    solved, estimate = solve(graph, 0.0, joined[-1], joint=30)
    assert_dense(graph, solved, estimate)


def test_the_yaw_of_the_camera_is_known_with_the_map():
    """What each keyframe says leaves it open by a degree."""
    observations, _, _ = ring(6, views=12, tags=60, laps=1.05)
    rng, yaw = np.random.default_rng(6), 0.02

    def seen_at(one):
        on_yaw = rng.normal(size=2 * len(one.ids) + 3) * ([1.0] * (2 * len(one.ids)) + [1.0, 1.0, 0.0])
        return at_yaw(replace(one, on_yaw=on_yaw, yaw=yaw), 0.0)

    believed = np.array([0.0, 0.0175])
    graph = reckoned([seen_at(one) for one in observations], replace(empty_graph(believed), yaw_prior=believed))
    solved, estimate = graph, None
    for _ in range(3):
        solved, estimate = solve(solved, 0.0, observations[-1], joint=20)
    _, _, covariance, expected = dense_solution(graph)
    assert abs(expected - yaw) < 4.0 * np.sqrt(covariance[-1, -1])
    np.testing.assert_allclose(solved.yaw, [expected, np.sqrt(covariance[-1, -1])], rtol=1e-6)
    assert all(one.yaw == solved.yaw[0] for one in solved.keyframes)
    assert_dense(graph, solved, estimate, entropy=False)


def test_fused_keyframes_tell_the_same_of_the_yaw():
    observations, _, _ = ring(7, views=60, laps=1.1)
    rng, believed = np.random.default_rng(7), np.array([0.0, 0.0175])
    joined = [replace(one, on_yaw=0.1 * rng.normal(size=2 * len(one.ids) + 3)) for one in with_ways(observations)]
    graph = reckoned(joined, replace(empty_graph(believed), yaw_prior=believed))
    for _ in range(3):
        graph, _ = solve(graph, 0.0, joined[-1])
    fewer = fused(graph)
    assert len(fewer.keyframes) < 0.7 * len(graph.keyframes)
    for _ in range(3):
        fewer, _ = solve(fewer, 0.0, joined[-1])
    sigma = graph.yaw[1]
    assert sigma < 0.01
    np.testing.assert_allclose(fewer.yaw, graph.yaw, atol=0.03 * sigma)


@pytest.mark.parametrize("joint", [400, 30])
def test_errors_of_tags_are_known_with_the_map(joint):
    observations, _, _ = ring(9, views=12, tags=60, laps=1.05, tag_error=TAG_ERROR)
    graph = replace(reckoned(observations), tag_error=TAG_ERROR)
    solved, estimate = solve(graph, 0.0, observations[-1], joint=joint)
    assert_dense(graph, solved, estimate)


def test_errors_of_tags_are_known_where_keyframes_are_fused():
    observations, _, _ = ring(4, views=60, laps=1.1, tag_error=TAG_ERROR)
    joined = with_ways(observations)
    graph = replace(reckoned(joined), tag_error=TAG_ERROR)
    fewer = fused(graph)
    assert len(fewer.keyframes) < 0.7 * len(joined)
    solved, whole = solve(fewer, 0.0, joined[-1], joint=30)
    assert_dense(fewer, solved, whole)
    _, every = solve(graph, 0.0, joined[-1], joint=30)
    sigma = np.sqrt(np.diag(every.covariance))
    assert np.abs(np.sqrt(np.diag(whole.covariance)) / sigma - 1.0).max() < 0.02


def test_how_large_the_errors_of_tags_are_is_learnt():
    found = []
    for seed in range(4):
        observations, _, _ = ring(seed, views=40, tags=200, laps=2.0, tag_error=TAG_ERROR)
        graph = reckoned(observations)
        for _ in range(12):
            graph, _ = solve(graph, 0.0, observations[-1])
        found.append(graph.tag_error)
    np.testing.assert_allclose(np.mean(found, axis=0), TAG_ERROR, rtol=0.15)


def test_tags_without_errors_are_found_to_have_none():
    for seed in range(4):
        observations, _, _ = ring(seed, views=40, tags=200, laps=2.0)
        graph, _ = solve(reckoned(observations), 0.0, observations[-1])
        assert not graph.tag_error.any()


@pytest.mark.slow
def test_six_thousand_unknowns_just_closed():
    observations, _, _ = ring(5, views=300, radius=150.0, tags=2100, reach=6.0, laps=1.003)
    graph = reckoned(observations)
    assert 2 * len(graph.ids) + 3 * len(graph.keyframes) > 5500
    solved, estimate = solve(graph, 0.0, observations[-1])
    assert_dense(graph, solved, estimate)


def test_consistent(nees):
    landmarks, poses = [], []
    for seed in range(12):
        observations, p_ML, X_MN = ring(seed, views=12, tags=60)
        _, estimate = solve(reckoned(observations), 0.0, observations[-1])
        error = (estimate.p_ML - p_ML[estimate.ids - 100]).ravel()
        pose = estimate.X_MD - X_MN[-1]
        pose[2] = se2.wrap_angle(pose[2])
        landmarks.append(nees(error, estimate.covariance[:-3, :-3]))
        poses.append(nees(pose, estimate.covariance[-3:, -3:]))
    assert 0.9 < np.mean(landmarks) < 1.1
    assert 0.5 < np.mean(poses) < 1.6


@pytest.mark.parametrize("joint", [400, 10])
def test_what_hangs_on_nothing_keeps_its_shape(joint):
    """A way of which nothing is known, between two halves that share no tag."""
    observations, p_ML, _ = ring(6, views=6, radius=30.0, laps=0.1)
    nothing = replace(observations[5], covariance=np.diag([1e7, 1e7, 1e7]))
    second = [replace(one, ids=one.ids + 1000) for one in observations[6:]]
    graph = reckoned([*observations[:5], nothing, *second])
    solved, estimate = solve(graph, 0.0, observations[-1], joint=joint)
    assert np.isfinite(estimate.covariance).all()
    rows = np.flatnonzero(solved.ids >= 1000)
    moved = se2.transform(se2.inverse(solved.X_MN[-1]), solved.p_ML[rows])
    true = p_ML[solved.ids[rows] - 1100]
    shape = np.hypot(*(moved[1:] - moved[0]).T) - np.hypot(*(true[1:] - true[0]).T)
    assert np.abs(shape).max() < 0.1


def test_how_many_are_known_jointly_is_bounded(monkeypatch):
    observations, _, _ = ring(7, views=6)
    graph = reckoned(observations)
    assert known_jointly(graph) == len(graph.ids)
    monkeypatch.setattr(map_solver, "MOST_JOINT", 10)
    assert known_jointly(graph) == map_solver.JOINT


def test_updates_come_to_what_a_solve_comes_to():
    """Without a loop that closes, updates one after the other differ from the optimum by what linearisation costs."""
    observations, _, _ = ring(8, views=12, laps=0.4)
    graph, estimate = built(observations)
    solved, whole = solve(graph, 0.0, observations[-1])
    assert np.abs(estimate.p_ML - solved.p_ML).max() < 5e-3
    deviation = np.sqrt(np.diag(whole.covariance))
    assert np.abs((estimate.covariance - whole.covariance) / np.outer(deviation, deviation)).max() < 0.02
    assert abs(estimate.entropy - whole.entropy) < 0.3


@pytest.mark.parametrize(("sigma", "joint"), [(0.3, 400), (0.6, 400), (0.6, 30)])
def test_the_covariance_is_that_of_the_map_where_headings_are_hardly_known(sigma, joint):
    """Steps overshoot there; what was done against it must not be taken for knowledge."""
    observations, _, _ = ring(3, views=8, laps=1.05)
    rng, blurred = np.random.default_rng(0), []
    for one in observations:
        noise = sigma * rng.normal(size=len(one.covariance))
        far = replace(one, p_AL=one.p_AL + noise[:-3].reshape(-1, 2), X_AD=one.X_AD + noise[-3:])
        blurred.append(replace(far, covariance=one.covariance + sigma**2 * np.eye(len(noise))))
    graph, estimate = solve(reckoned(blurred), 0.0, blurred[-1], joint=joint)
    again, after = solve(graph, 0.0, blurred[-1], joint=joint)
    np.testing.assert_allclose(after.p_ML, estimate.p_ML, atol=1e-3)
    np.testing.assert_allclose(after.X_MD, estimate.X_MD, atol=1e-3)
    _, _, covariance, _ = dense_solution(again)
    first = 2 * len(graph.ids) + 3 * (len(graph.keyframes) - 1)
    expected = np.diag(covariance)[first : first + 3]
    np.testing.assert_allclose(np.diag(estimate.covariance)[-3:], expected, rtol=0.02)
