import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.geometry.se2 import between, compose, inverse, rotation, transform, wrap_angle

lengths = st.floats(-100.0, 100.0)
angles = st.floats(-50.0, 50.0)
poses = st.tuples(lengths, lengths, angles).map(np.array)
points = st.lists(st.tuples(lengths, lengths), max_size=5).map(lambda rows: np.array(rows).reshape(-1, 2))


def matrix(X):
    c, s = np.cos(X[2]), np.sin(X[2])
    return np.array([[c, -s, X[0]], [s, c, X[1]], [0.0, 0.0, 1.0]])


def assert_same_pose(X, Y):
    np.testing.assert_allclose(matrix(X), matrix(Y), atol=1e-9)


@given(st.floats(-1e6, 1e6))
def test_wrapped_angle_is_the_same_direction_in_range(angle):
    wrapped = wrap_angle(angle)
    assert -np.pi < wrapped <= np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-8)


@given(st.floats(-np.pi, np.pi, exclude_min=True))
def test_wrapping_leaves_angles_in_range(angle):
    np.testing.assert_allclose(wrap_angle(angle), angle, atol=1e-15)


def test_wrapping_at_the_seam():
    np.testing.assert_array_equal(wrap_angle(np.array([np.pi, -np.pi, 0.0])), [np.pi, np.pi, 0.0])
    assert wrap_angle(np.nextafter(-np.pi, -4.0)) > 3.0
    assert wrap_angle(np.empty(0)).shape == (0,)


@given(poses, poses)
def test_compose_is_the_product_of_matrices(X_AB, X_BC):
    np.testing.assert_allclose(matrix(compose(X_AB, X_BC)), matrix(X_AB) @ matrix(X_BC), atol=1e-9)


@given(poses, poses, poses)
def test_compose_is_associative(X_AB, X_BC, X_CD):
    assert_same_pose(compose(compose(X_AB, X_BC), X_CD), compose(X_AB, compose(X_BC, X_CD)))


@given(poses)
def test_inverse_undoes_from_either_side(X_AB):
    identity = np.zeros(3)
    assert_same_pose(compose(X_AB, inverse(X_AB)), identity)
    assert_same_pose(compose(inverse(X_AB), X_AB), identity)
    assert_same_pose(inverse(inverse(X_AB)), X_AB)


@given(poses, poses)
def test_between_leads_from_the_first_to_the_second(X_AB, X_AC):
    assert_same_pose(compose(X_AB, between(X_AB, X_AC)), X_AC)


@given(poses, points)
def test_transform_is_the_matrix_on_points(X_AB, p_BP):
    homogeneous = np.column_stack([p_BP, np.ones(len(p_BP))])
    p_AP = transform(X_AB, p_BP)
    assert p_AP.shape == p_BP.shape
    np.testing.assert_allclose(p_AP, (homogeneous @ matrix(X_AB).T)[:, :2], atol=1e-9)
    for row, p in zip(p_AP, p_BP, strict=True):
        np.testing.assert_allclose(transform(X_AB, p), row, atol=1e-9)
    np.testing.assert_allclose(transform(inverse(X_AB), p_AP), p_BP, atol=1e-9)


@given(poses, poses)
def test_transform_agrees_with_compose(X_AB, X_BC):
    np.testing.assert_allclose(transform(X_AB, X_BC[:2]), compose(X_AB, X_BC)[:2], atol=1e-9)


@given(angles)
def test_rotation_is_proper(theta):
    R = rotation(theta)
    np.testing.assert_allclose(R @ R.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(R @ [1.0, 0.0], [np.cos(theta), np.sin(theta)], atol=1e-15)
    assert np.linalg.det(R) > 0


def test_rows_of_poses_broadcast():
    rng = np.random.default_rng(1)
    X_AB, X_BC = rng.normal(size=(7, 3)), rng.normal(size=(7, 3))
    rows = [compose(a, b) for a, b in zip(X_AB, X_BC, strict=True)]
    np.testing.assert_allclose(compose(X_AB, X_BC), rows, atol=1e-14)
    np.testing.assert_allclose(inverse(X_AB), [inverse(a) for a in X_AB], atol=1e-14)
    np.testing.assert_allclose(compose(X_AB[0], X_BC), [compose(X_AB[0], b) for b in X_BC], atol=1e-14)
    assert compose(X_AB[0], np.empty((0, 3))).shape == (0, 3)
