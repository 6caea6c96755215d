"""Somebody sends the robot to a place."""

import numpy as np

from tfg_drake.messages import MissionStatus, Roadmap
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.requested_goal import MOST_FAILURES, RequestedGoal, Sent, goal_there, where_sent

POINTS = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [4.2, 0.0]])


def where(*given):
    sent = where_sent(*given)
    return sent.count, sent.node


def roadmap(reachable=(True, True, True, False)):
    return Roadmap(
        stage=1,
        points=POINTS,
        edges=np.zeros((0, 2), dtype=np.int64),
        reachable=np.array(reachable),
        enterable=np.array(reachable),
        entry=np.full(4, -1),
        travel_time=np.zeros(4),
        travel_length=np.zeros(4),
        ids=np.array([3, 5, 8, 9]),
    )


def status(*, moving=False, failures=0):
    return MissionStatus(phase="choose", stage=1, since=0.0, moving=moving, failures=failures)


def test_the_robot_goes_to_the_reachable_place_next_to_the_one_asked_for():
    sent = where_sent(Sent(), RequestedGoal(1, np.array([9.0, 1.0])), roadmap(), status(), POINTS[0])
    assert (sent.count, sent.node) == (1, 8)
    choice = goal_there(empty_choice(), sent.node, roadmap())
    assert (choice.node, choice.verdict, choice.p_MG.tolist()) == (8, "goal", [4.0, 0.0])


def test_it_goes_there_until_it_has_looked_round_there():
    requested, sent = RequestedGoal(1, np.array([4.0, 0.0])), Sent(1, 8)
    assert where(sent, requested, roadmap(), status(moving=True), POINTS[2]) == (1, 8)
    assert where(sent, requested, roadmap(), status(), POINTS[1]) == (1, 8)
    assert where(sent, requested, roadmap(), status(), POINTS[2]) == (1, -1)


def test_it_gives_up_a_place_that_it_cannot_get_to():
    requested, sent = RequestedGoal(1, np.array([4.0, 0.0])), Sent(1, 8)
    assert where(sent, requested, roadmap([True, True, False, False]), status(), POINTS[1]) == (1, -1)
    assert where(sent, requested, roadmap(), status(failures=MOST_FAILURES), POINTS[1]) == (1, -1)
    nowhere = roadmap([False] * 4)
    assert where(Sent(), requested, nowhere, status(), POINTS[1]) == (1, -1)


def test_a_later_request_replaces_the_one_before():
    requested = RequestedGoal(2, np.array([2.0, 0.3]))
    assert where(Sent(1, 8), requested, roadmap(), status(moving=True), POINTS[0]) == (2, 5)
    assert where(Sent(), RequestedGoal(), roadmap(), status(), POINTS[0]) == (0, -1)
