"""The planner of grid methods: plans the cheapest path to the chosen goal and monitors it."""

from __future__ import annotations

import math

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.config import RobotConfig
from tfg_drake.geometry.se2 import pose_at
from tfg_drake.grid import path as paths
from tfg_drake.messages import FloatArray, GridMap, LaserScan, Path, PathStatus, PoseEstimate, message, replace
from tfg_drake.planning.planner import initial_state
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageInputs, MessageState


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
    """Plans with `tfg_drake.grid.path` when the mission asks for it, and monitors the path while it is followed.

    The goal lies at the edge of the known area, often at a wall. Then choosing another goal costs less than looking
    around.

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
        """keep_out: (k, 4) segments that fill the keep-out areas, m in M; None for none."""
        super().__init__()
        self._robot, self._keep_out = robot, np.zeros((0, 4)) if keep_out is None else keep_out
        self._inputs = MessageInputs(self, "grid", "pose", "goal", "scan", "mission")
        none = initial_state()
        state = MessageState(self, _PlannerState(none.path, none.status, 0, -math.inf, -math.inf), self._Update)
        state.declare_outputs(self, "path", path_status=lambda now: now.status)

    def _Update(self, context: Context, now: _PlannerState) -> _PlannerState:
        grid, pose, goal, scan, mission = self._inputs.each(context)
        asked = (now.path.stage, now.replans) != (mission.stage, mission.replans)
        if mission.phase == "plan" and goal.stage == mission.stage and goal.node >= 0 and asked:
            return self._Plan(context, now)
        if mission.phase == "follow" and now.status.free and scan.stamp > now.scan_stamp:
            return self._Watch(now, grid, scan, pose)
        return now

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
