import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.planning.test_planner import PARAMETERS
from tests.planning.test_roadmap import build, known, two_rooms
from tests.walls import no_walls, walls_between
from tfg_drake.config import ExplorerConfig
from tfg_drake.messages import WALLS_BELOW, replace
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.goal_choice import choose_near, empty_choice
from tfg_drake.planning.local import local, local_roadmap, planning_radius
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.planner import grow, initial_state, make_roadmap
from tfg_drake.planning.roadmap import extend, unchecked
from tfg_drake.slam import keyframe_graph
from tfg_drake.tfg.graph import empty_map
from tfg_drake.tfg.near import RADIUS, radius_of, within


def scattered(seed, spread=40.0):
    """A map and TFG strewn at random, of which every other landmark is known jointly."""
    rng = np.random.default_rng(seed)

    def places(n):
        return rng.uniform(-spread, spread, (n, 2))

    n, stars = 30, 12
    joint = np.arange(0, n, 2)
    root = rng.normal(size=(2 * len(joint) + 3, 2 * len(joint) + 3))
    X_MA = np.column_stack([places(stars), np.zeros(stars)])
    estimate = replace(
        keyframe_graph.empty_map(), stage=stars, ids=np.arange(n), p_ML=places(n), local=joint,
        **no_walls(n), covariance=root @ root.T, landmark_covariance=rng.normal(size=(n, 2, 2)), X_MA=X_MA,
    )  # fmt: skip
    offsets = np.append(0, np.cumsum(rng.integers(3, 7, stars)))
    starts = places(40)
    tfg = replace(
        empty_map(), stage=stars, segments=np.hstack([starts, starts + rng.normal(scale=5.0, size=(40, 2))]),
        segment_kind=np.arange(40), segment_ids=np.arange(80).reshape(40, 2), facing=places(n), frontiers=places(50),
        frontier_length=rng.random(50), frontier_normal=places(50), star_offsets=offsets,
        star_vertices=places(offsets[-1]), star_centers=X_MA[:, :2], given_up=places(20),
        given_up_length=rng.random(20), given_up_normal=places(20),
    )  # fmt: skip
    return estimate, tfg


@settings(deadline=None)
@given(st.integers(0, 10**6), st.floats(1.0, 60.0), st.floats(0.0, 20.0))
def test_what_is_near_is_what_lies_in_the_circle(seed, radius, sight):
    estimate, tfg = scattered(seed)
    part, part_tfg = local(estimate, tfg, radius, sight)
    here = shapely.Point(estimate.X_MA[-1, :2])

    def rows(points, within):
        return [k for k, p in enumerate(points) if here.distance(shapely.Point(p)) <= within]

    landmarks = rows(estimate.p_ML, radius + sight)
    assert part.ids.tolist() == landmarks
    np.testing.assert_array_equal(part_tfg.facing, tfg.facing[landmarks])
    np.testing.assert_array_equal(part.landmark_covariance, estimate.landmark_covariance[landmarks])
    # The same pairs have the same covariance.
    both = [i for i in estimate.local if i in landmarks]
    assert part.ids[part.local].tolist() == both
    at = np.searchsorted(estimate.local, both)
    columns = np.append((2 * at[:, None] + [0, 1]).ravel(), [-3, -2, -1]).astype(int)
    np.testing.assert_array_equal(part.covariance, estimate.covariance[np.ix_(columns, columns)])
    np.testing.assert_array_equal(part.X_MA, estimate.X_MA)
    segments = [
        k for k, s in enumerate(tfg.segments) if here.distance(shapely.LineString(s.reshape(2, 2))) <= radius + sight
    ]
    for name in ("segments", "segment_kind", "segment_ids"):
        np.testing.assert_array_equal(getattr(part_tfg, name), getattr(tfg, name)[segments])
    for points in (("frontiers", "frontier_length", "frontier_normal"), ("given_up", "given_up_length")):
        near = rows(getattr(tfg, points[0]), radius)
        for name in points:
            np.testing.assert_array_equal(getattr(part_tfg, name), getattr(tfg, name)[near])
    stars = rows(tfg.star_centers, radius + sight)
    np.testing.assert_array_equal(part_tfg.star_centers, tfg.star_centers[stars])
    whole, polygons = (np.split(of.star_vertices, of.star_offsets[1:-1]) for of in (tfg, part_tfg))
    assert len(polygons) == len(stars)
    for polygon, k in zip(polygons, stars, strict=True):
        np.testing.assert_array_equal(polygon, whole[k])


