"""The mission sequencer: repeats observe, map, choose, plan, follow until the mission ends."""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.config import RobotConfig
from tfg_drake.mission.sequence import MissionInputs, initial_status, step
from tfg_drake.systems.ports import PERIOD, MessageInputs, MessageState, number

# Output ports of the TFG explorer whose messages are maps.
MAPS = ("map", "tfg")


class MissionSequencer(LeafSystem):
    """Runs `tfg_drake.mission.sequence.step`.

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

    goal: GoalChoice, path: Path, path_status: PathStatus, follower_status: FollowerStatus, hazards: Hazards, map:
    MapEstimate, tfg: TfgMap. mission: MissionStatus.

    The stage of each map message, by default map and tfg, tells when the newest view is in it. pause, enable and stop:
    (1,), true above 0.5; unconnected they read 0, 1 and 0.
    """

    def __init__(
        self,
        robot: RobotConfig,
        glance_period: float = 0.0,
        maps: Sequence[str] = MAPS,
        *,
        ends_simulation: bool = True,
    ):
        """glance_period: s, as explorer.glance_period. maps: the inputs with maps, whose messages have a stage.
        ends_simulation: after the end of the mission every update requests termination."""
        super().__init__()
        self._ends_simulation = ends_simulation
        self._max_speed, self._glance_period = robot.max_speed, glance_period
        self._maps = tuple(maps)
        self._inputs = MessageInputs(self, "goal", "path", "path_status", "follower_status", "hazards", *maps)
        self._pause = self.DeclareVectorInputPort("pause", 1)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        self._stop = self.DeclareVectorInputPort("stop", 1)
        self._status = MessageState(self, initial_status())
        self.DeclareStateOutputPort("mission", self._status.index)
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Update(self, context: Context, state: State) -> EventStatus:
        status = self._status(context)
        if status.phase == "done":
            ended = EventStatus.ReachedTermination(self, f"{status.outcome}: {status.reason}")
            return ended if self._ends_simulation else EventStatus.DidNothing()
        inputs = MissionInputs(
            time=context.get_time(),
            follower=lambda: self._inputs(context, "follower_status"),
            goal=lambda: self._inputs(context, "goal"),
            path=lambda: self._inputs(context, "path"),
            path_status=lambda: self._inputs(context, "path_status"),
            mapped_stage=lambda: min(one.stage for one in self._inputs.each(context, *self._maps)),
            max_speed=self._max_speed,
            glance_period=self._glance_period,
            bumper=self._inputs(context, "hazards").bumper != 0,
            pause=number(self._pause, context, 0.0) > 0.5,
            enable=number(self._enable, context, 1.0) > 0.5,
            stop=number(self._stop, context, 0.0) > 0.5,
        )
        return self._status.set(state, step(status, inputs))
