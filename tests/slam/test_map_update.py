import numpy as np
import pytest

from tests.slam.oracle import NOISE, PRIOR, SIGMA, Drive
from tests.slam.rings import NOTHING, built, dense_solution, observed, reckoned, ring, way
from tests.slam.test_keyframe import looks_at_walls
from tfg_drake.geometry import se2
from tfg_drake.messages import replace
from tfg_drake.slam import map_update
from tfg_drake.slam.keyframe import without_tags
from tfg_drake.slam.keyframe_graph import empty_graph, empty_map
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.map_update import LOOSER, deviation_of, distance_to, finished, is_looser, needs_solve, updated
from tfg_drake.slam.shared import RANGE_SCALE, SHARED, exactly_known
from tfg_drake.slam.turn import reduced


def test_exact_without_noise():
    keyframes, p_ML, X_MN = ring(1, noise=0.0)
    graph, estimate = built(keyframes)
    np.testing.assert_allclose(estimate.p_ML, p_ML[estimate.ids - 100], atol=1e-9)
    np.testing.assert_allclose(se2.between(estimate.X_MD, X_MN[-1]), np.zeros(3), atol=1e-9)
    np.testing.assert_allclose(se2.between(X_MN, graph.X_MN), np.zeros((len(X_MN), 3)), atol=1e-9)
    assert estimate.stage == 24


def test_one_update_is_a_dense_solution_of_both():
    """From a solved graph, one keyframe more that hardly moves anything."""
    keyframes, _, _ = ring(2, noise=0.02, views=40, laps=0.4)
    graph, estimate = solve(reckoned(keyframes[:-1]), 0.0, NOTHING)
    graph, estimate, _ = updated(graph, estimate, keyframes[-1])
    graph, estimate = finished(graph, estimate, 1.0, NOTHING)
    X_MN, p_ML, _, P = dense_solution(graph)
    n = 2 * len(graph.ids)
    at = np.append(np.arange(n), np.arange(len(P) - 3 - SHARED, len(P) - SHARED))
    expected = P[np.ix_(at, at)]
    deviation = np.sqrt(np.diag(expected))
    assert np.abs((estimate.p_ML - p_ML).ravel() / deviation[:-3]).max() < 1e-3
    np.testing.assert_allclose(estimate.X_MD, X_MN[-1], atol=1e-5)
    assert np.abs((estimate.covariance - expected) / np.outer(deviation, deviation)).max() < 2e-3
    entropy = 0.5 * np.linalg.slogdet(2.0 * np.pi * np.e * expected[:-3, :-3])[1]
    assert abs(estimate.entropy - entropy) < 0.02


def test_consistent(nees):
    landmarks, poses = [], []
    for seed in range(12):
        keyframes, p_ML, X_MN = ring(seed, views=12, tags=60)
        _, estimate = built(keyframes)
        landmarks.append(nees((estimate.p_ML - p_ML[estimate.ids - 100]).ravel(), estimate.covariance[:-3, :-3]))
        poses.append(nees(se2.between(X_MN[-1], estimate.X_MD), estimate.covariance[-3:, -3:]))
    assert 0.85 < np.mean(landmarks) < 1.15
    assert 0.5 < np.mean(poses) < 1.6


def test_moved_tags_are_left_out_and_named():
    keyframes, p_ML, _ = ring(4)
    graph, estimate = built(keyframes[:4])
    view = keyframes[4]
    known = np.flatnonzero(np.isin(view.ids, graph.ids))
    y_AL = view.y_AL.copy()
    y_AL[known[:2]] += 1.5
    graph, estimate, rejected = updated(graph, estimate, replace(view, y_AL=y_AL))
    np.testing.assert_array_equal(rejected, view.ids[known[:2]])
    assert len(graph.keyframes[-1].ids) == len(view.ids) - 2
    assert np.abs(estimate.p_ML - p_ML[estimate.ids - 100]).max() < 0.3


def test_a_way_without_tags_hangs_on_odometry():
    rng = np.random.default_rng(6)
    ways = [way(rng, np.array([2.0, 0.0, 0.5]), noise=0.0) for _ in range(2)]
    _, estimate = built(ways)
    np.testing.assert_allclose(estimate.X_MD, [2.0 + 2.0 * np.cos(0.5), 2.0 * np.sin(0.5), 1.0], atol=1e-12)
    assert estimate.entropy == 0.0
    assert estimate.stage == 0


