"""A robot that maps on though it has lost its place finds the map before again."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.slam.oracle import NOISE
from tests.slam.rings import NOTHING, observed, reckoned, ring, way
from tests.slam.test_scan_lines import ANGLES, CONFIG
from tfg_drake.config import OdometryConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import Hypotheses, Odometry, TagDetections, replace
from tfg_drake.simulation.laser_scanner import scan
from tfg_drake.slam import estimator, relocalizer
from tfg_drake.slam.estimator import begin_turn, end_turn, pose_estimate, process_odometry, process_scan
from tfg_drake.slam.estimator_state import KIDNAPPED, initial_state, opened, unknown_way
from tfg_drake.slam.keyframe import without_tags
from tfg_drake.slam.keyframe_graph import adrift, empty_graph, empty_map, moved_part, seen_by
from tfg_drake.slam.localizer import start_localizer
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.map_update import updated
from tfg_drake.slam.place_search import Places, no_places
from tfg_drake.slam.relocalizer import (
    CONTRADICTIONS,
    DRIFTED,
    ELSEWHERE,
    PLACED,
    doubted,
    find_itself,
    found_again,
    mapped_elsewhere,
)
from tfg_drake.slam.shared import exactly_known
from tfg_drake.slam.walls import known_walls
from tfg_drake.table import empty

# A room that is not alike from any two sides.
ROOM = np.array(
    [[0, 0, 6, 0], [6, 0, 6, 3], [6, 3, 4, 3], [4, 3, 4, 5], [4, 5, 0, 5], [0, 5, 0, 0], [1.5, 2, 1.5, 3.2]],
    dtype=float,
)
PERIOD = 0.1
# A robot that was kidnapped maps on, and later sees what it had mapped before beside what it has mapped since.
SEEN, X_AD = 5.5, np.array([0.01, -0.02, 0.1])
PLACES = np.array([[0.0, 0.0, 0.3], [3.0, 0.0, -0.4], [14.0, 0.0, 1.0], [17.0, 0.0, 2.0], [8.5, 0.0, 0.5]])
# What the robot believes of where it was put, against where it is.
GUESS = np.array([2.0, -1.0, 0.6])
BETWEEN = way(np.random.default_rng(4), se2.between(se2.compose(PLACES[3], X_AD), PLACES[4]))


class Robot:
    """Drives exactly as its odometry says; scans have noise."""

    def __init__(self):
        self.X_WB, self.time, self.rng = np.array([2.5, 1.5, 0.0]), 0.0, np.random.default_rng(6)

    def odometry(self, speed=0.0, rate=0.0):
        return Odometry(self.time, self.X_WB.copy(), np.array([speed, rate]))

    def drive(self, state, speed, rate, steps):
        for _ in range(steps):
            self.time += PERIOD
            self.X_WB = se2.compose(self.X_WB, np.array([speed * PERIOD, 0.0, rate * PERIOD]))
            state = process_odometry(state, self.odometry(speed, rate))
            seen = scan(ROOM, self.X_WB, self.time, ANGLES, self.rng.normal(size=len(ANGLES)), CONFIG)
            state = process_scan(state, seen)
        return state

    def view(self, state):
        return end_turn(self.drive(begin_turn(state, self.time), 0.0, 0.7, 90), self.time)


@pytest.mark.parametrize("late", [False, True], ids=["at once", "a view later"])
@pytest.mark.parametrize("carried", [0.0, 0.8], ids=["where it was", "carried"])
def test_certainty_comes_back_when_the_walls_tell_where_the_robot_is(carried, late, monkeypatch):
    robot = Robot()
    state = process_odometry(initial_state(OdometryConfig(), landmarks="walls"), robot.odometry())
    state = robot.view(state)
    walls, before = known_walls(state.map)[1], known_walls(state.map)[2]
    assert len(walls) >= 6
    # From here on it is not found by its walls on the way.
    monkeypatch.setattr(estimator, "find_itself", lambda state, *_args, **_kwargs: state)
    state = robot.drive(state, 0.2, 0.0, 10)
    state = replace(state, log=(replace(opened(state), sigma=KIDNAPPED, is_apart=True),))
    offset = np.array([0.0, carried, 0.0])
    robot.X_WB = robot.X_WB + offset
    robot.odometry = lambda speed=0.0, rate=0.0: Odometry(robot.time, robot.X_WB - offset, np.array([speed, rate]))
    if late:
        with monkeypatch.context() as patch:
            patch.setattr(relocalizer, "find_places", lambda *_args, **_kwargs: no_places())
            state = robot.drive(robot.view(state), 0.2, 0.0, 5)
        assert state.map.is_adrift
        assert pose_estimate(state).places == 0
        # It is mapped apart: none of it is what was mapped before, and nothing of that contradicts the pose.
        newest = state.graph.keyframes[-1]
        assert newest.walls >= 5
        assert not np.isin(newest.ids, state.graph.keyframes[0].ids).any()
        assert state.contradictions == 0
        reaches = state.localizer.walls.reach[:, 1] > state.localizer.walls.reach[:, 0]
        np.testing.assert_array_equal(reaches, np.isin(state.map.ids, newest.ids))
    state = robot.view(state)
    assert np.abs(state.map.covariance[-3:, -3:]).max() < 0.05**2
    deviation = known_walls(state.map)[2]
    assert np.sort(deviation.max(axis=1))[len(walls) - 1] < 2.0 * before.max()
    error = se2.compose(np.array([2.5, 1.5, 0.0]), state.map.X_MD) - robot.X_WB
    error[2] = se2.wrap_angle(error[2])
    assert np.abs(error).max() < 0.03
    assert pose_estimate(state).places == -1


@pytest.mark.parametrize("off", [0.12, 3.0])
def test_it_is_lost_where_it_has_rather_been_carried_than_drifted(off, monkeypatch):
    """Of a place that is likely, but not certain."""

    def near(_known, _seen, prior, *_args, **_kwargs):
        return Places((prior.X + np.array([off, 0.0, 0.0]))[None], np.array([0.99]), np.ones(1, dtype=bool))

    monkeypatch.setattr(relocalizer, "find_places", near)
    robot = Robot()
    state = robot.view(process_odometry(initial_state(OdometryConfig(), landmarks="walls"), robot.odometry()))
    state = robot.drive(state, 0.2, 0.0, 10)
    state = find_itself(replace(state, contradictions=CONTRADICTIONS + 0.0, suspect=state.log[-1]), at_last=True)
    assert state.contradictions == (0.0 if off < 1.5 else CONTRADICTIONS)
    np.testing.assert_array_equal(state.log[-1].sigma, PLACED if off < 1.5 else KIDNAPPED)


def test_while_what_is_seen_contradicts_the_pose_it_is_not_known(monkeypatch):
    """Nor do a few looks that agree settle that: walls may fit a wrong pose."""
    monkeypatch.setattr(estimator, "find_itself", lambda state, *_args, **_kwargs: state)
    robot = Robot()
    sure = robot.view(process_odometry(initial_state(OdometryConfig(), landmarks="walls"), robot.odometry()))
    doubtful = replace(sure, contradictions=CONTRADICTIONS + 4.0)
    added = pose_estimate(doubtful).covariance - pose_estimate(sure).covariance
    np.testing.assert_allclose(added, np.diag(DRIFTED**2), atol=1e-12)
    some = robot.drive(doubtful, 0.0, 0.0, 5)
    assert CONTRADICTIONS <= some.contradictions < doubtful.contradictions
    many = robot.drive(some, 0.0, 0.0, 20)
    assert many.contradictions == 0
    assert np.all(np.diag(pose_estimate(many).covariance) < 0.1**2)


def turned_round(unfelt):
    """A robot that has mapped a room, drives on and turns there, and was carried before that turn, which its wheels do
    not know; its state at the end of the turn."""
    robot = Robot()
    state = process_odometry(initial_state(OdometryConfig(), landmarks="walls"), robot.odometry())
    state = robot.drive(robot.view(state), 0.2, 0.0, 10)
    robot.X_WB = robot.X_WB + unfelt
    robot.odometry = lambda speed=0.0, rate=0.0: Odometry(robot.time, robot.X_WB - unfelt, np.array([speed, rate]))
    return robot.drive(begin_turn(state, robot.time), 0.0, 0.5, 126)


def test_what_a_turn_sees_is_held_against_the_map(monkeypatch):
    """No frame's lines contradict the pose: the wrong place is told by what either has looked through."""
    monkeypatch.setattr(estimator, "find_itself", lambda state, *_args, **_kwargs: state)
    here = replace(turned_round(np.zeros(3)), contradictions=0)
    assert doubted(here) is here
    carried = replace(turned_round(np.array([1.2, 1.5, 0.8])), contradictions=0)
    suspicious = doubted(carried)
    assert (suspicious.contradictions, suspicious.suspect) == (CONTRADICTIONS, carried.turn)
    kidnapped = replace(carried, log=(replace(carried.turn, is_apart=True),))
    for state in (replace(carried, may_be_moved=False), kidnapped, replace(carried, log=())):
        assert doubted(state) is state


