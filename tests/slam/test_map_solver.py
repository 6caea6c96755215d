from types import SimpleNamespace

import numpy as np
import pytest

from tests.slam.oracle import NOISE, PRIOR, SIGMA, Drive, dense
from tests.slam.rings import NOTHING, built, dense_solution, gaussian, reckoned, ring, with_ways
from tests.walls import walls_between
from tfg_drake.geometry import se2
from tfg_drake.messages import WALLS_BELOW, replace
from tfg_drake.slam import map_solver
from tfg_drake.slam.dissection import DissectionSolver
from tfg_drake.slam.keyframe import of_places, way
from tfg_drake.slam.keyframe_graph import fused
from tfg_drake.slam.map_solver import known_jointly, solve
from tfg_drake.slam.map_update import distance_to
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.solver import Values
from tfg_drake.slam.turn import reduced

# Standard deviations of the tags' constant errors, m and rad.
TAG_ERROR = np.array([0.03, 0.01])


def assert_dense(graph, solved, estimate, node=None):
    """The solution and its joint covariance are a dense solution's, to a millionth."""
    X_MN, p_ML, shared, covariance = dense_solution(graph)
    size = np.abs(p_ML).max()
    assert np.abs(solved.p_ML - p_ML).max() < 1e-6 * size
    assert np.abs(se2.wrap_angle(solved.X_MN[:, 2] - X_MN[:, 2])).max() < 1e-6
    assert np.abs(solved.X_MN[:, :2] - X_MN[:, :2]).max() < 1e-6 * size
    node = len(graph.keyframes) if node is None else node
    first = 2 * len(graph.ids) + 3 * (node - 1)
    of_shared = len(covariance) - SHARED + np.arange(SHARED)
    at = np.concatenate([(2 * estimate.local[:, None] + [0, 1]).ravel(), np.arange(first, first + 3), of_shared])
    expected, found = covariance[np.ix_(at, at)], estimate.joint_covariance
    assert np.linalg.norm(found - expected) < 1e-6 * np.linalg.norm(expected)
    deviation = np.sqrt(np.diag(expected))
    assert np.abs((found - expected) / np.outer(deviation, deviation)).max() < 1e-6
    assert np.abs((solved.shared.mean - shared) / deviation[-SHARED:]).max() < 1e-4
    np.testing.assert_array_equal(estimate.shared, solved.shared.mean)
    np.testing.assert_array_equal(solved.shared.covariance, found[-SHARED:, -SHARED:])
    assert estimate.entropy == solved.entropy
    landmarks = covariance[: 2 * len(graph.ids), : 2 * len(graph.ids)]
    entropy = 0.5 * np.linalg.slogdet(2.0 * np.pi * np.e * landmarks)[1]
    assert abs(solved.entropy - entropy) < 1e-6 * abs(entropy)


def test_exact_without_noise():
    keyframes, p_ML, X_MN = ring(1, noise=0.0)
    graph, estimate = solve(reckoned(keyframes), 7.0, NOTHING)
    np.testing.assert_allclose(estimate.p_ML, p_ML[estimate.ids - 100], atol=1e-9)
    np.testing.assert_allclose(se2.between(X_MN, graph.X_MN), np.zeros((len(X_MN), 3)), atol=1e-9)
    assert estimate.stage == 24
    assert estimate.stamp == 7.0


@pytest.mark.parametrize("joint", [400, 30, 0])
def test_a_ring_just_closed_is_a_dense_solution(joint):
    """From dead reckoning, a metre and more off where the loop closes."""
    keyframes, _, _ = ring(2, laps=1.05)
    graph = reckoned(keyframes)
    solved, estimate = solve(graph, 0.0, NOTHING, joint=joint)
    assert len(estimate.local) == min(joint, len(graph.ids))
    assert np.abs(solved.X_MN[-1] - graph.X_MN[-1]).max() > 0.5
    assert_dense(graph, solved, estimate)


def test_round_another_place_and_pose():
    keyframes, _, _ = ring(3, laps=1.05)
    graph = reckoned(keyframes)
    also = np.array([0, 5])
    solved, estimate = solve(graph, 0.0, NOTHING, node=20, joint=25, also=also)
    assert np.isin(also, estimate.local).all()
    np.testing.assert_array_equal(estimate.X_MD, solved.X_MN[20])
    assert_dense(graph, solved, estimate, node=20)


