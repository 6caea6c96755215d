import math

import numpy as np
import pytest

from tfg_drake.config import ExplorerConfig
from tfg_drake.messages import Roadmap
from tfg_drake.planning.budget import MARGIN, RESERVE_DISTANCE, RESERVE_TIME, budget_left, leads_home, way_home


def roadmap(time, home_time=None, reachable=None):
    """Nodes along a line, a metre apart, reached after time (n,), s, at 1 m/s, and home_time (n,), s, from home."""
    n = len(time)
    time = np.asarray(time, dtype=float)
    points = np.stack([np.arange(n, dtype=float), np.zeros(n)], axis=1)
    all_of = np.ones(n, dtype=bool) if reachable is None else np.asarray(reachable, dtype=bool)
    home = np.zeros(0) if home_time is None else np.asarray(home_time, dtype=float)
    edges = np.zeros((0, 2), dtype=np.int64)
    return Roadmap(1, points, edges, all_of, all_of, np.where(all_of, np.arange(n), -1), time, time, home, home)


def test_without_a_budget_everything_is_affordable():
    left = budget_left(ExplorerConfig(), 1e6, 1e6, 7.0)
    assert left.affords(roadmap([1e5]), np.array([0])).all()
    assert left.latest_arrival(roadmap([1.0]), 0) == math.inf
    assert left.longest_way(roadmap([1.0]), 0) == math.inf


def test_a_goal_must_fit_into_the_time_left_with_the_way_home():
    left = budget_left(ExplorerConfig(budget_time=100.0), 30.0, 0.0, 7.0)
    ways = roadmap([10.0, 30.0, 43.0], [10.0, 30.0, 43.0])
    assert left.affords(ways, np.arange(3)).tolist() == [True, False, False]
    assert left.affords(roadmap([10.0, 30.0, 43.0]), np.arange(3)).tolist() == [True, True, False]
    assert left.latest_arrival(ways, 0) == pytest.approx(100.0 - 10.0 * MARGIN - 7.0 - RESERVE_TIME)
    assert str(left) == "70 s"


def test_a_goal_must_fit_into_the_distance_left():
    left = budget_left(ExplorerConfig(budget_distance=50.0), 1e6, 20.0, 7.0)
    reach = (30.0 - RESERVE_DISTANCE) / MARGIN
    assert left.affords(roadmap([reach - 0.1, reach + 0.1]), np.arange(2)).tolist() == [True, False]
    assert left.affords(roadmap([8.0, 8.0], [8.0, 20.0]), np.arange(2)).tolist() == [True, False]
    assert left.longest_way(roadmap([8.0], [8.0]), 0) == pytest.approx(30.0 - 8.0 * MARGIN - RESERVE_DISTANCE)
    assert left.longest_way(roadmap([8.0]), 0) == pytest.approx(30.0 - RESERVE_DISTANCE)
    assert str(left) == "30 m"


def test_while_no_way_leads_home_the_budget_is_for_finding_one():
    left = budget_left(ExplorerConfig(budget_time=100.0, budget_distance=90.0), 0.0, 0.0, 7.0)
    shut = roadmap([10.0, 30.0, 90.0], [np.inf, np.inf, 1.0], reachable=[1, 1, 0])
    assert left.affords(shut, np.arange(3)).tolist() == [True, True, False]
    assert left.latest_arrival(shut, 0) == pytest.approx(100.0 - 7.0 - RESERVE_TIME)
    assert left.longest_way(shut, 0) == pytest.approx(90.0 - RESERVE_DISTANCE)
    assert not leads_home(shut)
    ajar = roadmap([10.0, 30.0, 90.0], [np.inf, 40.0, 1.0], reachable=[1, 1, 0])
    assert leads_home(ajar)
    assert left.affords(ajar, np.arange(3)).tolist() == [False, False, False]
    unlimited = budget_left(ExplorerConfig(), 0.0, 0.0, 7.0)
    assert (unlimited.latest_arrival(shut, 0), unlimited.longest_way(shut, 0)) == (math.inf, math.inf)


@pytest.mark.parametrize("explorer", [ExplorerConfig(), ExplorerConfig(budget_time=1e6, budget_distance=1e6)])
def test_a_robot_that_was_called_back_affords_nothing(explorer):
    left = budget_left(explorer, 0.0, 0.0, 7.0, recalled=True)
    assert not left.affords(roadmap([0.0, 1.0], [0.0, 1.0]), np.arange(2)).any()
    assert left.spent() == "The robot was called back before all was explored."
    assert left.latest_arrival(roadmap([1.0]), 0) > 1e5


def test_both_limits_are_named():
    assert str(budget_left(ExplorerConfig(budget_time=90, budget_distance=50.0), 30.0, 20.0, 7.0)) == "60 s and 30 m"


def test_the_way_home_leads_to_the_node_there_unless_the_robot_is_home():
    assert way_home(roadmap([0, 1, 2]), np.array([0.1, 0.0]), np.array([2.0, 0.0])) == 0
    assert way_home(roadmap([0, 1, 2]), np.array([0.1, 0.0]), np.array([0.2, 0.1])) == -1


def test_a_robot_is_home_at_the_node_nearest_to_where_it_began():
    began = np.array([-0.6, 0.0])
    assert way_home(roadmap([0, 1, 2]), began, np.array([0.0, 0.0])) == -1
    assert way_home(roadmap([0, 1, 2]), began, np.array([1.0, 0.0])) == 0


def test_what_is_left_of_a_budget_is_never_less_than_nothing():
    explorer = ExplorerConfig(budget_time=75.0, budget_distance=20.0)
    assert str(budget_left(explorer, 80.0, 21.0, 3.0)) == "0 s and 0 m"
