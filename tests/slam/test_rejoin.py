"""A robot that was carried away maps on, and later sees what it had mapped before beside what it has mapped since."""

import numpy as np
import pytest

from tests.slam.test_map_window import SEGMENT, X_AD, observation
from tfg_drake.geometry import se2
from tfg_drake.slam.estimator_state import CARRIED
from tfg_drake.slam.goal_arrival import add_goal
from tfg_drake.slam.goal_graph import empty_graph, without_tags
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.rejoin import rejoined

PLACES = np.array([[0.0, 0.0, 0.3], [3.0, 0.0, -0.4], [14.0, 0.0, 1.0], [17.0, 0.0, 2.0], [8.5, 0.0, 0.5]])
# What the robot believes of where it was carried to, against where it is.
GUESS = np.array([2.0, -1.0, 0.6])


@pytest.fixture
def carried():
    """Graph and map after two goals, a lift by 11 m, and two more goals; the goal that sees both parts; the tags."""
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-4, 21, 60), rng.uniform(-4, 4, 60)])
    graph, estimate = empty_graph(), None
    for k, X in enumerate(PLACES[:4]):
        seen = observation(rng, points, X)
        X_DA, covariance = np.zeros(3), SEGMENT
        if k > 0:
            X_DA = se2.between(se2.compose(PLACES[k - 1], X_AD), X)
        if k == 2:
            X_DA, covariance = se2.compose(X_DA, GUESS), np.diag(CARRIED) ** 2
        graph, rejected = add_goal(graph, estimate, seen, X_DA, covariance)
        assert len(rejected) == 0
        graph, estimate = solve(graph, float(k), seen)
    X_MW = se2.inverse(PLACES[0])
    return graph, estimate, observation(rng, points, PLACES[4]), se2.transform(X_MW, points)


def joined(graph, estimate, seen):
    X_DA = se2.between(se2.compose(PLACES[3], X_AD), PLACES[4])
    graph, rejected = add_goal(graph, estimate, seen, X_DA, SEGMENT)
    return solve(graph, 9.0, seen)[0], rejected


def test_what_was_mapped_since_moves_to_its_place_and_no_tag_is_left_out(carried):
    graph, estimate, seen, p_ML = carried
    assert np.hypot(*(graph.p_ML - p_ML[graph.ids]).T).max() > 2.0
    whole, rejected = joined(*rejoined(graph, estimate, seen), seen)
    assert len(rejected) == 0
    assert np.hypot(*(whole.p_ML - p_ML[whole.ids]).T).max() < 0.2
    # Without the move, a linearisation about the guess takes the old tags for moved ones.
    _, rejected = joined(graph, estimate, seen)
    assert len(rejected) > 0


def test_nothing_moves_where_the_goal_does_not_say_where_to(carried):
    graph, estimate, seen, _ = carried
    since = np.concatenate([one.ids for one in graph.observations[2:]])
    only_new = without_tags(seen, np.setdiff1d(graph.ids, since))
    assert rejoined(graph, estimate, only_new)[0] is graph
    assert rejoined(graph, None, seen) == (graph, None)
    whole, _ = joined(*rejoined(graph, estimate, seen), seen)
    assert rejoined(whole, estimate, seen)[0] is whole


def test_a_misread_id_moves_nothing(carried):
    graph, estimate, seen, _ = carried
    first = np.concatenate([one.ids for one in graph.observations[:2]])
    row = int(np.flatnonzero(np.isin(seen.ids, first))[0])
    p_AL = seen.p_AL.copy()
    p_AL[row] += 3.0
    assert rejoined(graph, estimate, type(seen)(**{**vars(seen), "p_AL": p_AL}))[0] is graph
