"""An estimator that begins with a map, and what has changed since."""

import math

import numpy as np
import pytest

from tfg_drake.bad_input import BadInput
from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.mapfile.changes import map_changes, told
from tfg_drake.mapfile.known_map import begun_with
from tfg_drake.mapfile.merge import merge
from tfg_drake.mapfile.saved_map import restored_estimate
from tfg_drake.messages import Odometry, TagDetections, replace
from tfg_drake.slam.estimator import begin_turn, carried, end_turn, pose_estimate, process_detections, process_odometry
from tfg_drake.slam.estimator_state import initial_state


@pytest.fixture
def known(small_map):
    return begun_with(small_map, initial_state(OdometryConfig()))


def frame(saved, X_MB, stamp):
    """All tags of the map, seen without noise from a pose."""
    p_BL = se2.transform(se2.inverse(X_MB), saved.p_ML)
    sigma = np.full(len(saved.ids), 0.02)
    distance, bearing = np.hypot(*p_BL.T), np.arctan2(p_BL[:, 1], p_BL[:, 0])
    return TagDetections(stamp, saved.ids, distance, bearing, sigma, sigma)


def looked(state, saved, X_MB, since=0.0):
    """The state after a second of looking round, at rest at a pose."""
    odometry = [Odometry(stamp=since + k / 16, X_OB=np.zeros(3), V_B=np.zeros(2), at_rest=True) for k in range(20)]
    for k, one in enumerate(odometry):
        state = process_odometry(state, one)
        if k == 1:
            state = begin_turn(state, one.stamp)
        state = process_detections(state, frame(saved, X_MB, one.stamp))
    return end_turn(state, odometry[-1].stamp)


def test_the_map_is_there_before_the_first_message_and_apart(known, small_map):
    estimate, there = restored_estimate(small_map), known.known.estimate.of_tags
    np.testing.assert_allclose(there.p_ML, estimate.p_ML, atol=1e-6)
    np.testing.assert_allclose(there.landmark_covariance, estimate.landmark_covariance, atol=1e-6)
    assert known.map is None
    assert (known.at, len(known.graph.keyframes)) == (None, 0)


def test_where_it_is_said_to_begin_is_told_in_the_world_of_the_map(small_map):
    saved = replace(small_map, X_WM=np.array([1.0, 2.0, 0.5 * math.pi]))
    said = begun_with(saved, initial_state(OdometryConfig()), [1.0, 5.0, 2.0, 0.2, 0.1]).known.said
    np.testing.assert_allclose(said.X, [3.0, 0.0, 2.0 - 0.5 * math.pi], atol=1e-12)
    np.testing.assert_allclose(np.sqrt(np.diag(said.covariance)), [0.2, 0.2, 0.1])


@pytest.mark.parametrize("X_MB", [[0.0, 0.0, 0.0], [3.0, -1.0, 2.0], [-6.0, 4.0, -3.0]])
def test_the_robot_finds_itself_wherever_it_is(known, small_map, X_MB):
    X_MB = np.array(X_MB)
    state = looked(known, small_map, X_MB)
    assert 0.0 <= state.placed < 0.5
    np.testing.assert_allclose(pose_estimate(state).X_MB, X_MB, atol=0.02)
    np.testing.assert_allclose(state.map.of_tags.p_ML, small_map.p_ML, atol=0.02)
    assert (state.known, state.is_kidnapped) == (None, False)


def test_a_carried_robot_finds_itself_anew(known, small_map):
    state = carried(looked(known, small_map, np.array([1.0, 0.0, 0.0])))
    assert math.isnan(state.placed)
    old = Odometry(stamp=0.0, X_OB=np.zeros(3), V_B=np.zeros(2), at_rest=True)
    assert process_odometry(state, old) is state


def test_a_carried_robot_looks_for_itself_until_it_has_found_itself(known, small_map):
    strange = replace(small_map, graph=replace(small_map.graph, ids=small_map.graph.ids + 1000))
    state = carried(looked(known, small_map, np.array([1.0, 0.0, 0.0])))
    state = looked(state, strange, np.array([1.0, 2.0, 0.5]), since=2.0)
    assert math.isnan(state.placed)
    assert state.map.is_adrift
    state = looked(state, small_map, np.array([1.0, 2.0, 0.5]), since=4.0)
    assert math.isfinite(state.placed)
    assert not state.map.is_adrift
    np.testing.assert_allclose(pose_estimate(state).X_MB, [1.0, 2.0, 0.5], atol=0.05)


def test_a_robot_that_sees_no_mapped_tag_maps_apart(known, small_map):
    strange = replace(small_map, graph=replace(small_map.graph, ids=small_map.graph.ids + 1000))
    state = looked(known, strange, np.array([1.0, 2.0, 0.5]))
    assert state.at is None
    assert state.known is known.known
    np.testing.assert_array_equal(state.map.of_tags.ids, strange.ids)
    np.testing.assert_allclose(pose_estimate(state).X_MB, np.zeros(3), atol=0.01)


