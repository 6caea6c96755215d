"""The planner on a grid, message by message."""

import numpy as np
import pytest

from tests.systems.grid_bench import Bench, grid, pose, scan
from tfg_drake.config import RobotConfig
from tfg_drake.messages import MissionStatus, replace
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.systems.grid_planner import GridPlanner


def planner(goal=(3.5, 2.0)):
    choice = replace(empty_choice(), stage=1, node=7, p_MG=np.array(goal))
    system = GridPlanner(RobotConfig())
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
