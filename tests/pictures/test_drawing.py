import numpy as np

from tfg_drake.pictures.drawing import bands, circles, ellipses, outline_segments, polyline_segments, spreads


def areas(outlines):
    """Positive of those that are anticlockwise."""
    x, y = np.moveaxis(outlines, 2, 0)
    return 0.5 * np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)


def test_every_point_of_an_ellipse_has_the_stated_mahalanobis_distance():
    rng = np.random.default_rng(0)
    roots = rng.normal(size=(5, 2, 2))
    covariances, centers = roots @ np.swapaxes(roots, 1, 2), rng.normal(size=(5, 2))
    offset = ellipses(centers, covariances, sigmas=3.0) - centers[:, None]
    squared = np.einsum("nci,nij,ncj->nc", offset, np.linalg.inv(covariances), offset)
    np.testing.assert_allclose(squared, 9.0, rtol=1e-9)
    exact = np.pi * 9.0 * np.sqrt(np.linalg.det(covariances))
    np.testing.assert_allclose(areas(ellipses(centers, covariances, corners=200)), exact, rtol=1e-3)


def test_bands_cover_their_area():
    segments = np.array([[0.0, 0.0, 3.0, 4.0], [1.0, 1.0, 1.0, 1.0]])
    np.testing.assert_allclose(areas(bands(segments, 0.2)), [5.2 * 0.2, 0.2 * 0.2])


def test_a_spread_is_three_deviations_to_either_side_of_each_end():
    (outline,) = spreads(np.array([[1.0, 1.0, 4.0, 5.0]]), np.array([[0.1, 0.5]]))
    assert areas(outline[None])[0] > 0.0
    to_line = (outline - [1.0, 1.0]) @ np.array([[0.6, -0.8], [0.8, 0.6]])  # along, to the left
    np.testing.assert_allclose(to_line, [[0.0, -0.3], [5.0, -1.5], [5.0, 1.5], [0.0, 0.3]], atol=1e-12)


def test_circles_are_regular_polygons():
    polygons = circles(np.array([[1.0, 2.0], [3.0, 4.0]]), 0.5, corners=64)
    np.testing.assert_allclose(areas(polygons), 0.5 * 64 * 0.25 * np.sin(2 * np.pi / 64))
    np.testing.assert_allclose(polygons.mean(axis=1), [[1.0, 2.0], [3.0, 4.0]])


def test_empty_inputs():
    nothing = np.zeros((0, 2))
    assert ellipses(nothing, np.zeros((0, 2, 2))).shape == (0, 24, 2)
    assert outline_segments(np.zeros((0, 32, 2))).shape == (0, 4)
    assert polyline_segments(np.zeros((1, 2))).shape == (0, 4)
    assert bands(np.zeros((0, 4)), 0.1).shape == (0, 4, 2)
    assert circles(nothing, 0.1).shape == (0, 12, 2)
