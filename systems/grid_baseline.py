"""The baseline on an occupancy grid: GMapping, the frontier to look at next, and the cheapest path there."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.config import GridConfig, OdometryConfig, RobotConfig
from tfg_drake.geometry.se2 import pose_at
from tfg_drake.grid import gmapping
from tfg_drake.grid import path as paths
from tfg_drake.grid.frontier_goal import TriedPlaces, is_spent, no_tries
from tfg_drake.messages import (
    FloatArray,
    GoalChoice,
    GridMap,
    LaserScan,
    MissionStatus,
    Path,
    PathStatus,
    PoseEstimate,
    message,
    replace,
)
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.planner import initial_state
from tfg_drake.systems.blas_threads import keep_to_one_thread
from tfg_drake.systems.cpu_meter import measured, metered
from tfg_drake.systems.ports import PERIOD, MessageInputs, MessageState, declare_message_output


@message
class _MapperState:
    """The particle filter, and the map of its best particle when a scan or a view was last put in."""

    filter: gmapping.GmappingState
    grid: GridMap


class GridMapper(LeafSystem):
    """Estimates pose and occupancy grid by a Rao-Blackwellised particle filter (GMapping).

    .. pydrake_system::

        name: GridMapper
        input_ports:
        - odometry
        - scan
        - mission
        output_ports:
        - pose
        - grid
        - filter

    odometry: Odometry, scan: LaserScan, mission: MissionStatus. pose: PoseEstimate at the newest odometry. grid:
    GridMap, whose stage becomes the mission's stage plus one in phase "map", with the newest scan in it.
    filter: GmappingState, all it knows.
    """

    def __init__(self, config: GridConfig, odometry: OdometryConfig, seed: int) -> None:
        """odometry: what the filter believes of it; seed: of the particles."""
        super().__init__()
        keep_to_one_thread()
        self._inputs = MessageInputs(self, "odometry", "scan", "mission")
        first = gmapping.initial_state(config, odometry, seed)
        self._state = MessageState(self, _MapperState(first, gmapping.grid_map(first, 0)))
        declare_message_output(self, "pose", self._CalcPose, self._state.tickets)
        self._state.declare_outputs(self, "grid", "filter")
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    @metered("grid_mapper")
    def _CalcPose(self, context: Context):
        now = self._state(context)
        return gmapping.pose_estimate(now.filter, now.grid.stage)

    @metered("grid_mapper")
    def _Update(self, context: Context, state: State) -> EventStatus:
        now, (odometry, scan, mission) = self._state(context), self._inputs.each(context)
        due = mission.phase == "map" and now.grid.stage == mission.stage
        stage = now.grid.stage + due
        moved = gmapping.process_odometry(now.filter, odometry)
        updated = gmapping.process_scan(moved, scan, force=due)
        grid = gmapping.grid_map(updated, stage) if updated is not moved or due else now.grid
        return self._state.set(state, _MapperState(updated, grid))


@message
class _SelectorState:
    """The newest goal and the places tried so far."""

    goal: GoalChoice
    tried: TriedPlaces


class FrontierGoalSelector(LeafSystem):
    """Chooses when the mission asks for it, and says on the way when the goal has become pointless.

    .. pydrake_system::

        name: FrontierGoalSelector
        input_ports:
        - grid
        - pose
        - mission
        - path
        - path_status
        output_ports:
        - goal

    grid: GridMap, pose: PoseEstimate, mission: MissionStatus, path: Path, path_status: PathStatus, goal: GoalChoice,
    all in M.
    """

    def __init__(
        self,
        choose: Callable[[GridMap, PoseEstimate, TriedPlaces], tuple[GoalChoice, TriedPlaces]],
        robot: RobotConfig,
        eager: bool,
    ):
        """choose: the rule, such as `tfg_drake.grid.frontier_goal.choose`. eager: see GridConfig."""
        super().__init__()
        self._choose, self._robot, self._eager = choose, robot, eager
        self._inputs = MessageInputs(self, "grid", "pose", "mission", "path", "path_status")
        self._state = MessageState(self, _SelectorState(empty_choice(), no_tries()))
        self._state.declare_outputs(self, "goal")
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Update(self, context: Context, state: State) -> EventStatus:
        now, (grid, mission) = self._state(context), self._inputs.each(context, "grid", "mission")
        if mission.phase == "choose" and mission.stage == grid.stage > now.goal.stage:
            pose = self._inputs(context, "pose")
            after = _SelectorState(*measured(self, "goal", self._choose, grid, pose, now.tried))
        elif now.goal.stage == mission.stage and not now.goal.spent and self._Pointless(context, now, mission, grid):
            after = _SelectorState(replace(now.goal, spent=True), now.tried)
        else:
            return EventStatus.DidNothing()
        return self._state.set(state, after)

    @metered("goal_selector")
    def _Pointless(self, context: Context, now: _SelectorState, mission: MissionStatus, grid: GridMap) -> bool:
        """True if the goal is pointless: no path leads there, or a newer map has no frontier there any more."""
        if mission.phase == "plan":
            path, status = self._inputs.each(context, "path", "path_status")
            return status.unreachable and path.stage == mission.stage
        return mission.phase == "follow" and self._eager and is_spent(grid, now.tried, self._robot)


@message
class _PlannerState:
    """The path, whether it is free, the mission's count of replans when it was planned, and the stamps (s) of the scan
    and the grid it was checked against."""

    path: Path
    status: PathStatus
    replans: int
    scan_stamp: float
    grid_stamp: float


class GridPlanner(LeafSystem):
    """Plans with `tfg_drake.grid.path` when the mission asks for it, and watches the path while it is followed.

    The goal lies at the edge of what is known: often there is a wall. Then another goal costs less than a look round.

    .. pydrake_system::

        name: GridPlanner
        input_ports:
        - grid
        - pose
        - goal
        - scan
        - mission
        output_ports:
        - path
        - path_status

    grid: GridMap, pose: PoseEstimate, goal: GoalChoice, mission: MissionStatus, path: Path, path_status: PathStatus,
    all in M. scan: LaserScan.
    """

    def __init__(self, robot: RobotConfig, keep_out: FloatArray | None = None):
        """keep_out: (k, 4) what fills the areas that the robot must not enter, m in M; None for none."""
        super().__init__()
        self._robot, self._keep_out = robot, np.zeros((0, 4)) if keep_out is None else keep_out
        self._inputs = MessageInputs(self, "grid", "pose", "goal", "scan", "mission")
        none = initial_state()
        self._state = MessageState(self, _PlannerState(none.path, none.status, 0, -math.inf, -math.inf))
        self._state.declare_outputs(self, "path", path_status=lambda now: now.status)
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Update(self, context: Context, state: State) -> EventStatus:
        now = after = self._state(context)
        grid, pose, goal, scan, mission = self._inputs.each(context)
        asked = (now.path.stage, now.replans) != (mission.stage, mission.replans)
        if mission.phase == "plan" and goal.stage == mission.stage and goal.node >= 0 and asked:
            after = self._Plan(context, now)
        elif mission.phase == "follow" and now.status.free and scan.stamp > now.scan_stamp:
            after = self._Watch(now, grid, scan, pose)
        return self._state.set(state, after)

    @metered("grid_planner")
    def _Plan(self, context: Context, now: _PlannerState) -> _PlannerState:
        grid, pose, goal, scan, mission = self._inputs.each(context)
        seen = paths.with_segments(paths.with_returns(grid, scan, pose_at(pose, scan.stamp)), self._keep_out)
        p_MB = pose.X_MB[:2]
        points = paths.plan_path(seen, paths.find_ways(seen, p_MB, self._robot), p_MB, goal.p_MG)
        if len(points):
            path = Path(now.path.id + 1, mission.stage, points)
            status = PathStatus(path.id, free=True)
        else:
            path = replace(now.path, stage=mission.stage)
            status = PathStatus(path.id, free=False, unreachable=True)
        return _PlannerState(path, status, mission.replans, scan.stamp, grid.stamp)

    @metered("grid_planner")
    def _Watch(self, now: _PlannerState, grid: GridMap, scan: LaserScan, pose: PoseEstimate) -> _PlannerState:
        points, X_MS = now.path.points, pose_at(pose, scan.stamp)
        free = paths.path_in_scan_is_free(points, grid, scan, X_MS, self._robot)
        if grid.stamp > now.grid_stamp:
            barred = paths.with_segments(grid, self._keep_out)
            free = free and paths.path_in_grid_is_free(points, barred, X_MS[:2], self._robot)
        status = now.status if free else PathStatus(now.path.id, free=False)
        return replace(now, status=status, scan_stamp=scan.stamp, grid_stamp=grid.stamp)