def test_a_map_that_is_not_solved_anew_is_as_if_it_were():
    """Round a ring and on: what is put off between two solves moves no landmark by a twentieth of its deviation."""
    keyframes, _, _ = ring(7, views=40, laps=1.2)
    graph, estimate = empty_graph(exactly_known()), empty_map(exactly_known())
    last, solves = graph, []
    for number, one in enumerate(keyframes):
        graph, estimate, _ = updated(graph, estimate, one, is_view=len(one.ids) > 0)
        if needs_solve(graph, last, estimate):
            graph, estimate = solve(graph, float(number), NOTHING)
            last = graph
            solves.append(number)
            continue
        graph, estimate = finished(graph, estimate, float(number), NOTHING)
        if number % 8 == 7:
            whole, exact = solve(graph, float(number), NOTHING)
            deviation = np.sqrt(np.diag(exact.covariance)[:-3]).reshape(-1, 2)
            assert np.abs((estimate.p_ML - whole.p_ML) / deviation).max() < 0.05
    assert 0 < len(solves) < 0.5 * len(keyframes)


def test_a_tag_seen_for_the_first_time_is_known_as_its_keyframe_knows_it():
    rng = np.random.default_rng(8)
    p_ML = np.array([[3.0, 1.0], [2.0, -1.0], [5.0, 0.0]])
    first = observed(rng, p_ML, np.zeros(3), np.array([0.1, 0.0, 0.2]), np.arange(3))
    _, estimate, _ = updated(empty_graph(exactly_known()), empty_map(exactly_known()), first)
    p_AL, X_AD, covariance = first.given(np.zeros(SHARED))
    np.testing.assert_allclose(estimate.p_ML, p_AL)
    np.testing.assert_allclose(estimate.X_MD, X_AD)
    # The parameters that are known to be zero are so to a millionth.
    np.testing.assert_allclose(estimate.covariance, covariance, atol=1e-9)