def test_what_is_seen_where_the_map_has_not_looked_contradicts_no_pose(monkeypatch):
    """The next room, nothing of the first in view."""
    monkeypatch.setattr(estimator, "find_itself", lambda state, *_args, **_kwargs: state)
    state = turned_round(np.zeros(3))
    beyond = replace(state, contradictions=0, log=(replace(state.turn, X_MB=np.array([7.5, 0.0, 0.0])),))
    assert doubted(beyond) is beyond


def test_a_robot_in_another_place_than_it_believes_finds_itself_at_the_end_of_a_turn():
    unfelt = np.array([1.2, 1.5, 0.8])
    state = turned_round(unfelt)
    state = end_turn(replace(state, contradictions=0), state.newest.stamp)
    true = state.newest.X_OB + unfelt
    error = se2.between(true, se2.compose(np.array([2.5, 1.5, 0.0]), state.map.X_MD))
    assert np.all(np.abs(error) < [0.05, 0.05, 0.02])


def observation(rng, points, X):
    p_ML = se2.transform(se2.inverse(PLACES[0]), points)
    X_MA = se2.between(PLACES[0], X)
    return observed(rng, p_ML, X_MA, X_AD, np.flatnonzero(np.hypot(*(points - X[:2]).T) < SEEN))


@pytest.fixture
def kidnapped():
    """Graph and map after two views, a lift by 11 m, and two more views; the view that sees both parts; the tags."""
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-4, 21, 60), rng.uniform(-4, 4, 60)])
    graph, estimate = empty_graph(exactly_known()), empty_map(exactly_known())
    for k, X in enumerate(PLACES[:4]):
        seen = observation(rng, points, X)
        if k > 0:
            X_DA = se2.between(se2.compose(PLACES[k - 1], X_AD), X)
            between = unknown_way(se2.compose(X_DA, GUESS)) if k == 2 else way(rng, X_DA)
            graph, estimate, _ = updated(graph, estimate, between, is_view=False)
        graph, estimate, rejected = updated(graph, estimate, seen)
        assert len(rejected) == 0
        graph, estimate = solve(graph, float(k), NOTHING)
    return graph, estimate, observation(rng, points, PLACES[4]), se2.transform(se2.inverse(PLACES[0]), points)


