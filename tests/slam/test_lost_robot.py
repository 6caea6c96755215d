"""A pose from one frame of mapped tags."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.slam.oracle import NOISE
from tests.slam.rings import NOTHING, reckoned, ring
from tfg_drake.geometry import se2
from tfg_drake.messages import MapEstimate, TagDetections
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.slam.localizer import start_localizer
from tfg_drake.slam.lost_robot import ELSEWHERE, Expected, mapped_elsewhere, relocalize
from tfg_drake.slam.map_solver import solve

# An expected pose that says nothing of where the robot is.
FAR_AWAY = Expected(np.array([1e4, 0.0, 0.0]), np.full(3, 0.05), np.ones(3))


def a_map(rng, n=30) -> MapEstimate:
    covariance = np.tile(0.05**2 * np.eye(2), (n, 1, 1))
    return dataclasses.replace(
        empty_map(), stage=1, ids=np.arange(n) * 2, p_ML=rng.uniform(-8.0, 8.0, (n, 2)), landmark_covariance=covariance
    )


def sight(estimate, rows, X_MB, rng=None):
    p_BL = se2.transform(se2.inverse(X_MB), estimate.p_ML[rows])
    r, b = np.hypot(*p_BL.T), np.arctan2(p_BL[:, 1], p_BL[:, 0])
    sigma_r, sigma_b = 0.02 + 0.01 * r, np.full(len(rows), 0.01)
    if rng is not None:
        r, b = r + sigma_r * rng.normal(size=len(rows)), b + sigma_b * rng.normal(size=len(rows))
    return TagDetections(0.0, estimate.ids[rows], r, b, sigma_r, sigma_b)


@given(seed=st.integers(0, 10_000), theta=st.floats(-np.pi, np.pi), count=st.integers(3, 8))
def test_exact_without_noise(seed, theta, count):
    rng = np.random.default_rng(seed)
    estimate = a_map(rng)
    X_MB = np.append(rng.uniform(-5.0, 5.0, 2), theta)
    rows = rng.choice(30, count, replace=False)
    found = relocalize(estimate, sight(estimate, rows, X_MB), FAR_AWAY)
    assert found is not None
    error = se2.between(X_MB, found.X_MB)
    np.testing.assert_allclose(error, 0.0, atol=1e-6)
    assert found.agreeing.all()
    assert found.is_known


def test_wrong_ids_and_outliers_are_outvoted():
    hits = 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        estimate = a_map(rng)
        X_MB = np.append(rng.uniform(-5.0, 5.0, 2), rng.uniform(-np.pi, np.pi))
        rows = rng.choice(30, 8, replace=False)
        detections = sight(estimate, rows, X_MB, rng)
        ids, r = detections.ids.copy(), detections.range.copy()
        ids[0] = estimate.ids[np.setdiff1d(np.arange(30), rows)[0]]
        r[1] += 1.5
        found = relocalize(estimate, dataclasses.replace(detections, ids=ids, range=r), FAR_AWAY)
        if found is None:
            continue
        error = se2.between(X_MB, found.X_MB)
        assert np.hypot(*error[:2]) < 0.25
        assert not found.agreeing[:2].any()
        hits += 1
    assert hits > 45


@pytest.mark.parametrize("rows", [[], [3], [3, 4]])
def test_too_few_tags_tell_nothing(rows):
    estimate = a_map(np.random.default_rng(0))
    rows = np.array(rows, dtype=np.int64)
    assert relocalize(estimate, sight(estimate, rows, np.zeros(3)), FAR_AWAY) is None


def test_tags_that_do_not_agree_tell_nothing():
    estimate = a_map(np.random.default_rng(0))
    detections = sight(estimate, np.arange(6), np.zeros(3))
    scrambled = dataclasses.replace(detections, ids=np.roll(detections.ids, 2))
    unknown = dataclasses.replace(detections, ids=detections.ids + 1)
    assert relocalize(estimate, scrambled, FAR_AWAY) is None
    assert relocalize(estimate, unknown, FAR_AWAY) is None


def test_landmarks_that_hang_loose_tell_nothing():
    rng = np.random.default_rng(3)
    estimate = a_map(rng)
    X_MB, rows = np.array([1.0, -2.0, 0.5]), np.arange(6)
    loose = estimate.landmark_covariance.copy()
    loose[rows[:4]] = 50.0**2 * np.eye(2)
    seen = sight(estimate, rows, X_MB)
    assert relocalize(estimate, seen, FAR_AWAY) is not None
    assert relocalize(dataclasses.replace(estimate, landmark_covariance=loose), seen, FAR_AWAY) is None


def test_one_tag_says_near_the_expected_pose_what_it_can_and_two_say_all():
    rng = np.random.default_rng(5)
    estimate = a_map(rng)
    X_MB = np.array([1.0, -2.0, 0.5])
    off = se2.compose(X_MB, np.array([0.4, -0.3, 0.6]))
    expected = Expected(off, np.full(3, 0.05), np.array([1.0, 1.0, 1.0]))
    one = relocalize(estimate, sight(estimate, [2], X_MB), expected)
    assert one is not None
    assert not one.is_known
    two = relocalize(estimate, sight(estimate, [2, 5], X_MB), expected)
    assert two is not None
    assert two.is_known
    assert two.is_near
    np.testing.assert_allclose(two.X_MB, X_MB, atol=0.05)


def test_tags_that_are_where_they_should_be_move_nobody():
    estimate = a_map(np.random.default_rng(6))
    X_MB = np.array([-1.0, 0.5, 2.0])
    expected = Expected(X_MB, np.full(3, 0.05), np.array([3.0, 3.0, 3.0]))
    assert relocalize(estimate, sight(estimate, [1, 4, 7, 9], X_MB), expected) is None


def test_a_tag_of_the_far_end_of_the_map_that_is_seen_here_is_elsewhere():
    """The localiser knows those near by for itself; a far one seen where the map has it is where it should be."""
    graph, estimate = solve(reckoned(ring(3, views=12, laps=0.5)[0]), 0.0, NOTHING, joint=20)
    state = SimpleNamespace(graph=graph, map=estimate, noise=SimpleNamespace(now=NOISE))
    distance = np.hypot(*(estimate.p_ML - estimate.X_MD[:2]).T)
    far = np.argsort(distance)[-3:]
    assert not np.isin(far, estimate.local).any()
    assert distance[far].min() > ELSEWHERE + 3.0

    def count(rows, ranges):
        seen = sight(estimate, rows, estimate.X_MD)
        return mapped_elsewhere(state, start_localizer(estimate), dataclasses.replace(seen, range=ranges))

    assert count(far, distance[far]) == 0
    assert count(far, np.full(3, 2.0)) == 3
    assert count(far, np.append(distance[far[:2]], 2.0)) == 1
    assert count(estimate.local[:3], np.full(3, 30.0)) == 0
    assert (
        mapped_elsewhere(
            SimpleNamespace(graph=graph, map=None), start_localizer(estimate), sight(estimate, far, estimate.X_MD)
        )
        == 0
    )
