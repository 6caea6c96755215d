import numpy as np

from tests.slam.oracle import NOISE, PRIOR, SIGMA, Drive
from tests.slam.rings import built, dense_solution, observed, reckoned, ring
from tfg_drake.geometry import se2
from tfg_drake.messages import replace
from tfg_drake.slam import keyframe_graph
from tfg_drake.slam.keyframe_graph import empty_graph, empty_map, forget, fused, taken_back
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.turn import reduced


def drive(seed, noise=1.0, count=10):
    """Pieces of one way, each beginning where the one before ends, along a wall of tags; where they begin and end."""
    rng = np.random.default_rng(seed)
    p_ML = np.column_stack([np.arange(0.0, 20.0, 0.7), np.full(29, 2.0) + rng.uniform(-0.5, 0.5, 29)])
    X_AD, X, pieces, X_MN = np.array([0.9, 0.05, 0.1]), np.zeros(3), [], [np.zeros(3)]
    for _ in range(count):
        seen = np.flatnonzero(np.hypot(*(p_ML - X[:2]).T) < 4.0)
        pieces.append(observed(rng, p_ML, X, X_AD, seen, noise))
        X = se2.compose(X, X_AD)
        X_MN.append(X)
    return pieces, np.array(X_MN)


def test_what_is_fused_is_exact_without_noise():
    pieces, X_MN = drive(1, noise=0.0)
    graph = fused(reckoned(pieces))
    assert len(graph.keyframes) < len(pieces)
    np.testing.assert_allclose(graph.X_MA, X_MN[:-1], atol=1e-9)
    np.testing.assert_allclose(graph.X_MN[-1], X_MN[-1], atol=1e-9)
    for one, X_MA in zip(graph.keyframes, graph.X_MN, strict=False):
        assert np.all(np.diff(one.ids) > 0)
        rows = np.searchsorted(graph.ids, one.ids)
        np.testing.assert_allclose(se2.transform(X_MA, one.given(np.zeros(SHARED))[0]), graph.p_ML[rows], atol=1e-9)


def test_a_fused_graph_says_of_the_map_what_the_whole_one_says():
    pieces, _ = drive(2)
    graph = reckoned(pieces)
    fewer = fused(graph)
    (X_MN, p_ML, _, P), (X_few, p_few, _, P_few) = dense_solution(graph), dense_solution(fewer)
    n = 2 * len(graph.ids)
    deviation = np.sqrt(np.diag(P[:n, :n]))
    assert np.abs((p_ML - p_few).ravel() / deviation).max() < 0.02
    assert np.abs((P[:n, :n] - P_few[:n, :n]) / np.outer(deviation, deviation)).max() < 0.01
    np.testing.assert_allclose(X_MN[-1], X_few[-1], atol=1e-3)


def test_a_fused_graph_says_of_the_parameters_what_the_whole_one_says():
    """The drive has all parameters off; its pieces are keyframes."""
    rng = np.random.default_rng(3)
    robot = Drive(rng.uniform(-6.0, 6.0, (20, 2)), SIGMA * rng.normal(size=SHARED), 3)
    pieces = [robot.piece(0.3, 0.4 * (-1) ** (k // 4), 2.0) for k in range(12)]
    graph = reckoned([reduced(NOISE, one, PRIOR).keyframe for one in pieces], PRIOR)
    fewer = fused(graph)
    assert len(fewer.keyframes) < 0.7 * len(pieces)
    (X_MN, p_ML, shared, P), (X_few, p_few, shared_few, P_few) = dense_solution(graph), dense_solution(fewer)
    n = 2 * len(graph.ids)
    sigma, few = (np.sqrt(np.diag(one)[np.append(np.arange(n), np.arange(-3 - SHARED, 0))]) for one in (P, P_few))
    off = np.concatenate([(p_few - p_ML).ravel(), X_few[-1] - X_MN[-1], shared_few - shared])
    assert np.abs(off / sigma).max() < 0.1
    np.testing.assert_allclose(few, sigma, rtol=0.02)


def test_what_shares_no_landmarks_stays_and_no_keyframe_grows_without_end():
    pieces, _ = drive(3)
    apart = reckoned([replace(one, ids=one.ids + 100 * k) for k, one in enumerate(pieces)])
    assert fused(apart) is apart
    pieces, _ = drive(3, count=22)
    several = fused(reckoned(pieces)).keyframes
    assert 5 < len(several) < len(pieces)
    assert max(len(one.ids) for one in several) <= keyframe_graph.FULL


def test_keyframes_whose_points_would_be_off_stay_apart(monkeypatch):
    pieces, _ = drive(3)
    point = np.array([[1.0, 0.0, -1.0, 0.0]])
    seen = reckoned([replace(one, points=point) for one in pieces])
    monkeypatch.setattr(keyframe_graph, "WITH_POINTS", keyframe_graph.MOST_DEVIATION)
    fewer = fused(seen)
    assert len(fewer.keyframes) < len(pieces)
    assert sum(len(one.points) for one in fewer.keyframes) == len(pieces)
    # The pose between them is known, but not well enough for these.
    monkeypatch.setattr(keyframe_graph, "WITH_POINTS", 1e-4)
    assert fused(seen) is seen
    one_of_two = reckoned([replace(one, points=point[k % 2 :]) for k, one in enumerate(pieces)])
    assert len(fused(one_of_two).keyframes) < len(pieces)


def test_a_forgotten_landmark_leaves_what_it_told():
    keyframes, _, _ = ring(10, views=6, laps=0.3)
    graph, _ = built(keyframes)
    gone = graph.ids[:2]
    after = forget(graph, gone)
    assert not np.isin(gone, after.ids).any()
    for one, left in zip(graph.keyframes, after.keyframes, strict=True):
        keep = np.append(np.repeat(~np.isin(one.ids, gone), 2), np.ones(3, dtype=bool))
        before, after_it = one.given(np.zeros(SHARED))[2], left.given(np.zeros(SHARED))[2]
        np.testing.assert_allclose(after_it, before[np.ix_(keep, keep)], rtol=1e-6, atol=1e-12)


def test_one_sighting_is_taken_back():
    graph = reckoned(drive(11, count=3)[0])
    tag = int(np.intersect1d(graph.keyframes[0].ids, graph.keyframes[2].ids)[0])
    after = taken_back(graph, tag, 2)
    assert [tag in one.ids for one in after.keyframes] == [True, True, False]
    np.testing.assert_array_equal(after.ids, graph.ids)


def test_the_empty_map_is_stage_zero_and_knows_the_parameters_by_their_prior():
    assert empty_map().stage == 0
    estimate = empty_map(PRIOR)
    np.testing.assert_array_equal(estimate.shared, PRIOR.mean)
    np.testing.assert_array_equal(estimate.joint_covariance[3:, 3:], PRIOR.covariance)
    assert not estimate.joint_covariance[:3].any()
    graph = empty_graph(PRIOR)
    assert graph.shared is PRIOR
    assert graph.X_MA.shape == (0, 3)
