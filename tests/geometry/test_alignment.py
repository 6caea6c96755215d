import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tfg_drake.geometry.alignment import align
from tfg_drake.geometry.se2 import transform


@settings(max_examples=50)
@given(st.tuples(*[st.floats(-20, 20)] * 2, st.floats(-3.1, 3.1)), st.integers(2, 30))
def test_alignment_undoes_any_rigid_transform(pose, n):
    p = np.random.default_rng(n).uniform(-10, 10, (n, 2))
    np.testing.assert_allclose(align(transform(np.array(pose), p), p), pose, atol=1e-9)


def test_alignment_is_the_least_squares_optimum():
    random = np.random.default_rng(0)
    truth = random.uniform(-5, 5, (20, 2))
    estimate = 1.1 * truth + random.normal(0.0, 0.2, (20, 2))
    X = align(truth, estimate)
    squares = [np.sum((transform(X + change, estimate) - truth) ** 2) for change in random.normal(0.0, 0.05, (200, 3))]
    assert np.sum((transform(X, estimate) - truth) ** 2) <= min(squares)
