"""A session maps apart until it knows where it is in the map that it began with."""

import copy
import logging

import numpy as np
import pytest

from tests.slam.test_reunion import Robot
from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.mapfile.saved_map import as_one_keyframe
from tfg_drake.messages import Hypotheses, Odometry, SaidPose, replace
from tfg_drake.slam.estimator import begin_turn, pose_estimate, process_odometry
from tfg_drake.slam.estimator_state import KnownMap, Placed, initial_state
from tfg_drake.slam.joining import with_known
from tfg_drake.slam.place_search import nearest, seen_by_keyframes
from tfg_drake.slam.relocalizer import BY_WALLS, EACH_VIEW, joined, said_to_be
from tfg_drake.slam.surface_fit import map_points
from tfg_drake.slam.walls import known_walls

# Another room, and where the second session begins in the map of the first, whose origin is at (2.5, 1.5).
OTHER = np.array([[0, 0, 9, 0], [9, 0, 9, 2], [9, 2, 0, 2], [0, 2, 0, 0]], dtype=float)
START = np.array([1.0, 1.2, 2.0])


class Session(Robot):
    """A robot that begins somewhere, where its odometry says zero."""

    def __init__(self, start, seed):
        super().__init__()
        self.X_WB, self.start, self.rng = np.array(start), np.array(start), np.random.default_rng(seed)

    def odometry(self, speed=0.0, rate=0.0):
        return Odometry(self.time, se2.between(self.start, self.X_WB), np.array([speed, rate]))

    def begun(self, known=None):
        state = replace(initial_state(OdometryConfig(), landmarks="walls"), known=known)
        return process_odometry(replace(state, look=None), self.odometry())


@pytest.fixture(scope="module")
def first():
    """The map of the first session, by two views."""
    robot = Session([2.5, 1.5, 0.0], 6)
    state = robot.view(robot.begun())
    return robot.view(robot.drive(state, 0.3, 0.1, 25))


@pytest.fixture(scope="module")
def known(first):
    one = as_one_keyframe(first.map, first.sheet).keyframes[0]
    return KnownMap(one, first.map.X_MD, first.map, seen_by_keyframes(first.graph), first.evidence, np.zeros((0, 2)))


def viewed(robot, known):
    """The robot, and its state after a view."""
    return robot, robot.view(robot.begun(known))


@pytest.fixture(scope="module")
def of_the_same(known):
    return viewed(Session(START, 7), known)


@pytest.fixture(scope="module")
def of_another(known):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tests.slam.test_reunion.ROOM", OTHER)
        return viewed(Session([4.0, 1.0, 0.3], 8), known)


@pytest.fixture
def placed(of_the_same):
    """A robot in the known building and its state after the first view."""
    return copy.deepcopy(of_the_same[0]), of_the_same[1]


@pytest.fixture
def elsewhere(of_another, monkeypatch):
    """A robot in another building and its state after the first view."""
    monkeypatch.setattr("tests.slam.test_reunion.ROOM", OTHER)
    return copy.deepcopy(of_another[0]), of_another[1]


def in_K(X_WB):
    return se2.between(np.array([2.5, 1.5, 0.0]), X_WB)


def test_it_finds_itself_in_the_first_turn_and_both_maps_become_one(first, known, placed):
    robot = Session(START, 7)
    state = robot.begun(known)
    turning = robot.drive(begin_turn(state, robot.time), 0.0, 0.5, 100)
    assert turning.at is not None
    assert (pose_estimate(state).places, pose_estimate(turning).places) == (0, -1)
    assert 0.0 < turning.placed < robot.time
    np.testing.assert_allclose(pose_estimate(turning).X_MB, in_K(robot.X_WB), atol=0.05)

    robot, state = placed
    assert (state.known.since, state.map.stage) == (1, 1)
    assert pose_estimate(state).places == -1
    assert np.all(np.abs(se2.between(in_K(START), state.map.X_MA[0])) < [0.03, 0.03, 0.01])
    # The walls of both are one, and known better than by either.
    assert len(known_walls(first.map)[0]) <= len(known_walls(state.map)[0]) <= len(known_walls(first.map)[0]) + 1
    before, after = (known_walls(of)[2].max() for of in (first.map, state.map))
    assert after < 1.1 * before
    # It goes on in that map.
    state = robot.view(robot.drive(state, 0.3, 0.0, 20))
    error = se2.between(in_K(robot.X_WB), state.map.X_MD)
    assert np.all(np.abs(error) < [0.03, 0.03, 0.01])
    assert error @ np.linalg.solve(state.map.covariance[-3:, -3:], error) < 16.0


