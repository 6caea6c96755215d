"""On a large map a view changes what is near it as it would change the whole."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tfg_drake.geometry.se2 import inverse, transform
from tfg_drake.messages import MapEstimate, replace
from tfg_drake.table import concat, empty, take
from tfg_drake.tfg.feature_graph import TfgGraph, part_of, with_part
from tfg_drake.tfg.frontier import FREE, place_points, points_of
from tfg_drake.tfg.graph import resolve, update

# A corridor, rooms with thin walls and doors on one side of it, an unexplored end.
WALLS = [[0, 0, 70, 0], [70, 3, 0, 3], [0, 3, 0, 0], [0, 8, 70, 8], [0, 3, 0, 8], [70, 3, 70, 8]]
for x in range(0, 70, 10):
    WALLS += [[x, 3, x, 8], [x, 3, x + 4, 3], [x + 5, 3, x + 10, 3]]
WALLS.remove([70, 3, 0, 3])
TOUR = [[x, 1.2, 0.3] for x in np.arange(2.0, 66.0, 3.5)]
TOUR = np.array([*TOUR, [44.5, 4.0, 1.0], [34.5, 2.0, 0.0]])
FAR_END = np.array([64.0, 1.4, 0.0])


def large(estimate: MapEstimate) -> MapEstimate:
    """The same map, known jointly round the robot only."""
    local = np.hypot(*(estimate.p_ML - estimate.X_MD[:2]).T) < 12.0
    rows = np.append(np.repeat(local, 2), np.ones(3, dtype=bool))
    return replace(estimate, local=np.flatnonzero(local), covariance=estimate.covariance[np.ix_(rows, rows)])


def rows(*columns: np.ndarray) -> np.ndarray:
    """Rows of all columns, in an order of their own."""
    table = np.column_stack(columns)
    return table[np.lexsort(np.round(table, 6).T)]


def assert_same(a: TfgGraph, b: TfgGraph, world) -> None:
    first, second = (resolve(graph, world.estimate, world.robot, world.explorer) for graph in (a, b))
    for name in ("facing", "star_offsets", "star_vertices", "star_centers"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    pieces = (rows(tfg.segments, tfg.segment_kind, tfg.segment_ids) for tfg in (first, second))
    np.testing.assert_allclose(*pieces, atol=1e-9)
    # A face not seen well is told by samples, which begin where its pieces do: of those the order is free.
    assert len(first.frontiers) == len(second.frontiers)
    for points in ("frontiers", "given_up"):
        gap, at = cKDTree(getattr(first, points)).query(getattr(second, points))
        assert gap.max(initial=0.0) < 0.1
        normal = points.removesuffix("s") + "_normal"
        np.testing.assert_allclose(getattr(first, normal)[at], getattr(second, normal), atol=0.05)
    assert first.frontier_length.sum() == pytest.approx(second.frontier_length.sum(), rel=1e-3)


def toured(world, glance=False, small_until=0):
    """The tour of a world, whose graph takes every view up as the whole, and the graph that takes it up by what is
    near."""
    graph = empty(TfgGraph)
    for k, X_WA in enumerate(TOUR):
        graph = take_up(world, graph, X_WA, glance, is_large=k >= small_until)
    return graph


def take_up(world, graph, X_WA, glance=False, is_large=True):
    before = world.graph
    world.observe(X_WA, glance=glance)
    world.estimate = large(world.estimate) if is_large else world.estimate
    arguments = world.estimate, world.last_panorama, world.tags, world.robot, world.explorer
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tfg_drake.tfg.graph.part_of", lambda whole, estimate, _: part_of(whole, estimate, np.inf))
        world.graph = update(before, *arguments, glance=glance)
    return update(graph, *arguments, glance=glance)


def test_a_part_put_back_is_the_graph_again(simulate) -> None:
    world = simulate(WALLS)
    toured(world)
    part = part_of(world.graph, world.estimate, 15.0)
    assert 0 < len(part.graph.surfaces.kind) < len(world.graph.surfaces.kind)
    assert 0 < len(part.estimate.ids) < len(world.estimate.ids)
    # The newest view's star comes with what has changed.
    views = len(TOUR) - 1
    before = replace(
        world.graph,
        stage=views,
        star_offsets=world.graph.star_offsets[:-1],
        star_vertices=world.graph.star_vertices[: world.graph.star_offsets[-2]],
    )
    assert_same(with_part(before, part_of(before, world.estimate, 15.0), part.graph), world.graph, world)


@pytest.mark.parametrize("glance", [False, True])
def test_a_view_changes_what_is_near_it_as_it_does_the_whole(simulate, glance) -> None:
    world = simulate(WALLS)
    graph = toured(world, glance)
    assert len(world.graph.surfaces.kind) > 100
    assert_same(world.graph, graph, world)
    for name in ("tag_ids", "tag_view", "tag_facing", "tag_range"):
        np.testing.assert_array_equal(getattr(graph, name), getattr(world.graph, name))


def test_what_a_small_map_found_far_away_stays_where_it_lies(simulate) -> None:
    """Unseen faces are looked for everywhere as long as all is known jointly."""
    world = simulate(WALLS)
    graph = toured(world, small_until=18)
    assert_same(world.graph, graph, world)
    graph = take_up(world, graph, FAR_END)
    points = take(graph.frontiers, graph.frontiers.on_face)
    away = place_points(points, world.estimate.X_MA).p - world.estimate.X_MA[points.view, :2]
    assert np.hypot(*away.T).max(initial=0.0) < 11.0


def test_unseen_faces_stay_at_their_surface_when_the_heading_of_the_view_that_found_them_is_corrected(simulate) -> None:
    world = simulate(WALLS)
    toured(world)
    before = world.estimate.X_MA
    after = before.copy()
    after[-1, 2] += 0.006
    points = take(world.graph.frontiers, world.graph.frontiers.on_face)
    places = place_points(points, before).p
    _, nearest = cKDTree(before[:, :2]).query(places)
    elsewhere = nearest != len(TOUR) - 1
    near = np.hypot(*(places - before[-1, :2]).T) < 10.0
    assert (elsewhere & near).sum() > 5
    np.testing.assert_allclose(place_points(points, after).p[elsewhere], places[elsewhere], atol=1e-3)


def test_what_was_mapped_another_way_round_and_what_is_found_here_say_nothing_of_each_other(simulate) -> None:
    """A passage 1 m wide along a room, whose map has drifted by 1 m into the passage; before, a wall far away."""
    walls = [[-3.0, 0.2, 3.0, 0.2], [3.0, 0.2, 3.0, 3.0], [3.0, 3.0, -3.0, 3.0], [998.0, 2.0, 1002.0, 2.0]]
    walls += [[-8.0, 0.0, 8.0, 0.0], [-8.0, -1.0, 8.0, -1.0], [-1.0, -1.0, -1.0, -0.45]]
    in_room, in_passage = np.array([-2.0, 1.6, 0.0]), np.array([0.5, -0.5, 0.0])
    alone, world = simulate(walls, noise=0.0), simulate(walls, noise=0.0)
    passage, graph = (take_up(each, empty(TfgGraph), np.array([1000.0, 0.0, 0.0])) for each in (alone, world))
    passage = take_up(alone, passage, in_passage)
    graph = take_up(world, graph, in_room)
    drifted = in_room - np.array([0.0, 1.0, 0.0])
    # Much of what is open in the room lies now where it is in the passage, and in the middle of that.
    there = place_points(take(of := passage.frontiers, of.view == 1), np.array(alone.X_MA))
    p, normal = (np.vstack([each, [xy]]) for each, xy in ((there.p, [1.0, -0.5]), (there.normal, [0.0, -1.0])))
    added = points_of(1, transform(inverse(drifted), p), normal, np.full(len(p), 0.3))
    added = replace(added, kind=np.append(there.kind, FREE))
    room = graph = replace(graph, frontiers=concat(graph.frontiers, added))
    of_room = np.isin(np.arange(len(world.p_WT)), room.tag_ids) & (world.p_WT[:, 0] < 100.0)
    world.error = np.where(of_room, -1.0, 0.0)[:, None] * [[0.0, 1.0]]
    world.sigma = np.where(of_room, 2.0, 1e-3)
    world.X_MA[1] = drifted
    graph = take_up(world, graph, in_passage)
    # What the view finds in the passage is as if the room were not there ...
    mine, alone_there = graph.frontiers, passage.frontiers
    np.testing.assert_array_equal(mine.p[mine.view == 2], alone_there.p[alone_there.view == 1])
    # ... which loses nothing by that.
    mine, before = (take(of := each.frontiers, of.view == 1) for each in (graph, room))
    assert len(before.p) > 1
    np.testing.assert_array_equal(*(np.sort(each.p, axis=0) for each in (mine, before)))


def test_what_was_mapped_another_way_round_is_tried_where_nothing_else_is_in_view(simulate) -> None:
    """The end of a wall that its view only looked along has drifted into the middle of where the robot is."""
    box = [[-3.0, -3.0, 3.0, -3.0], [3.0, -3.0, 3.0, 3.0], [3.0, 3.0, -3.0, 3.0], [-3.0, 3.0, -3.0, -3.0]]
    elsewhere = [[998.0, 2.0, 1002.0, 2.0], [96.0, 2.0, 108.0, 2.0]]
    world = simulate([*elsewhere, *box], noise=0.0)
    graph = take_up(world, empty(TfgGraph), np.array([1000.0, 0.0, 0.0]))
    graph = take_up(world, graph, np.array([100.0, 0.0, 0.0]))
    of_wall = (world.p_WT[:, 0] > 50.0) & (world.p_WT[:, 0] < 200.0)
    world.error = np.where(of_wall, -106.0, 0.0)[:, None] * [[1.0, 0.0]]
    world.sigma = np.where(of_wall, 2.0, 1e-3)
    world.X_MA[1] = np.array([-6.0, 0.0, 0.0])
    graph = take_up(world, graph, np.zeros(3))
    tried = place_points(take(graph.frontiers, graph.frontiers.tries > 0), np.array(world.X_MA)).p
    assert (np.abs(tried - [1.0, 2.0]).max(axis=1) < 1.0).any()


def test_a_part_has_a_wall_of_which_one_end_is_near(simulate) -> None:
    world = simulate([[-30.0, 2.0, 3.0, 2.0]], landmarks=np.array([[3.0, 2.0, -30.0, 2.0], [-29.0, 2.0, -30.0, 2.0]]))
    world.observe(np.array([0.0, 0.0, 0.0]))
    part = part_of(empty(TfgGraph), world.estimate, 5.0)
    assert part.estimate.ids[part.estimate.ids < 0].tolist() == world.estimate.ids[:1].tolist()
