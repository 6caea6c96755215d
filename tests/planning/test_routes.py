import numpy as np
import pytest

from tests.planning.test_roadmap import PLANNER, ROBOT
from tfg_drake.messages import replace
from tfg_drake.planning.roadmap import Edges, empty_roadmap
from tfg_drake.planning.routes import routes
from tfg_drake.tfg.graph import empty_map


def diamond(narrow, *, only_narrow=False):
    """Two ways from the robot at the origin to node 3: the shorter by node 1, with this clearance, m, or by node 2."""
    points = np.array([[0.0, 0.0], [2.0, 0.5], [2.0, -1.0], [4.0, 0.0]])
    nodes = np.array([[0, 1], [1, 3], [0, 2], [2, 3]])
    all_of = np.ones(4, dtype=bool)
    usable = np.array([True, True, not only_narrow, not only_narrow])
    edges = Edges(nodes, ~all_of, all_of, np.array([narrow, narrow, 1.0, 1.0]), np.full(4, 0.2), usable)
    return replace(empty_roadmap(), ids=np.arange(4), points=points, sigma=np.zeros(4), edges=edges)


def test_a_way_with_room_is_preferred_to_a_little_shorter_one_along_a_wall():
    for narrow, before in ((1.0, 1), (0.3, 2)):
        assert routes(diamond(narrow), empty_map(), np.zeros(3), ROBOT, PLANNER).predecessor[3] == before


@pytest.mark.parametrize(("gap", "only_narrow", "before"), [(0.4, False, 2), (0.4, True, 1), (0.22, True, -1)])
def test_what_was_met_is_passed_at_a_distance_or_not_at_all(gap, only_narrow, before):
    met = np.array([[2.0, 0.5 + gap, 2.0, 2.0]])
    state = diamond(1.0, only_narrow=only_narrow)
    assert routes(state, empty_map(), np.zeros(3), ROBOT, PLANNER, met).predecessor[3] == before


@pytest.mark.parametrize(("gap", "reached"), [(0.1, False), (0.4, True)])
def test_a_robot_sets_off_with_room_to_either_side_of_its_way(gap, reached):
    alone = replace(empty_roadmap(), ids=np.arange(1), points=np.array([[2.0, 0.0]]), sigma=np.zeros(1))
    corner = replace(empty_map(), segments=np.array([[1.0, gap, 1.0, 3.0]]))
    assert np.isfinite(routes(alone, corner, np.zeros(3), ROBOT, PLANNER).cost[0]) == reached


def test_a_way_takes_longer_where_the_robot_must_turn():
    state = diamond(1.0)
    times = {theta: routes(state, empty_map(), np.array([0.0, 0.0, theta]), ROBOT, PLANNER) for theta in (0.25, 3.0)}
    ahead, behind = times[0.25], times[3.0]
    np.testing.assert_array_equal(ahead.length, behind.length)
    straight = ahead.length / ROBOT.max_speed + ROBOT.max_speed / ROBOT.max_acceleration
    # To node 1 it must turn round first, and at node 1 it turns on the way to node 3.
    assert ahead.time[1] == pytest.approx(straight[1], abs=0.05)
    assert behind.time[1] > straight[1] + 2.5 / ROBOT.max_turn_rate + ROBOT.max_speed / ROBOT.max_acceleration
    assert ahead.time[3] == pytest.approx(straight[3] + 2.0 * np.arctan(0.25) / ROBOT.max_turn_rate, abs=0.05)
