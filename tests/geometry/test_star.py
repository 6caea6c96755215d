"""Star polygons against shapely."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tfg_drake.geometry.star import inside_any, inspected


def _stars(seed: int, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    offsets, vertices, centers = [0], [], []
    for _ in range(count):
        center = rng.uniform(-5.0, 5.0, 2)
        angles = np.sort(rng.uniform(-np.pi, np.pi, rng.integers(3, 40)))
        ranges = rng.uniform(0.2, 4.0, len(angles))
        vertices.append(center + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1))
        centers.append(center)
        offsets.append(offsets[-1] + len(angles))
    return np.array(offsets), np.concatenate([np.zeros((0, 2)), *vertices]), np.array(centers).reshape(-1, 2)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.integers(0, 4))
def test_inside_any_agrees_with_shapely(seed: int, count: int) -> None:
    offsets, vertices, centers = _stars(seed, count)
    points = np.random.default_rng(seed + 1).uniform(-8.0, 8.0, (200, 2))
    expected = np.zeros(200, dtype=bool)
    for j in range(count):
        polygon = shapely.Polygon(vertices[offsets[j] : offsets[j + 1]])
        expected |= shapely.contains_xy(polygon, points)
    np.testing.assert_array_equal(inside_any(points, offsets, vertices, centers), expected)


def test_nothing_is_inside_no_star() -> None:
    offsets, vertices, centers = _stars(0, 0)
    assert not inside_any(np.zeros((3, 2)), offsets, vertices, centers).any()
    assert inside_any(np.zeros((0, 2)), *_stars(0, 2)).shape == (0,)


@pytest.mark.parametrize(
    ("normal_angle", "max_range", "expected"),
    [(np.pi, 5.0, True), (np.pi - 1.3, 5.0, True), (np.pi - 1.32, 5.0, False), (0.0, 5.0, False), (np.pi, 1.5, False)],
)
def test_inspected_needs_range_and_incidence(normal_angle: float, max_range: float, expected: bool) -> None:
    square = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
    normal = np.array([[np.cos(normal_angle), np.sin(normal_angle)]])
    seen = inspected(
        np.array([[2.0, 0.0]]), normal, np.array([0, 4]), square, np.zeros((1, 2)), max_range, np.deg2rad(75.0)
    )
    assert seen.tolist() == [expected]


def test_inspected_needs_free_line_of_sight() -> None:
    square = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
    seen = inspected(
        np.array([[4.0, 0.0]]), np.array([[-1.0, 0.0]]), np.array([0, 4]), square, np.zeros((1, 2)), 9.0, 1.3
    )
    assert seen.tolist() == [False]
