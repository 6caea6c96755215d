import numpy as np

from tfg_drake.pictures.drawing import discs, ellipses, outline_segments, polyline_segments, ribbons


def area(vertices, faces):
    a, b, c = (vertices[faces[:, i], :2] for i in range(3))
    u, v = b - a, c - a
    return 0.5 * np.sum(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def test_every_point_of_an_ellipse_has_the_stated_mahalanobis_distance():
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(5, 2, 2))
    covariances, centers = roots @ np.swapaxes(roots, 1, 2), rng.normal(size=(5, 2))
    offset = ellipses(centers, covariances, sigmas=3.0) - centers[:, None]
    squared = np.einsum("nci,nij,ncj->nc", offset, np.linalg.inv(covariances), offset)
    np.testing.assert_allclose(squared, 9.0, rtol=1e-9)


def test_ribbons_cover_their_area_and_face_up():
    segments = np.array([[0.0, 0.0, 3.0, 4.0], [1.0, 1.0, 1.0, 1.0]])
    vertices, faces = ribbons(segments, 0.2, 0.5)
    assert vertices.shape == (8, 3)
    np.testing.assert_allclose(area(vertices, faces), 5.2 * 0.2 + 0.2 * 0.2)
    assert np.all(vertices[:, 2] == 0.5)


def test_discs_are_regular_polygons():
    vertices, faces = discs(np.array([[1.0, 2.0], [3.0, 4.0]]), 0.5, 0.0, corners=64)
    np.testing.assert_allclose(area(vertices, faces), 2 * 0.5 * 64 * 0.25 * np.sin(2 * np.pi / 64))


def test_empty_inputs():
    nothing = np.zeros((0, 2))
    assert ellipses(nothing, np.zeros((0, 2, 2))).shape == (0, 32, 2)
    assert outline_segments(np.zeros((0, 32, 2))).shape == (0, 4)
    assert polyline_segments(np.zeros((1, 2))).shape == (0, 4)
    assert [part.shape for part in ribbons(np.zeros((0, 4)), 0.1, 0.0)] == [(0, 3), (0, 3)]
    assert [part.shape for part in discs(nothing, 0.1, 0.0)] == [(0, 3), (0, 3)]
