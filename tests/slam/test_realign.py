"""A robot that was kidnapped maps on, and later sees what it had mapped before beside what it has mapped since."""

import numpy as np
import pytest

from tests.slam.rings import NOTHING, observed, way
from tfg_drake.geometry import se2
from tfg_drake.messages import replace
from tfg_drake.slam.estimator_state import unknown_way
from tfg_drake.slam.keyframe import without_tags
from tfg_drake.slam.keyframe_graph import empty_graph, empty_map
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.map_update import updated
from tfg_drake.slam.realign import realigned
from tfg_drake.slam.shared import exactly_known

SEEN, X_AD = 5.5, np.array([0.01, -0.02, 0.1])
PLACES = np.array([[0.0, 0.0, 0.3], [3.0, 0.0, -0.4], [14.0, 0.0, 1.0], [17.0, 0.0, 2.0], [8.5, 0.0, 0.5]])
# What the robot believes of where it was put, against where it is.
GUESS = np.array([2.0, -1.0, 0.6])


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
            between = unknown_way(se2.compose(X_DA, GUESS))[0].keyframe if k == 2 else way(rng, X_DA)
            graph, estimate, _ = updated(graph, estimate, between, is_view=False)
        graph, estimate, rejected = updated(graph, estimate, seen)
        assert len(rejected) == 0
        graph, estimate = solve(graph, float(k), NOTHING)
    return graph, estimate, observation(rng, points, PLACES[4]), se2.transform(se2.inverse(PLACES[0]), points)


def joined(graph, estimate, seen):
    between = way(np.random.default_rng(4), se2.between(se2.compose(PLACES[3], X_AD), PLACES[4]))
    graph, estimate, _ = updated(graph, estimate, between, is_view=False)
    graph, _, rejected = updated(graph, estimate, seen)
    return *solve(graph, 9.0, NOTHING), rejected


def test_what_was_mapped_since_moves_to_its_place_and_no_tag_is_left_out(kidnapped):
    graph, estimate, seen, p_ML = kidnapped
    assert np.hypot(*(graph.p_ML - p_ML[graph.ids - 100]).T).max() > 2.0
    whole, _, rejected = joined(*realigned(graph, estimate, seen), seen)
    assert len(rejected) == 0
    assert np.hypot(*(whole.p_ML - p_ML[whole.ids - 100]).T).max() < 0.2
    # Without the move, a linearisation about the guess takes the old tags for moved ones.
    _, _, rejected = joined(graph, estimate, seen)
    assert len(rejected) > 0


def test_nothing_moves_where_the_view_does_not_say_where_to(kidnapped):
    graph, estimate, seen, _ = kidnapped
    since = np.concatenate([one.ids for one in graph.keyframes[4:]])
    only_new = without_tags(seen, np.setdiff1d(graph.ids, since))
    assert realigned(graph, estimate, only_new)[0] is graph
    assert realigned(empty_graph(exactly_known()), estimate, seen)[1] is estimate
    whole, after, _ = joined(*realigned(graph, estimate, seen), seen)
    assert realigned(whole, after, seen)[0] is whole


def test_a_misread_id_moves_nothing(kidnapped):
    graph, estimate, seen, _ = kidnapped
    first = np.concatenate([one.ids for one in graph.keyframes[:3]])
    row = int(np.flatnonzero(np.isin(seen.ids, first))[0])
    y_AL = seen.y_AL.copy()
    y_AL[row] += 3.0
    assert realigned(graph, estimate, replace(seen, y_AL=y_AL))[0] is graph
