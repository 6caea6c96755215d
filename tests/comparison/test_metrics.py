import numpy as np
import pytest
from shapely.geometry import LineString, MultiLineString, Point

from tfg_drake.comparison import metrics
from tfg_drake.geometry.se2 import transform

RANDOM = np.random.default_rng(0)


def random_covariance(n: int) -> np.ndarray:
    a = RANDOM.normal(size=(n, n))
    return a @ a.T + 0.1 * np.eye(n)


def test_landmark_rmse():
    truth = np.zeros((2, 2))
    assert metrics.landmark_rmse(np.array([[3.0, 4.0], [0.0, 0.0]]), truth) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(metrics.landmark_rmse(np.zeros((0, 2)), np.zeros((0, 2))))


def test_a_moved_map_has_an_aligned_rmse_of_zero():
    p = RANDOM.uniform(-10, 10, (30, 2))
    assert metrics.landmark_rmse_aligned(p, transform(np.array([3.0, -20.0, 2.0]), p)) == pytest.approx(0.0, abs=1e-9)


def test_the_aligned_rmse_has_no_scale():
    truth = RANDOM.uniform(-5, 5, (20, 2))
    assert metrics.landmark_rmse_aligned(1.1 * truth + RANDOM.normal(0.0, 0.2, (20, 2)), truth) > 0.1


def test_anees_and_landmark_nees_against_loops():
    n = 6
    truth, estimate = RANDOM.normal(size=(n, 2)), RANDOM.normal(size=(n, 2))
    covariance = random_covariance(2 * n + 3)
    e = (estimate - truth).reshape(-1)
    entries = [slice(2 * i, 2 * i + 2) for i in range(n)]
    expected = np.mean([e[b] @ np.linalg.inv(covariance[b, b]) @ e[b] / 2 for b in entries])
    assert metrics.anees(estimate - truth, np.array([covariance[b, b] for b in entries])) == pytest.approx(expected)
    joint = e @ np.linalg.inv(covariance[: 2 * n, : 2 * n]) @ e / (2 * n)
    assert metrics.landmark_nees(estimate, truth, covariance) == pytest.approx(joint)
    none = np.zeros((0, 2))
    assert np.isnan(metrics.anees(none, np.zeros((0, 2, 2))))
    assert np.isnan(metrics.landmark_nees(none, none, np.eye(3)))


def test_consistent_errors_have_a_nees_of_one():
    covariance = random_covariance(200)
    errors = RANDOM.multivariate_normal(np.zeros(200), covariance).reshape(-1, 2)
    assert metrics.landmark_nees(errors, np.zeros((100, 2)), covariance) == pytest.approx(1.0, abs=0.35)


def test_pose_anees_wraps_the_heading():
    X, X_true = np.array([[1.0, 2.0, np.pi - 0.1]]), np.array([[1.0, 2.0, -np.pi + 0.1]])
    covariance = np.diag([1.0, 1.0, 0.04])[None]
    assert metrics.pose_anees(X, X_true, covariance) == pytest.approx(1.0 / 3.0)


def test_statistics():
    assert metrics.statistics(np.array([1.0, 3.0, 2.0])) == pytest.approx(
        {"mean": 2.0, "std": np.sqrt(2.0 / 3.0), "max": 3.0, "final": 2.0}
    )
    assert all(np.isnan(value) for value in metrics.statistics(np.zeros(0)).values())


def test_pose_errors():
    position, heading = metrics.pose_errors(np.array([[3.0, 4.0, 3.1]]), np.array([[0.0, 0.0, -3.1]]))
    np.testing.assert_allclose(position, [5.0])
    np.testing.assert_allclose(heading, [2 * np.pi - 6.2])


def test_surface_coverage_against_shapely():
    surface, segments = RANDOM.uniform(0, 5, (300, 2)), RANDOM.uniform(0, 5, (6, 4))
    mapped = MultiLineString(segments.reshape(-1, 2, 2).tolist())
    expected = np.mean([mapped.distance(Point(p)) <= 0.25 for p in surface])
    assert metrics.surface_coverage(surface, segments) == pytest.approx(expected)
    assert metrics.surface_coverage(surface, np.zeros((0, 4))) == 0.0
    assert np.isnan(metrics.surface_coverage(np.zeros((0, 2)), segments))


def test_face_coverage_against_shapely():
    """A wall without thickness, mapped 3 cm off from above as far as x = 2, and 6 cm off from below."""
    points = np.column_stack([np.arange(0.025, 4.0, 0.05), np.zeros(80)])
    up, down = np.tile([0.0, 1.0], (80, 1)), np.tile([0.0, -1.0], (80, 1))
    above, below, near_below = (np.array([[a, y, b, y]]) for a, b, y in ((0, 2, 0.03), (4, 0, -0.06), (4, 0, -0.04)))
    near = np.mean([LineString(above.reshape(2, 2)).distance(Point(p)) <= 0.05 for p in points])
    assert near == 41 / 80  # The first point beyond its end is 4 cm off.
    assert metrics.face_coverage(points, up, above, has_sides=False) == near
    assert metrics.face_coverage(points, up, above, has_sides=True) == near
    assert metrics.face_coverage(points, down, above, has_sides=False) == near
    assert metrics.face_coverage(points, down, above, has_sides=True) == 0.0
    assert metrics.face_coverage(points, down, below, has_sides=True) == 0.0
    assert metrics.face_coverage(points, down, near_below, has_sides=True) == 1.0
    assert np.isnan(metrics.face_coverage(np.zeros((0, 2)), np.zeros((0, 2)), above, has_sides=True))
    assert metrics.face_coverage(points, up, np.zeros((0, 4)), has_sides=True) == 0.0


def test_surface_phantom_against_shapely():
    segments, walls = RANDOM.uniform(0, 5, (8, 4)), RANDOM.uniform(0, 5, (6, 4))
    near = MultiLineString(walls.reshape(-1, 2, 2).tolist()).buffer(0.25, quad_segs=64)
    expected = sum(LineString(s.reshape(2, 2)).difference(near).length for s in segments)
    assert metrics.surface_phantom(segments, walls) == pytest.approx(expected, abs=0.05 * 8)
    assert metrics.surface_phantom(walls, walls) == 0.0
    assert metrics.surface_phantom(np.array([[0.0, 0, 3, 4], [1, 1, 1, 1]]), np.zeros((0, 4))) == pytest.approx(5.0)
    assert metrics.surface_phantom(np.zeros((0, 4)), walls) == 0.0
