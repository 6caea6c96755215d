"""The goal selector: once a stage, the roadmap node that promises the most information per time."""

from __future__ import annotations

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.config import ExplorerConfig, OdometryConfig, RobotConfig, TagSensorConfig
from tfg_drake.cpu_meter import metered
from tfg_drake.messages import GoalChoice, MapEstimate, MissionStatus, Roadmap, TfgMap
from tfg_drake.planning.goal_choice import choose, empty_choice
from tfg_drake.systems.ports import (
    declare_message_input,
    declare_message_output,
    eval_message,
    set_state_message,
    state_message,
)

PERIOD = 1 / 16


class InfoGainGoalSelector(LeafSystem):
    """Runs `tfg_drake.planning.goal_choice.choose` when the mission asks for it and map, TFG and roadmap are ready.

    .. pydrake_system::

        name: InfoGainGoalSelector
        input_ports:
        - map
        - tfg
        - roadmap
        - mission
        output_ports:
        - goal
    """

    def __init__(
        self,
        robot: RobotConfig,
        odometry: OdometryConfig,
        sensor: TagSensorConfig,
        explorer: ExplorerConfig,
        seed: int = 0,
    ):
        """seed: of the goals, where explorer.goal is random."""
        super().__init__()
        self._robot, self._sensor, self._odometry, self._explorer = robot, sensor, odometry, explorer
        self._seed = seed
        self._map = declare_message_input(self, "map")
        self._tfg = declare_message_input(self, "tfg")
        self._roadmap = declare_message_input(self, "roadmap")
        self._mission = declare_message_input(self, "mission")
        self._goal = self.DeclareAbstractState(AbstractValue.Make(empty_choice()))
        declare_message_output(
            self,
            "goal",
            lambda context: state_message(context, self._goal, GoalChoice),
            {self.abstract_state_ticket(self._goal)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    @metered("goal_selector")
    def _Update(self, context: Context, state: State) -> EventStatus:
        mission = eval_message(self._mission, context, MissionStatus)
        previous = state_message(context, self._goal, GoalChoice)
        if mission.phase != "choose" or mission.stage <= previous.stage:
            return EventStatus.DidNothing()
        estimate = eval_message(self._map, context, MapEstimate)
        tfg = eval_message(self._tfg, context, TfgMap)
        roadmap = eval_message(self._roadmap, context, Roadmap)
        if not mission.stage == estimate.stage == tfg.stage == roadmap.stage:
            return EventStatus.DidNothing()
        goal = choose(
            estimate, tfg, roadmap, self._sensor, self._odometry, self._robot, self._explorer, previous, self._seed
        )
        set_state_message(state, self._goal, goal)
        return EventStatus.Succeeded()