def before_the_view(graph, estimate, seen):
    """Graph and map as they are put together where the robot has come to a view by a way that it knows."""
    state = SimpleNamespace(graph=graph, map=estimate, placed=0.0, stamp=9.0, hypotheses=empty(Hypotheses))
    return found_again(state, (SimpleNamespace(keyframe=BETWEEN),), seen)[:2]


def joined(graph, estimate, seen):
    between = BETWEEN
    graph, estimate, _ = updated(graph, estimate, between, is_view=False)
    graph, _, rejected = updated(graph, estimate, seen)
    return *solve(graph, 9.0, NOTHING), rejected


def test_what_was_mapped_since_moves_to_its_place_and_no_tag_is_left_out(kidnapped):
    graph, estimate, seen, p_ML = kidnapped
    assert np.hypot(*(graph.p_ML - p_ML[graph.ids - 100]).T).max() > 2.0
    whole, _, rejected = joined(*before_the_view(graph, estimate, seen), seen)
    assert len(rejected) == 0
    assert np.hypot(*(whole.p_ML - p_ML[whole.ids - 100]).T).max() < 0.2
    # Without the move, a linearisation about the guess takes the old tags for moved ones.
    _, _, rejected = joined(graph, estimate, seen)
    assert len(rejected) > 0


def test_what_is_adrift_stays_where_it_begins(kidnapped):
    """Wherever that is: the rest of it follows, and its place is not known better than before."""
    graph, estimate, _, _ = kidnapped
    j = adrift(graph)
    assert j >= 0
    since, move = seen_by(graph, graph.keyframes[j + 1 :]), np.array([3.0, -7.0, 2.0])
    X_MN = graph.X_MN.copy()
    X_MN[j + 1 :] = se2.compose(move, X_MN[j + 1 :])
    there, after = solve(moved_part(replace(graph, X_MN=X_MN), since, move), 9.0, NOTHING)
    np.testing.assert_allclose(there.X_MN[j + 1], X_MN[j + 1], atol=1e-3)
    np.testing.assert_allclose(
        se2.between(there.X_MN[j + 1], there.X_MN[j + 1 :]), se2.between(X_MN[j + 1], X_MN[j + 1 :]), atol=1e-3
    )
    np.testing.assert_allclose(there.X_MN[: j + 1], graph.X_MN[: j + 1], atol=1e-3)
    assert estimate.is_adrift
    assert after.is_adrift
    assert adrift(there) == j