def test_where_all_is_near_it_is_what_was_given():
    estimate, tfg = scattered(1)
    for radius in (np.inf, 500.0):
        part, part_tfg = local(estimate, tfg, radius, 10.0)
        assert part is estimate
        assert part_tfg is tfg


def test_only_on_a_large_map_is_anything_far():
    estimate, _ = scattered(1)
    joint = replace(estimate, local=np.arange(30), covariance=np.eye(63))
    assert (radius_of(estimate), radius_of(joint)) == (RADIUS, np.inf)
    assert planning_radius(estimate, ExplorerConfig()) == RADIUS
    for options in ({"goal": "argmax"}, {"goal": "random"}, {"return_home": True}):
        assert planning_radius(estimate, ExplorerConfig(**options)) == np.inf


def edges_of(state):
    """Each edge by its nodes' ids, with what is known of it."""
    edges = state.edges
    columns = edges.travelled, edges.free, edges.clearance, edges.required
    pairs = map(tuple, np.sort(state.ids[edges.nodes], axis=1).tolist())
    return dict(zip(pairs, zip(*(column.tolist() for column in columns), strict=True), strict=True))


@pytest.mark.parametrize("radius", [1.0, 3.0, 6.0, 50.0])
def test_only_what_is_near_of_a_roadmap_changes(radius):
    state, estimate, tfg = build(two_rooms(), [(-4, 1, 0), (3, 0.5, 1)])
    near = within(state.points, estimate.X_MA[-1], radius)
    part = local_roadmap(state, estimate, radius)
    assert part.ids.tolist() == state.ids[near].tolist()
    whole = edges_of(state)
    assert edges_of(part) == {pair: row for pair, row in whole.items() if set(pair) <= set(part.ids.tolist())}
    # Where nothing is known any more, it becomes known again of what is near, and of nothing else.
    edges = unchecked(state.edges.nodes, state.edges.travelled)
    unknown = replace(state, sigma=np.full(len(near), 7.0), edges=edges)
    later = replace(estimate, stage=3, X_MA=np.vstack([estimate.X_MA, [2.1, -1.3, 0.0]]))
    after = extend(unknown, tfg, later, PARAMETERS, radius=radius)
    assert (np.diff(after.ids) > 0).all()
    old = len(near)
    assert len(after.ids) > old
    near = within(after.points, later.X_MA[-1], radius)
    ids, were = set(after.ids[near].tolist()), edges_of(unknown)
    for pair, row in edges_of(after).items():
        assert row[3] > 0.0 if set(pair) <= ids else row == were[pair]
    assert (after.sigma[:old][~near[:old]] == 7.0).all()
    assert (after.sigma[near] != 7.0).all()
    np.testing.assert_allclose(after.points[:old], state.points, atol=1e-12)
    pair = after.edges.nodes @ [len(after.ids), 1]
    assert (np.diff(pair) > 0).all()


VIEWS = [(-4.0, 1.0, 0.0), (-2.0, 0.0, 0.0), (3.0, 0.5, 1.0)]
FAR = np.array([300.0, 0.0])


