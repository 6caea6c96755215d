import numpy as np

from tfg_drake.config import TagSensorConfig
from tfg_drake.messages import Roadmap, replace
from tfg_drake.planning.planner import frontier_in_sight, with_frontiers
from tfg_drake.slam import goal_graph
from tfg_drake.tfg.graph import empty_map

IDS = np.zeros(0, dtype=np.int64)
NONE = np.zeros((0, 2))


def test_a_past_goal_is_no_place_to_see_a_frontier_from():
    estimate = replace(goal_graph.empty_map(), stage=1, covariance=np.eye(3), X_MA=np.zeros((1, 3)))
    frontiers = np.array([[3.0, -0.2], [3.0, 0.2]])
    normals = np.tile([-1.0, 0.0], (2, 1))
    tfg = replace(empty_map(), frontiers=frontiers, frontier_length=np.full(2, 0.4), frontier_normal=normals)
    # The goal's own place, one beside it that sees the frontier, and one that does not.
    points = np.array([[0.1, 0.0], [1.0, 0.0], [6.0, 0.0]])

    def seen(reachable):
        reachable = np.array(reachable, dtype=bool)
        roadmap = Roadmap(
            1, points, np.zeros((0, 2), dtype=int), reachable, *2 * [np.ones(3, dtype=bool)], *2 * [np.zeros(3)]
        )
        roadmap = with_frontiers(roadmap, estimate, tfg, TagSensorConfig())
        return frontier_in_sight(roadmap, tfg, TagSensorConfig())

    assert seen([1, 1, 1]) == (True, False)
    assert seen([1, 0, 1]) == (False, True)
    assert seen([0, 0, 0]) == (False, True)
    assert seen([1, 1, 0]) == (True, False)
