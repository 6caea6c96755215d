"""The grid baseline's systems, message by message."""

import numpy as np
import pytest
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator

from tfg_drake.config import ExplorerConfig, GridConfig, OdometryConfig, RobotConfig
from tfg_drake.grid import frontier_goal
from tfg_drake.messages import (
    GridMap,
    LaserScan,
    MissionStatus,
    Odometry,
    Path,
    PathStatus,
    PoseEstimate,
    replace,
)
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.systems.grid_baseline import FrontierGoalSelector, GridMapper, GridPlanner

ROBOT, EXPLORER = RobotConfig(), ExplorerConfig()
NONE = np.zeros((0, 2))
ANGLES = np.linspace(-1.0, 1.0, 121)


def grid(stage=1, stamp=0.0, known=4.0):
    """A room of 6 x 4 m, walled in, of which the left `known` metres were seen."""
    probability = np.full((80, 120), 0.1, dtype=np.float32)
    probability[[0, -1]] = probability[:, [0, -1]] = 0.9
    probability[:, round(known / 0.05) :] = 0.5
    return GridMap(stage, stamp, 0.05, np.zeros(2), probability)


def pose(x=1.0, y=2.0, stamp=0.0):
    return PoseEstimate(stamp, np.array([x, y, 0.0]), 1e-4 * np.eye(3), np.zeros(2), 1, NONE[:, 0].astype(int), NONE)


def scan(stamp=0.0, ranges=10.0):
    return LaserScan(stamp, ANGLES, np.full(len(ANGLES), ranges), 10.0, 0.015)


class Bench:
    """One system with its inputs at hand."""

    def __init__(self, system, **messages):
        self.system, self.simulator = system, Simulator(system)
        self.context = self.simulator.get_mutable_context()
        self.set(**messages)
        self.simulator.Initialize()

    def set(self, **messages):
        for name, value in messages.items():
            self.system.GetInputPort(name).FixValue(self.context, AbstractValue.Make(value))
        return self

    def run(self, seconds=0.125):
        self.simulator.AdvanceTo(self.context.get_time() + seconds)
        return self

    def output(self, name):
        return self.system.GetOutputPort(name).Eval(self.context)


def selector(eager=True):
    system = FrontierGoalSelector(
        lambda grid, pose, tried: frontier_goal.choose(grid, pose, tried, ROBOT, EXPLORER), ROBOT, eager
    )
    bench = Bench(system, grid=grid(), pose=pose(), mission=MissionStatus("choose", 1, 0.0))
    return bench.set(path=Path(0, 0, NONE), path_status=PathStatus(0, True)).run()


def test_the_nearest_frontier_is_the_goal_and_no_other_is_chosen_at_the_same_stage():
    bench = selector()
    goal = bench.output("goal")
    assert (goal.stage, goal.verdict, goal.spent) == (1, "goal", False)
    assert 3.0 < goal.p_MG[0] < 4.0
    assert bench.set(pose=pose(2.0)).run().output("goal") is goal


@pytest.mark.parametrize("eager", [True, False])
def test_a_goal_whose_frontier_was_seen_on_the_way_is_spent_for_an_eager_robot(eager):
    bench = selector(eager).set(mission=MissionStatus("follow", 1, 1.0)).run()
    assert not bench.output("goal").spent
    assert bench.set(grid=grid(stamp=2.0, known=6.0)).run().output("goal").spent == eager


def test_a_goal_to_which_no_path_leads_is_spent():
    bench = selector().set(mission=MissionStatus("plan", 1, 1.0)).run()
    bench.set(path_status=PathStatus(0, False, unreachable=True)).run()
    assert not bench.output("goal").spent  # that was said of the goal before
    assert bench.set(path=Path(0, 1, NONE)).run().output("goal").spent


def planner(goal=(3.5, 2.0)):
    choice = replace(empty_choice(), stage=1, node=7, p_MG=np.array(goal))
    system = GridPlanner(ROBOT)
    bench = Bench(system, grid=grid(), pose=pose(), goal=choice, scan=scan(), mission=MissionStatus("plan", 1, 0.0))
    return bench.run()


def test_a_path_is_planned_once_and_watched():
    bench = planner()
    path = bench.output("path")
    assert (path.id, path.stage, bench.output("path_status").free) == (1, 1, True)
    assert path.points[0] == pytest.approx([1.0, 2.0])
    assert path.points[-1] == pytest.approx([3.5, 2.0], abs=0.05)
    bench.set(mission=MissionStatus("follow", 1, 0.5), scan=scan(1.0, ranges=2.5), pose=pose(stamp=1.0)).run()
    assert bench.output("path_status").free
    bench.set(scan=scan(2.0, ranges=0.8), pose=pose(stamp=2.0)).run()
    assert (bench.output("path_status").path_id, bench.output("path_status").free) == (1, False)
    bench.set(mission=MissionStatus("plan", 1, 2.0, replans=1)).run()
    assert bench.output("path_status").unreachable == (bench.output("path").id == 1)


def test_a_grid_that_shows_a_wall_across_the_path_blocks_it():
    bench = planner()
    walled = grid(stamp=1.0)
    probability = walled.probability.copy()
    probability[:, 50] = 0.9
    bench.set(mission=MissionStatus("follow", 1, 0.5)).run()
    bench.set(grid=replace(walled, probability=probability), scan=scan(1.0), pose=pose(stamp=1.0)).run()
    assert not bench.output("path_status").free
    bench.set(mission=MissionStatus("plan", 1, 2.0, replans=1)).run()
    status = bench.output("path_status")
    assert (status.free, status.unreachable) == (False, True)
    assert (bench.output("path").id, bench.output("path").stage) == (1, 1)


def test_a_map_grows_and_its_stage_follows_the_mission():
    mapper = GridMapper(GridConfig(particles=3), OdometryConfig(), seed=1)
    still = Odometry(0.0, np.zeros(3), np.zeros(2), at_rest=True)
    bench = Bench(mapper, odometry=still, scan=scan(0.0, 2.0), mission=MissionStatus("observe", 0, 0.0)).run()
    assert bench.output("grid").stage == 0
    bench.set(odometry=replace(still, stamp=0.25), scan=scan(0.2, 2.0), mission=MissionStatus("map", 0, 0.25)).run(0.25)
    first = bench.output("grid")
    assert first.stage == 1
    assert (first.probability > 0.55).any()
    assert (first.probability < 0.45).any()
    assert bench.run(0.25).output("grid").stage == 1  # until the mission is at stage 1 and maps again
    assert bench.output("pose").stage == 1
    assert pytest.approx([0.0, 0.0, 0.0], abs=0.02) == bench.output("pose").X_MB
