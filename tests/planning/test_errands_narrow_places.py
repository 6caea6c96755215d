import numpy as np
import pytest

from tfg_drake.config import ExplorerConfig
from tfg_drake.messages import Roadmap, replace
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.errands import narrow_places
from tfg_drake.planning.goal_choice import choose, choose_near, empty_choice
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.planner import with_frontiers
from tfg_drake.slam import keyframe_graph
from tfg_drake.tfg.graph import empty_map

PARAMETERS = PlanningParameters()
STAY, STOP = 3.0, 20.0


def two_passages(at=0.0):
    """A wall along y = 1 with frontiers behind it round x = -10 and x = 6. The robot, at (at, 0), can reach what is in
    front of the wall; behind it the roadmap has room beyond those there, through slits too narrow to look through."""
    estimate = replace(
        keyframe_graph.empty_map(),
        stage=1,
        covariance=1e-4 * np.eye(3),
        X_MA=np.zeros((1, 3)),
        X_MD=np.array([at, -1.0, 0]),
    )
    walls = np.array([[-15.0, 1.0, 15.0, 1.0]])
    frontiers = np.array([[x + side, 3.0] for x in (-10.0, 6.0) for side in (-2.5, -2.0, 2.0, 2.5)])
    tfg = replace(
        empty_map(),
        stage=1,
        segments=walls,
        frontiers=frontiers,
        frontier_length=np.ones(8),
        frontier_normal=np.tile([0.0, -1.0], (8, 1)),
    )
    front = np.stack([np.arange(-12.0, 10.0, 2.0), np.full(11, -1.0)], axis=1)
    points = np.vstack([front, [[-10.0, 2.0], [6.0, 2.0]]])
    reachable = points[:, 1] < 0.0
    entry = np.append(np.arange(11), [1, 9])
    distance = np.where(reachable, np.abs(points[:, 0] - at), np.inf)
    edges = np.zeros((0, 2), dtype=np.int64)
    roadmap = Roadmap(1, points, edges, reachable, reachable, entry, distance / 0.5, distance)
    return estimate, tfg, with_frontiers(roadmap, estimate, tfg, PARAMETERS)


def test_what_lies_behind_is_reached_past_the_entry():
    estimate, tfg, roadmap = two_passages()
    narrow = narrow_places(Situation(estimate, tfg, roadmap, PARAMETERS), STAY)
    np.testing.assert_array_equal(narrow.at, [1, 9])
    np.testing.assert_allclose(narrow.worth, narrow.gain / (np.array([13.0, 9.0]) / 0.5 + STAY))
    assert (narrow.gain > STOP).all()


def test_the_robot_goes_back_to_every_passage_once_the_nearest_first():
    looked, order = np.zeros(0, dtype=np.int64), []
    for at in (0.0, 6.0, -10.0):
        estimate, tfg, roadmap = two_passages(at)
        narrow = narrow_places(Situation(estimate, tfg, roadmap, PARAMETERS), STAY)
        looked = narrow.looked_from(roadmap, np.array([at, -1.0]), looked)
        left = narrow.left(roadmap, looked)
        order.append(int(narrow.at[np.argmax(left * narrow.worth)]) if left.any() else -1)
    assert order == [9, 1, -1]
    np.testing.assert_array_equal(looked, [1, 9])


def test_nothing_barred_is_nowhere_to_go():
    estimate, tfg, roadmap = two_passages()
    roadmap = replace(roadmap, entry=np.where(roadmap.reachable, roadmap.entry, -1))
    narrow = narrow_places(Situation(estimate, tfg, roadmap, PARAMETERS), STAY)
    looked = narrow.looked_from(roadmap, np.zeros(2), np.array([5]))
    np.testing.assert_array_equal(looked, [5])
    assert len(narrow.left(roadmap, looked)) == 0


def test_a_mission_is_stuck_only_after_the_robot_has_looked_again():
    choice = empty_choice()
    for at, node in ((0.0, 9), (6.0, 1)):
        choice = choose(Situation(*two_passages(at), PARAMETERS), choice)
        assert (choice.verdict, choice.node) == ("goal", node)
        assert choice.reason.endswith(" nats lie behind a passage that was too narrow: it looks once more.")
    choice = choose(Situation(*two_passages(-10.0), PARAMETERS), choice)
    assert (choice.verdict, choice.node) == ("stuck", -1)


def test_by_what_is_near_alone_no_passage_is_looked_at_again():
    assert choose_near(Situation(*two_passages(), PARAMETERS), empty_choice(), 20.0) is None


@pytest.mark.parametrize(("metres", "node"), [(20.0, 9), (9.0, 5), (5.0, -1)])
def test_the_robot_goes_back_where_the_budget_allows_it(metres, node):
    budget = ExplorerConfig(budget_distance=metres)
    estimate, tfg, roadmap = two_passages()
    roadmap = replace(roadmap, entry=np.append(np.arange(11), [5, 9]))
    choice = choose(Situation(estimate, tfg, roadmap, replace(PARAMETERS, explorer=budget)), empty_choice())
    assert choice.node == node
    if node < 0:
        reason = f"{metres:.0f} m of the budget were too little for another goal."
        assert (choice.verdict, choice.reason) == ("budget", reason)