def test_what_hangs_on_the_sessions_walls_stays_where_it_is(placed):
    """Surfaces are told from a wall's anchor: that of the session's counts."""
    _, apart = viewed(Session(START, 7), None)
    _, together = placed
    rows = np.searchsorted(together.map.ids, apart.map.ids)
    np.testing.assert_array_equal(together.map.ids[rows], apart.map.ids)
    moved = se2.transform(together.map.X_MA[0], apart.map.anchor)
    np.testing.assert_allclose(together.map.anchor[rows], moved, atol=0.03)


def test_in_another_building_it_maps_apart(known, elsewhere):
    _, state = elsewhere
    assert (state.at, state.placed) == (None, -np.inf)
    assert state.known is known
    three = Hypotheses(np.zeros((3, 3)), np.full(3, 0.3), known.seen.points)
    assert pose_estimate(replace(state, hypotheses=three)).places == 3
    np.testing.assert_allclose(state.map.X_MA[0], np.zeros(3), atol=0.02)
    assert len(known_walls(state.map)[0]) == 4


def test_a_place_that_what_follows_contradicts_is_taken_back(elsewhere, caplog):
    _, state = elsewhere
    wrong = replace(state, at=Placed(np.array([1.0, 0.0, 0.0]), np.eye(3) * 1e-4), placed=1.0)
    with caplog.at_level(logging.WARNING, "tfg_drake.operator"):
        after = joined(wrong)
    assert (after.at, after.placed) == (None, -np.inf)
    assert "contradicts that place" in caplog.text


def test_both_are_one_for_good_once_what_follows_agrees(placed):
    robot, state = placed
    for stage in range(2, 2 + EACH_VIEW):
        assert (state.known is None, pose_estimate(state).places) == (False, -1)
        state = robot.view(robot.drive(state, 0.2, 0.1, 5))
        assert state.map.stage == stage
    assert (state.known, state.at) == (None, None)


def test_both_become_two_again_where_what_follows_contradicts_that(known, elsewhere, caplog):
    """It is in another building, and was believed to be in the known one."""
    robot, state = elsewhere
    alone, apart = viewed(Session([4.0, 1.0, 0.3], 8), None)
    wrong = Placed(np.array([2.0, 0.0, -0.3]), np.diag(BY_WALLS**2))
    state = with_known(state, known, wrong)
    assert (state.known.since, pose_estimate(state).places) == (1, -1)
    assert len(state.graph.keyframes) == len(apart.graph.keyframes) + 2
    np.testing.assert_allclose(state.map.X_MA[0], wrong.X, atol=0.3)
    with caplog.at_level(logging.WARNING, "tfg_drake.operator"):
        state = robot.view(robot.drive(state, 0.2, 0.1, 5))
        apart = alone.view(alone.drive(apart, 0.2, 0.1, 5))
    assert "contradicts that place" in caplog.text
    assert (state.at, state.placed, state.known.since) == (None, -np.inf, 0)
    for field in ("keyframe", "estimate", "seen"):
        assert getattr(state.known, field) is getattr(known, field)
    # All is as if the session had never been joined to it, but for the names of walls.
    np.testing.assert_allclose(state.map.X_MA, apart.map.X_MA, atol=0.01)
    np.testing.assert_allclose(state.map.X_MD, apart.map.X_MD, atol=0.01)
    assert len(state.graph.keyframes) == len(apart.graph.keyframes)
    seen = np.concatenate([one.ids for one in state.graph.keyframes])
    np.testing.assert_array_equal(state.graph.ids, np.unique(seen))
    ends, ends_apart = known_walls(state.map)[1], known_walls(apart.map)[1]
    assert len(ends) == len(ends_apart)
    for wall in ends:
        assert np.abs(ends_apart - wall).max(axis=(1, 2)).min() < 0.1
    # It goes on apart.
    state = robot.view(robot.drive(state, 0.2, 0.0, 5))
    assert state.known.since == 0
    np.testing.assert_allclose(state.map.X_MD, se2.between(robot.start, robot.X_WB), atol=0.03)


