import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from tests.planning.test_planner import step
from tfg_drake.messages import (
    LaserScan,
    MapEstimate,
    MissionStatus,
    Observation,
    PoseEstimate,
    TfgMap,
    replace,
)
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.planner import ASK_AGAIN, BOLD_AFTER, OBSTACLE_MEMORY, Now, initial_state
from tfg_drake.slam import keyframe_graph
from tfg_drake.systems.prm_planner import PrmPlanner

PARAMETERS = PlanningParameters(seed=1)
NONE = np.zeros((0, 2))
IDS = np.zeros(0, dtype=np.int64)
SQUARE = np.array([[-4.0, -4], [4, -4], [4, 4], [-4, 4]])


def maps(stage):
    """A room of 8 x 8 m with a tag in the middle of three walls, the fourth unknown."""
    observation = Observation(IDS, NONE[:, 0], np.zeros((0, 3)))
    if stage == 0:
        estimate = keyframe_graph.empty_map()
        tfg = TfgMap(0, np.zeros((0, 4)), IDS, IDS.reshape(0, 2), NONE, NONE, NONE[:, 0], NONE, np.zeros(1, dtype=int),
                     NONE, NONE)  # fmt: skip
        return estimate, tfg
    walls = np.array([[-4.0, -4, 4, -4], [4, -4, 4, 4], [4, 4, -4, 4]])
    tags, facing = np.array([[0.0, -4], [4, 0], [0, 4]]), np.array([[0.0, 1], [-1, 0], [0, -1]])
    none = np.zeros((3, 2))
    estimate = MapEstimate(stage, 1.0, np.arange(3), tags, none, none, np.zeros(3), np.arange(3), 1e-2 * np.eye(9),
                           np.tile(1e-2 * np.eye(2), (3, 1, 1)), np.zeros((stage, 3)), observation, 0.0)  # fmt: skip
    frontiers = np.stack([np.full(15, -4.35), np.linspace(-3.5, 3.5, 15)], axis=1)
    normals = np.tile([1.0, 0.0], (15, 1))
    tfg = TfgMap(stage, walls, np.zeros(3, dtype=int), np.zeros((3, 2), dtype=int), facing, frontiers,
                 np.full(15, 0.5), normals, np.arange(stage + 1) * 4, np.tile(SQUARE, (stage, 1)),
                 np.zeros((stage, 2)))  # fmt: skip
    return estimate, tfg


def pose(stage):
    return PoseEstimate(1.0, np.zeros(3), 1e-4 * np.eye(3), np.zeros(2), stage, IDS, NONE)


def scan(stamp=0.0, ranges=None):
    angles = np.linspace(-1, 1, 200)
    return LaserScan(stamp, angles, np.full(200, np.inf) if ranges is None else ranges, 10.0, 0.015)


def fix(system, context, **messages):
    for name, value in messages.items():
        system.GetInputPort(name).FixValue(context, AbstractValue.Make(value))


def output(system, context, name):
    return system.GetOutputPort(name).Eval(context)


def looked(state, estimate, tfg, scan, mission):
    """The planner's state after one look."""
    return step(state, Now(estimate, tfg, pose(tfg.stage), empty_choice(), scan, mission, PARAMETERS))


class Planner:
    def __init__(self):
        self.system = PrmPlanner(PARAMETERS)
        self.simulator = Simulator(self.system)
        self.context = self.simulator.get_mutable_context()
        estimate, tfg = maps(0)
        self.set(map=estimate, tfg=tfg, pose=pose(0))
        self.set(goal=empty_choice(), scan=scan(), mission=MissionStatus("observe", 0, 0.0))
        self.simulator.Initialize()

    def set(self, **messages):
        fix(self.system, self.context, **messages)

    def run(self, seconds=0.125):
        self.simulator.AdvanceTo(self.context.get_time() + seconds)

    def output(self, name):
        return output(self.system, self.context, name)

    def observed(self):
        estimate, tfg = maps(1)
        self.set(map=estimate, tfg=tfg, pose=pose(1), mission=MissionStatus("choose", 1, 0.0))
        self.run()
        return estimate, tfg


