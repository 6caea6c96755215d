import dataclasses

import numpy as np

from tests.planning.test_path import returns
from tests.planning.test_roadmap import PARAMETERS, build, known, nearest, two_rooms
from tfg_drake.config import TagSensorConfig
from tfg_drake.messages import LaserScan, MissionStatus, PoseEstimate, Roadmap, replace
from tfg_drake.planning import planner
from tfg_drake.planning.candidates import frontier_in_sight
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.planner import (
    Now,
    extended,
    grow,
    initial_state,
    looked,
    make_roadmap,
    obstacles_in_map,
    planned,
    watched,
    with_frontiers,
)
from tfg_drake.slam import keyframe_graph
from tfg_drake.tfg.graph import empty_map


def step(state, now):
    """The planner's state after one look at the newest messages."""
    state = looked(state, now)
    for due in (extended, planned, watched):
        after = due(state, now)
        if after is not state:
            return after
    return state


def test_a_past_view_is_no_place_to_see_a_frontier_from():
    estimate = replace(keyframe_graph.empty_map(), stage=1, covariance=np.eye(3), X_MA=np.zeros((1, 3)))
    frontiers = np.array([[3.0, -0.2], [3.0, 0.2]])
    normals = np.tile([-1.0, 0.0], (2, 1))
    tfg = replace(empty_map(), frontiers=frontiers, frontier_length=np.full(2, 0.4), frontier_normal=normals)
    # The view's own place, one beside it that sees the frontier, and one that does not.
    points = np.array([[0.1, 0.0], [1.0, 0.0], [6.0, 0.0]])

    def seen(reachable):
        reachable = np.array(reachable, dtype=bool)
        roadmap = Roadmap(
            1, points, np.zeros((0, 2), dtype=int), reachable, np.ones(3, dtype=bool), np.arange(3), *2 * [np.zeros(3)]
        )
        roadmap = with_frontiers(roadmap, estimate, tfg, PlanningParameters())
        return frontier_in_sight(roadmap, tfg, TagSensorConfig())

    assert seen([1, 1, 1]) is True
    assert seen([1, 0, 1]) is False
    assert seen([0, 0, 0]) is False
    assert seen([1, 1, 0]) is True


def test_what_the_robot_drives_while_it_glances_is_travelled():
    parameters = PlanningParameters(seed=1)
    X_MA = np.array([[0.0, 0.0, 0.0], [0.8, 0.0, 0.0], [1.6, 0.0, 0.0]])
    X_MD = X_MA + np.array([0.375, 0.0, 0.0])
    circle = 3.0 * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    state = initial_state()
    for k in (1, 2, 3):
        if k > 1:
            # What the planner notes while the robot drives, until the glance has ended.
            way = np.arange(X_MD[k - 2, 0] + 0.1, X_MD[k - 1, 0] + 1e-9, 0.1)[:, None] * [1.0, 0.0]
            state = replace(state, driven=np.vstack([state.driven, way]))
        estimate = replace(keyframe_graph.empty_map(), stage=k, covariance=np.eye(3), X_MA=X_MA[:k], X_MD=X_MD[k - 1])
        tfg = replace(
            empty_map(),
            stage=k,
            star_offsets=4 * np.arange(k + 1),
            star_vertices=np.vstack([A[:2] + circle for A in X_MA[:k]]),
            star_centers=X_MA[:k, :2],
        )
        state = grow(state, estimate, tfg, parameters)
    a, b = state.nodes.points[state.nodes.edges.nodes[state.nodes.edges.travelled]].transpose(1, 0, 2)
    np.testing.assert_allclose(np.sort(np.append(a[:, 0], b[:, 0]))[[0, -1]], [0.0, X_MD[2, 0]], atol=0.15)
    assert np.hypot(*(a - b).T).sum() > 1.5
    # From the first glance's end to the last one's, every metre once.
    np.testing.assert_allclose(state.driven_before, 1.6)


def seen_on_the_way(path, X_MB, speed, scan, X_MA):
    """The planner's state, and its map, after a look at a scan on its way along a path from the newest view."""
    stage = len(X_MA)
    estimate = replace(keyframe_graph.empty_map(), stage=stage, X_MA=X_MA, X_MD=X_MA[-1])
    state = initial_state()
    tfg = replace(empty_map(), stage=stage)
    state = replace(
        state,
        nodes=replace(state.nodes, stage=stage),
        estimate=estimate,
        tfg=tfg,
        path=replace(state.path, id=1, stage=stage, points=path),
    )
    pose = PoseEstimate(1.0, X_MB, np.eye(3), speed, stage, np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
    mission = MissionStatus("follow", stage, 0.0, path_id=1)
    choice = replace(empty_choice(), stage=stage)
    return step(state, Now(estimate, tfg, pose, choice, scan, mission, PARAMETERS)), estimate


def test_what_is_met_is_kept_where_it_stands_seen_from_the_newest_view():
    X_MA = np.array([[0.0, 0.0, 0.0], [2.0, 1.0, 0.5 * np.pi]])
    path = np.stack([np.full(31, 2.0), np.linspace(1.0, 4.0, 31)], axis=1)
    state, estimate = seen_on_the_way(path, np.array([2.0, 1.5, 0.5 * np.pi]), np.zeros(2), returns(1.2), X_MA)
    assert not state.status.free
    met = obstacles_in_map(state, estimate)
    fronts = met[: len(met) // 2]
    assert np.hypot(*(fronts.reshape(-1, 2) - [2.0, 2.7]).T).max() < 0.1
    moved = replace(estimate, X_MA=X_MA + np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]))
    np.testing.assert_allclose(obstacles_in_map(state, moved), np.add(met, [0.5, 0.0, 0.5, 0.0]), atol=1e-9)


