import itertools

import numpy as np
import pytest
import shapely

from tests.arrays import frozen
from tests.walls import no_walls
from tfg_drake.config import TagSensorConfig
from tfg_drake.geometry.segment_grid import segment_grid
from tfg_drake.geometry.visibility import surely_visible
from tfg_drake.messages import WALLS_BELOW, replace
from tfg_drake.planning.expected_view import Visibility, expected_frontiers, targets, visible_targets
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


def test_a_view_counts_the_targets_whose_landmarks_are_known_jointly():
    estimate = replace(empty_map(), ids=np.arange(10, 16), **no_walls(6), local=np.array([1, 3, 4]))
    of = targets(replace(estimate, p_ML=np.zeros((6, 2))), replace(empty_tfg(), facing=np.zeros((6, 2))))
    visible = of.known_jointly(Visibility(np.array([0, 3, 4, 4, 6]), np.array([0, 1, 4, 5, 3, 4])))
    assert visible.offsets.tolist() == [0, 2, 2, 2, 4]
    assert visible.index.tolist() == [1, 4, 3, 4]


@pytest.mark.parametrize("seed", range(5))
def test_the_targets_of_a_wall_are_on_it_and_move_with_it(seed):
    rng = np.random.default_rng(seed)
    wall, anchor = rng.uniform([-3.0, -2.0], [3.0, 2.0]), rng.uniform(-5.0, 5.0, 2)
    reach, tag = np.sort(rng.uniform(-4.0, 4.0, 2)), rng.uniform(-5.0, 5.0, 2)
    tfg = replace(empty_tfg(), facing=np.array([[0.0, 1.0]]))

    def of(*by):
        p_ML, a = np.array([wall + by, tag]), np.array([anchor, [0.0, 0.0]])
        ids, reaches = np.array([WALLS_BELOW - 1, 3]), np.array([reach, [0.0, 0.0]])
        return targets(replace(empty_map(), ids=ids, p_ML=p_ML, anchor=a, reach=reaches, local=np.array([1])), tfg)

    at, normal = of(0.0, 0.0), np.array([np.cos(wall[0]), np.sin(wall[0])])
    np.testing.assert_allclose((at.p_MT[:2] - anchor) @ normal, wall[1])
    inwards = min(0.2, 0.25 * (reach[1] - reach[0]))
    np.testing.assert_allclose((at.p_MT[:2] - anchor) @ [-normal[1], normal[0]], reach + np.array([inwards, -inwards]))
    by_turn = (of(1e-6, 0.0).p_MT - of(-1e-6, 0.0).p_MT)[:2] / 2e-6
    by_shift = (of(0.0, 1e-6).p_MT - of(0.0, -1e-6).p_MT)[:2] / 2e-6
    # Along the wall its points are held.
    np.testing.assert_allclose(at.by_landmark[:2, :, 0], (by_turn @ normal)[:, None] * normal, atol=1e-8)
    np.testing.assert_allclose(at.by_landmark[:2, :, 1], by_shift, atol=1e-8)
    np.testing.assert_array_equal(at.by_landmark[2], np.eye(2))
    np.testing.assert_allclose(at.facing, [-normal, -normal, [0.0, 1.0]])
    assert (at.entry.tolist(), at.of_walls) == ([-1, -1, 0], 2)


@pytest.mark.parametrize("least_range", [0.0, 0.5, 1.5])
def test_frontier_in_the_blind_zone_of_the_scanner_is_not_seen(least_range):
    points = np.array([[0.0, 0.0], [3.0, 0.0]])
    frontiers = np.array([[0.4, 0.0], [1.0, 0.0], [2.0, 0.0]])
    tfg = replace(empty_tfg(), frontiers=frontiers, frontier_normal=np.tile([-1.0, 0.0], (3, 1)))
    visible = expected_frontiers(points, tfg, TagSensorConfig(), least_range)
    seen = [0, 1, 2]
    assert visible.of(np.array([0])).index.tolist() == [k for k in seen if frontiers[k, 0] >= least_range]
    assert visible.offsets[-1] == len(visible.index)
