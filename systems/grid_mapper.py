"""GMapping as a Drake system: a shell round tfg_drake/grid/gmapping.py."""

from __future__ import annotations

from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.config import GridConfig, OdometryConfig
from tfg_drake.grid import gmapping
from tfg_drake.messages import GridMap, message
from tfg_drake.systems.blas_threads import keep_to_one_thread
from tfg_drake.systems.cpu_meter import metered
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