def test_landmarks_all_over_the_map_are_known_jointly_too():
    keyframes, _, _ = ring(2, laps=1.05)
    graph = reckoned(keyframes)
    solved, estimate = solve(graph, 0.0, NOTHING, joint=20, spread=30)
    _, near = solve(graph, 0.0, NOTHING, joint=20)
    assert len(estimate.local) == 50
    assert np.isin(near.local, estimate.local).all()
    assert np.diff(np.setdiff1d(estimate.local, near.local)).max() <= 2 + len(graph.ids) // 30
    assert_dense(graph, solved, estimate)
    assert len(solve(graph, 0.0, NOTHING, joint=20, spread=1000)[1].local) == len(graph.ids)


def test_a_graph_whose_keyframes_are_fused_is_a_dense_solution_too():
    keyframes, _, _ = ring(4, views=60, laps=1.1)
    joined = with_ways(keyframes)
    graph = fused(reckoned(joined))
    assert len(graph.keyframes) < 0.7 * len(joined)
    solved, estimate = solve(graph, 0.0, NOTHING, joint=30)
    assert_dense(graph, solved, estimate)


@pytest.mark.parametrize("joint", [400, 30])
def test_the_parameters_are_known_with_the_map(joint, nees):
    """Each keyframe depends on all of them, which no two keyframes do alike."""
    truth = SIGMA * np.random.default_rng(6).normal(size=SHARED)
    keyframes, p_ML, _ = ring(6, views=12, tags=60, laps=1.05, shared=truth)
    graph = reckoned(keyframes, PRIOR)
    solved, estimate = solve(graph, 0.0, NOTHING, joint=joint)
    assert_dense(graph, solved, estimate)
    local = estimate.ids[estimate.local]
    error = np.concatenate([(estimate.local_p_ML - p_ML[local - 100]).ravel(), estimate.shared - truth])
    pose = np.s_[-3 - SHARED : -SHARED]
    covariance = np.delete(np.delete(estimate.joint_covariance, pose, 0), pose, 1)
    assert 0.7 < nees(error, covariance) < 1.4


# Speed, turn rate and length, s, of turns and ways.
PIECES = [(0.0, 0.6, 10.5), (0.4, 0.1, 4.0), (0.0, 0.6, 10.5), (0.4, -0.15, 5.0), (0.0, -0.6, 8.0)]


def drive_of(seed, pieces):
    """The pieces of a drive with all parameters off."""
    rng = np.random.default_rng(seed)
    robot = Drive(rng.uniform(-8.0, 8.0, (30, 2)), SIGMA * rng.normal(size=SHARED), seed)
    return [robot.piece(*one) for one in pieces]


def graph_of(pieces, shared):
    """The graph of some pieces, all reduced where the parameters are taken to be `shared`."""
    return reckoned([reduced(NOISE, one, shared).keyframe for one in pieces], PRIOR)


def test_the_graph_of_a_drive_is_the_least_squares_of_all_its_frames():
    """Reduced once more where the parameters have been found."""
    pieces = drive_of(3, PIECES)
    expected = dense(pieces)
    graph, estimate = solve(graph_of(pieces, PRIOR), 0.0, NOTHING)
    for _ in range(2):
        graph, estimate = solve(graph_of(pieces, graph.shared), 0.0, NOTHING)
    np.testing.assert_array_equal(estimate.ids, expected.ids)
    error, covariance = expected.off(estimate.p_ML, estimate.X_MD, estimate.shared)
    deviation = np.sqrt(np.diag(covariance))
    assert np.abs(error / deviation).max() < 0.1
    assert np.abs((estimate.joint_covariance - covariance) / np.outer(deviation, deviation)).max() < 0.05


@pytest.mark.parametrize("joint", [400, 30])
def test_errors_of_tags_are_known_with_the_map(joint):
    keyframes, _, _ = ring(9, views=12, tags=60, laps=1.05, tag_error=TAG_ERROR)
    graph = replace(reckoned(keyframes), tag_error=TAG_ERROR)
    solved, estimate = solve(graph, 0.0, NOTHING, joint=joint)
    assert_dense(graph, solved, estimate)


