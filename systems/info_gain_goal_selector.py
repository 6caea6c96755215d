"""The goal selector: once a stage, the roadmap node to drive to next."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.config import ExplorerConfig, OdometryConfig, RobotConfig, TagSensorConfig
from tfg_drake.messages import GoalChoice, MapEstimate, MissionStatus, Roadmap, TfgMap, WorkingMap, message
from tfg_drake.planning.candidates import GoalParameters
from tfg_drake.planning.goal_choice import choose, empty_choice, remember
from tfg_drake.planning.requested_goal import RequestedGoal, Sent, goal_there, where_sent
from tfg_drake.systems.blas_threads import keep_to_one_thread
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageState, declare_message_input, eval_message, eval_optional

PERIOD = 1 / 16


@message
class _SelectorState:
    """The choice at the newest stage, what all choices so far found worth remembering, and where somebody has sent the
    robot."""

    goal: GoalChoice
    remembered: GoalChoice
    sent: Sent = Sent()


class InfoGainGoalSelector(LeafSystem):
    """Runs `tfg_drake.planning.goal_choice.choose` when the mission asks for it and map, TFG and roadmap are ready.

    .. pydrake_system::

        name: InfoGainGoalSelector
        input_ports:
        - map
        - tfg
        - working_map
        - roadmap
        - working_roadmap
        - mission
        - recall
        - requested_goal
        output_ports:
        - goal

    map: MapEstimate, tfg: TfgMap, working_map: WorkingMap, roadmap: Roadmap, working_roadmap: Roadmap, mission:
    MissionStatus, goal: GoalChoice, all in M.

    The goal is looked for in the working map; in the whole one where nothing there is worth going to, or only by a way
    that is longer than to what may lie outside, and as long as the robot is on such a way. recall: (1,), 0 where it
    is unconnected: above 0.5 the robot was called back, and no goal is worth going to any more.
    requested_goal: a RequestedGoal message, optional: where somebody has sent the robot, see
    tfg_drake.planning.requested_goal.
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
        keep_to_one_thread()
        self._parameters = GoalParameters(robot, sensor, odometry, explorer, seed)
        self._map = declare_message_input(self, "map")
        self._tfg = declare_message_input(self, "tfg")
        self._working_map = declare_message_input(self, "working_map")
        self._working_roadmap = declare_message_input(self, "working_roadmap")
        self._roadmap = declare_message_input(self, "roadmap")
        self._mission = declare_message_input(self, "mission")
        self._recall = self.DeclareVectorInputPort("recall", 1)
        self._requested = declare_message_input(self, "requested_goal")
        self._state = MessageState(self, _SelectorState(empty_choice(), empty_choice()))
        self._state.declare_output(self, "goal", lambda now: now.goal)
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def Choose(self, context: Context, goal: GoalChoice) -> None:
        """Makes this the newest choice in the system's context, as if the rule had come to it: its stage is that of the
        one that it replaces, its node one of the roadmap that can be reached."""
        roadmap = eval_message(self._working_roadmap, context, Roadmap)
        before = self._state(context)
        remembered = remember(before.remembered, goal, roadmap, self._parameters.explorer.stop_gain)
        context.SetAbstractState(int(self._state.index), _SelectorState(goal, remembered, before.sent))

    def _Update(self, context: Context, state: State) -> EventStatus:
        mission = eval_message(self._mission, context, MissionStatus)
        now = self._state(context)
        if mission.phase != "choose" or mission.stage <= now.goal.stage:
            return EventStatus.DidNothing()
        working = eval_message(self._working_map, context, WorkingMap)
        roadmap = eval_message(self._working_roadmap, context, Roadmap)
        if not mission.stage == working.stage == roadmap.stage:
            return EventStatus.DidNothing()
        chosen = self._Choose(context, now, working, roadmap)
        self._state.set(state, self._Send(context, chosen, mission))
        return EventStatus.Succeeded()

    @metered("goal")
    def _Choose(self, context: Context, now: _SelectorState, working: WorkingMap, roadmap: Roadmap) -> _SelectorState:
        # On a long way the robot weighs all there is against its goal.
        recalled = self._recall.HasValue(context) and bool(self._recall.Eval(context)[0] > 0.5)
        goal = None
        if now.goal.node < 0 or _is_nearest(now.goal, roadmap, working.reach):
            part = working.estimate, working.tfg, roadmap, self._parameters, now.remembered
            goal = choose(*part, everything=working.is_all, recalled=recalled)
        if goal is None or not (working.is_all or _is_nearest(goal, roadmap, working.reach)):
            estimate, tfg = eval_message(self._map, context, MapEstimate), eval_message(self._tfg, context, TfgMap)
            roadmap = eval_message(self._roadmap, context, Roadmap)
            goal = choose(estimate, tfg, roadmap, self._parameters, now.remembered, recalled=recalled)
        remembered = remember(now.remembered, goal, roadmap, self._parameters.explorer.stop_gain)
        return _SelectorState(goal, remembered, now.sent)

    def _Send(self, context: Context, now: _SelectorState, mission: MissionStatus) -> _SelectorState:
        """The state with another goal, where somebody has sent the robot there."""
        requested = eval_optional(self._requested, context, RequestedGoal) or RequestedGoal()
        if now.sent.node < 0 and requested.count == now.sent.count:
            return now
        roadmap = eval_message(self._roadmap, context, Roadmap)
        p_MA = eval_message(self._map, context, MapEstimate).X_MA[-1, :2]
        sent = where_sent(now.sent, requested, roadmap, mission, p_MA)
        goal = goal_there(now.goal, sent.node, roadmap) if sent.node >= 0 else now.goal
        return _SelectorState(goal, now.remembered, sent)


def _is_nearest(goal: GoalChoice, roadmap: Roadmap, reach: float) -> bool:
    """Whether there is a goal, and nearer, as the robot drives, than anything beyond reach (m) can be."""
    return goal.node >= 0 and bool(roadmap.reaches(np.array([goal.node]), reach)[0])