def choice(roadmap, place, stage=1):
    node = int(np.argmin(np.hypot(*(roadmap.points - place).T))) if place is not None else 10**6
    p_MG = roadmap.points[node] if place is not None else np.zeros(2)
    return replace(empty_choice(), stage=stage, node=node, p_MG=p_MG)


def test_waits_for_the_first_map():
    planner = Planner()
    planner.run(1.0)
    assert planner.output("roadmap").stage == 0
    assert planner.output("path").id == 0
    assert planner.output("path_status").free


def test_roadmap_then_path_then_a_watch_on_it():
    planner = Planner()
    planner.observed()
    roadmap = planner.output("roadmap")
    assert roadmap.stage == 1
    assert roadmap.reachable.mean() > 0.9
    assert planner.output("path").id == 0

    planner.set(goal=choice(roadmap, (3, 0)), mission=MissionStatus("plan", 1, 0.0))
    planner.run()
    path = planner.output("path")
    assert (path.id, path.stage) == (1, 1)
    np.testing.assert_allclose(path.points[0], [0, 0], atol=1e-9)
    planner.run(0.5)
    assert planner.output("path") is path

    planner.set(mission=MissionStatus("follow", 1, 0.0, path_id=1), scan=scan(1.0))
    planner.run()
    assert planner.output("path_status").free
    bearing = np.arctan2(*path.points[15][::-1])
    blocked = np.where(np.abs(scan().angles - bearing) < 0.1, 1.2, np.inf)
    planner.set(scan=scan(1.1, blocked))
    planner.run()
    assert (planner.output("path_status").path_id, planner.output("path_status").free) == (1, False)

    planner.set(mission=MissionStatus("plan", 1, 0.0, replans=1, path_id=1))
    planner.run()
    assert planner.output("path").id == 1
    planner.set(pose=replace(pose(1), stamp=pose(1).stamp + ASK_AGAIN))
    planner.run()
    around = planner.output("path")
    assert around.id == 2
    assert planner.output("path_status").free
    place = 1.2 * np.array([np.cos(bearing), np.sin(bearing)])
    assert np.hypot(*(around.points - place).T).min() > 0.18


def test_what_blocked_the_way_is_kept_for_some_stages():
    planner = Planner()
    planner.observed()
    planner.set(goal=choice(planner.output("roadmap"), (3, 0)), mission=MissionStatus("plan", 1, 0.0))
    planner.run()
    ahead = planner.output("path").points[15]
    bearing = np.arctan2(ahead[1], ahead[0])
    met = 1.2 * np.array([np.cos(bearing), np.sin(bearing)])
    blocked = np.where(np.abs(scan().angles - bearing) < 0.1, 1.2, np.inf)
    planner.set(mission=MissionStatus("follow", 1, 0.0, path_id=1), scan=scan(1.1, blocked))
    planner.run()
    assert not planner.output("path_status").free

    def nearest(stage):
        estimate, tfg = maps(stage)
        planner.set(map=estimate, tfg=tfg, pose=pose(stage), mission=MissionStatus("choose", stage, 0.0))
        planner.run()
        goal = choice(planner.output("roadmap"), (3, 0), stage)
        planner.set(goal=goal, mission=MissionStatus("plan", stage, 0.0))
        planner.run()
        path = planner.output("path")
        assert path.stage == stage
        return np.hypot(*(path.points - met).T).min()

    assert nearest(2) > PARAMETERS.robot.radius
    assert nearest(1 + OBSTACLE_MEMORY) > PARAMETERS.robot.radius
    assert nearest(2 + OBSTACLE_MEMORY) < 0.1


