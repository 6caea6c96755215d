"""How one map lies in another by the tags of both."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry import se2
from tfg_drake.messages import MapEstimate
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.slam.tag_search import by_tags

SIGMA = 0.05


def a_map(rng, n=30) -> MapEstimate:
    covariance = np.tile(SIGMA**2 * np.eye(2), (n, 1, 1))
    return dataclasses.replace(
        empty_map(), stage=1, ids=np.arange(n) * 2, p_ML=rng.uniform(-8.0, 8.0, (n, 2)), landmark_covariance=covariance
    )


def seen_from(of_A, rows, X_AB, rng=None):
    """Some of its tags in another frame."""
    rows = np.sort(rows)
    p_BL = se2.transform(se2.inverse(X_AB), of_A.p_ML[rows])
    if rng is not None:
        p_BL = p_BL + 0.02 * rng.normal(size=p_BL.shape)
    covariance = np.tile(0.02**2 * np.eye(2), (len(rows), 1, 1))
    return dataclasses.replace(of_A, ids=of_A.ids[rows], p_ML=p_BL, landmark_covariance=covariance)


@given(seed=st.integers(0, 10_000), theta=st.floats(-np.pi, np.pi), count=st.integers(4, 8))
def test_exact_without_noise(seed, theta, count):
    rng = np.random.default_rng(seed)
    estimate = a_map(rng)
    X_AB = np.append(rng.uniform(-5.0, 5.0, 2), theta)
    found = by_tags(estimate, seen_from(estimate, rng.choice(30, count, replace=False), X_AB))
    assert found is not None
    np.testing.assert_allclose(se2.between(X_AB, found.X), 0.0, atol=1e-6)
    assert (len(found.moved), found.tags) == (0, count)


def test_stated_deviations_hold(nees):
    """Draws of both maps' errors; NEES of the pose that is found."""
    values = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        true = a_map(rng)
        X_AB = np.append(rng.uniform(-5.0, 5.0, 2), rng.uniform(-np.pi, np.pi))
        of_B = seen_from(true, rng.choice(30, 10, replace=False), X_AB, rng)
        of_A = dataclasses.replace(true, p_ML=true.p_ML + SIGMA * rng.normal(size=(30, 2)))
        found = by_tags(of_A, of_B)
        error = found.X - X_AB
        error[2] = se2.wrap_angle(error[2])
        values.append(float(error @ np.linalg.solve(found.covariance, error)))
    # A tag may be MAP_SIGMA from where the map has it: here none is.
    assert 0.4 < np.mean(values) / 3.0 < 1.0


def test_tags_that_were_moved_are_outvoted():
    for seed in range(50):
        rng = np.random.default_rng(seed)
        estimate = a_map(rng)
        X_AB = np.append(rng.uniform(-5.0, 5.0, 2), rng.uniform(-np.pi, np.pi))
        of_B = seen_from(estimate, rng.choice(30, 8, replace=False), X_AB, rng)
        p_ML = of_B.p_ML.copy()
        p_ML[:2] += [[1.5, 0.0], [0.0, -2.0]]
        found = by_tags(estimate, dataclasses.replace(of_B, p_ML=p_ML))
        np.testing.assert_array_equal(found.moved, of_B.ids[:2])
        assert np.hypot(*(found.X - X_AB)[:2]) < 0.25


@pytest.mark.parametrize("rows", [[], [3], [3, 4]])
def test_too_few_tags_tell_nothing(rows):
    estimate = a_map(np.random.default_rng(0))
    assert by_tags(estimate, seen_from(estimate, np.array(rows, dtype=np.int64), np.zeros(3))) is None


def test_three_of_which_one_was_moved_tell_nothing():
    estimate = a_map(np.random.default_rng(0))
    of_B = seen_from(estimate, np.array([3, 4, 9]), np.zeros(3))
    p_ML = of_B.p_ML + np.array([[0.0, 0.0], [0.0, 0.0], [2.0, 1.0]])
    assert by_tags(estimate, dataclasses.replace(of_B, p_ML=p_ML)) is None


def test_tags_that_do_not_agree_are_of_another_place():
    estimate = a_map(np.random.default_rng(0))
    of_B = seen_from(estimate, np.arange(6), np.zeros(3))
    with pytest.raises(BadInput, match=r"^6 tags are in both, but fewer than three in five of them stand alike"):
        by_tags(estimate, dataclasses.replace(of_B, p_ML=np.roll(of_B.p_ML, 2, axis=0)))
    assert by_tags(estimate, dataclasses.replace(of_B, ids=of_B.ids + 1)) is None


def test_landmarks_that_hang_loose_tell_nothing():
    estimate = a_map(np.random.default_rng(3))
    of_B = seen_from(estimate, np.arange(6), np.array([1.0, -2.0, 0.5]))
    loose = estimate.landmark_covariance.copy()
    loose[:4] = 50.0**2 * np.eye(2)
    assert by_tags(estimate, of_B) is not None
    assert by_tags(dataclasses.replace(estimate, landmark_covariance=loose), of_B) is None