def test_after_each_update_of_a_drive_all_is_as_a_solve_would_have_it():
    """Parameters and map, jointly: the parameters are as far off as their data sheets let them be."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        robot = Drive(rng.uniform(-8.0, 8.0, (30, 2)), SIGMA * rng.normal(size=SHARED), seed)
        graph, estimate = empty_graph(PRIOR), empty_map(PRIOR)
        for one in [(0.0, 0.6, 10.5), (0.4, 0.1, 4.0), (0.0, 0.6, 10.5), (0.4, -0.15, 5.0), (0.0, -0.6, 8.0)]:
            seen = reduced(NOISE, robot.piece(*one), graph.shared).keyframe
            graph, estimate, rejected = updated(graph, estimate, seen)
            assert len(rejected) == 0
            graph, estimate = finished(graph, estimate, 0.0, NOTHING)
            whole, exact = solve(replace(graph, p_ML=estimate.p_ML), 0.0, NOTHING)
            deviation = np.sqrt(np.diag(exact.joint_covariance))
            off = np.concatenate(
                [(estimate.p_ML - exact.p_ML).ravel(), estimate.X_MD - exact.X_MD, estimate.shared - exact.shared]
            )
            assert np.abs(off / deviation).max() < 0.05
            share = (estimate.joint_covariance - exact.joint_covariance) / np.outer(deviation, deviation)
            assert np.abs(share).max() < 0.03
            assert abs(estimate.entropy - whole.entropy) < 0.05


def test_ways_in_another_unit_are_taken_in_as_a_solve_would():
    """A way without tags is in the unit of distance: what turns tell of its scale moves its end."""
    keyframes, _, _ = ring(11, views=6, laps=0.2, shared=0.5 * SIGMA)
    graph, estimate = built(keyframes, PRIOR)
    whole, exact = solve(replace(graph, p_ML=estimate.p_ML), 0.0, NOTHING)
    deviation = np.sqrt(np.diag(exact.joint_covariance))
    assert np.abs((estimate.shared - whole.shared.mean) / deviation[-SHARED:]).max() < 0.05
    assert np.abs((estimate.p_ML - exact.p_ML).ravel() / deviation[: -3 - SHARED]).max() < 0.05


@pytest.mark.parametrize("new", [[0], [0, 1], [1]])
def test_an_update_by_walls_is_a_dense_solution(new):
    """Two walls and two tags, some of the walls seen by the last keyframe alone; each keyframe has its own anchors."""
    *before, last = looks_at_walls()
    gone = last.ids[new]
    graph, estimate = solve(reckoned([without_tags(one, gone) for one in before]), 0.0, NOTHING)
    graph, estimate, rejected = updated(graph, estimate, last)
    assert not len(rejected)
    # Before it is finished, too: of a large map the next solve depends on it.
    off = distance_to(estimate, estimate.X_MD)
    _, estimate = finished(graph, estimate, 1.0, NOTHING)
    np.testing.assert_array_equal(off, distance_to(estimate, estimate.X_MD))
    X_MN, p_ML, _, P = dense_solution(graph)
    at = np.append(np.arange(8), np.arange(14, 17))
    expected = P[np.ix_(at, at)]
    deviation = np.sqrt(np.diag(expected))
    assert np.abs((estimate.p_ML - p_ML).ravel() / deviation[:-3]).max() < 0.05
    assert np.abs((estimate.X_MD - X_MN[-1]) / deviation[-3:]).max() < 0.05
    assert np.abs((estimate.covariance - expected) / np.outer(deviation, deviation)).max() < 0.02
    # A wall that is new has the keyframe's anchor, where that was seen.
    X_MA = graph.X_MN[-2]
    np.testing.assert_allclose(estimate.anchor[new], se2.transform(X_MA, last.anchor[new]), atol=0.02)


def test_a_wall_that_contradicts_all_else_is_left_out():
    first, second, last = looks_at_walls()
    graph, estimate = solve(reckoned([first, second]), 0.0, NOTHING)
    y_AL = last.y_AL.copy()
    y_AL[1, 1] += 0.6
    graph, _, rejected = updated(graph, estimate, replace(last, y_AL=y_AL))
    np.testing.assert_array_equal(rejected, last.ids[1:2])
    np.testing.assert_array_equal(graph.keyframes[-1].ids, last.ids[[0, 2, 3]])


@pytest.fixture
def just_solved():
    """Graph and map of half a ring, solved."""
    keyframes, _, _ = ring(9, views=10, laps=0.5)
    return solve(reckoned(keyframes, PRIOR), 0.0, NOTHING)


def with_a_landmark_moved(estimate, _, metres):
    p_ML = estimate.p_ML.copy()
    p_ML[3, 1] -= metres
    return replace(estimate, p_ML=p_ML)


def with_a_heading_that_bends_the_map_by(estimate, _, metres):
    """Its deviation takes what is 5 m beyond the robot so far off the tangent of a turn about the origin."""
    radius, angle = np.hypot(*estimate.X_MD[:2]) + 5.0, 0.0
    while radius * (1.0 - np.cos(angle)) < metres:
        angle += 1e-5
    covariance = estimate.covariance.copy()
    covariance[-1, -1] = angle**2
    return replace(estimate, covariance=covariance)


def with_a_parameter_moved(estimate, shared, deviations):
    return replace(estimate, shared=shared.mean - deviations * shared.sigma * np.eye(SHARED)[RANGE_SCALE])


@pytest.mark.parametrize(
    ("changed", "little", "much"),
    [
        (with_a_landmark_moved, 0.04, 0.06),
        (with_a_heading_that_bends_the_map_by, 0.0029, 0.0031),
        (with_a_parameter_moved, 0.9, 1.1),
    ],
)
def test_any_one_thing_that_has_changed_so_far_has_the_graph_solved(just_solved, changed, little, much):
    graph, estimate = just_solved
    assert not needs_solve(graph, graph, estimate)
    assert not needs_solve(graph, graph, changed(estimate, graph.shared, little))
    assert needs_solve(graph, graph, changed(estimate, graph.shared, much))


def test_a_pose_that_scan_points_may_tell_better_has_the_graph_solved(just_solved):
    graph, estimate = just_solved
    points = np.array([[2.0, 1.0, -1.0, 0.0]])
    seen = replace(graph, keyframes=(*graph.keyframes[:-1], replace(graph.keyframes[-1], points=points)))
    now = deviation_of(estimate)
    looser = np.sqrt(np.square(now) + np.diag(np.square(1.1 * LOOSER)))
    assert not is_looser(seen, estimate, now)
    covariance = estimate.covariance.copy()
    covariance[-3, -3] += (1.1 * LOOSER[0]) ** 2
    less_known = replace(estimate, covariance=covariance)
    np.testing.assert_allclose(deviation_of(less_known), [looser[0, 0], now[1]])
    assert is_looser(seen, less_known, now)
    assert not is_looser(graph, less_known, now)


def test_the_landmarks_nearest_to_the_robot_are_to_be_known_jointly(just_solved, monkeypatch):
    graph, _ = just_solved
    monkeypatch.setattr(map_update, "NEAREST", 20)
    for joint, enough in ((15, False), (25, True)):
        graph, estimate = solve(graph, 0.0, NOTHING, joint=joint)
        assert len(estimate.local) == joint < len(graph.ids)
        assert needs_solve(graph, graph, estimate) != enough