def test_errors_of_tags_are_known_where_keyframes_are_fused():
    keyframes, _, _ = ring(4, views=60, laps=1.1, tag_error=TAG_ERROR)
    joined = with_ways(keyframes)
    graph = replace(reckoned(joined), tag_error=TAG_ERROR)
    fewer = fused(graph)
    assert len(fewer.keyframes) < 0.7 * len(joined)
    solved, whole = solve(fewer, 0.0, NOTHING, joint=30)
    assert_dense(fewer, solved, whole)
    _, every = solve(graph, 0.0, NOTHING, joint=30)
    sigma = np.sqrt(np.diag(every.covariance))
    assert np.abs(np.sqrt(np.diag(whole.covariance)) / sigma - 1.0).max() < 0.02


def test_how_large_the_errors_of_tags_are_is_learnt():
    found = []
    for seed in range(2):
        keyframes, _, _ = ring(seed, views=40, tags=200, laps=2.0, tag_error=TAG_ERROR)
        graph = reckoned(keyframes)
        for _ in range(12):
            graph, _ = solve(graph, 0.0, NOTHING)
        found.append(graph.tag_error)
    np.testing.assert_allclose(np.mean(found, axis=0), TAG_ERROR, rtol=0.15)


def test_tags_without_errors_are_found_to_have_none():
    for seed in range(4):
        keyframes, _, _ = ring(seed, views=40, tags=200, laps=2.0)
        graph, _ = solve(reckoned(keyframes), 0.0, NOTHING)
        assert not graph.tag_error.any()


@pytest.mark.slow
def test_six_thousand_unknowns_just_closed():
    keyframes, _, _ = ring(5, views=300, radius=150.0, tags=2100, reach=6.0, laps=1.003)
    graph = reckoned(keyframes)
    assert 2 * len(graph.ids) + 3 * len(graph.keyframes) > 5500
    solved, estimate = solve(graph, 0.0, NOTHING)
    assert_dense(graph, solved, estimate)


def test_consistent(nees):
    landmarks, poses = [], []
    for seed in range(12):
        keyframes, p_ML, X_MN = ring(seed, views=12, tags=60)
        _, estimate = solve(reckoned(keyframes), 0.0, NOTHING)
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
    keyframes, p_ML, _ = ring(6, views=6, radius=30.0, laps=0.1)
    nothing = way(keyframes[5].y_AD, np.diag([1e7, 1e7, 1e7]))
    second = [replace(one, ids=one.ids + 1000) for one in keyframes[6:]]
    graph = reckoned([*keyframes[:5], nothing, *second])
    solved, estimate = solve(graph, 0.0, NOTHING, joint=joint)
    assert np.isfinite(estimate.covariance).all()
    rows = np.flatnonzero(solved.ids >= 1000)
    moved = se2.transform(se2.inverse(solved.X_MN[-1]), solved.p_ML[rows])
    true = p_ML[solved.ids[rows] - 1100]
    shape = np.hypot(*(moved[1:] - moved[0]).T) - np.hypot(*(true[1:] - true[0]).T)
    assert np.abs(shape).max() < 0.1


def test_poses_that_a_double_cannot_tell_given_the_landmarks_end_no_mission(monkeypatch):
    class Singular(DissectionSolver):
        def __init__(self, graph, *, landmarks=True):
            super().__init__(graph, landmarks=landmarks)
            self.landmarks = landmarks

        def linearised(self, values, damping):
            if not self.landmarks and damping == 0.0:
                raise np.linalg.LinAlgError
            return super().linearised(values, damping)

    graph = reckoned(ring(7, views=6)[0])
    solved, _ = solve(graph, 0.0, NOTHING, joint=10)
    monkeypatch.setattr(map_solver, "DissectionSolver", Singular)
    held, _ = solve(graph, 0.0, NOTHING, joint=10)
    assert held.entropy == pytest.approx(solved.entropy, rel=1e-6)


def test_how_many_are_known_jointly_is_bounded(monkeypatch):
    keyframes, _, _ = ring(7, views=6)
    graph = reckoned(keyframes)
    assert known_jointly(graph) == len(graph.ids)
    monkeypatch.setattr(map_solver, "MOST_JOINT", 10)
    assert known_jointly(graph) == map_solver.JOINT


