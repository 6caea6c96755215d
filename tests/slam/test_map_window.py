"""A window of a large map against the whole of it: a robot that goes round a block and comes back to where it began."""

import gtsam
import numpy as np
import pytest

from tfg_drake.geometry import se2
from tfg_drake.messages import GoalObservation, replace
from tfg_drake.slam import map_solver, map_window
from tfg_drake.slam.departure_frame import in_departure_frame
from tfg_drake.slam.goal_arrival import add_goal
from tfg_drake.slam.goal_factors import factor_graph, values_of
from tfg_drake.slam.goal_graph import empty_graph
from tfg_drake.slam.map_solver import restored, seen_from, settle, solve, whole
from tfg_drake.slam.map_window import (
    boundary_goals,
    link,
    smoothed_block,
    travelled_about_origin,
    travelled_covariance,
    window_goals,
    with_travel,
)

SEGMENT = np.diag([0.05, 0.05, 0.02]) ** 2
GOALS, RADIUS, SEEN = 36, 24.0, 5.5
X_AD = np.array([0.01, -0.02, 0.1])


def observation(rng, points, X):
    rows = np.flatnonzero(np.hypot(*(points - X[:2]).T) < SEEN)
    p = se2.transform(se2.inverse(X), points[rows])
    root = np.zeros((2 * len(rows) + 3, 2 * len(rows) + 4))
    for i in range(len(rows)):
        root[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = 0.02 * np.eye(2)
        root[2 * i : 2 * i + 2, -1] = -0.003 * p[i, 1], 0.003 * p[i, 0]
    root[-3:, -4:-1] = np.diag([0.003, 0.003, 0.002])
    error = root @ rng.standard_normal(root.shape[1])
    p_AL = p + error[:-3].reshape(-1, 2)
    return GoalObservation(rows, p_AL, X_AD + error[-3:], root @ root.T, np.empty(0), np.empty((0, 3)))


def block(goals=GOALS, seed=0):
    """The graph and map of the first goals on a circle of 36, and the landmarks in M; tags are seen 5.5 m far."""
    rng = np.random.default_rng(seed)
    angle, r = rng.uniform(0.0, 2.0 * np.pi, 220), RADIUS + rng.uniform(-3.0, 3.0, 220)
    points = r[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    a = 2.0 * np.pi * np.arange(goals) / GOALS
    X_WA = np.column_stack([RADIUS * np.cos(a), RADIUS * np.sin(a), se2.wrap_angle(a + 1.0)])
    graph, estimate = empty_graph(), None
    for k, X in enumerate(X_WA):
        seen = observation(rng, points, X)
        X_DA = np.zeros(3)
        if k > 0:
            X_WD = se2.compose(X_WA[k - 1], X_AD)
            X_DA = se2.between(X_WD, X) + np.sqrt(np.diag(SEGMENT)) * rng.standard_normal(3)
        graph, rejected = add_goal(graph, estimate, seen, X_DA, SEGMENT)
        assert len(rejected) == 0
        graph, estimate = solve(graph, float(k), seen)
    return graph, estimate, se2.transform(se2.inverse(X_WA[0]), points)


@pytest.fixture
def windows(monkeypatch):
    """Every map is large, and a window has about a dozen goals."""
    monkeypatch.setattr(map_window, "SMALL", 0)
    monkeypatch.setattr(map_window, "SIGHTINGS", 200)


def sigmas(estimate, rows):
    """Deviation of each landmark in some rows as seen from the departure pose."""
    _, P = in_departure_frame(estimate, rows)
    return np.sqrt(np.diag(P)[: 2 * len(rows)].reshape(-1, 2).sum(axis=1))


def test_a_small_map_is_solved_as_a_whole():
    graph, estimate, _ = block(6)
    np.testing.assert_array_equal(window_goals(graph, np.zeros(2)), np.arange(6))
    np.testing.assert_array_equal(estimate.local, np.arange(len(estimate.ids)))


def test_a_map_seen_over_and_over_is_no_small_one(monkeypatch):
    graph, _, _ = block()
    goals = window_goals(graph, graph.X_MA[-1, :2])
    np.testing.assert_array_equal(goals, np.arange(GOALS))
    monkeypatch.setattr(map_window, "SIGHTINGS", 200)
    monkeypatch.setattr(map_window, "SMALL_SIGHTINGS", graph.sightings.sum() - 1)
    assert len(window_goals(graph, graph.X_MA[-1, :2])) < GOALS


def test_the_window_is_what_lies_nearest_and_the_newest_goal(windows):
    graph, estimate, _ = block()
    here = window_goals(graph, graph.X_MA[-1, :2])
    assert 6 < len(here) < 24
    # Newest and oldest goals: the way is a circle.
    assert {0, 1, GOALS - 2, GOALS - 1} <= set(here.tolist())
    assert GOALS // 2 not in here
    there = window_goals(graph, graph.X_MA[GOALS // 2, :2])
    assert there[-1] == GOALS - 1
    assert {GOALS // 2 - 1, GOALS // 2, GOALS // 2 + 1} <= set(there.tolist())
    beyond = boundary_goals(graph, here, graph.X_MA[-1, :2])
    assert len(beyond)
    assert not np.isin(beyond, here).any()
    assert len(estimate.local) < len(estimate.ids)
    far = seen_from(graph, estimate, GOALS // 2)
    np.testing.assert_array_equal(far.X_MD, graph.X_MD[GOALS // 2])
    assert np.isin(np.searchsorted(graph.ids, graph.observations[GOALS // 2].ids), far.local).all()


def test_the_window_knows_its_neighbourhood_as_the_whole_map_does(windows):
    graph, estimate, _ = block()
    _, everything = whole(graph, 0.0, graph.observations[-1].observation)
    near = np.searchsorted(graph.ids, graph.observations[-1].ids)
    np.testing.assert_allclose(sigmas(estimate, near), sigmas(everything, near), rtol=0.02)
    ratio = sigmas(estimate, estimate.local) / sigmas(everything, estimate.local)
    assert ratio.min() > 0.98
    assert ratio.max() < 1.5
    # Absolutely, it never claims more than the whole does.
    own = np.trace(estimate.landmark_covariance, axis1=1, axis2=2)
    assert np.all(own > 0.98 * np.trace(everything.landmark_covariance, axis1=1, axis2=2))
    assert abs(estimate.entropy - everything.entropy) < 0.002 * abs(everything.entropy)


def test_a_loop_about_to_close_is_as_loose_as_it_is(windows):
    graph, estimate, _ = block(GOALS - 3)
    goals = window_goals(graph, graph.X_MA[-1, :2])
    assert np.diff(goals).max() > 1
    _, everything = whole(graph, 0.0, graph.observations[-1].observation)
    across = np.searchsorted(graph.ids, graph.observations[0].ids)
    ratio = sigmas(estimate, across) / sigmas(everything, across)
    assert ratio.min() > 0.9
    assert ratio.max() < 1.5


def test_what_a_block_of_the_way_was_told_makes_a_loop_about_to_close_less_loose(windows, monkeypatch):
    # Windows large enough to know two blocks and a half, but not the loop.
    monkeypatch.setattr(map_window, "SIGHTINGS", 320)
    across, off = None, []
    for length in (4, 1000):
        monkeypatch.setattr(map_window, "BLOCK", length)
        graph, estimate, _ = block(GOALS - 3)
        assert np.diff(window_goals(graph, graph.X_MA[-1, :2])).max() > 1
        across = np.searchsorted(graph.ids, graph.observations[0].ids)
        _, everything = whole(graph, 0.0, graph.observations[-1].observation)
        off.append(sigmas(estimate, across).mean() / sigmas(everything, across).mean())
    assert 0.97 < off[0] < 1.0 + 0.8 * (off[1] - 1.0)


def test_a_way_begun_while_the_map_was_small_is_told_anew_too(monkeypatch):
    deviation = []
    for length in (4, 1000):
        monkeypatch.setattr(map_window, "BLOCK", length)
        graph, _, _ = block(16)
        assert len(window_goals(graph, graph.X_MA[-1, :2])) == 16
        deviation.append(np.sqrt(np.diag(link(graph, travelled_covariance(graph), 0, 12)[1])))
    assert (deviation[0] < 0.85 * deviation[1]).all()


def test_goals_beyond_the_window_tell_what_they_have_seen_of_its_edge(windows, monkeypatch):
    graph, _, _ = block()
    goals = window_goals(graph, graph.X_MA[-1, :2])
    beyond = boundary_goals(graph, goals, graph.X_MA[-1, :2])
    edge = np.intersect1d(
        np.concatenate([graph.observations[k].ids for k in goals]),
        np.concatenate([graph.observations[k].ids for k in beyond]),
    )
    rows, observation = np.searchsorted(graph.ids, edge), graph.observations[-1].observation
    _, everything = whole(graph, 0.0, observation)
    with_them = sigmas(restored(graph, 0.0, observation), rows) / sigmas(everything, rows)
    monkeypatch.setattr(map_solver, "boundary_goals", lambda *_: np.zeros(0, dtype=np.int64))
    without = sigmas(restored(graph, 0.0, observation), rows) / sigmas(everything, rows)
    assert np.all(with_them < without + 1e-9)
    assert with_them.mean() < 1.0 + 0.8 * (without.mean() - 1.0)


def test_travel_told_anew_adds_up_and_each_leg_keeps_its_share(windows):
    graph, _, _ = block(12)
    told = 0.5 * link(graph, travelled_covariance(graph), 2, 10)[1]
    again = with_travel(graph, 2, 10, travelled_about_origin(graph, 2, 10, told))
    legs = again.travel_covariance[2:10] / graph.travel_covariance[2:10]
    assert 0.3 < legs[:, 0, 0].min() < legs[:, 0, 0].max() < 0.8
    np.testing.assert_array_equal(again.travel_covariance[:2], graph.travel_covariance[:2])
    # A link ends where its last turn begins, told as if with it; the turn is small here.
    np.testing.assert_allclose(link(again, travelled_covariance(again), 2, 10)[1], told, rtol=0.05, atol=1e-6)


def test_travel_that_rounding_made_no_covariance_stays_as_it_was():
    graph, _, _ = block(12)
    assert with_travel(graph, 2, 10, np.diag([1e-3, 1e-3, -1e-12])) is graph


def test_each_block_of_the_way_is_told_anew_once():
    graph, _, _ = block(34)
    goals = np.arange(34)
    blocks = []
    for k in range(3, 34):
        short = replace(graph, observations=graph.observations[:k], is_goal=graph.is_goal[:k])
        blocks.append(smoothed_block(short, goals[:k]))
    assert [found for found in blocks if found] == [(0, 8), (0, 8, 16), (8, 16, 24)]
    # Where the window does not reach back to the block before, the newest is told by itself.
    short = replace(graph, observations=graph.observations[:33], is_goal=graph.is_goal[:33])
    assert smoothed_block(short, goals[16:33]) == (16, 24)
    assert smoothed_block(short, goals[20:33]) == ()


def test_a_link_is_what_its_legs_add_up_to(windows):
    graph, _, _ = block(8)
    rng = np.random.default_rng(1)
    X_DA, covariance = link(graph, travelled_covariance(graph), 1, 6)
    np.testing.assert_allclose(X_DA, se2.between(graph.X_MD[1], graph.X_MA[6]), atol=1e-12)
    legs = [se2.between(graph.X_MD[j], graph.X_MD[j + 1]) for j in range(1, 6)]
    # To D_6: the turn at goal 6 is no part of the link, but small.
    samples = np.tile(np.zeros(3), (20000, 1))
    for j, leg in enumerate(legs, start=1):
        noise = rng.multivariate_normal(np.zeros(3), graph.travel_covariance[j], len(samples))
        samples = se2.compose(samples, leg + noise)
    expected = np.cov((samples - samples.mean(axis=0)).T)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), np.sqrt(np.diag(expected)), rtol=0.05)
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(covariance / np.outer(scale, scale), expected / np.outer(scale, scale), atol=0.1)


def test_a_link_over_legs_known_better_than_a_turn_by_itself_is_a_covariance(windows):
    """Legs are known by all tags on arrival, a turn's own factor by what it saw."""
    graph, _, _ = block(8)
    graph = replace(graph, travel_covariance=1e-6 * graph.travel_covariance)
    legs = travelled_covariance(graph)
    for i, j in ((1, 3), (1, 6), (4, 7)):
        assert np.linalg.eigvalsh(link(graph, legs, i, j)[1])[0] > 0.0


def test_the_windows_optimum_is_that_of_the_whole(windows):
    graph, estimate, _ = block()
    graph = settle(graph)
    moved, rim = map_solver._settle_window(graph, window_goals(graph, graph.X_MA[-1, :2]))
    np.testing.assert_allclose(moved.p_ML, graph.p_ML, atol=1e-4)
    np.testing.assert_allclose(moved.X_MA, graph.X_MA, atol=1e-4)
    assert rim < 1e-4
    assert restored(graph, estimate.stamp, estimate.observation).stage == GOALS


def test_a_window_out_of_shape_is_mended_and_nothing_else_touched(windows):
    graph, _, _ = block()
    graph = settle(graph)
    goals = window_goals(graph, graph.X_MA[-1, :2])
    rng = np.random.default_rng(2)
    bent = graph.X_MA.copy()
    bent[goals[-3:]] += 0.05 * rng.standard_normal((3, 3))
    disturbed = replace(graph, X_MA=bent)
    error = factor_graph(graph).error
    mended, _ = map_solver._settle_window(disturbed, goals)
    assert error(values_of(mended)) < 1.001 * error(values_of(graph)) < error(values_of(disturbed))
    outside = np.setdiff1d(np.arange(GOALS), goals)
    np.testing.assert_array_equal(mended.X_MA[outside], graph.X_MA[outside])


def test_pieces_of_the_way_are_goals_like_others(windows):
    """Each goal is reached over a piece that is mapped, from half way on."""
    rng = np.random.default_rng(3)
    angle, r = rng.uniform(0.0, 2.0 * np.pi, 220), RADIUS + rng.uniform(-3.0, 3.0, 220)
    points = r[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    a = 2.0 * np.pi * np.arange(24) / GOALS
    X_WA = np.column_stack([RADIUS * np.cos(a), RADIUS * np.sin(a), se2.wrap_angle(a + 1.0)])
    graph, estimate = empty_graph(), None
    for k, X in enumerate(X_WA):
        way = ()
        if k > 0:
            X_WD = se2.compose(X_WA[k - 1], X_AD)
            piece = observation(rng, points, X_WD)
            motion = se2.between(X_WD, X) + np.sqrt(np.diag(SEGMENT)) * rng.standard_normal(3)
            joint = piece.covariance.copy()
            joint[-3:, -3:] = SEGMENT
            way = (replace(piece, X_AD=motion, covariance=joint),)
        seen = observation(rng, points, X)
        graph, rejected = add_goal(graph, estimate, seen, np.zeros(3), SEGMENT, way)
        assert len(rejected) == 0
        graph, estimate = solve(graph, float(k), seen)
    assert len(estimate.local) < len(estimate.ids)
    assert np.isfinite(graph.departure_covariance[graph.is_goal]).all()
    assert not np.isfinite(graph.departure_covariance[~graph.is_goal]).any()
    _, everything = whole(graph, 0.0, seen)
    ratio = sigmas(estimate, estimate.local) / sigmas(everything, estimate.local)
    assert 0.98 < ratio.min() < ratio.max() < 1.5
    error = se2.transform(X_WA[0], everything.p_ML) - points[everything.ids]
    assert np.hypot(*error.T).max() < 4.0 * np.sqrt(np.trace(everything.landmark_covariance, axis1=1, axis2=2)).max()


def test_windows_lead_to_the_map_that_whole_solves_lead_to(monkeypatch):
    _, expected, _ = block()
    monkeypatch.setattr(map_window, "SMALL", 0)
    monkeypatch.setattr(map_window, "SIGHTINGS", 200)
    graph, estimate, _ = block()
    # Where a window moved what others rest on, as when the loop closed, all were solved: never far off.
    np.testing.assert_allclose(graph.p_ML, expected.p_ML, atol=0.03)
    _, settled = whole(graph, 0.0, estimate.observation)
    np.testing.assert_allclose(settled.p_ML, expected.p_ML, atol=1e-3)
    own, others = settled.landmark_covariance, expected.landmark_covariance
    np.testing.assert_allclose(own, others, atol=0.02 * others.max())
    assert settled.entropy == pytest.approx(expected.entropy, abs=0.5)


def test_of_a_map_too_large_to_be_known_jointly_each_landmark_is_known_in_the_end(windows, monkeypatch):
    graph, estimate, _ = block()
    _, jointly = whole(graph, 0.0, estimate.observation)
    monkeypatch.setattr(map_solver, "MOST_JOINT", 0)
    settled, each = whole(graph, 0.0, estimate.observation)
    assert len(each.local) < len(each.ids)
    assert np.abs(each.landmark_covariance / jointly.landmark_covariance - 1.0).max() < 1e-3
    np.testing.assert_array_equal(settled.landmark_covariance, each.landmark_covariance)


def test_a_window_saves_the_solve_of_the_whole(windows, monkeypatch):
    calls = []
    monkeypatch.setattr(map_solver, "settle", lambda graph: calls.append(len(graph.observations)) or settle(graph))
    block(GOALS - 4)
    # While the map is small and, perhaps, where a goal bends the way behind it; not at every goal.
    assert len(calls) < 20
    assert calls[-1] < GOALS - 6


def test_a_misread_id_of_a_tag_far_away_is_left_out(windows):
    graph, estimate, points = block(24)
    rng = np.random.default_rng(5)
    origin = np.array([RADIUS, 0.0, 1.0])
    X = se2.compose(se2.compose(origin, graph.X_MD[-1]), np.array([0.5, 0.0, 0.0]))
    seen = observation(rng, se2.transform(origin, points), X)
    far = graph.observations[3].ids[0]
    assert far not in graph.ids[estimate.local]
    ids = seen.ids.copy()
    ids[0] = far
    order = np.argsort(ids)
    rows = np.append(np.repeat(2 * order, 2) + np.tile([0, 1], len(order)), 2 * len(order) + np.arange(3))
    misread = replace(seen, ids=ids[order], p_AL=seen.p_AL[order], covariance=seen.covariance[np.ix_(rows, rows)])
    _, rejected = add_goal(graph, estimate, misread, np.array([0.5, 0.0, 0.0]), SEGMENT)
    assert rejected.tolist() == [far]


def test_the_anchor_is_what_is_known_best_but_never_what_is_not_known_yet(windows):
    graph, _, _ = block()
    goals = window_goals(graph, graph.X_MA[-1, :2])
    anchor = map_window.anchor_goal(graph, goals)
    spread = graph.departure_covariance[goals[:-1]][:, [0, 1], [0, 1]].sum(axis=1)
    assert anchor == goals[np.argmin(spread)] == 0
    unknown = graph.departure_covariance.copy()
    unknown[goals[goals != goals[5]]] = np.inf
    assert map_window.anchor_goal(replace(graph, departure_covariance=unknown), goals) == goals[5]


def test_a_map_that_hangs_on_nothing_any_more_keeps_its_shape():
    """Two points a known distance apart whose place has rounded to less than nothing."""
    free = -1e-7 * np.eye(4)
    tie = np.kron(np.array([[1.0, -1.0], [-1.0, 1.0]]), 1e4 * np.eye(2))
    factor = map_solver._cholesky(free + tie)
    covariance = np.linalg.inv(factor.T @ factor)
    J = np.hstack([np.eye(2), -np.eye(2)])
    np.testing.assert_allclose(J @ covariance @ J.T, 1e-4 * np.eye(2), rtol=1e-3)
    assert np.sqrt(covariance[0, 0]) < 2.0 * map_solver.LOOSEST


@pytest.fixture
def bent():
    """The graph of twenty goals, the last ten headings 1.5 rad off: a Gauss-Newton step goes too far."""
    graph = block(20)[0]
    return replace(graph, X_MA=graph.X_MA + np.outer(np.arange(20) >= 10, [0.0, 0.0, 1.5]))


@pytest.mark.parametrize("shares", [map_solver.SHARES, ()], ids=["a part of the step", "Levenberg-Marquardt"])
def test_where_gauss_newton_goes_too_far_the_optimum_is_found(bent, monkeypatch, shares):
    monkeypatch.setattr(map_solver, "SHARES", shares)
    asked = levenberg_marquardt(monkeypatch, gtsam.LevenbergMarquardtParams())
    factors = factor_graph(bent)
    error, best = (factors.error(values_of(settle(graph))) for graph in (bent, block(20)[0]))
    assert error == pytest.approx(best, rel=1e-9)
    assert len(asked) == (not shares)


@pytest.mark.parametrize("shares", [(1e-6,), ()], ids=["a part of the step", "Levenberg-Marquardt"])
def test_where_it_creeps_no_more_is_asked_for(bent, monkeypatch, shares):
    monkeypatch.setattr(map_solver, "SHARES", shares)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(1)
    parameters.setlambdaInitial(1e12)
    parameters.setlambdaUpperBound(1e13)
    asked = levenberg_marquardt(monkeypatch, parameters)
    factors = factor_graph(bent)
    before, after = (factors.error(values_of(graph)) for graph in (bent, settle(bent)))
    assert (1.0 - map_solver.CREEPING) * before < after < before
    assert len(asked) == (not shares)


def levenberg_marquardt(monkeypatch, parameters):
    """A list that grows whenever the solver asks for Levenberg-Marquardt, which it gets with these parameters."""
    asked, optimizer = [], gtsam.LevenbergMarquardtOptimizer
    monkeypatch.setattr(
        map_solver.gtsam,
        "LevenbergMarquardtOptimizer",
        lambda factors, values: asked.append(1) or optimizer(factors, values, parameters),
    )
    return asked
