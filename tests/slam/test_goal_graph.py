import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import D, L

from tfg_drake.geometry import se2
from tfg_drake.messages import GoalObservation, replace
from tfg_drake.slam.goal_arrival import add_goal
from tfg_drake.slam.goal_factors import factor_graph, joint_factor, values_of
from tfg_drake.slam.goal_graph import empty_graph, empty_map, loosened, rescaled, without_tags
from tfg_drake.slam.map_solver import solve

SEGMENT = np.diag([0.05, 0.05, 0.02]) ** 2


def ring(seed, noise, goals=8, tags=40, seen=15):
    """Goals on a circle, their observations with correlated noise, and the segments between them."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-6.0, 6.0, (tags, 2))
    angle = 2.0 * np.pi * np.arange(goals) / goals
    X_WA = np.column_stack([4.0 * np.cos(angle), 4.0 * np.sin(angle), se2.wrap_angle(angle + 1.0)])
    points = se2.transform(se2.inverse(X_WA[0]), points)
    X_MA = se2.between(X_WA[0], X_WA)
    observations, segments, X_MD = [], [], []
    for i, X in enumerate(X_MA):
        rows = np.sort(np.argsort(np.hypot(*(points - X[:2]).T))[:seen])
        size = 2 * seen + 3
        root = 0.003 * rng.normal(size=(size, size)) + 0.01 * np.eye(size)
        X_AD = np.array([0.02, -0.01, 0.1])
        error = noise * root @ rng.normal(size=size)
        observations.append(
            GoalObservation(
                ids=rows + 100,
                p_AL=se2.transform(se2.inverse(X), points[rows]) + error[:-3].reshape(-1, 2),
                X_AD=X_AD + error[-3:],
                covariance=root @ root.T,
                stamps=np.empty(0),
                X_AB=np.empty((0, 3)),
            )
        )
        if i > 0:
            segments.append(se2.between(X_MD[-1], X) + noise * np.sqrt(np.diag(SEGMENT)) * rng.normal(size=3))
        X_MD.append(se2.compose(X, X_AD))
    return points, X_MA, np.array(X_MD), observations, segments


def build(observations, segments):
    graph, estimate = empty_graph(), None
    for i, observation in enumerate(observations):
        X_DA = segments[i - 1] if i > 0 else np.zeros(3)
        graph, rejected = add_goal(graph, estimate, observation, X_DA, SEGMENT)
        assert len(rejected) == 0
        graph, estimate = solve(graph, float(i), observation)
    return graph, estimate


def test_exact_without_noise():
    points, X_MA, X_MD, observations, segments = ring(1, 0.0)
    graph, estimate = build(observations, segments)
    np.testing.assert_allclose(estimate.p_ML, points[estimate.ids - 100], atol=1e-6)
    np.testing.assert_allclose(se2.between(X_MA, estimate.X_MA), np.zeros((8, 3)), atol=1e-6)
    np.testing.assert_allclose(se2.between(X_MD, graph.X_MD), np.zeros((8, 3)), atol=1e-6)
    assert estimate.stage == len(observations)
    assert np.all(np.diff(estimate.ids) > 0)


def test_values_and_covariance_are_gtsams_own():
    _, _, _, observations, segments = ring(2, 1.0)
    graph, estimate = build(observations, segments)
    factors = factor_graph(graph)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-12)
    values = gtsam.LevenbergMarquardtOptimizer(factors, values_of(graph), parameters).optimize()
    for tag, point in zip(estimate.ids, estimate.p_ML, strict=True):
        np.testing.assert_allclose(point, values.atPoint2(L(int(tag))), atol=1e-5)
    keys = [*(L(int(tag)) for tag in estimate.ids), D(len(observations) - 1)]
    expected = gtsam.Marginals(factors, values).jointMarginalCovariance(keys).fullMatrix()
    to_M = np.eye(len(expected))
    to_M[-3:-1, -3:-1] = se2.rotation(estimate.X_MD[2])
    np.testing.assert_allclose(estimate.covariance, to_M @ expected @ to_M.T, rtol=2e-3, atol=1e-8)
    entropy = 0.5 * np.linalg.slogdet(2.0 * np.pi * np.e * estimate.covariance[:-3, :-3])[1]
    assert abs(estimate.entropy - entropy) < 1e-8


@pytest.mark.parametrize(("pose_free", "held"), [(True, 0), (True, 4), (False, 4)])
def test_jacobians_of_the_goal_factor(pose_free, held):
    """Of the poses and landmarks that are free; the others stay where the graph has them."""
    _, _, _, observations, segments = ring(3, 1.0)
    graph, _ = build(observations, segments)
    free = ~np.isin(graph.ids, observations[2].ids[:held])
    factor = joint_factor(graph, 2, pose_free, free)
    keys = list(factor.keys())
    assert len(keys) == 2 * pose_free + len(observations[2].ids) - held
    values = values_of(graph)
    for key in keys[2 * pose_free :]:
        values.update(key, values.atPoint2(key) + 0.1)
    jacobian = factor.linearize(values).jacobian()[0]
    column = 0
    for key in keys:
        size = 3 if pose_free and key in keys[:2] else 2
        for i in range(size):
            errors = []
            for h in (1e-6, -1e-6):
                moved = gtsam.Values(values)
                if size == 3:
                    moved.update(key, moved.atPose2(key).retract(h * np.eye(3)[i]))
                else:
                    moved.update(key, moved.atPoint2(key) + h * np.eye(2)[i])
                errors.append(factor.unwhitenedError(moved))
            np.testing.assert_allclose(jacobian[:, column], (errors[0] - errors[1]) / 2e-6, rtol=1e-4, atol=1e-3)
            column += 1


def test_consistent(nees):
    landmarks, poses = [], []
    for seed in range(20):
        points, _, X_MD, observations, segments = ring(seed, 1.0)
        _, estimate = build(observations, segments)
        error = (estimate.p_ML - points[estimate.ids - 100]).ravel()
        pose = estimate.X_MD - X_MD[-1]
        pose[2] = se2.wrap_angle(pose[2])
        landmarks.append(nees(error, estimate.covariance[:-3, :-3]))
        poses.append(nees(pose, estimate.covariance[-3:, -3:]))
    assert 0.85 < np.mean(landmarks) < 1.15
    assert 0.5 < np.mean(poses) < 1.6


def test_a_moved_tag_is_left_out_and_named():
    points, _, _, observations, segments = ring(4, 1.0)
    graph, estimate = build(observations[:3], segments[:2])
    observation = observations[3]
    known = np.flatnonzero(np.isin(observation.ids, graph.ids))
    p_AL = observation.p_AL.copy()
    p_AL[known[:2]] += 1.5
    moved = GoalObservation(
        ids=observation.ids,
        p_AL=p_AL,
        X_AD=observation.X_AD,
        covariance=observation.covariance,
        stamps=observation.stamps,
        X_AB=observation.X_AB,
    )
    graph, rejected = add_goal(graph, estimate, moved, segments[2], SEGMENT)
    np.testing.assert_array_equal(rejected, observation.ids[known[:2]])
    assert len(graph.observations[-1].ids) == len(observation.ids) - 2
    _, estimate = solve(graph, 0.0, moved)
    assert np.abs(estimate.p_ML - points[estimate.ids - 100]).max() < 0.2


def test_goals_without_tags_hang_on_their_segments():
    nothing = GoalObservation(
        ids=np.empty(0, dtype=np.int64),
        p_AL=np.empty((0, 2)),
        X_AD=np.array([0.0, 0.0, 0.5]),
        covariance=1e-4 * np.eye(3),
        stamps=np.empty(0),
        X_AB=np.empty((0, 3)),
    )
    _, estimate = build([nothing, nothing], [np.array([2.0, 0.0, 0.0])])
    np.testing.assert_allclose(estimate.X_MD, [2.0 * np.cos(0.5), 2.0 * np.sin(0.5), 1.0], atol=1e-9)
    assert estimate.entropy == 0.0
    assert empty_map().stage == 0


def test_segments_that_only_odometry_speaks_for_are_loosened():
    _, _, _, observations, segments = ring(6, 1.0)
    # Two goals at the end that have nothing in common with those before, the second nothing with the first but one tag.
    strange = [replace(observations[k], ids=observations[k].ids + 1000) for k in (2, 3)]
    shared = np.intersect1d(strange[0].ids, strange[1].ids)
    strange[1] = without_tags(strange[1], shared[1:])
    graph, _ = build([*observations[:2], *strange], segments[:3])
    loose = 100.0 * np.eye(3)
    freed = loosened(graph, loose)
    np.testing.assert_array_equal(freed.segment_covariance[0], SEGMENT)
    for covariance in (freed.segment_covariance, freed.travel_covariance):
        np.testing.assert_array_equal(covariance[1:], [loose, loose])
    graph, _ = build(observations[:4], segments[:3])
    np.testing.assert_array_equal(loosened(graph, loose).segment_covariance, graph.segment_covariance)


def test_a_scale_learnt_later_is_taken_out_of_earlier_goals():
    _, _, _, observations, segments = ring(7, 0.0)
    graph, _ = build(observations[:3], segments[:2])
    again = rescaled(graph, 0.01)
    for before, after in zip(graph.observations, again.observations, strict=True):
        np.testing.assert_allclose(after.p_AL, before.p_AL / 1.01)
        assert after.range_scale == 0.01
    assert rescaled(again, 0.01 + 5e-5).observations == again.observations
    for before, after in zip(graph.observations, rescaled(again, 0.0).observations, strict=True):
        np.testing.assert_allclose(after.p_AL, before.p_AL)