def test_walls_are_known_jointly_if_they_pass_near():
    """Four walls seen from one pose, the second long and beside it."""
    ids = WALLS_BELOW - 4 + np.arange(4)
    ends = [[[5.0, 0], [5, 1]], [[-20, 0.5], [20, 0.5]], [[0, 7], [2, 7]], [[9, 9], [9, 8]]]
    seen = of_places(ids, *walls_between(ends), np.zeros(3), 1e-4 * np.eye(11))
    graph = reckoned([seen])
    for joint, walls in ((1, [1]), (2, [1, 0]), (3, [1, 0, 2])):
        _, estimate = solve(graph, 0.0, NOTHING, joint=joint)
        assert estimate.ids[estimate.local].tolist() == sorted(ids[walls].tolist())


def test_a_wall_is_as_far_as_what_is_seen_of_it():
    wall, anchor, reach = walls_between([[[-10.0, 1.0], [10.0, 1.0]], [[3.0, 4.0], [9.0, 4.0]]])
    tag = np.zeros((1, 2))
    ids, p_ML = np.array([WALLS_BELOW - 2, WALLS_BELOW - 1, 7]), np.vstack([wall, [[0.0, -2.0]]])
    seen = of_places(ids, p_ML, np.vstack([anchor, tag]), np.vstack([reach, tag]), np.zeros(3), 1e-4 * np.eye(9))
    np.testing.assert_allclose(distance_to(reckoned([seen]), np.zeros(3)), [1.0, 5.0, 2.0])


def test_updates_come_to_what_a_solve_comes_to():
    """Without a loop that closes, updates one after the other differ from the optimum by what linearisation costs."""
    keyframes, _, _ = ring(8, views=12, laps=0.4)
    graph, estimate = built(keyframes)
    solved, whole = solve(graph, 0.0, NOTHING)
    assert np.abs(estimate.p_ML - solved.p_ML).max() < 5e-3
    deviation = np.sqrt(np.diag(whole.covariance))
    assert np.abs((estimate.covariance - whole.covariance) / np.outer(deviation, deviation)).max() < 0.02
    assert abs(estimate.entropy - whole.entropy) < 0.3


@pytest.mark.parametrize(("sigma", "joint"), [(0.3, 400), (0.6, 400), (0.6, 30)])
def test_the_covariance_is_that_of_the_map_where_headings_are_hardly_known(sigma, joint):
    """Steps overshoot there; what was done against it must not be taken for knowledge."""
    keyframes, _, _ = ring(3, views=8, laps=1.05)
    rng, blurred = np.random.default_rng(0), []
    for one in keyframes:
        covariance = one.conditional()[0] + sigma**2 * np.eye(2 * len(one.ids) + 3)
        noise = sigma * rng.normal(size=len(covariance))
        y_AL, y_AD = one.y_AL + noise[:-3].reshape(-1, 2), one.y_AD + noise[-3:]
        blurred.append(gaussian(one.ids, y_AL, y_AD, covariance))
    graph, estimate = solve(reckoned(blurred), 0.0, NOTHING, joint=joint)
    again, after = solve(graph, 0.0, NOTHING, joint=joint)
    np.testing.assert_allclose(after.p_ML, estimate.p_ML, atol=1e-3)
    np.testing.assert_allclose(after.X_MD, estimate.X_MD, atol=1e-3)
    _, _, _, covariance = dense_solution(again)
    first = 2 * len(graph.ids) + 3 * (len(graph.keyframes) - 1)
    expected = np.diag(covariance)[first : first + 3]
    np.testing.assert_allclose(np.diag(estimate.covariance)[-3:], expected, rtol=0.02)


@pytest.mark.parametrize(("best", "share"), [(1.0, 1.0), (0.6, 1.0), (0.4, 0.5), (0.1, 0.125)])
def test_a_step_that_raises_the_error_is_halved_until_it_lowers_it(best, share):
    """The error grows with the square of the distance from a share of the step."""
    graph = reckoned(ring(1, views=2)[0])
    start = Values(graph.X_MN, graph.p_ML, graph.shared.mean, np.zeros(graph.p_ML.shape))
    unknowns = DissectionSolver(graph).unknowns
    step = np.ones(unknowns.shared_at + SHARED)

    def gradient(values):
        return None, float(np.mean(values.p_ML - start.p_ML) - best) ** 2

    there, taken = map_solver._lowered(SimpleNamespace(unknowns=unknowns, gradient=gradient), best**2, start, step)
    assert taken == share
    np.testing.assert_allclose(there.p_ML, start.p_ML + share)
