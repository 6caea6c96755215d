"""The goal selector of a grid, message by message."""

import pytest

from tests.systems.grid_bench import NONE, Bench, grid, pose
from tfg_drake.config import ExplorerConfig, RobotConfig
from tfg_drake.grid import frontier_goal
from tfg_drake.messages import MissionStatus, Path, PathStatus
from tfg_drake.systems.frontier_goal_selector import FrontierGoalSelector

ROBOT, EXPLORER = RobotConfig(), ExplorerConfig()


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
