import numpy as np

from tfg_drake.config import ExplorerConfig
from tfg_drake.messages import Roadmap, replace
from tfg_drake.planning.goal_choice import _homewards, more_first_turns, pick, preferred
from tfg_drake.slam import keyframe_graph


def best(value, worth, time=None):
    time = np.arange(len(value)) if time is None else np.array(time)
    return pick(np.asarray(value, dtype=float), np.asarray(worth, dtype=bool), time)


def test_the_most_value_wins_and_the_soonest_reached_of_equals():
    assert best([3, 2, 4, 4], [1, 1, 1, 1]) == 2
    assert best([3, 4, 4, 4], [1, 1, 1, 0], time=[1, 9, 2, 1]) == 2


def test_only_what_is_worth_going_to_is_picked():
    assert best([9, 1], [0, 1]) == 1
    assert best([9, 1], [0, 0]) == -1
    assert best([], []) == -1


def test_places_that_see_enough_known_tags_are_preferred_where_there_are_any():
    open_to, tags = np.array([True, True, True, False]), np.array([7, 8, -1, 9])
    np.testing.assert_array_equal(preferred(open_to, tags, 8), [False, True, True, False])
    np.testing.assert_array_equal(preferred(open_to, tags, 0), open_to)
    np.testing.assert_array_equal(preferred(open_to, np.array([7, 3, 2, 9]), 8), open_to)


def test_a_place_that_the_rule_does_not_want_is_picked_only_where_no_other_is_left():
    assert best([-np.inf, -5], [1, 1]) == 1
    assert best([-np.inf, -5], [1, 0]) == 0
    assert best([-5, -np.inf], [0, 1]) == 1


def homewards(reachable, entry, looked=()):
    """What ends a complete mission at home, (0, 0), for a robot 2 m away on a line of nodes a metre apart."""
    points, reachable = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), np.array(reachable, dtype=bool)
    names, no_edges = np.array([4, 7, 9]), np.zeros((0, 2), dtype=np.int64)
    roadmap = Roadmap(1, points, no_edges, reachable, reachable, np.array(entry), *2 * [np.zeros(3)], ids=names)
    estimate = replace(keyframe_graph.empty_map(), X_MA=np.zeros((1, 3)), X_MD=np.array([2.0, 0.0, 0.0]))
    node, verdict, reason, after = _homewards(estimate, roadmap, "complete", "Done.", np.array(looked, dtype=int))
    return node, verdict, reason, after.tolist()


def test_a_mission_ends_at_home():
    assert homewards([1, 1, 1], [0, 1, 2]) == (0, "complete", "Done.", [])


def test_where_the_way_home_is_too_narrow_the_robot_looks_at_it_once_more_and_is_stuck_then():
    again = "The way home is too narrow: it looks once more."
    assert homewards([0, 1, 1], [1, 1, 2]) == (1, "goal", again, [7])
    stuck = "Done. But the robot cannot get back to where it began."
    assert homewards([0, 1, 1], [1, 1, 2], [7]) == (-1, "stuck", stuck, [7])
    assert homewards([0, 1, 1], [-1, 1, 2]) == (-1, "stuck", stuck, [])


def test_the_first_look_has_more_turns_the_less_a_frame_tells_up_to_twice_as_many():
    assert [more_first_turns(worth, ExplorerConfig(first_turns=3)) for worth in (1.0, 0.5, 0.25, 0.05)] == [0, 1, 3, 3]
