"""GMapping as a Drake system, see tfg_drake/grid/gmapping.py."""

from __future__ import annotations

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.config import GridConfig, OdometryConfig
from tfg_drake.grid import gmapping
from tfg_drake.messages import GridMap, PoseEstimate, message
from tfg_drake.systems.blas_threads import keep_to_one_thread
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageInputs, MessageState


@message
class _MapperState:
    """The particle filter, and its best particle's map at the last update with a scan or view."""

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
    GridMap, which in phase "map" includes the newest scan and gets the mission's stage plus one. filter: GmappingState,
    its whole state.
    """

    def __init__(self, config: GridConfig, odometry: OdometryConfig, seed: int) -> None:
        """odometry: the filter's odometry model; seed: of the particles."""
        super().__init__()
        keep_to_one_thread()
        self._inputs = MessageInputs(self, "odometry", "scan", "mission")
        first = gmapping.initial_state(config, odometry, seed)
        state = MessageState(self, _MapperState(first, gmapping.grid_map(first, 0)), self._Update)
        state.declare_outputs(self, pose=self._Pose)
        state.declare_outputs(self, "grid", "filter")

    @metered("grid_mapper")
    def _Pose(self, now: _MapperState) -> PoseEstimate:
        return gmapping.pose_estimate(now.filter, now.grid.stage)

    @metered("grid_mapper")
    def _Update(self, context: Context, now: _MapperState) -> _MapperState:
        odometry, scan, mission = self._inputs.each(context)
        due = mission.phase == "map" and now.grid.stage == mission.stage
        stage = now.grid.stage + due
        moved = gmapping.process_odometry(now.filter, odometry)
        updated = gmapping.process_scan(moved, scan, force=due)
        grid = gmapping.grid_map(updated, stage) if updated is not moved or due else now.grid
        return _MapperState(updated, grid)