def test_a_scan_is_placed_by_the_pose_at_its_stamp():
    path = np.stack([np.linspace(0.0, 3.0, 31), np.zeros(31)], axis=1)
    # The robot turns to the left: what it sees to its right is on the path by then.
    turning, scan = np.array([0.0, 1.0]), returns(1.0, bearing=-0.4, stamp=1.4)
    assert not seen_on_the_way(path, np.zeros(3), turning, scan, np.zeros((1, 3)))[0].status.free
    assert seen_on_the_way(path, np.zeros(3), np.zeros(2), scan, np.zeros((1, 3)))[0].status.free


def test_the_way_home_is_measured_from_where_the_robot_began():
    state, estimate, tfg = build(two_rooms(), [(-4, 1, 0), (3, 0.5, 1)])
    began, here = nearest(state, (-4, 1)), nearest(state, (3, 0.5))
    for return_home in (True, False):
        explorer = dataclasses.replace(PARAMETERS.explorer, return_home=return_home)
        parameters = dataclasses.replace(PARAMETERS, explorer=explorer)
        roadmap = make_roadmap(state, tfg, estimate, parameters, np.zeros((0, 4)), 0.0)
        assert len(roadmap.home_time) == len(roadmap.home_length) == return_home * len(state.points)
        if return_home:
            assert roadmap.home_length[began] < 0.5 < 7.0 < roadmap.home_length[here]
            assert roadmap.home_time[began] < 5.0 < 14.0 < roadmap.home_time[here]


def before_a_door(blocked):
    """A robot that is to go from one room of two to the other, as a function of the time (s) and of how far a scan
    straight ahead sees (m): the planner's state. blocked: something stood in the door when it was met."""
    views = [(-3.0, 0.0, 0.0), (3.0, 0.0, 0.0), (-2.0, 0.0, 0.0)]
    state = initial_state()
    for k in range(1, len(views) + 1):
        estimate, tfg = known(two_rooms(), views[:k])
        state = grow(state, estimate, tfg, PARAMETERS)
    in_A = np.array([[2.0, -0.4, 2.0, 0.4]])
    if blocked:
        state = replace(state, obstacles=in_A, obstacle_view=np.array([2]))
    goal = replace(
        empty_choice(), stage=3, node=int(state.nodes.ids[nearest(state.nodes, (3.0, 0.0))]), p_MG=np.array([3.0, 0.0])
    )
    none = np.zeros(0, dtype=np.int64)

    def step_at(time, distance, bearing=0.0):
        nonlocal state
        X_MB = np.array([-2.0, 0.0, bearing])
        pose = PoseEstimate(time, X_MB, np.eye(3), np.zeros(2), 3, none, np.zeros((0, 2)))
        mission = MissionStatus("plan", 3, 0.0, path_id=state.path.id)
        angles = np.linspace(-1.0, 1.0, 201)
        scan = LaserScan(time, angles, np.full(201, distance), 10.0, 0.015)
        state = step(state, Now(estimate, tfg, pose, goal, scan, mission, PARAMETERS))
        return state

    return step_at


def test_where_somebody_bars_the_only_way_the_robot_waits_until_he_has_gone():
    assert len(before_a_door(blocked=False)(0.0, 2.0).path.points)
    look = before_a_door(blocked=True)
    for time in np.arange(0.0, 4.0, 0.25):
        assert look(time, 2.0).path.id == 0
    assert not len(look(4.0, 6.0).obstacles)
    gone = look(4.5, 6.0)
    assert gone.path.id == 1
    assert gone.path.points[-1, 0] > 2.0


def test_the_robot_does_not_wait_for_ever():
    look = before_a_door(blocked=True)
    times = np.arange(0.0, 12.0, 0.25)
    answered = [look(time, 2.0).path.id for time in times]
    assert times[answered.index(1)] == planner.PATIENCE
    assert not len(look(12.0, 2.0).path.points)


def test_what_is_out_of_view_bars_no_way():
    assert len(before_a_door(blocked=True)(0.0, 2.0, bearing=2.0).path.points)


def test_what_was_met_is_forgotten_only_where_that_opens_something():
    state, views = initial_state(), [(-4, 1, 0), (3, 0.5, 0), (3.5, 0.5, 0)]
    for count in (1, 2, 3):
        estimate, tfg = known(two_rooms(0.9), views[:count])
        if count == 3:
            # Beside the way, when nothing is open any more.
            state = replace(state, obstacles=np.array([[2.0, 0.0, 2.05, 0.0]]), obstacle_view=np.array([1]))
        state = grow(state, estimate, tfg, PARAMETERS)
    assert len(state.obstacles) == 1
