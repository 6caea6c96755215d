import numpy as np
import pytest

from tests.slam.rings import ODOMETRY, built, dense_solution, observed, reckoned, ring
from tfg_drake.geometry import se2
from tfg_drake.messages import replace
from tfg_drake.slam import keyframe_graph
from tfg_drake.slam.keyframe_graph import decoupled, empty_map, forget, fused, rescaled, without_tags


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
        np.testing.assert_allclose(se2.transform(X_MA, one.p_AL), graph.p_ML[rows], atol=1e-9)


def test_a_fused_graph_says_of_the_map_what_the_whole_one_says():
    pieces, _ = drive(2)
    graph = reckoned(pieces)
    fewer = fused(graph)
    (X_MN, p_ML, P, _), (X_few, p_few, P_few, _) = dense_solution(graph), dense_solution(fewer)
    P, P_few = P[:-1, :-1], P_few[:-1, :-1]
    n = 2 * len(graph.ids)
    deviation = np.sqrt(np.diag(P[:n, :n]))
    assert np.abs((p_ML - p_few).ravel() / deviation).max() < 0.02
    assert np.abs((P[:n, :n] - P_few[:n, :n]) / np.outer(deviation, deviation)).max() < 0.01
    np.testing.assert_allclose(X_MN[-1], X_few[-1], atol=1e-3)


def test_what_shares_no_landmarks_stays_and_no_keyframe_grows_without_end():
    pieces, _ = drive(3)
    apart = reckoned([replace(one, ids=one.ids + 100 * k) for k, one in enumerate(pieces)])
    assert fused(apart) is apart
    pieces, _ = drive(3, count=22)
    several = fused(reckoned(pieces)).keyframes
    assert 5 < len(several) < len(pieces)
    assert max(len(one.ids) for one in several) <= keyframe_graph.FULL


def test_ways_that_only_odometry_speaks_for_are_decoupled():
    observations, _, _ = ring(6, views=24)
    # Two turns at the end that have nothing in common with those before, the second nothing with the first but one tag.
    first, second = (replace(observations[k], ids=observations[k].ids + 1000) for k in (4, 6))
    shared = np.intersect1d(first.ids, second.ids)
    observations = [*observations[:4], first, observations[5], without_tags(second, shared[1:])]
    graph, loose = reckoned(observations), 100.0 * np.eye(3)
    freed = decoupled(graph, loose, np.empty(0, dtype=np.int64))
    expected = [ODOMETRY, loose, loose]
    for j, covariance in zip((1, 3, 5), expected, strict=True):
        np.testing.assert_allclose(freed.keyframes[j].covariance, covariance)
    together, _ = drive(7)
    graph = reckoned(together)
    assert decoupled(graph, loose, np.empty(0, dtype=np.int64)) is graph


def test_a_joint_that_only_odometry_speaks_for_becomes_a_loose_way():
    pieces, _ = drive(8, count=4)
    strange = [*pieces[:3], replace(pieces[3], ids=pieces[3].ids + 1000)]
    graph, loose = reckoned(strange), 100.0 * np.eye(3)
    freed = decoupled(graph, loose, np.empty(0, dtype=np.int64))
    assert [len(one.ids) == 0 for one in freed.keyframes] == [False, False, False, True, False]
    np.testing.assert_allclose(freed.keyframes[3].covariance, loose)
    np.testing.assert_allclose(freed.X_MA, graph.X_MA)


def test_a_scale_learnt_later_is_taken_out_of_earlier_keyframes():
    graph = reckoned(drive(9)[0])
    again = rescaled(graph, 0.01)
    for before, after in zip(graph.keyframes, again.keyframes, strict=True):
        np.testing.assert_allclose(after.p_AL, before.p_AL / 1.01)
        np.testing.assert_allclose(after.X_AD, before.X_AD / [1.01, 1.01, 1.0])
        assert after.range_scale == 0.01
    assert rescaled(again, 0.01 + 5e-5) is again


def test_a_forgotten_landmark_leaves_what_it_told():
    observations, _, _ = ring(10, views=6, laps=0.3)
    graph, _ = built(observations)
    gone = graph.ids[:2]
    after = forget(graph, gone)
    assert not np.isin(gone, after.ids).any()
    for one, left in zip(graph.keyframes, after.keyframes, strict=True):
        keep = np.append(np.repeat(~np.isin(one.ids, gone), 2), np.ones(3, dtype=bool))
        np.testing.assert_allclose(left.covariance, one.covariance[np.ix_(keep, keep)], rtol=1e-6, atol=1e-12)


def test_the_empty_map_is_stage_zero():
    assert empty_map().stage == 0
    with pytest.raises(np.linalg.LinAlgError):
        reckoned([empty_map().observation])