@pytest.mark.parametrize("off", [pytest.param(0.2, marks=pytest.mark.slow), 3.0])
def test_where_it_is_said_to_be_counts_less_than_what_it_sees(known, off, caplog):
    said = Placed(in_K(START) + np.array([off, 0.0, 0.0]), np.diag([0.25, 0.25, 0.09]))
    robot = Session(START, 7)
    with caplog.at_level(logging.WARNING, "tfg_drake.operator"):
        state = robot.view(robot.begun(replace(known, said=said)))
    assert state.known.since == 1
    assert np.all(np.abs(se2.between(in_K(START), state.map.X_MA[0])) < [0.03, 0.03, 0.01])
    assert ("from where it was said to be" in caplog.text) == (off > 1.0)


def test_who_says_where_the_robot_is_says_where_its_session_began(known):
    """The prior is of the session's beginning; brute force: draws of the pose that is said, moved back there."""
    robot = Session(START, 7)
    state = robot.drive(robot.begun(replace(known, X_WK=np.array([2.5, 1.5, 0.0]))), 0.3, 0.2, 80)
    X_MB, sigma = pose_estimate(state).X_MB, np.array([0.1, 0.05])
    assert np.hypot(*X_MB[:2]) > 1.0
    said = said_to_be(state, SaidPose(X_WB=robot.X_WB, sigma=sigma), X_MB).known.said
    np.testing.assert_allclose(said.X, in_K(START), atol=0.01)
    rng = np.random.default_rng(1)
    X_KB = in_K(robot.X_WB) + rng.normal(size=(200_000, 3)) * sigma[[0, 0, 1]]
    drawn = se2.compose(X_KB, np.broadcast_to(se2.inverse(X_MB), X_KB.shape))
    drawn[:, 2] = se2.wrap_angle(drawn[:, 2] - said.X[2])
    np.testing.assert_allclose(said.covariance, np.cov(drawn.T), atol=2e-4)


def test_what_is_said_of_a_robot_that_maps_apart_from_nothing_does_not_count(known, caplog):
    state, said = Session(START, 7).begun(known), SaidPose(1.0, 1, np.array([1.0, 2.0, 0.5]))
    for one in (replace(state, known=None), replace(state, at=Placed(np.zeros(3), np.eye(3)))):
        caplog.clear()
        with caplog.at_level(logging.WARNING, "tfg_drake.operator"):
            assert said_to_be(one, said, np.zeros(3)) is one
        (record,) = caplog.records
        why = "where the robot is said to be does not count: it does not map apart"
        assert record.getMessage() == f"{one.stamp:.2f} s: {why}"


def test_views_tell_what_was_seen_from_where(first):
    graph = first.graph
    seen = seen_by_keyframes(graph)
    np.testing.assert_allclose(seen.eyes, first.map.X_MA[:, :2], atol=1e-9)
    np.testing.assert_array_equal(seen.points, map_points(graph))
    for eye, depth, k in zip(seen.eyes, seen.depth, graph.view_keyframe, strict=True):
        of_view = map_points(graph, [k])
        np.testing.assert_array_equal(depth, nearest(eye, of_view))
        np.testing.assert_array_equal(seen_by_keyframes(graph, [k]).points, of_view)
        # What faces its eye has been seen from there.
        assert np.mean(np.sum((eye - of_view[:, :2]) * of_view[:, 2:], axis=1) > 0.0) > 0.98
