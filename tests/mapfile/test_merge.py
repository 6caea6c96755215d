"""Two maps as one: exact without noise, as one solution with it, in whatever frames they are."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

import tfg_drake
from tests.slam.rings import NOTHING, reckoned, ring
from tests.slam.test_place_search import ROOM
from tests.walls import known_at_their_ends, walls_between
from tfg_drake.bad_input import BadInput
from tfg_drake.comparison.metrics import landmark_nees, landmark_rmse_aligned
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.geometry import se2
from tfg_drake.mapfile.merge import merge
from tfg_drake.mapfile.saved_map import SavedMap, load_map, restored_estimate, save_map
from tfg_drake.messages import WALLS_BELOW, is_tag
from tfg_drake.slam.estimator_state import unknown_way
from tfg_drake.slam.evidence import Evidence
from tfg_drake.slam.keyframe import of_places
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.walls import directions, known_walls, no_walls
from tfg_drake.table import empty
from tfg_drake.tfg.feature_graph import TfgGraph
from tfg_drake.tfg.graph import empty_map
from tfg_drake.tfg.surfaces import Surfaces

X_WM = np.array([5.0, 3.0, 0.5])
# Turns and ways of the first half of a ring of 24 views.
HALF = 2 * 12 - 1


def saved(keyframes, surfaces=None, star=None):
    """A map of some keyframes, its surfaces, and the free polygon (s, 2), m in M, that every view has seen."""
    graph, estimate = solve(reckoned(keyframes), 10.0, NOTHING, joint=1000)
    k, none = len(graph.view_keyframe), np.zeros((0, 2))
    stars = [none if star is None else se2.transform(se2.inverse(X), star) for X in graph.X_MA]
    offsets = np.append(0, np.cumsum([len(one) for one in stars]))
    tfg = empty(TfgGraph, stage=k, star_offsets=offsets, star_vertices=np.concatenate(stars))
    resolved = dataclasses.replace(
        empty_map(),
        stage=k,
        facing=np.zeros((np.count_nonzero(is_tag(graph.ids)), 2)),
        star_offsets=offsets,
        star_centers=graph.X_MA[:, :2],
        star_vertices=np.concatenate([none if star is None else star for _ in stars]),
    )
    if surfaces is not None:
        tfg = dataclasses.replace(tfg, surfaces=surfaces)
        pieces = known_walls(graph)[1].reshape(-1, 4)
        ids = surfaces.ids
        resolved = dataclasses.replace(
            resolved, segments=pieces, segment_kind=np.zeros(len(ids), dtype=np.int64), segment_ids=ids
        )
    doubtful = np.zeros(0, dtype=np.int64)
    return SavedMap(X_WM, k, estimate.stamp, graph, 0, doubtful, no_walls(), empty(Evidence), tfg, resolved)


def halves(seed, noise):
    keyframes, p_ML, _ = ring(seed, noise)
    return keyframes, p_ML, saved(keyframes[:HALF]), saved(keyframes[HALF + 1 :])


def in_frame(one, X):
    """The same map in another frame, in which M lies at X (3,)."""
    graph, R = one.graph, se2.rotation(float(X[2]))
    graph = dataclasses.replace(
        graph,
        X_MN=se2.compose(X, graph.X_MN),
        p_ML=se2.transform(X, graph.p_ML),
        landmark_covariance=R @ graph.landmark_covariance @ R.T,
    )
    return dataclasses.replace(one, graph=graph, X_WM=se2.compose(one.X_WM, se2.inverse(X)))


def test_exact_without_noise():
    _, p_ML, first, second = halves(1, 0.0)
    both = merge(first, second)
    np.testing.assert_array_equal(both.ids, np.union1d(first.ids, second.ids))
    np.testing.assert_allclose(both.p_ML, p_ML[both.ids - 100], atol=1e-6)
    assert (both.stage, len(both.doubtful)) == (24, 0)
    np.testing.assert_array_equal(both.X_WM, X_WM)


def test_a_map_in_two_halves_is_the_whole_but_for_the_way_between():
    keyframes, _, first, second = halves(2, 1.0)
    both = merge(first, second)
    X_MN = solve(reckoned(keyframes), 0.0, NOTHING)[0].X_MN
    keyframes[HALF] = unknown_way(se2.between(X_MN[HALF], X_MN[HALF + 1]))
    whole, _ = solve(reckoned(keyframes), 0.0, NOTHING, joint=1000)
    sigma = np.sqrt(np.linalg.eigvalsh(whole.landmark_covariance)[:, -1:])
    assert np.abs((both.p_ML - whole.p_ML) / sigma).max() < 0.15
    np.testing.assert_allclose(
        both.landmark_covariance / sigma[:, None] ** 2, whole.landmark_covariance / sigma[:, None] ** 2, atol=0.05
    )


def test_the_covariance_is_honest():
    found = []
    for seed in range(3, 9):
        _, p_ML, first, second = halves(seed, 1.0)
        both = merge(first, second)
        estimate = solve(both.graph, 0.0, NOTHING, joint=1000)[1]
        found.append(landmark_nees(both.p_ML, p_ML[both.ids - 100], estimate.covariance[:-3, :-3]))
    assert 0.8 < np.mean(found) < 1.2


@settings(max_examples=10)
@given(x=st.floats(-50.0, 50.0), y=st.floats(-50.0, 50.0), theta=st.floats(-3.0, 3.0))
def test_the_frame_of_the_second_map_does_not_matter(x, y, theta):
    _, _, first, second = halves(2, 1.0)
    one, other = merge(first, second), merge(first, in_frame(second, np.array([x, y, theta])))
    np.testing.assert_allclose(other.p_ML, one.p_ML, atol=1e-5)
    np.testing.assert_allclose(other.landmark_covariance, one.landmark_covariance, rtol=1e-3, atol=1e-8)
    np.testing.assert_allclose(other.X_MA, one.X_MA, atol=1e-5)


def renamed(one, names):
    """The map with the ids of some tags changed."""

    def anew(part, *columns):
        ids = np.array([names.get(tag, tag) for tag in part.ids.tolist()])
        order = np.argsort(ids)
        return dataclasses.replace(part, ids=ids[order], **{name: getattr(part, name)[order] for name in columns})

    keyframes = []
    for keyframe in one.graph.keyframes:
        ids = np.array([names.get(tag, tag) for tag in keyframe.ids.tolist()], dtype=np.int64)
        rows = np.append(
            (2 * np.argsort(ids)[:, None] + [0, 1]).ravel(), np.arange(2 * len(ids), len(keyframe.information))
        )
        keyframe = dataclasses.replace(keyframe, information=keyframe.information[np.ix_(rows, rows)])
        keyframes.append(anew(keyframe, "y_AL", "on_error"))
    graph = anew(dataclasses.replace(one.graph, keyframes=tuple(keyframes)), "p_ML", "landmark_covariance")
    return dataclasses.replace(one, graph=graph)


def test_tags_that_have_changed_places_stay_where_the_first_map_has_them():
    _, p_ML, first, second = halves(4, 0.0)
    common = np.intersect1d(first.ids, second.ids)
    p = p_ML[common - 100]
    a = 0
    b = int(np.argmax(np.hypot(*(p - p[a]).T)))
    swapped = common[[a, b]].tolist()
    both = merge(first, renamed(second, dict(zip(swapped, swapped[::-1], strict=True))))
    np.testing.assert_array_equal(both.doubtful, np.sort(swapped))
    np.testing.assert_allclose(both.p_ML, p_ML[both.ids - 100], atol=1e-6)


def test_maps_of_two_places_are_refused():
    first, other = saved(ring(1, 0.0)[0][:HALF]), saved(ring(7, 0.0)[0][HALF + 1 :])
    common = len(np.intersect1d(first.ids, other.ids))
    with pytest.raises(BadInput) as caught:
        merge(first, other)
    told = "tags are in both, but fewer than three in five of them stand alike: are both of one place?"
    assert str(caught.value) == f"{common} {told}"


# A turn's end in its beginning, and how well it is known; what a look tells of walls, m normal to them.
X_AD, TURN, ACROSS = np.array([0.2, 0.1, 0.3]), np.diag([0.02, 0.02, 0.01]) ** 2, 0.005
# Which walls of a room of six are seen from each of three places. The first two share walls of one direction alone.
IN_VIEW = ([0, 1, 2], [0, 2, 3, 4, 5], [0, 2, 4])


def looks(room, names, X_MA, at):
    """Keyframes of three turns, the first at X_MA (3,), that see walls (w, 4) of a room by these names (w,), anchored
    by this share of their length."""
    keyframes, X_MB, room = [], np.zeros(3), np.array(room, dtype=float)
    for view in IN_VIEW:
        seen = np.array(sorted((w for w in view if w < len(room)), key=lambda w: -names[w]))
        p = se2.transform(se2.inverse(se2.compose(X_MA, X_MB)), room[seen].reshape(-1, 2))
        walls, anchor, reach = walls_between(p, at)
        covariance = block_diag(*known_at_their_ends(reach, ACROSS), TURN)
        keyframes.append(of_places(WALLS_BELOW - 1 - np.array(names)[seen], walls, anchor, reach, X_AD, covariance))
        X_MB = se2.compose(X_MB, X_AD)
    return keyframes


def in_room(room, names, X_MA, at=0.25):
    """The map of these looks; every view has seen the whole room to be free."""
    keyframes, w, room = looks(room, names, X_MA, at), len(room), np.array(room, dtype=float)
    order = np.argsort(-np.array(names))
    length = directions(room[order].reshape(-1, 2, 2))[2]
    along = length[:, None] * [-at, 1.0 - at]
    surfaces = Surfaces(
        ids=np.tile(WALLS_BELOW - 1 - np.array(names)[order][:, None], 2),
        view=np.full(w, 2),
        range=np.full(w, 5.0),
        offsets=2 * np.arange(w + 1),
        vertices=np.column_stack([along.ravel(), np.zeros(2 * w)]),
    )
    return saved(keyframes, surfaces, se2.transform(se2.inverse(X_MA), room[:, :2]))


HERE, THERE = np.array([3.5, 1.5, 0.4]), np.array([1.0, 1.0, -2.0])


def test_without_tags_the_walls_tell_how_they_lie_and_become_one(tmp_path):
    first, second = in_room(ROOM, range(6), HERE), in_room(ROOM, [7, 2, 9, 0, 4, 5], THERE, at=0.6)
    both = merge(first, second)
    np.testing.assert_array_equal(both.graph.ids, first.graph.ids)
    np.testing.assert_allclose(both.graph.p_ML, first.graph.p_ML, atol=1e-3)
    np.testing.assert_allclose(both.X_MA[3], se2.between(HERE, THERE), atol=1e-3)
    np.testing.assert_array_equal(both.graph.anchor, first.graph.anchor)
    np.testing.assert_allclose(both.graph.reach, first.graph.reach, atol=5e-3)
    # What both have seen is there once.
    length = np.hypot(*(both.tfg.segments[:, 2:] - both.tfg.segments[:, :2]).T)
    assert length.sum() == pytest.approx(directions(np.array(ROOM).reshape(-1, 2, 2))[2].sum(), abs=0.05)
    save_map(tmp_path / "map.npz", both)
    assert load_map(tmp_path / "map.npz").stage == 6


def test_what_is_known_of_walls_is_known_as_well_as_if_one_graph_had_seen_all():
    both = merge(in_room(ROOM, range(6), HERE), in_room(ROOM, [7, 2, 9, 0, 4, 5], THERE, at=0.6))
    keyframes = looks(ROOM, range(6), HERE, 0.25)
    end = se2.compose(HERE, se2.compose(X_AD, se2.compose(X_AD, X_AD)))
    keyframes += [unknown_way(se2.between(end, THERE)), *looks(ROOM, range(6), THERE, 0.6)]
    whole, _ = solve(reckoned(keyframes), 0.0, NOTHING)
    np.testing.assert_allclose(known_walls(both.graph)[2], known_walls(whole)[2], rtol=0.03)


def test_a_wall_of_the_second_map_alone_gets_an_id_of_its_own():
    first, second = in_room(ROOM[:-1], range(5), HERE), in_room(ROOM, range(6), THERE)
    both = merge(first, second)
    ids, pairs, _ = known_walls(both.graph)
    np.testing.assert_array_equal(ids, WALLS_BELOW - np.arange(6)[::-1] - 1)
    expected = se2.transform(se2.inverse(HERE), np.array(ROOM[-1], dtype=float).reshape(-1, 2))
    np.testing.assert_allclose(np.sort(pairs[0], axis=0), np.sort(expected, axis=0), atol=0.02)


def test_a_room_that_looks_the_same_from_two_sides_is_refused():
    room = [[0.0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]
    with pytest.raises(BadInput, match=r"^0 tags are in both, .* the walls fit nowhere or in several places: "):
        merge(in_room(room, range(4), HERE), in_room(room, range(4), THERE))


def half(scenario, seed, start, out, **options):
    return tfg_drake.explore(scenario, seed=seed, start=start, until=300.0, out=out, **options)


@pytest.mark.slow
def test_two_halves_of_a_building_are_as_exact_as_the_whole(tmp_path):
    half("paper", 1, (3.5, 2.5, 0.0), tmp_path / "a")
    half("paper", 11, (37.0, 19.5, 0.0), tmp_path / "b")
    tfg_drake.explore("paper", seed=1, out=tmp_path / "whole")
    world, errors = MakeWorld(LoadScenario("paper").world), []
    for one in (tfg_drake.merge(tmp_path / "a", tmp_path / "b"), load_map(tmp_path / "whole")):
        estimate, p_WT = restored_estimate(one), world.p_WT[np.searchsorted(world.tag_ids, one.ids)]
        p_MT = se2.transform(se2.inverse(one.X_WM), p_WT)
        errors.append(landmark_rmse_aligned(one.p_ML, p_MT))
        assert 0.7 < landmark_nees(one.p_ML, p_MT, estimate.covariance[:-3, :-3]) < 1.3
    assert errors[0] < 1.2 * errors[1]


@pytest.mark.slow
def test_halves_of_a_building_without_tags_are_put_together_by_their_walls(tmp_path):
    half("paper", 1, (3.5, 2.5, 0.0), tmp_path / "a", tag_spacing=math.inf)
    half("paper", 11, (37.0, 19.5, 0.0), tmp_path / "b", tag_spacing=math.inf)
    both, views = tfg_drake.merge(tmp_path / "a", tmp_path / "b"), load_map(tmp_path / "a").stage
    # The second map's origin in the first one's frame, by where the two began.
    X_MB = se2.compose(both.X_MA[views], se2.inverse(load_map(tmp_path / "b").X_MA[0]))
    np.testing.assert_allclose(X_MB, [33.5, 17.0, 0.0], atol=0.06)