def test_a_robot_that_fails_again_and_again_forgets_what_it_met():
    estimate, tfg = maps(2)
    met = np.array([[1.0, -1.0, 1.0, 1.0]])
    state = replace(initial_state(), estimate=estimate, obstacles=met, obstacle_view=np.zeros(1, dtype=np.int64))
    for failures, left in ((BOLD_AFTER - 1, 1), (BOLD_AFTER, 0)):
        mission = MissionStatus("choose", 2, 0.0, failures=failures)
        grown = looked(state, estimate, tfg, scan(-np.inf), mission)
        assert len(grown.obstacles) == left


def test_a_robot_shut_in_by_what_it_met_forgets_it():
    estimate, tfg = maps(1)
    tfg = replace(tfg, frontiers=NONE, frontier_length=NONE[:, 0], frontier_normal=NONE)
    angle = np.linspace(0.0, 2.0 * np.pi, 13)
    ring = 0.3 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    met = np.hstack([ring[:-1], ring[1:]])
    state = replace(initial_state(), estimate=estimate, obstacles=met, obstacle_view=np.zeros(len(met), dtype=np.int64))
    mission = MissionStatus("choose", 1, 0.0)
    state = looked(state, estimate, tfg, scan(), mission)
    assert state.roadmap.reachable.mean() > 0.9
    assert len(state.obstacles) == 0


def test_an_unreachable_goal_gives_an_empty_path_with_a_new_id():
    planner = Planner()
    planner.observed()
    roadmap = planner.output("roadmap")
    node = int(roadmap.node_ids(np.flatnonzero(~roadmap.reachable))[0])
    planner.set(goal=replace(choice(roadmap, (3, 0)), node=node), mission=MissionStatus("plan", 1, 0.0))
    planner.run()
    assert planner.output("path").id == 1
    assert len(planner.output("path").points) == 0


def test_a_goal_that_is_not_there_is_an_error():
    planner = Planner()
    planner.observed()
    planner.set(goal=choice(planner.output("roadmap"), None), mission=MissionStatus("plan", 1, 0.0))
    with pytest.raises(ValueError, match="goal of stage 1: there is no node 1000000; choose one of the roadmap's"):
        planner.run()


def test_a_way_longer_than_the_budget_allows_is_not_taken():
    planner = Planner()
    planner.observed()
    # It has driven half a metre since the goal was chosen.
    planner.set(pose=replace(pose(1), X_MB=np.array([0.5, 0.0, 0.0])))
    planner.run()
    goal = choice(planner.output("roadmap"), (3, 0))
    whole = 0.5 + np.hypot(*(goal.p_MG - [0.5, 0.0]))
    for replans, (longest, planned) in enumerate(((whole + 0.05, True), (whole - 0.05, False))):
        planner.set(goal=replace(goal, longest_way=longest), mission=MissionStatus("plan", 1, 0.0, replans=replans))
        planner.run()
        assert planner.output("path").id == replans + 1
        assert (len(planner.output("path").points) > 0) == planned


def test_two_runs_are_equal_to_the_bit():
    roadmaps = []
    for _ in range(2):
        planner = Planner()
        planner.observed()
        roadmaps.append(planner.output("roadmap"))
    assert len(roadmaps[0].points) > 50
    for name, value in vars(roadmaps[0]).items():
        np.testing.assert_array_equal(value, getattr(roadmaps[1], name))


def test_a_path_begins_where_the_robot_is_by_the_newest_map():
    for stage, start in ((1, [0.5, 0.2]), (0, [0.0, 0.0])):
        planner = Planner()
        planner.observed()
        at = replace(pose(stage), X_MB=np.array([0.5, 0.2, 0.0]))
        planner.set(pose=at, goal=choice(planner.output("roadmap"), (3, 0)), mission=MissionStatus("plan", 1, 0.0))
        planner.run()
        np.testing.assert_allclose(planner.output("path").points[0], start, atol=1e-9)


def test_no_path_is_planned_to_a_goal_of_an_older_stage():
    planner = Planner()
    planner.observed()
    planner.set(goal=choice(planner.output("roadmap"), (3, 0), stage=0), mission=MissionStatus("plan", 1, 0.0))
    planner.run(0.5)
    assert planner.output("path").id == 0
