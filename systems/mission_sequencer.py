"""The mission sequencer: observe, map, choose, plan, follow, until there is a reason to end."""

from __future__ import annotations

from collections.abc import Mapping

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.config import RobotConfig
from tfg_drake.messages import (
    FollowerStatus,
    GoalChoice,
    Hazards,
    MapEstimate,
    MissionStatus,
    Path,
    PathStatus,
    TfgMap,
)
from tfg_drake.mission import MissionInputs, initial_status, step
from tfg_drake.systems.ports import (
    declare_message_input,
    declare_message_output,
    eval_message,
    set_state_message,
    state_message,
)

PERIOD = 1 / 16
# What maps in the TFG explorer.
MAPS: Mapping[str, type] = {"map": MapEstimate, "tfg": TfgMap}


class MissionSequencer(LeafSystem):
    """Runs `tfg_drake.mission.step` and ends the simulation with the mission.

    .. pydrake_system::

        name: MissionSequencer
        input_ports:
        - map (or whatever else maps)
        - tfg
        - goal
        - path
        - path_status
        - follower_status
        - hazards
        - pause
        - enable
        - stop
        output_ports:
        - mission

    Whatever maps, by default map and tfg, says with its message's stage that the newest goal is in it. pause, enable
    and stop are vectors of size 1, true above 0.5; unconnected they read 0, 1 and 0.
    """

    def __init__(self, robot: RobotConfig, glance_period: float = 0.0, maps: Mapping[str, type] = MAPS):
        """glance_period: s, as explorer.glance_period. maps: the inputs that are maps and the kinds of their messages,
        which have a stage."""
        super().__init__()
        self._max_speed, self._glance_period = robot.max_speed, glance_period
        self._maps = {declare_message_input(self, name): kind for name, kind in maps.items()}
        self._goal = declare_message_input(self, "goal")
        self._path = declare_message_input(self, "path")
        self._path_status = declare_message_input(self, "path_status")
        self._follower = declare_message_input(self, "follower_status")
        self._hazards = declare_message_input(self, "hazards")
        self._pause = self.DeclareVectorInputPort("pause", 1)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        self._stop = self.DeclareVectorInputPort("stop", 1)
        self._status = self.DeclareAbstractState(AbstractValue.Make(initial_status()))
        declare_message_output(
            self,
            "mission",
            lambda context: state_message(context, self._status, MissionStatus),
            {self.abstract_state_ticket(self._status)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Update(self, context: Context, state: State) -> EventStatus:
        status = state_message(context, self._status, MissionStatus)
        if status.phase == "done":
            return EventStatus.ReachedTermination(self, f"{status.outcome}: {status.reason}")
        updated = step(status, self._Inputs(context))
        if updated is status:
            return EventStatus.DidNothing()
        set_state_message(state, self._status, updated)
        return EventStatus.Succeeded()

    def _Inputs(self, context: Context) -> MissionInputs:
        return MissionInputs(
            time=context.get_time(),
            follower=eval_message(self._follower, context, FollowerStatus),
            goal=eval_message(self._goal, context, GoalChoice),
            path=eval_message(self._path, context, Path),
            path_status=eval_message(self._path_status, context, PathStatus),
            mapped_stage=min(eval_message(port, context, kind).stage for port, kind in self._maps.items()),
            max_speed=self._max_speed,
            glance_period=self._glance_period,
            bumper=eval_message(self._hazards, context, Hazards).bumper != 0,
            pause=_flag(self._pause, context, False),
            enable=_flag(self._enable, context, True),
            stop=_flag(self._stop, context, False),
        )


def _flag(port, context: Context, default: bool) -> bool:
    return bool(port.Eval(context)[0] > 0.5) if port.HasValue(context) else default
