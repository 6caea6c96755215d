import numpy as np

from tfg_drake.config import ExplorerConfig, OdometryConfig, PlannerConfig, RobotConfig, TagSensorConfig
from tfg_drake.messages import Roadmap, WorkingMap, replace
from tfg_drake.planning.planner import frontier_in_sight, grow, initial_state, with_frontiers
from tfg_drake.planning.roadmap import RoadmapParameters
from tfg_drake.slam import goal_graph
from tfg_drake.tfg.graph import empty_map


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
            1, points, np.zeros((0, 2), dtype=int), reachable, np.ones(3, dtype=bool), np.arange(3), *2 * [np.zeros(3)]
        )
        roadmap = with_frontiers(roadmap, estimate, tfg, TagSensorConfig())
        return frontier_in_sight(roadmap, tfg, TagSensorConfig())

    assert seen([1, 1, 1]) == (True, False)
    assert seen([1, 0, 1]) == (False, True)
    assert seen([0, 0, 0]) == (False, True)
    assert seen([1, 1, 0]) == (True, False)


def test_what_the_robot_drives_while_it_glances_is_travelled():
    parameters = RoadmapParameters(
        RobotConfig(), TagSensorConfig(), OdometryConfig(), ExplorerConfig(), PlannerConfig(), seed=1
    )
    X_MA = np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0], [1.6, 0.0, 0.0]])
    X_MD = X_MA + np.array([0.375, 0.0, 0.0])
    circle = 3.0 * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    state = initial_state()
    for k in (1, 2, 3):
        if k > 1:
            # What the planner notes while the robot drives, until the glance has ended.
            way = np.arange(X_MD[k - 2, 0] + 0.1, X_MD[k - 1, 0] + 1e-9, 0.1)[:, None] * [1.0, 0.0]
            state = replace(state, driven=np.vstack([state.driven, way]))
        estimate = replace(goal_graph.empty_map(), stage=k, covariance=np.eye(3), X_MA=X_MA[:k], X_MD=X_MD[k - 1])
        tfg = replace(
            empty_map(),
            stage=k,
            star_offsets=4 * np.arange(k + 1),
            star_vertices=np.vstack([A[:2] + circle for A in X_MA[:k]]),
            star_centers=X_MA[:k, :2],
        )
        state = grow(state, WorkingMap(estimate, tfg, np.ones(k, dtype=bool)), parameters)
    a, b = state.nodes.points[state.nodes.edges.nodes[state.nodes.edges.travelled]].transpose(1, 0, 2)
    np.testing.assert_allclose(np.sort(np.append(a[:, 0], b[:, 0]))[[0, -1]], [0.0, X_MD[2, 0]], atol=0.15)
    assert np.hypot(*(a - b).T).sum() > 1.5
    # From the first glance's end to the last one's, every metre once.
    np.testing.assert_allclose(state.driven_before, 1.6)
