"""The manual driver: somebody at the keys drives, and the mission goes on around that."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from tfg_drake.config import RobotConfig
from tfg_drake.messages import (
    FollowerStatus,
    GoalChoice,
    MissionStatus,
    Path,
    PathStatus,
    PoseEstimate,
    TfgMap,
    message,
    replace,
)
from tfg_drake.mission.manual_drive import END, LOOK, Pressed, steered
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.scripted_drive import end_of_drive
from tfg_drake.systems.ports import (
    declare_message_input,
    declare_message_output,
    eval_message,
    set_state_message,
    state_message,
)

PERIOD = 1 / 16
# The path that the mission is told of goes so far ahead of the robot, m: nobody knows where the driver will go.
AHEAD = 0.5
# The mission is told that so much of it is left, m: there is always more to glance at.
LEFT = 10.0


@message
class _Driving:
    """goal and path as the mission is told. velocity: (v, w) of the keys, m/s and rad/s. looks: the driver wants to
    look round here; ends: to end then. pressed: all keys so far."""

    goal: GoalChoice
    path: Path
    velocity: tuple[float, float] = (0.0, 0.0)
    looks: bool = False
    ends: bool = False
    pressed: tuple[Pressed, ...] = ()


class ManualDriver(LeafSystem):
    """Commands the base as the keys say, but while the mission looks round: then the follower turns it.

    .. pydrake_system::

        name: ManualDriver
        input_ports:
        - tfg
        - pose
        - mission
        - turn_commanded
        - turn_status
        output_ports:
        - velocity_commanded
        - goal
        - path
        - path_status
        - follower_status

    turn_commanded, turn_status: the follower's velocity_commanded and follower_status. While the robot moves the
    mission glances ahead as it does on any way. The key "look" ends the way, so that the robot turns round; so does
    "end", and the mission ends after that.
    """

    def __init__(self, robot: RobotConfig, keys: Callable[[], Sequence[str]], drive: Sequence[Pressed] = ()):
        """keys: returns those pressed since it was last called, of `manual_drive.KEYS`; drive: pressed at their
        times."""
        super().__init__()
        self._robot, self._keys, self._drive = robot, keys, tuple(drive)
        self._tfg = declare_message_input(self, "tfg")
        self._pose = declare_message_input(self, "pose")
        self._mission = declare_message_input(self, "mission")
        self._turn = self.DeclareVectorInputPort("turn_commanded", 2)
        self._turn_status = declare_message_input(self, "turn_status")
        initial = _Driving(empty_choice(), Path(0, 0, np.zeros((0, 2))))
        self._state = self.DeclareAbstractState(AbstractValue.Make(initial))
        ticket = {self.abstract_state_ticket(self._state)}
        self.DeclareVectorOutputPort("velocity_commanded", 2, self._CalcVelocity)
        declare_message_output(self, "goal", lambda context: self._State(context).goal, ticket)
        declare_message_output(self, "path", lambda context: self._State(context).path, ticket)
        declare_message_output(
            self, "path_status", lambda context: PathStatus(self._State(context).path.id, free=True), ticket
        )
        declare_message_output(self, "follower_status", self._Status, {self.all_sources_ticket()})
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def pressed(self, context: Context) -> tuple[Pressed, ...]:
        """All keys so far; context: the system's own."""
        return self._State(context).pressed

    def _State(self, context: Context) -> _Driving:
        return state_message(context, self._state, _Driving)

    def _CalcVelocity(self, context: Context, output: BasicVector) -> None:
        mission = eval_message(self._mission, context, MissionStatus)
        if mission.phase == "observe":
            output.SetFromVector(self._turn.Eval(context))
        elif mission.phase in ("done", "paused"):
            output.SetFromVector([0.0, 0.0])
        else:
            output.SetFromVector(list(self._State(context).velocity))

    def _Status(self, context: Context) -> FollowerStatus:
        mission, now = eval_message(self._mission, context, MissionStatus), self._State(context)
        turn = eval_message(self._turn_status, context, FollowerStatus)
        if mission.phase == "observe":
            return turn
        # Of a robot that stands nothing is told: the mission waits.
        told = now.path.id if now.looks or any(now.velocity) else -1
        return replace(turn, path_id=told, arrived=now.looks, turn_done=False, stalled=False, left=LEFT)

    def _Update(self, context: Context, state: State) -> EventStatus:
        mission, before = eval_message(self._mission, context, MissionStatus), self._State(context)
        now = self._Press(before, context.get_time())
        if mission.phase == "observe" and now.looks:
            now = replace(now, looks=False, velocity=(0.0, 0.0))
        if mission.phase == "choose" and mission.stage > now.goal.stage:
            now = replace(now, goal=self._Goal(context, mission, now))
        if mission.phase == "plan" and now.path.stage != mission.stage:
            x, y, theta = eval_message(self._pose, context, PoseEstimate).X_MB.tolist()
            points = np.array([[x, y], [x + AHEAD * np.cos(theta), y + AHEAD * np.sin(theta)]])
            now = replace(now, path=Path(now.path.id + 1, mission.stage, points))
        if now is before:
            return EventStatus.DidNothing()
        set_state_message(state, self._state, now)
        return EventStatus.Succeeded()

    def _Press(self, now: _Driving, time: float) -> _Driving:
        """After the keys that are due."""
        keys = list(self._keys())
        replayed = sum(one.time <= time for one in self._drive) if self._drive else 0
        keys += [one.key for one in self._drive[len(now.pressed) : replayed]]
        for key in keys:
            now = replace(
                now,
                velocity=steered(now.velocity, key, self._robot),
                looks=now.looks or key in (LOOK, END),
                ends=now.ends or key == END,
                pressed=(*now.pressed, Pressed(time, key)),
            )
        return now

    def _Goal(self, context: Context, mission: MissionStatus, now: _Driving) -> GoalChoice:
        if now.ends:
            return end_of_drive(mission.stage, eval_message(self._tfg, context, TfgMap))
        p_MB = eval_message(self._pose, context, PoseEstimate).X_MB[:2]
        return replace(empty_choice(), stage=mission.stage, node=0, p_MG=p_MB, reason="Somebody drives.")