def test_tags_that_hang_elsewhere_since_are_where_they_hang_now(known, small_map):
    p_ML = small_map.p_ML.copy()
    p_ML[0] += [0.4, 0.3]
    moved = replace(small_map, graph=replace(small_map.graph, p_ML=p_ML))
    state = looked(known, moved, np.array([1.0, 2.0, 0.5]))
    assert state.known is None
    np.testing.assert_allclose(state.map.of_tags.p_ML, p_ML, atol=0.03)


def test_nothing_has_changed_in_the_same_map(small_map):
    changes = map_changes(small_map, small_map)
    assert not any(changes.values())
    assert told(changes) == "nothing"


def test_each_thing_that_is_new_or_gone_is_told_by_itself(small_map):
    nothing = map_changes(small_map, small_map)
    table = [[1.0, 0.0, 1.2, 0.0], [1.2, 0.0, 1.4, 0.0], [1.4, 0.0, 1.4, 0.2]]
    chest = [[5.0, 3.0, 5.0, 3.2]]
    changed = nothing | {"surfaces_new": chest + table, "surfaces_gone": chest}
    assert told(changed) == (
        "surface new: 0.6 m about (1.3, 0.0), 0.2 m about (5.0, 3.1); surface gone: 0.2 m about (5.0, 3.1)"
    )


def test_moved_lost_and_new_tags_are_told(small_map):
    graph = small_map.graph
    tags = np.flatnonzero(small_map.is_tag)
    p_ML = graph.p_ML.copy()
    p_ML[tags[0]] += [0.3, 0.0]
    p_ML[tags[1]] += [0.01, 0.0]
    moved, lost = int(graph.ids[tags[0]]), int(graph.ids[tags[2]])
    ids = graph.ids.copy()
    ids[tags[-1]] += 1000
    keep = graph.ids != lost
    after = replace(
        small_map,
        graph=replace(
            graph,
            ids=ids[keep],
            p_ML=p_ML[keep],
            anchor=graph.anchor[keep],
            reach=graph.reach[keep],
            landmark_covariance=np.full_like(graph.landmark_covariance, 0.0)[keep] + 1e-4 * np.eye(2),
        ),
    )
    before = replace(
        small_map, graph=replace(graph, landmark_covariance=np.zeros_like(graph.landmark_covariance) + 1e-4 * np.eye(2))
    )
    changes = map_changes(before, after)
    assert changes["tags_moved"] == [moved]
    assert set(changes["tags_gone"]) == {lost, int(graph.ids[tags[-1]])}
    assert changes["tags_new"] == [int(ids[tags[-1]])]
    assert f"tags moved: {moved}" in told(changes)


def test_surfaces_that_came_stand_where_there_was_free_space(small_map):
    square = np.array([[-5.0, -5.0], [5.0, -5.0], [5.0, 5.0], [-5.0, 5.0]])
    tfg = replace(
        small_map.tfg,
        segments=np.array([[-5.0, -5.0, 5.0, -5.0]]),
        star_offsets=np.array([0, 4]),
        star_vertices=square,
        star_centers=np.zeros((1, 2)),
    )
    before = replace(small_map, tfg=tfg)
    chair = np.array([[1.0, 1.0, 1.6, 1.0]])
    after = replace(small_map, tfg=replace(tfg, segments=np.vstack([tfg.segments, chair])))
    assert len(map_changes(before, after)["surfaces_new"]) == 3
    assert map_changes(before, after)["surfaces_gone"] == []
    assert len(map_changes(after, before)["surfaces_gone"]) == 3


def test_a_surface_that_no_view_saw_through_is_not_gone(small_map):
    before_it, behind_it = ([[-5.0, y], [5.0, y], [5.0, y + 5.0], [-5.0, y + 5.0]] for y in (-4.05, 1.05))
    tfg = replace(
        small_map.tfg,
        segments=np.zeros((0, 4)),
        star_offsets=np.array([0, 4, 8]),
        star_vertices=np.array([*before_it, *behind_it]),
        star_centers=np.array([[0.0, 0.0], [0.0, 4.0]]),
    )
    after = replace(small_map, tfg=tfg)
    before = replace(small_map, tfg=replace(tfg, segments=np.array([[1.0, 1.0, 1.6, 1.0]])))
    assert map_changes(before, after)["surfaces_gone"] == []


def test_a_session_and_the_map_that_it_began_with_count_once(small_map):
    """One is part of the other, though no look of it is left as it was."""
    before = replace(small_map, graph=replace(small_map.graph, sessions=np.array([5])))
    session = begun_with(before, initial_state(OdometryConfig()))
    assert session.known is not None
    np.testing.assert_array_equal(session.known.sessions, [5])
    state = looked(session, small_map, np.zeros(3))
    assert len(state.graph.sessions) == 2
    both = replace(small_map, graph=replace(small_map.graph, keyframes=(), sessions=state.graph.sessions))
    with pytest.raises(BadInput, match="both maps hold the same session"):
        merge(before, both)