def beside(estimate, tfg):
    """The same map with as much again far away that is not known jointly, as if mapped before; frontiers in both."""
    open_ = {
        "frontiers": np.array([[5.5, 1.0]]),
        "frontier_length": np.ones(1),
        "frontier_normal": np.array([[-1.0, 0]]),
    }
    here = replace(tfg, **open_)
    n, moved = len(estimate.ids), np.tile(FAR, 2)
    large = replace(
        estimate,
        ids=np.arange(2 * n),
        p_ML=np.vstack([estimate.p_ML, estimate.p_ML + FAR]),
        **no_walls(2 * n),
        landmark_covariance=np.concatenate([estimate.landmark_covariance] * 2),
    )
    twice = {
        "segments": np.vstack([tfg.segments, tfg.segments + moved]),
        "segment_kind": np.tile(tfg.segment_kind, 2),
        "segment_ids": np.tile(tfg.segment_ids, (2, 1)),
        "facing": np.tile(tfg.facing, (2, 1)),
        "frontiers": np.vstack([open_["frontiers"], open_["frontiers"] + FAR]),
        "frontier_length": np.ones(2),
        "frontier_normal": np.tile(open_["frontier_normal"], (2, 1)),
    }
    return (estimate, here), (large, replace(tfg, **twice))


def test_planning_finds_near_the_robot_what_it_would_find_if_that_were_all():
    alone = large = initial_state()
    for k in range(1, len(VIEWS) + 1):
        small, all_of_it = beside(*known(two_rooms(), VIEWS[:k]))
        alone, large = grow(alone, *small, PARAMETERS), grow(large, *all_of_it, PARAMETERS)
        if k == 1:
            # Nodes far away, from before.
            nodes = large.nodes
            large = replace(
                large,
                nodes=replace(
                    nodes,
                    ids=np.append(nodes.ids, nodes.next_id),
                    next_id=nodes.next_id + 1,
                    anchor=np.append(nodes.anchor, 0),
                    p_AN=np.vstack([nodes.p_AN, FAR]),
                    points=np.vstack([nodes.points, FAR]),
                    sigma=np.append(nodes.sigma, 0.5),
                ),
            )
    for name in ("points", "reachable", "travel_time", "frontier_offsets", "frontier_index", "edges"):
        np.testing.assert_array_equal(getattr(large.roadmap, name), getattr(alone.roadmap, name))
    assert len(large.nodes.ids) == len(alone.nodes.ids) + 1
    assert 0.5 in large.nodes.sigma
    goal_parameters = PlanningParameters()
    near, far = (
        choose_near(Situation(*maps, roadmap, goal_parameters, is_large=True), empty_choice(), RADIUS)
        for maps, roadmap in ((small, alone.roadmap), (local(*all_of_it, RADIUS, 10.0), large.roadmap))
    )
    np.testing.assert_array_equal(far.p_MG, near.p_MG)
    np.testing.assert_array_equal(far.gain, near.gain)
    # The whole leads to the same places, and knows of the rest.
    whole = make_roadmap(large.nodes, all_of_it[1], all_of_it[0], PARAMETERS, np.zeros((0, 4)), 0.0)
    rows = whole.nodes(large.roadmap.ids)
    np.testing.assert_allclose(whole.travel_time[rows], large.roadmap.travel_time)
    assert not whole.reachable[np.isin(np.arange(len(whole.points)), rows, invert=True)].any()


def test_a_wall_is_near_where_one_of_its_ends_is():
    estimate, tfg = scattered(1)
    walls = walls_between([[[50.0, 0.0], [5.0, 0.0]], [[50.0, 3.0], [50.0, 9.0]]])
    tags = [[1.0, 1.0], [60.0, 0.0]], np.zeros((2, 2)), np.zeros((2, 2))
    p_ML, anchor, reach = (np.vstack(both) for both in zip(walls, tags, strict=True))
    estimate = replace(
        estimate, ids=np.append(WALLS_BELOW - np.array([2, 1]), [0, 1]), p_ML=p_ML, anchor=anchor, reach=reach,
        local=np.arange(4), covariance=np.eye(11), landmark_covariance=np.zeros((4, 2, 2)), X_MA=np.zeros((1, 3)),
    )  # fmt: skip
    part, part_tfg = local(estimate, replace(tfg, facing=np.array([[0.0, 1], [1, 0]])), 10.0, 5.0)
    assert part.ids.tolist() == [WALLS_BELOW - 2, 0]
    assert part_tfg.facing.tolist() == [[0.0, 1]]
