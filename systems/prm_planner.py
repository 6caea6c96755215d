"""The PRM planner: the roadmap of each stage, the path to the goal chosen, and a watch on that path."""

from __future__ import annotations

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.config import ExplorerConfig, OdometryConfig, PlannerConfig, RobotConfig, TagSensorConfig
from tfg_drake.cpu_meter import metered
from tfg_drake.messages import GoalChoice, LaserScan, MapEstimate, MissionStatus, PoseEstimate, TfgMap
from tfg_drake.planning.planner import PlannerState, initial_state, step
from tfg_drake.planning.roadmap import RoadmapParameters
from tfg_drake.systems.ports import (
    declare_message_input,
    declare_message_output,
    eval_message,
    set_state_message,
    state_message,
)

PERIOD = 1 / 16


class PrmPlanner(LeafSystem):
    """Runs `tfg_drake.planning.planner.step` at 16 Hz.

    .. pydrake_system::

        name: PrmPlanner
        input_ports:
        - map
        - tfg
        - pose
        - goal
        - scan
        - mission
        output_ports:
        - roadmap
        - path
        - path_status

    seed: of the roadmap's samples; with it and the inputs the roadmap is determined.
    """

    def __init__(
        self,
        robot: RobotConfig,
        odometry: OdometryConfig,
        sensor: TagSensorConfig,
        explorer: ExplorerConfig,
        planner: PlannerConfig,
        seed: int,
    ):
        super().__init__()
        self._parameters = RoadmapParameters(robot, sensor, odometry, explorer, planner, seed)
        self._map = declare_message_input(self, "map")
        self._tfg = declare_message_input(self, "tfg")
        self._pose = declare_message_input(self, "pose")
        self._goal = declare_message_input(self, "goal")
        self._scan = declare_message_input(self, "scan")
        self._mission = declare_message_input(self, "mission")
        self._state = self.DeclareAbstractState(AbstractValue.Make(initial_state()))
        ticket = {self.abstract_state_ticket(self._state)}
        declare_message_output(self, "roadmap", lambda context: self._State(context).roadmap, ticket)
        declare_message_output(self, "path", lambda context: self._State(context).path, ticket)
        declare_message_output(self, "path_status", lambda context: self._State(context).status, ticket)
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _State(self, context: Context) -> PlannerState:
        return state_message(context, self._state, PlannerState)

    @metered("prm_planner")
    def _Update(self, context: Context, state: State) -> EventStatus:
        now = self._State(context)
        updated = step(
            now,
            eval_message(self._map, context, MapEstimate),
            eval_message(self._tfg, context, TfgMap),
            eval_message(self._pose, context, PoseEstimate),
            eval_message(self._goal, context, GoalChoice),
            eval_message(self._scan, context, LaserScan),
            eval_message(self._mission, context, MissionStatus),
            self._parameters,
        )
        if updated is now:
            return EventStatus.DidNothing()
        set_state_message(state, self._state, updated)
        return EventStatus.Succeeded()
