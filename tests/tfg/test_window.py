"""The part of a large map round a goal takes the goal up as the whole map does."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tfg_drake.messages import MapEstimate, replace
from tfg_drake.tfg import graph as whole
from tfg_drake.tfg import window
from tfg_drake.tfg.frontier import frontier_length_total
from tfg_drake.tfg.graph import Sightings, TfgGraph, no_sightings, resolve

# A corridor, rooms with thin walls and doors on one side of it, an unexplored end.
WALLS = [[0, 0, 70, 0], [70, 3, 0, 3], [0, 3, 0, 0], [0, 8, 70, 8], [0, 3, 0, 8], [70, 3, 70, 8]]
for x in range(0, 70, 10):
    WALLS += [[x, 3, x, 8], [x, 3, x + 4, 3], [x + 5, 3, x + 10, 3]]
WALLS.remove([70, 3, 0, 3])
TOUR = np.array([[x, y, 0.3] for x in np.arange(2.0, 66.0, 3.5) for y in (1.2,)] + [[44.5, 4.0, 1.0], [34.5, 2.0, 0.0]])


def large(estimate: MapEstimate) -> MapEstimate:
    """The same map, known jointly round the robot only."""
    local = np.hypot(*(estimate.p_ML - estimate.X_MD[:2]).T) < 12.0
    rows = np.append(np.repeat(local, 2), np.ones(3, dtype=bool))
    return replace(estimate, local=np.flatnonzero(local), covariance=estimate.covariance[np.ix_(rows, rows)])


def rows(*columns: np.ndarray) -> np.ndarray:
    """Rows of all columns, in an order of their own."""
    table = np.column_stack(columns)
    return table[np.lexsort(np.round(table, 6).T)]


def assert_same(a: TfgGraph, b: TfgGraph, world, estimate: MapEstimate) -> None:
    first, second = (resolve(graph, estimate, world.robot, world.explorer) for graph in (a, b))
    for name in ("facing", "star_offsets", "star_vertices", "star_centers"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    for names in (("segments", "segment_kind", "segment_ids"), ("viewpoints",)):
        np.testing.assert_allclose(
            *(rows(*(getattr(tfg, name) for name in names)) for tfg in (first, second)), atol=1e-9, err_msg=names[0]
        )
    # A face not seen well is told by samples, which begin where its pieces do: of those the order is free.
    assert len(first.frontiers) == len(second.frontiers)
    for points in ("frontiers", "given_up"):
        gap, at = cKDTree(getattr(first, points)).query(getattr(second, points))
        assert gap.max(initial=0.0) < 0.05
        normal = points.removesuffix("s") + "_normal"
        np.testing.assert_allclose(getattr(first, normal)[at], getattr(second, normal), atol=0.05)
    assert frontier_length_total(first) == pytest.approx(frontier_length_total(second), rel=1e-3)


@pytest.mark.parametrize("glance", [False, True])
def test_a_goal_changes_the_part_round_it_as_it_does_the_whole(simulate, glance) -> None:
    world = simulate(WALLS)
    parts = world.graph
    for k, X_WA in enumerate(TOUR):
        seen = no_sightings()
        if k == 4:
            seen = Sightings(np.array([10_000]), X_WA[None, :2] + [1.0, 0.5], X_WA[None, :2])
        before = world.graph
        world.observe(X_WA, seen, glance=glance)
        estimate = large(world.estimate)
        panorama = world.last_panorama
        arguments = estimate, panorama, seen, world.tags, world.robot, world.explorer
        world.graph = whole.update(before, *arguments, glance=glance)
        parts = window.update(parts, *arguments, glance=glance)
    assert len(world.graph.surfaces.kind) > 100
    assert_same(world.graph, parts, world, estimate)


def test_of_a_small_map_the_part_is_the_whole(two_rooms) -> None:
    before = two_rooms.graph
    two_rooms.observe(np.array([2.0, 3.0, 0.3]))
    again = window.update(
        before,
        two_rooms.estimate,
        two_rooms.last_panorama,
        no_sightings(),
        two_rooms.tags,
        two_rooms.robot,
        two_rooms.explorer,
    )
    for name in ("tag_ids", "star_vertices"):
        np.testing.assert_array_equal(getattr(again, name), getattr(two_rooms.graph, name))
    np.testing.assert_array_equal(again.surfaces.vertices, two_rooms.graph.surfaces.vertices)


def test_a_part_and_the_rest_are_the_graph(simulate) -> None:
    world = simulate(WALLS)
    for X_WA in TOUR[:8]:
        world.observe(X_WA)
    estimate, place = world.estimate, np.array([12.0, 1.0])
    goals = np.hypot(*(estimate.X_MA[:, :2] - place).T) < 6.0
    landmarks = np.hypot(*(estimate.p_ML - place).T) < 9.0
    near, far = window.split(world.graph, estimate, goals, landmarks, place, 6.0)
    assert 0 < len(near.surfaces.kind) < len(world.graph.surfaces.kind)
    assert 0 < len(near.tag_ids) < len(world.graph.tag_ids)
    together = window.joined(near, np.flatnonzero(goals), far, np.flatnonzero(~goals))
    assert_same(world.graph, together, world, estimate)


def test_the_map_near_a_place_keeps_its_rows_together(simulate) -> None:
    world = simulate(WALLS)
    for X_WA in TOUR[:10]:
        tfg = world.observe(X_WA)
    near, estimate = window.map_near(tfg, large(world.estimate), np.array([30.0, 1.0]), 8.0)
    assert 0 < len(estimate.ids) < len(world.estimate.ids)
    assert len(estimate.covariance) == 2 * len(estimate.local) + 3
    at = np.searchsorted(world.estimate.ids, estimate.ids)
    np.testing.assert_array_equal(near.facing, tfg.facing[at])
    np.testing.assert_array_equal(estimate.p_ML, world.estimate.p_ML[at])
    assert len(near.star_offsets) == len(near.star_centers) + 1
    assert near.star_offsets[-1] == len(near.star_vertices)
    assert (np.hypot(*(near.star_centers - [30.0, 1.0]).T) <= 8.0).all()
