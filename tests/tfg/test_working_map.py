"""The part of a large map that is worked on takes a view up as the whole map does."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tfg_drake.geometry.se2 import inverse, transform
from tfg_drake.messages import MapEstimate, replace
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.tfg import graph as whole
from tfg_drake.tfg.frontier import join, place_points, points_of, select
from tfg_drake.tfg.graph import TfgGraph, UnmappedSightings, no_sightings, resolve
from tfg_drake.tfg.working_map import empty_graphs, of_landmarks, update, whole_graph, working_map

# A corridor, rooms with thin walls and doors on one side of it, an unexplored end.
WALLS = [[0, 0, 70, 0], [70, 3, 0, 3], [0, 3, 0, 0], [0, 8, 70, 8], [0, 3, 0, 8], [70, 3, 70, 8]]
for x in range(0, 70, 10):
    WALLS += [[x, 3, x, 8], [x, 3, x + 4, 3], [x + 5, 3, x + 10, 3]]
WALLS.remove([70, 3, 0, 3])
TOUR = [[x, 1.2, 0.3] for x in np.arange(2.0, 66.0, 3.5)]
TOUR = np.array([*TOUR, [44.5, 4.0, 1.0], [34.5, 2.0, 0.0]])
FAR_END = np.array([64.0, 1.4, 0.0])


@pytest.fixture(autouse=True)
def little_is_worked_on(monkeypatch) -> None:
    """As much as one view sees, or the corridor would have to be longer."""
    monkeypatch.setattr("tfg_drake.tfg.working_map.COMPLETE", 1.0)


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
        assert gap.max(initial=0.0) < 0.1
        normal = points.removesuffix("s") + "_normal"
        np.testing.assert_allclose(getattr(first, normal)[at], getattr(second, normal), atol=0.05)
    assert first.frontier_length.sum() == pytest.approx(second.frontier_length.sum(), rel=1e-3)


def toured(world, glance=False, sightings_at=-1, small_until=0):
    """The tour, taken up by the whole graph of the world and by parts, which are given."""
    graphs = empty_graphs()
    for k, X_WA in enumerate(TOUR):
        seen = no_sightings()
        if k == sightings_at:
            seen = UnmappedSightings(np.array([10_000]), X_WA[None, :2] + [1.0, 0.5], X_WA[None, :2])
        graphs = take_up(world, graphs, X_WA, seen, glance, is_large=k >= small_until)
    return graphs


def take_up(world, graphs, X_WA, seen, glance, is_large=True):
    before = world.graph
    world.observe(X_WA, seen, glance=glance)
    world.estimate = large(world.estimate) if is_large else world.estimate
    arguments = world.estimate, world.last_panorama, seen, world.tags, world.robot, world.explorer
    world.graph = whole.update(before, *arguments, glance=glance)
    return update(graphs, *arguments, glance=glance)


@pytest.mark.parametrize("glance", [False, True])
def test_a_view_changes_the_part_round_it_as_it_does_the_whole(simulate, glance) -> None:
    world = simulate(WALLS)
    graphs = toured(world, glance, sightings_at=4)
    assert len(world.graph.surfaces.kind) > 100
    assert_same(world.graph, whole_graph(graphs), world, world.estimate)


def test_what_a_small_map_found_far_away_rests_where_it_lies(simulate) -> None:
    """Unseen faces are looked for everywhere as long as all is known jointly."""
    world = simulate(WALLS)
    graphs = toured(world, small_until=18)
    assert_same(world.graph, whole_graph(graphs), world, world.estimate)
    graphs = take_up(world, graphs, FAR_END, no_sightings(), False)
    assert graphs.inactive
    for part in (graphs.active, *graphs.inactive.values()):
        for points in (part.unseen_backs, part.open_ends):
            away = place_points(points, world.estimate.X_MA).p - world.estimate.X_MA[points.view, :2]
            assert np.hypot(*away.T).max(initial=0.0) < 11.0


def test_unseen_faces_stay_at_their_surface_when_the_heading_of_the_view_that_found_them_is_corrected(simulate) -> None:
    world = simulate(WALLS)
    toured(world)
    before = world.estimate.X_MA
    after = before.copy()
    after[-1, 2] += 0.006
    points = join(world.graph.unseen_backs, world.graph.open_ends)
    places = place_points(points, before).p
    _, nearest = cKDTree(before[:, :2]).query(places)
    elsewhere = nearest != len(TOUR) - 1
    near = np.hypot(*(places - before[-1, :2]).T) < 10.0
    assert (elsewhere & near).sum() > 5
    np.testing.assert_allclose(place_points(points, after).p[elsewhere], places[elsewhere], atol=1e-3)


def test_what_is_worked_on_is_the_map_as_far_as_a_stage_needs_it(simulate) -> None:
    world = simulate(WALLS)
    graphs = take_up(world, toured(world), FAR_END, no_sightings(), False)
    estimate = world.estimate
    part = working_map(graphs, estimate, world.last_panorama, world.robot, world.explorer)
    assert not part.is_all
    assert part.stage == len(TOUR) + 1
    np.testing.assert_array_equal(part.views, graphs.views)
    assert len(part.tfg.star_centers) == len(graphs.views)
    all_of_it = resolve(world.graph, estimate, world.robot, world.explorer)
    near = np.hypot(*(all_of_it.frontiers - FAR_END[:2]).T) < part.reach
    gap, _ = cKDTree(part.tfg.frontiers).query(all_of_it.frontiers[near])
    assert near.sum() > 3
    assert gap.max() < 0.05
    # Beyond that walls may be missing, and what lies behind them would seem to be in sight.
    assert np.hypot(*(part.tfg.frontiers - FAR_END[:2]).T).max() <= part.reach
    assert len(part.tfg.frontiers) == len(part.tfg.frontier_length) == len(part.tfg.frontier_normal)
    seen = np.hypot(*(all_of_it.segments[:, :2] - FAR_END[:2]).T) < part.reach
    distance, _ = cKDTree(part.tfg.segments[:, :2]).query(all_of_it.segments[seen, :2])
    assert seen.sum() > 30
    assert distance.max() < 0.1
    # Row for row with its own landmarks, which are what near views saw and what is within reach.
    at = np.searchsorted(estimate.ids, part.estimate.ids)
    assert 0 < len(at) < len(estimate.ids)
    np.testing.assert_array_equal(part.estimate.p_ML, estimate.p_ML[at])
    faced = np.isin(part.estimate.ids, graphs.active.tag_ids)
    np.testing.assert_allclose(part.tfg.facing[faced], all_of_it.facing[at[faced]], atol=1e-12)
    assert np.isin(np.flatnonzero(np.hypot(*(estimate.p_ML - FAR_END[:2]).T) < 10.0), at).all()
    assert len(part.estimate.covariance) == 2 * len(part.estimate.local) + 3


def test_a_small_map_is_worked_on_as_a_whole(two_rooms) -> None:
    graphs = empty_graphs()
    for X_WA in ([2.0, 3.0, 0.3], [2.5, 3.0, 0.3]):
        two_rooms.observe(np.array(X_WA))
        graphs = update(
            graphs,
            two_rooms.estimate,
            two_rooms.last_panorama,
            no_sightings(),
            two_rooms.tags,
            two_rooms.robot,
            two_rooms.explorer,
        )
    assert whole_graph(graphs).stage == graphs.active.stage == len(graphs.views)
    part = working_map(graphs, two_rooms.estimate, two_rooms.last_panorama, two_rooms.robot, two_rooms.explorer)
    assert part.is_all
    assert part.estimate is two_rooms.estimate


@pytest.mark.parametrize("settings", [{"goal": "argmax"}, {"goal": "random"}, {"return_home": True}])
def test_nothing_rests_where_all_of_the_map_is_asked_at_every_stage(simulate, settings) -> None:
    world = simulate(WALLS)
    explorer = dataclasses.replace(world.explorer, **settings)
    graphs = empty_graphs()
    for X_WA in TOUR[:16]:
        world.observe(X_WA, glance=True)
        arguments = large(world.estimate), world.last_panorama, no_sightings(), world.tags, world.robot
        graphs = update(graphs, *arguments, explorer, glance=True)
    assert not graphs.inactive


def test_what_was_mapped_another_way_round_says_nothing_until_it_is_known_where_it_is(simulate, monkeypatch) -> None:
    """A passage 1 m wide along a room, whose map has drifted by 1 m into the passage; before, a wall far away."""
    monkeypatch.setattr("tfg_drake.tfg.submaps.LEAST_VIEWS", 1)
    walls = [[-3.0, 0.2, 3.0, 0.2], [3.0, 0.2, 3.0, 3.0], [3.0, 3.0, -3.0, 3.0], [998.0, 2.0, 1002.0, 2.0]]
    walls += [[-8.0, 0.0, 8.0, 0.0], [-8.0, -1.0, 8.0, -1.0], [-1.0, -1.0, -1.0, -0.45]]
    in_room, in_passage = np.array([-2.0, 1.6, 0.0]), np.array([0.5, -0.5, 0.0])
    alone, world = simulate(walls, noise=0.0), simulate(walls, noise=0.0)
    passage, graphs = (
        take_up(each, empty_graphs(), np.array([1000.0, 0.0, 0.0]), no_sightings(), False) for each in (alone, world)
    )
    passage = take_up(alone, passage, in_passage, no_sightings(), False)
    graphs = take_up(world, graphs, in_room, no_sightings(), False)
    drifted = in_room - np.array([0.0, 1.0, 0.0])
    # Much of what is open in the room lies now where it is in the passage, and in the middle of that.
    open_there = {}
    for name in ("free_space_frontiers", "uninspected"):
        there = place_points(select(of := getattr(passage.active, name), of.view == 1), np.array(alone.X_MA))
        p, normal = (np.vstack([each, [xy]]) for each, xy in ((there.p, [1.0, -0.5]), (there.normal, [0.0, -1.0])))
        points = points_of(1, transform(inverse(drifted), p), normal, np.full(len(p), 0.3))
        open_there[name] = join(getattr(graphs.active, name), points)
    room = replace(graphs.active, **open_there)
    graphs = replace(graphs, active=room)
    of_room = np.isin(np.arange(len(world.p_WT)), room.tag_ids) & (world.p_WT[:, 0] < 100.0)
    world.error = np.where(of_room, -1.0, 0.0)[:, None] * [[0.0, 1.0]]
    world.sigma = np.where(of_room, 2.0, 1e-3)
    world.X_MA[1] = drifted
    graphs = take_up(world, graphs, in_passage, no_sightings(), False)
    # The passage is as if the room were not there ...
    part, expected = (
        working_map(of, each.estimate, each.last_panorama, each.robot, each.explorer)
        for of, each in ((graphs, world), (passage, alone))
    )
    np.testing.assert_array_equal(part.tfg.segments, expected.tfg.segments)
    assert part.tfg.facing.any(axis=1).tolist() == (~of_room[part.estimate.ids]).tolist()
    for name in ("free_space_frontiers", "uninspected"):
        mine, alone_there = getattr(graphs.active, name), getattr(passage.active, name)
        np.testing.assert_array_equal(mine.p[mine.view == 2], alone_there.p[alone_there.view == 1])
    # ... which loses nothing by that,
    for name in ("free_space_frontiers", "uninspected"):
        mine, before = (select(of := getattr(graph, name), of.view == 1) for graph in (graphs.active, room))
        assert len(before.p) > 1
        np.testing.assert_array_equal(mine.p, before.p)
    all_of_it = resolve(whole_graph(graphs), world.estimate, world.robot, world.explorer)
    assert all_of_it.facing.any(axis=1).all()
    # and it is there again when the loop has closed.
    world.error, world.sigma, world.X_MA[1] = None, None, in_room
    graphs = take_up(world, graphs, np.array([0.6, -0.5, 0.0]), no_sightings(), True)
    part = working_map(graphs, world.estimate, world.last_panorama, world.robot, world.explorer)
    assert part.tfg.facing.any(axis=1).all()
    assert (part.tfg.segments[:, 1] > 0.1).any()


def test_what_was_mapped_another_way_round_is_tried_where_nothing_else_is_in_view(simulate, monkeypatch) -> None:
    """The end of a wall that its view only looked along has drifted into the middle of where the robot is."""
    monkeypatch.setattr("tfg_drake.tfg.submaps.LEAST_VIEWS", 1)
    box = [[-3.0, -3.0, 3.0, -3.0], [3.0, -3.0, 3.0, 3.0], [3.0, 3.0, -3.0, 3.0], [-3.0, 3.0, -3.0, -3.0]]
    elsewhere = [[998.0, 2.0, 1002.0, 2.0], [96.0, 2.0, 108.0, 2.0]]
    world = simulate([*elsewhere, *box], noise=0.0)
    graphs = take_up(world, empty_graphs(), np.array([1000.0, 0.0, 0.0]), no_sightings(), False)
    graphs = take_up(world, graphs, np.array([100.0, 0.0, 0.0]), no_sightings(), False)
    of_wall = (world.p_WT[:, 0] > 50.0) & (world.p_WT[:, 0] < 200.0)
    world.error = np.where(of_wall, -106.0, 0.0)[:, None] * [[1.0, 0.0]]
    world.sigma = np.where(of_wall, 2.0, 1e-3)
    world.X_MA[1] = np.array([-6.0, 0.0, 0.0])
    graphs = take_up(world, graphs, np.zeros(3), no_sightings(), False)
    tried = place_points(graphs.active.tried, np.array(world.X_MA)).p
    assert (np.abs(tried - [1.0, 2.0]).max(axis=1) < 1.0).any()


def test_fewer_landmarks_keep_what_ties_them_to_the_shared_parameters() -> None:
    joint = np.arange(2.0 * 4 + 3 + 8)[:, None] + 100.0 * np.arange(2.0 * 4 + 3 + 8)
    estimate = replace(
        empty_map(),
        ids=np.arange(5),
        p_ML=np.zeros((5, 2)),
        local=np.array([0, 1, 3, 4]),
        covariance=joint[:11, :11],
        with_shared=joint[:, 11:],
        landmark_covariance=np.zeros((5, 2, 2)),
    )
    few = of_landmarks(estimate, np.array([True, False, True, True, False]))
    rows = np.array([0, 1, 4, 5, *range(8, 19)])
    assert few.local.tolist() == [0, 2]
    np.testing.assert_array_equal(few.with_shared, joint[np.ix_(rows, np.arange(11, 19))])
    assert few.joint_covariance.shape == (15, 15)
