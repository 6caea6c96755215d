"""Ray casting and line of sight against shapely."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tfg_drake.geometry.visibility import cast_rays, disc_distances, line_of_sight, surely_visible

SQUARE = np.array([[-1.0, -1, 1, -1], [1, -1, 1, 1], [1, 1, -1, 1], [-1, 1, -1, -1]])


def test_rays_in_a_square_are_exact():
    ranges = cast_rays(SQUARE, np.zeros(2), np.array([0.0, np.pi / 2, np.pi, -np.pi / 2]), 10.0)
    assert ranges == pytest.approx(np.ones(4), abs=1e-15)


def test_no_ray_slips_through_a_corner():
    # Every ray from every origin hits, also those aimed at the corners themselves.
    rng = np.random.default_rng(0)
    for origin in rng.uniform(-0.99, 0.99, (50, 2)):
        corners = np.arctan2(SQUARE[:, 1] - origin[1], SQUARE[:, 0] - origin[0])
        angles = np.concatenate([corners, rng.uniform(-np.pi, np.pi, 100)])
        assert np.isfinite(cast_rays(SQUARE, origin, angles, 10.0)).all()


def test_nothing_within_range_is_inf():
    assert np.isinf(cast_rays(SQUARE, np.zeros(2), np.array([0.0]), 0.5)).all()
    assert np.isinf(cast_rays(np.zeros((0, 4)), np.zeros(2), np.array([0.0, 1.0]), 10.0)).all()
    assert cast_rays(SQUARE, np.zeros(2), np.zeros(0), 10.0).shape == (0,)


def test_ray_along_a_segment_hits_its_near_end():
    wall = np.array([[3.0, 0.0, 2.0, 0.0]])
    assert cast_rays(wall, np.zeros(2), np.array([0.0, np.pi]), 10.0).tolist() == [2.0, np.inf]


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_rays_agree_with_shapely(seed):
    rng = np.random.default_rng(seed)
    segments = rng.uniform(-5, 5, (20, 4))
    origin, angles = rng.uniform(-5, 5, 2), rng.uniform(-np.pi, np.pi, 30)
    walls = shapely.MultiLineString(segments.reshape(-1, 2, 2).tolist())
    ranges = cast_rays(segments, origin, angles, 4.0)
    for angle, found in zip(angles, ranges, strict=True):
        end = origin + 4.0 * np.array([np.cos(angle), np.sin(angle)])
        hits = walls.intersection(shapely.LineString([origin, end]))
        expected = np.inf if hits.is_empty else shapely.Point(origin).distance(hits)
        assert found == pytest.approx(expected, abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_line_of_sight_agrees_with_shapely(seed):
    rng = np.random.default_rng(seed)
    segments = rng.uniform(-5, 5, (8, 4))
    p_from, p_to = rng.uniform(-5, 5, 2), rng.uniform(-5, 5, (30, 2))
    walls = shapely.MultiLineString(segments.reshape(-1, 2, 2).tolist())
    expected = [not walls.intersects(shapely.LineString([p_from, p])) for p in p_to]
    assert line_of_sight(segments, p_from, p_to, 0.0).tolist() == expected


def test_a_point_on_a_surface_is_seen_from_either_side_of_it():
    on_wall = np.array([[1.0, 0.3]])
    assert line_of_sight(SQUARE, np.zeros(2), on_wall).tolist() == [True]
    assert line_of_sight(SQUARE, np.array([2.0, 0.0]), on_wall).tolist() == [True]
    assert line_of_sight(SQUARE, np.zeros(2), on_wall, 0.0).tolist() == [False]


def test_what_is_seen_past_one_end_of_a_wall_by_too_little_does_not_count_but_through_a_slit_it_does():
    upper, lower = [3.0, 0.06, 3.0, 2.0], [3.0, -0.06, 3.0, -2.0]
    place, target = np.zeros(2), np.array([[3.3, 0.0], [2.9, 0.0]])
    for walls, graze, seen in (([upper], 0.1, False), ([upper, lower], 0.1, True), ([upper], 0.05, True)):
        assert surely_visible(np.array(walls), place, target, graze).tolist() == [seen, True]


def test_line_of_sight_without_points_or_walls():
    assert line_of_sight(SQUARE, np.zeros(2), np.zeros((0, 2))).shape == (0,)
    assert line_of_sight(np.zeros((0, 4)), np.zeros(2), np.ones((2, 2))).all()
    assert line_of_sight(SQUARE, np.zeros(2), np.zeros((1, 2))).tolist() == [True]


def test_rays_meet_a_disc_where_its_circle_is():
    rng = np.random.default_rng(5)
    discs = np.column_stack([rng.uniform(-5, 5, (6, 2)), rng.uniform(0.1, 0.5, 6)])
    angles = rng.uniform(-np.pi, np.pi, 500)
    origin = np.array([0.3, -0.2])
    distance = disc_distances(discs, origin, angles)
    for angle, found in zip(angles, distance, strict=True):
        ray = shapely.LineString([origin, origin + 20.0 * np.array([np.cos(angle), np.sin(angle)])])
        circles = [shapely.Point(x, y).buffer(r, quad_segs=2000) for x, y, r in discs]
        meets = [shapely.Point(origin).distance(ray.intersection(c)) for c in circles if ray.intersects(c)]
        assert found == pytest.approx(min(meets, default=np.inf), abs=1e-5)


def test_from_inside_a_disc_nothing_else_is_seen_and_behind_one_nothing():
    ahead, behind = np.array([[1.0, 0.0, 0.25]]), np.array([[-1.0, 0.0, 0.25]])
    assert disc_distances(ahead, np.zeros(2), np.zeros(1)).tolist() == [0.75]
    assert disc_distances(behind, np.zeros(2), np.zeros(1)).tolist() == [np.inf]
    assert disc_distances(ahead, np.array([1.1, 0.0]), np.array([0.0, 2.0])).tolist() == [0.0, 0.0]
    assert disc_distances(np.zeros((0, 3)), np.zeros(2), np.zeros(2)).tolist() == [np.inf, np.inf]
