"""Star polygons against shapely."""

import itertools

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.arrays import frozen
from tfg_drake.geometry.star import ALONG, inside_any, inspected, looked_through


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
    offsets, vertices, _ = _stars(seed, count)
    points = np.random.default_rng(seed + 1).uniform(-8.0, 8.0, (200, 2))
    expected = np.zeros(200, dtype=bool)
    for j in range(count):
        polygon = shapely.Polygon(vertices[offsets[j] : offsets[j + 1]])
        expected |= shapely.contains_xy(polygon, points)
    np.testing.assert_array_equal(inside_any(points, offsets, vertices), expected)


def test_nothing_is_inside_no_star() -> None:
    offsets, vertices, _ = _stars(0, 0)
    assert not inside_any(np.zeros((3, 2)), offsets, vertices).any()
    assert not inside_any(np.zeros((3, 2)), np.array([0, 0]), vertices).any()
    assert inside_any(np.zeros((0, 2)), *_stars(0, 2)[:2]).shape == (0,)


@pytest.mark.parametrize(
    ("normal_angle", "max_range", "expected"),
    [(np.pi, 5.0, True), (np.pi - 1.3, 5.0, True), (np.pi - 1.32, 5.0, False), (0.0, 5.0, False), (np.pi, 1.5, False)],
)
def test_inspected_needs_range_and_incidence(normal_angle: float, max_range: float, expected: bool) -> None:
    square = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
    normal = frozen([[np.cos(normal_angle), np.sin(normal_angle)]])
    seen = inspected(
        np.array([[2.0, 0.0]]), normal, np.array([0, 4]), square, np.zeros((1, 2)), max_range, np.deg2rad(75.0)
    )
    assert seen.tolist() == [expected]


def test_inspected_needs_free_line_of_sight() -> None:
    square = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
    seen = inspected(
        np.array([[4.0, 0.0]]), frozen([[-1.0, 0.0]]), np.array([0, 4]), square, np.zeros((1, 2)), 9.0, 1.3
    )
    assert seen.tolist() == [False]


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.integers(0, 4))
def test_looked_through_agrees_with_shapely(seed: int, count: int) -> None:
    star_offsets, star_vertices, centers = _stars(seed, count)
    rng = np.random.default_rng(seed + 1)
    sizes = rng.integers(2, 4, 60)
    offsets = np.append(0, np.cumsum(sizes))
    vertices = np.repeat(rng.uniform(-6.0, 6.0, (60, 2)), sizes, axis=0) + rng.normal(0.0, 0.15, (offsets[-1], 2))
    rank, star_rank = rng.uniform(0.0, 1.0, 60), rng.uniform(0.0, 1.0, count)

    def sine_of_view(a: np.ndarray, b: np.ndarray, eye: np.ndarray) -> float:
        along, towards = b - a, eye - 0.5 * (a + b)
        return (along[0] * towards[1] - along[1] * towards[0]) / (np.hypot(*along) * np.hypot(*towards))

    expected = np.zeros(60, dtype=bool)
    for i in range(60):
        line = vertices[offsets[i] : offsets[i + 1]]
        for j in range(count):
            polygon = shapely.Polygon(star_vertices[star_offsets[j] : star_offsets[j + 1]])
            polyline = shapely.LineString(line)
            deep = polygon.contains(polyline) and polygon.exterior.distance(polyline) >= 0.1
            near = np.hypot(*(line[0] - centers[j])) <= 2.0
            aside = all(sine_of_view(a, b, centers[j]) < ALONG for a, b in itertools.pairwise(line))
            expected[i] |= deep and near and aside and star_rank[j] < rank[i]
    surfaces, stars = frozen(offsets, np.int64), frozen(star_offsets, np.int64)
    result = looked_through(surfaces, vertices, rank, stars, star_vertices, centers, star_rank, 0.1, 2.0)
    np.testing.assert_array_equal(result, expected)


@pytest.mark.parametrize(
    ("surface", "depth", "rank", "expected"),
    [
        (((1.0, 0.5), (1.0, -0.5)), 0.2, 1.0, True),
        (((1.0, -0.5), (1.0, 0.5)), 0.2, 1.0, False),
        (((1.0, -0.1), (2.0, -0.1)), 0.2, 1.0, True),
        (((1.0, 0.5), (1.0, -0.5)), 2.1, 1.0, False),
        (((2.5, -0.5), (3.5, 0.5)), 0.2, 1.0, False),
        (((1.0, 0.5), (1.0, -0.5)), 0.2, 0.0, False),
        (((-0.5, 2.0), (-0.5, -0.5), (2.0, -0.5)), 0.2, 1.0, False),
        (((-0.5, -0.5), (-0.5, 0.5), (0.5, 0.5), (0.5, -0.5), (-0.5, -0.5)), 0.2, 1.0, True),
    ],
    ids=[
        "from behind",
        "its front",
        "along it",
        "not so deep",
        "half outside",
        "mapped from here",
        "a corner",
        "a ring",
    ],
)
def test_a_surface_in_what_was_seen_free(surface: tuple, depth: float, rank: float, expected: bool) -> None:
    square = np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]])
    of = frozen([0, len(surface)], np.int64), np.array(surface), np.array([rank])
    seen = looked_through(*of, frozen([0, 4], np.int64), square, np.zeros((1, 2)), np.zeros(1), depth, 5.0)
    assert seen.tolist() == [expected]
