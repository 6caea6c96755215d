import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tfg_drake.messages import Roadmap, replace
from tfg_drake.planning.goal_rules import gain_per_time, nearest_frontier, shortest_order, stops, tour


def test_gain_per_time():
    np.testing.assert_array_equal(gain_per_time(np.array([10.0, 30.0]), np.array([5.0, 30.0])), [2.0, 1.0])


def test_the_nearest_frontier_is_driven_up_to():
    time = np.array([5.0, 3.0, 4.0])
    distance = np.array([[1.0, np.inf], [2.0, np.inf], [np.inf, 3.0]])
    np.testing.assert_array_equal(nearest_frontier(time, distance), [-5.0, -np.inf, -4.0])
    np.testing.assert_array_equal(nearest_frontier(time, np.full((3, 2), np.inf)), -time)
    np.testing.assert_array_equal(nearest_frontier(time, np.zeros((3, 0))), -time)


@given(st.integers(1, 6), st.integers(0, 1000))
def test_the_order_of_a_tour_is_the_shortest_of_those_that_end_alike(count, seed):
    rng = np.random.default_rng(seed)
    places = rng.uniform(0, 10, (count + 1, 2))
    time = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))

    def length(order):
        return time[0, order[0] + 1] + sum(time[a + 1, b + 1] for a, b in itertools.pairwise(order))

    last = int(rng.integers(count))
    found = shortest_order(time[0, 1:], time[1:, 1:].copy(), last)
    assert sorted(found) == list(range(count))
    orders = [order for order in itertools.permutations(range(count)) if order[-1] == last]
    assert found[-1] == last
    assert length(found) == pytest.approx(min(length(order) for order in orders))


def corridor(where):
    """A roadmap along a line, the robot at 0; its nodes at the places where (n,), m."""
    n = len(where)
    points = np.stack([np.asarray(where, dtype=float), np.zeros(n)], axis=1)
    all_of = np.ones(n, dtype=bool)
    edges = np.array(list(itertools.combinations(range(n), 2)))
    away = np.abs(points[:, 0])
    return Roadmap(1, points, edges, all_of, all_of, np.arange(n), away, away)


def tour_of(where, gain, frontier):
    roadmap = corridor(where)
    gain, frontier = np.asarray(gain, dtype=float), np.asarray(frontier, dtype=float)
    return tour(gain, roadmap.travel_time, 2.0, frontier, 0.24, np.arange(len(where)), roadmap, 1.0)


def test_a_tour_clears_the_short_end_before_it_leaves_for_the_long_one():
    # By gain per time the rich end to the right would come first, and the robot would have to come back.
    value, look = tour_of([-3.0, 5.0, 9.0], [5.0, 60.0, 60.0], np.eye(3))
    assert np.argmax(value) == 0
    np.testing.assert_array_equal(value, [-5.0, -15.0, -21.0])
    np.testing.assert_array_equal(look, [True, False, False])


def test_the_stops_of_a_tour_are_in_its_order_and_its_first_is_the_goal():
    value, _ = tour_of([-3.0, 5.0, 9.0, 5.1], [5.0, 60.0, 60.0, 1.0], [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 1, 0]])
    assert stops(value, 0).tolist() == [0, 1, 2]
    assert stops(value, 3).tolist() == stops(value, 1).tolist() == []  # It goes elsewhere first.
    by_gain, _ = tour_of([1.0, 8.0], [30.0, 40.0], np.zeros((2, 1)))
    assert stops(by_gain, 0).tolist() == []


def test_a_tour_does_not_leave_what_is_near_for_last():
    # The shortest way to all would end at the near place, with the robot far away from it meanwhile.
    value, _ = tour_of([1.0, -1.5, -4.0], [60.0, 20.0, 60.0], np.eye(3))
    np.testing.assert_array_equal(np.argsort(-value), [0, 1, 2])


def test_a_tour_begins_with_what_is_near_though_only_the_robot_is_joined_to_it():
    # No edge of the roadmap leads to the place beside the robot.
    roadmap = corridor([0.5, 5.0, 9.0])
    roadmap = replace(roadmap, edges=np.array([[1, 2]]))
    gain = np.array([5.0, 60.0, 60.0])
    value, _ = tour(gain, roadmap.travel_time, 2.0, np.eye(3), 0.24, np.arange(3), roadmap, 1.0)
    np.testing.assert_array_equal(value, [-2.5, -10.0, -16.0])


@pytest.mark.parametrize("gain", [[0.0, 0.0, 0.0], [-30.0, -20.0, -10.0]])
def test_where_no_place_promises_anything_a_tour_clears_the_frontier_all_the_same(gain):
    value, _ = tour_of([40.0, -2.0, 1.0], gain, np.eye(3))
    np.testing.assert_array_equal(np.argsort(-value), [1, 2, 0])
    assert np.isfinite(value).all()


def test_of_two_places_that_see_the_same_a_tour_visits_one():
    value, _ = tour_of([1.0, 1.5, 9.0], [30.0, 20.0, 20.0], [[1, 0], [1, 0], [0, 1]])
    assert np.isfinite(value).tolist() == [True, False, True]


def test_of_the_places_that_see_what_a_goal_is_for_the_one_on_the_way_is_visited():
    # The richest place is far inside a dead end to the left; its mouth sees 96 % of the same.
    frontier = [[1.0, 0.0], [0.96, 0.0], [0.5, 0.0], [0.0, 1.0]]
    value, look = tour_of([-5.0, -2.0, -1.0, 9.0], [50.0, 10.0, 10.0, 10.0], frontier)
    assert np.argmax(value) == 1
    assert value[0] == -np.inf
    np.testing.assert_array_equal(look, [True, False])


def test_without_a_frontier_gain_per_time_decides():
    value, look = tour_of([1.0, 8.0], [30.0, 40.0], np.zeros((2, 1)))
    np.testing.assert_array_equal(value, [10.0, 4.0])
    assert look.all()
