import itertools

import numpy as np
import pytest
import shapely

from tests.arrays import frozen
from tfg_drake.config import TagSensorConfig
from tfg_drake.geometry.segment_grid import segment_grid
from tfg_drake.geometry.visibility import surely_visible
from tfg_drake.messages import replace
from tfg_drake.planning.expected_view import Visibility, expected_frontiers, local_visibility, visible_targets
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.tfg.graph import empty_map as empty_tfg

STEEPEST = np.radians(75)


def view(points, targets, normals, segments, range_max=10.0, incidence=STEEPEST, tolerance=0.1, graze=0.0):
    arguments = np.atleast_2d(np.asarray(points, dtype=float)), frozen(targets), frozen(normals)
    walls = frozen(np.asarray(segments, dtype=float).reshape(-1, 4))
    within = range_max, incidence, tolerance, graze, 0.0
    offsets, index = visible_targets(*arguments, walls, segment_grid(walls), *within)
    return [index[a:b].tolist() for a, b in itertools.pairwise(offsets)]


@pytest.mark.parametrize("graze", [0.0, 0.2])
def test_agrees_with_shapely(graze):
    rng = np.random.default_rng(1)
    points, targets = rng.uniform(-6, 6, (30, 2)), rng.uniform(-6, 6, (60, 2))
    angle = rng.uniform(-np.pi, np.pi, 60)
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    start = rng.uniform(-6, 6, (25, 2))
    segments = np.hstack([start, start + rng.normal(0, 1.0, (25, 2))])
    walls = shapely.multilinestrings(shapely.linestrings(segments.reshape(-1, 2, 2)))
    expected = []
    for p in points:
        d = p - targets
        r = np.hypot(*d.T)
        end = targets + 0.1 * d / r[:, None]
        aside = graze * np.stack([-d[:, 1], d[:, 0]], axis=1) / r[:, None]
        clear, left, right = (
            ~shapely.intersects(shapely.linestrings(np.stack([np.broadcast_to(p, end.shape), end + by], axis=1)), walls)
            for by in (0.0, aside, -aside)
        )
        seen = (r < 5) & ((d * normals).sum(1) >= np.cos(np.radians(75)) * r) & clear & (left == right)
        expected.append(np.flatnonzero(seen).tolist())
    assert sum(map(len, expected)) > 50
    assert view(points, targets, normals, segments, range_max=5.0, graze=graze) == expected


def test_the_planner_expects_the_looks_that_the_map_counts_as_attempts():
    rng = np.random.default_rng(2)
    start, grazed = rng.uniform(-6, 6, (15, 2)), 0
    segments = np.hstack([start, start + rng.normal(0, 2.0, (15, 2))])
    for place in rng.uniform(-6, 6, (40, 2)):
        targets = rng.uniform(-6, 6, (60, 2))
        d = place - targets
        looks = surely_visible(segments, frozen(place), targets, 0.1)
        normals = d / np.hypot(*d.T)[:, None]
        assert view([place], targets, normals, segments, range_max=20.0, tolerance=0.0, graze=0.1) == [
            np.flatnonzero(looks).tolist()
        ]
        grazed += len(view([place], targets, normals, segments, range_max=20.0, tolerance=0.0)[0]) - looks.sum()
    assert grazed > 20


def test_what_is_seen_past_one_end_of_a_wall_by_too_little_does_not_count_but_through_a_slit_it_does():
    upper, lower = [[3.0, 0.06, 3.0, 2.0]], [[3.0, -0.06, 3.0, -2.0]]
    for walls, graze, seen in ((upper, 0.0, [0]), (upper, 0.1, []), (upper + lower, 0.1, [0]), (upper, 0.05, [0])):
        assert view([[0, 0]], [[3.3, 0]], [[-1, 0]], walls, graze=graze) == [seen]


def test_the_far_face_of_a_thin_wall_is_not_seen():
    wall = [[-3, 0, 3, 0], [-3, -0.02, 3, -0.02]]
    both = [[0, 0], [0, -0.02]], [[0, 1], [0, -1]]
    assert view([[0.5, 2], [0.5, -2]], *both, wall) == [[0], [1]]


def test_incidence_and_range_bound_the_view():
    tag = [[0, 0]], [[0, 1]]
    angles = np.radians([0, 74, 76, 120])
    assert view(3 * np.stack([np.sin(angles), np.cos(angles)], axis=1), *tag, []) == [[0], [0], [], []]
    assert view([[0, 9.9], [0, 10.1]], *tag, []) == [[0], []]


def test_nothing_to_see_and_nowhere_to_see_it_from():
    assert view([[0, 0]], np.zeros((0, 2)), np.zeros((0, 2)), []) == [[]]
    assert view(np.zeros((0, 2)), [[1, 0]], [[-1, 0]], []) == []


def test_the_view_from_some_of_the_points():
    view_of_four = Visibility(np.array([0, 2, 2, 5, 6]), np.array([3, 4, 0, 1, 2, 7]))
    some = view_of_four.of(np.array([0, 1, 3]))
    assert (some.offsets.tolist(), some.index.tolist()) == ([0, 2, 2, 3], [3, 4, 7])
    none = view_of_four.of(np.zeros(0, dtype=np.int64))
    assert (none.offsets.tolist(), none.index.tolist()) == ([0], [])


def test_a_view_counts_the_landmarks_known_jointly_by_their_place_among_them():
    estimate = replace(empty_map(), ids=np.arange(10, 16), local=np.array([1, 3, 4]))
    visible = local_visibility(Visibility(np.array([0, 3, 4, 4, 6]), np.array([0, 1, 4, 5, 3, 4])), estimate)
    assert visible.offsets.tolist() == [0, 2, 2, 2, 4]
    assert visible.index.tolist() == [0, 2, 1, 2]


@pytest.mark.parametrize("least_range", [0.0, 0.5, 1.5])
def test_frontier_in_the_blind_zone_of_the_scanner_is_not_seen(least_range):
    points = np.array([[0.0, 0.0], [3.0, 0.0]])
    frontiers = np.array([[0.4, 0.0], [1.0, 0.0], [2.0, 0.0]])
    tfg = replace(empty_tfg(), frontiers=frontiers, frontier_normal=np.tile([-1.0, 0.0], (3, 1)))
    visible = expected_frontiers(points, tfg, TagSensorConfig(), least_range)
    seen = [0, 1, 2]
    assert visible.of(np.array([0])).index.tolist() == [k for k in seen if frontiers[k, 0] >= least_range]
    assert visible.offsets[-1] == len(visible.index)
