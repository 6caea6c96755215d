import dataclasses

import numpy as np
import pytest

from tests.planning.test_roadmap import PARAMETERS, PLANNER, ROBOT
from tfg_drake.messages import replace
from tfg_drake.planning.roadmap import Edges, empty_roadmap
from tfg_drake.planning.routes import routes
from tfg_drake.tfg.graph import empty_map


def diamond(narrow, *, only_narrow=False, aside=1.0):
    """Two ways from the robot at the origin to node 3: the shorter by node 1, with this clearance, m, or by node 2, so
    many metres aside."""
    points = np.array([[0.0, 0.0], [2.0, 0.5], [2.0, -aside], [4.0, 0.0]])
    nodes = np.array([[0, 1], [1, 3], [0, 2], [2, 3]])
    all_of = np.ones(4, dtype=bool)
    usable = np.array([True, True, not only_narrow, not only_narrow])
    edges = Edges(nodes, ~all_of, usable, np.array([narrow, narrow, 1.0, 1.0]), np.full(4, 0.2))
    return replace(empty_roadmap(), ids=np.arange(4), points=points, sigma=np.zeros(4), edges=edges)


def test_a_way_with_room_is_preferred_to_a_little_shorter_one_along_a_wall():
    for narrow, before in ((1.0, 1), (0.3, 2)):
        assert routes(diamond(narrow), empty_map(), np.zeros(3), PARAMETERS).predecessor[3] == before


@pytest.mark.parametrize(("gap", "only_narrow", "before"), [(0.4, False, 2), (0.4, True, 1), (0.22, True, -1)])
def test_what_was_met_is_passed_at_a_distance_or_not_at_all(gap, only_narrow, before):
    met = np.array([[2.0, 0.5 + gap, 2.0, 2.0]])
    state = diamond(1.0, only_narrow=only_narrow)
    assert routes(state, empty_map(), np.zeros(3), PARAMETERS, met).predecessor[3] == before


@pytest.mark.parametrize(("gap", "reached"), [(0.1, False), (0.4, True)])
def test_a_robot_sets_off_with_room_to_either_side_of_its_way(gap, reached):
    alone = replace(empty_roadmap(), ids=np.arange(1), points=np.array([[2.0, 0.0]]), sigma=np.zeros(1))
    corner = replace(empty_map(), segments=np.array([[1.0, gap, 1.0, 3.0]]))
    assert np.isfinite(routes(alone, corner, np.zeros(3), PARAMETERS).cost[0]) == reached


@pytest.mark.parametrize(("aside", "before"), [(1.0, 2), (15.0, 2), (40.0, 2)])
def test_what_is_too_risky_by_the_short_way_is_reached_by_the_long_one(aside, before):
    sure = dataclasses.replace(
        PARAMETERS, planner=dataclasses.replace(PLANNER, risk="path", collision_probability=0.01)
    )
    state = replace(diamond(0.36, aside=aside), sigma=np.full(4, 0.06))
    ways = routes(state, empty_map(), np.zeros(3), sure)
    assert ways.predecessor[3] == before
    assert ways.cost[3] < np.inf
    # The short way itself is open to who needs not be so sure, and where there is no other it is not taken.
    assert routes(state, empty_map(), np.zeros(3), PARAMETERS).predecessor[3] == (2 if aside < 2.0 else 1)
    alone = replace(diamond(0.36, aside=aside, only_narrow=True), sigma=np.full(4, 0.06))
    assert routes(alone, empty_map(), np.zeros(3), sure).predecessor[3] == -1


def test_a_way_takes_longer_where_the_robot_must_turn():
    state = diamond(1.0)
    times = {theta: routes(state, empty_map(), np.array([0.0, 0.0, theta]), PARAMETERS) for theta in (0.25, 3.0)}
    ahead, behind = times[0.25], times[3.0]
    np.testing.assert_array_equal(ahead.length, behind.length)
    straight = ahead.length / ROBOT.max_speed + ROBOT.max_speed / ROBOT.max_acceleration
    # To node 1 it must turn round first, and at node 1 it turns on the way to node 3.
    assert ahead.time[1] == pytest.approx(straight[1], abs=0.05)
    assert behind.time[1] > straight[1] + 2.5 / ROBOT.max_turn_rate + ROBOT.max_speed / ROBOT.max_acceleration
    assert ahead.time[3] == pytest.approx(straight[3] + 2.0 * np.arctan(0.25) / ROBOT.max_turn_rate, abs=0.05)


def test_a_robot_in_a_slit_goes_back_as_it_came_though_it_comes_nearer_to_a_wall():
    points, nodes = np.array([[-0.05, 0.0], [0.2, 0.0], [2.0, 0.0]]), np.array([[1, 2]])
    driven = Edges(nodes, np.ones(1, dtype=bool), np.ones(1, dtype=bool), np.array([0.2]), np.zeros(1))
    state = replace(empty_roadmap(), ids=np.arange(3), points=points, sigma=np.zeros(3), edges=driven)
    slit = replace(
        empty_map(), segments=np.array([[-0.5, 0.23, 0.1, 0.23], [0.1, 0.205, 0.9, 0.205], [0.9, 0.2, 2.0, 0.2]])
    )
    assert routes(state, slit, np.zeros(3), PARAMETERS).predecessor.tolist() == [3, 3, 1]
    shut = replace(slit, segments=np.vstack([slit.segments, [0.1, -1.0, 0.1, 1.0]]))
    assert routes(state, shut, np.zeros(3), PARAMETERS).predecessor.tolist() == [3, -1, -1]
