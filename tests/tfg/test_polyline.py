"""Packed polylines against shapely."""

import numpy as np
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tfg_drake.tfg.polyline import (
    arc_length,
    covered,
    joined,
    nearest,
    pack,
    sample,
    segments_of,
    sub_polyline,
    uncovered_runs,
)


def _polylines(seed: int, count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.uniform(-3.0, 3.0, (rng.integers(2, 6), 2)) for _ in range(count)]


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.integers(1, 5))
def test_nearest_agrees_with_shapely(seed: int, count: int) -> None:
    polylines = _polylines(seed, count)
    points = np.random.default_rng(seed + 1).uniform(-4.0, 4.0, (20, 2))
    owner, along, distance, normal = nearest(points, *pack(polylines))
    lines = [shapely.LineString(p) for p in polylines]
    for i, point in enumerate(points):
        expected = shapely.distance(lines, shapely.Point(point))
        np.testing.assert_allclose(distance[i], expected.min(), atol=1e-9)
        np.testing.assert_allclose(
            lines[owner[i]].interpolate(along[i]).distance(shapely.Point(point)), distance[i], atol=1e-9
        )
    np.testing.assert_allclose(np.hypot(*normal.T), 1.0)


def test_nearest_without_polylines() -> None:
    owner, _, distance, _ = nearest(np.zeros((2, 2)), *pack([]))
    assert owner.tolist() == [-1, -1]
    assert np.isinf(distance).all()


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000), st.floats(0.05, 2.0))
def test_samples_cut_a_polyline_into_its_length(seed: int, spacing: float) -> None:
    polylines = _polylines(seed, 3)
    points, normals, owner, start, stop = sample(*pack(polylines), spacing)
    for i, polyline in enumerate(polylines):
        own = owner == i
        np.testing.assert_allclose((stop - start)[own].sum(), arc_length(polyline)[-1])
        assert (stop - start)[own].max() <= spacing + 1e-9
        assert shapely.distance(shapely.LineString(polyline), shapely.points(points[own])).max() < 1e-9
    np.testing.assert_allclose(np.hypot(*normals.T), 1.0)


def test_left_is_the_side_of_the_normal() -> None:
    _, normals, _, _, _ = sample(*pack([np.array([[0.0, 0.0], [1.0, 0.0]])]), 0.5)
    np.testing.assert_allclose(normals, [[0.0, 1.0], [0.0, 1.0]], atol=1e-12)


def test_cut_keeps_the_corners_between() -> None:
    polyline = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    np.testing.assert_allclose(sub_polyline(polyline, 0.5, 1.5), [[0.5, 0.0], [1.0, 0.0], [1.0, 0.5]])
    np.testing.assert_allclose(sub_polyline(polyline, 0.0, 2.0), polyline)


def test_segments_do_not_join_polylines() -> None:
    segments, owner = segments_of(
        *pack([np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), np.array([[5.0, 5.0], [6.0, 6.0]])])
    )
    np.testing.assert_array_equal(segments, [[0, 0, 1, 0], [1, 0, 1, 1], [5, 5, 6, 6]])
    assert owner.tolist() == [0, 0, 1]


def test_the_far_face_of_a_thin_wall_is_not_covered() -> None:
    wall = np.array([[0.0, 0.0, 2.0, 0.0]])
    points = np.array([[1.0, 0.05], [1.0, 0.05], [1.0, 0.2], [2.1, 0.0]])
    normals = np.array([[0.0, 1.0], [0.0, -1.0], [0.0, 1.0], [0.0, 1.0]])
    assert covered(points, normals, wall, np.full(4, 0.1)).tolist() == [True, False, False, False]


def test_uncovered_runs() -> None:
    start, owner = np.tile(np.arange(5) * 0.1, 2), np.repeat([0, 1], 5)
    flags = np.array([False, True, True, False, False, False, True, True, True, True])

    def runs(flags: np.ndarray, least: float) -> list[tuple[int, float, float]]:
        return list(zip(*(of.tolist() for of in uncovered_runs(owner, flags, start, start + 0.1, least)), strict=True))

    assert runs(flags, 0.0) == [(0, 0.0, 0.1), (0, 0.30000000000000004, 0.5), (1, 0.0, 0.1)]
    assert runs(flags, 0.15) == [(0, 0.30000000000000004, 0.5)]
    assert runs(np.ones(10, dtype=bool), 0.0) == []


def test_a_polyline_does_not_join_itself() -> None:
    segments, owner = segments_of(*pack([np.array([[0.0, 0.0], [1.0, 0.0]]), np.array([[1.05, 0.0], [2.0, 0.0]])]))
    ends = np.array([[0.0, 0.0], [1.0, 0.0], [1.05, 0.0], [2.0, 0.0]])
    outwards, is_last = np.array([[-1.0, 0.0], [1.0, 0.0]] * 2), np.array([False, True] * 2)
    assert joined(ends, outwards, is_last, np.array([0, 0, 1, 1]), segments, owner, 0.1).tolist() == [
        False, True, True, False,
    ]  # fmt: skip


def test_a_polyline_is_joined_by_what_goes_on_not_by_the_same_face_once_more() -> None:
    end, outwards = np.array([[1.0, 0.0]]), np.array([[1.0, 0.0]])
    for other, is_joined in (
        ([0.3, 0.01, 0.98, 0.01], False),  # the same once more
        ([0.3, 0.01, 1.2, 0.01], True),  # it goes on
        ([1.05, 0.0, 1.05, -1.0], True),  # round the corner
        ([0.98, -0.1, 0.3, -0.1], True),  # the other face
    ):
        segments = np.array([[0.0, 0.0, 1.0, 0.0], other])
        found = joined(end, outwards, np.array([True]), np.array([0]), segments, np.array([0, 1]), 0.15)
        assert found.tolist() == [is_joined]
        # The same polyline, run the other way, as it is seen from the other side.
        flipped = segments[:, [2, 3, 0, 1]].copy(order="C")
        found = joined(end, outwards, np.array([False]), np.array([0]), flipped, np.array([0, 1]), 0.15)
        assert found.tolist() == [is_joined]