def test_nothing_moves_where_the_view_does_not_say_where_to(kidnapped):
    graph, estimate, seen, _ = kidnapped
    since = np.concatenate([one.ids for one in graph.keyframes[4:]])
    only_new = without_tags(seen, np.setdiff1d(graph.ids, since))
    assert before_the_view(graph, estimate, only_new)[0] is graph
    assert before_the_view(empty_graph(exactly_known()), estimate, seen)[1] is estimate
    whole, after, _ = joined(*before_the_view(graph, estimate, seen), seen)
    assert before_the_view(whole, after, seen)[0] is whole


def test_a_misread_id_is_outvoted(kidnapped):
    graph, estimate, seen, p_ML = kidnapped
    first = np.concatenate([one.ids for one in graph.keyframes[:3]])
    row = int(np.flatnonzero(np.isin(seen.ids, first))[0])
    y_AL = seen.y_AL.copy()
    y_AL[row] += 3.0
    whole, _, rejected = joined(*before_the_view(graph, estimate, replace(seen, y_AL=y_AL)), replace(seen, y_AL=y_AL))
    np.testing.assert_array_equal(rejected, seen.ids[row])
    assert np.hypot(*(whole.p_ML - p_ML[whole.ids - 100]).T).max() < 0.2


def sight(estimate, rows, X_MB):
    p_BL = se2.transform(se2.inverse(X_MB), estimate.p_ML[rows])
    r, b = np.hypot(*p_BL.T), np.arctan2(p_BL[:, 1], p_BL[:, 0])
    return TagDetections(0.0, estimate.ids[rows], r, b, 0.02 + 0.01 * r, np.full(len(rows), 0.01))


def test_a_tag_of_the_far_end_of_the_map_that_is_seen_here_is_elsewhere():
    """The localiser knows those near by for itself; a far one seen where the map has it is where it should be."""
    graph, estimate = solve(reckoned(ring(3, views=12, laps=0.5)[0]), 0.0, NOTHING, joint=20)
    state = SimpleNamespace(graph=graph, map=estimate, noise=SimpleNamespace(now=NOISE))
    distance = np.hypot(*(estimate.p_ML - estimate.X_MD[:2]).T)
    far = np.argsort(distance)[-3:]
    assert not np.isin(far, estimate.local).any()
    assert distance[far].min() > ELSEWHERE + 3.0

    def count(rows, ranges):
        seen = sight(estimate, rows, estimate.X_MD)
        return mapped_elsewhere(state, start_localizer(estimate), replace(seen, range=ranges))

    assert count(far, distance[far]) == 0
    assert count(far, np.full(3, 2.0)) == 3
    assert count(far, np.append(distance[far[:2]], 2.0)) == 1
    assert count(estimate.local[:3], np.full(3, 30.0)) == 0
    assert (
        mapped_elsewhere(
            SimpleNamespace(graph=graph, map=None), start_localizer(estimate), sight(estimate, far, estimate.X_MD)
        )
        == 0
    )
