"""The paper's baseline on the same ports: GMapping, the nearest frontier and paths on the grid."""

from __future__ import annotations

from pydrake.systems.framework import Diagram

from tfg_drake.diagrams.explorer import Wiring
from tfg_drake.diagrams.scenario import MakeKeepOut, Scenario
from tfg_drake.grid import frontier_goal, weighted_goal
from tfg_drake.grid.frontier_goal import TriedPlaces
from tfg_drake.grid.path import with_segments
from tfg_drake.messages import GoalChoice, GridMap, PoseEstimate
from tfg_drake.systems.frontier_goal_selector import FrontierGoalSelector
from tfg_drake.systems.grid_mapper import GridMapper
from tfg_drake.systems.grid_planner import GridPlanner
from tfg_drake.systems.mission_sequencer import MissionSequencer
from tfg_drake.systems.pure_pursuit_follower import PurePursuitFollower


def MakeGridExplorer(scenario: Scenario, *, weighted: bool = False) -> Diagram:
    """The grid explorer for a scenario; its ports are those of MakeTfgExplorer, with grid for map, tfg and roadmap.

    weighted: goals by the weighted sum of grid entropy and pose uncertainty (the paper's eq. 1), not the nearest
    frontier.
    """
    robot, explorer = scenario.robot, scenario.explorer
    keep_out = MakeKeepOut(scenario)

    def choose(grid: GridMap, pose: PoseEstimate, tried: TriedPlaces) -> tuple[GoalChoice, TriedPlaces]:
        grid = with_segments(grid, keep_out)
        if weighted:
            return weighted_goal.choose(
                grid, pose, tried, scenario.odometry, scenario.scan, robot, explorer, scenario.grid
            )
        return frontier_goal.choose(grid, pose, tried, robot, explorer)

    wiring = Wiring(scenario.reality.planning_time)
    mapper = wiring.Add("grid_mapper", GridMapper(scenario.grid, scenario.odometry, scenario.seed))
    selector = wiring.Add("goal_selector", FrontierGoalSelector(choose, robot, scenario.grid.eager))
    planner = wiring.Add("grid_planner", GridPlanner(robot, keep_out))
    follower = wiring.Add("follower", PurePursuitFollower(robot, explorer, None))
    sequencer = wiring.Add("mission_sequencer", MissionSequencer(robot, maps=["grid"]))

    wiring.FeedAll(mapper, selector, planner, follower, sequencer)
    return wiring.Build(follower, sequencer, selector)
