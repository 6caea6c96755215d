"""The goal selector: once a stage, the roadmap node to drive to next."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.messages import GoalChoice, MapEstimate, MissionStatus, message, replace
from tfg_drake.planning.candidates import GoalParameters, Situation
from tfg_drake.planning.goal_choice import choose, choose_near, empty_choice
from tfg_drake.planning.information_gain import density_shown
from tfg_drake.planning.local import local, planning_radius
from tfg_drake.planning.promises import Promise, judged, promised
from tfg_drake.planning.requested_goal import RequestedGoal, Sent, goal_there, where_sent
from tfg_drake.systems.blas_threads import keep_to_one_thread
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageInputs, MessageState, number


@message
class _SelectorState:
    """The choice at the newest stage, where somebody has sent the robot, and what the goals have promised."""

    goal: GoalChoice
    sent: Sent = Sent()
    promise: Promise = Promise()


class InfoGainGoalSelector(LeafSystem):
    """Runs `tfg_drake.planning.goal_choice.choose` when the mission asks for it and map, TFG and roadmap are ready.

    .. pydrake_system::

        name: InfoGainGoalSelector
        input_ports:
        - map
        - landmarks
        - tfg
        - roadmap
        - local_roadmap
        - mission
        - hypotheses
        - recall
        - requested_goal
        output_ports:
        - goal

    map: MapEstimate, tfg: TfgMap, roadmap: Roadmap, local_roadmap: Roadmap, mission: MissionStatus, goal: GoalChoice,
    all in M. local_roadmap: as much of roadmap as planning works on. landmarks: MapEstimate of tags and walls,
    optional; without it, and with the approximations to the exact gain, tags alone count. hypotheses: Hypotheses,
    optional, in which places of a known map the robot may be, see `tfg_drake.planning.which_place`.

    On a large map the goal is looked for near the newest view first, see `tfg_drake.planning.goal_choice.choose_near`.
    recall: (1,), 0 where it is unconnected: above 0.5 the robot was called back, and no goal is worth going to any
    more.
    requested_goal: a RequestedGoal message, optional: where somebody has sent the robot, see
    tfg_drake.planning.requested_goal.
    """

    def __init__(self, parameters: GoalParameters, frontiers: Callable[[Situation], Situation] | None = None) -> None:
        """frontiers: puts others into a situation than the TFG has."""
        super().__init__()
        keep_to_one_thread()
        self._parameters = parameters
        self._frontiers = frontiers or (lambda now: now)
        maps = "map", "landmarks", "tfg", "roadmap", "local_roadmap"
        self._inputs = MessageInputs(self, *maps, "mission", "hypotheses", requested_goal=RequestedGoal)
        self._recall = self.DeclareVectorInputPort("recall", 1)
        self._state = MessageState(self, _SelectorState(empty_choice()), self._Update)
        self._state.declare_outputs(self, "goal")

    def Choose(self, context: Context, goal: GoalChoice) -> None:
        """Makes this the newest choice in the system's context, as if the rule had come to it: its stage is that of the
        one that it replaces, its node one of the roadmap that can be reached."""
        context.SetAbstractState(int(self._state.index), replace(self._state(context), goal=goal, promise=Promise()))

    def _Update(self, context: Context, now: _SelectorState) -> _SelectorState:
        mission = self._inputs(context, "mission")
        if mission.phase != "choose" or mission.stage <= now.goal.stage:
            return now
        estimate, tfg, near = self._inputs.each(context, "map", "tfg", "local_roadmap")
        if self._parameters.explorer.gain == "exact":
            estimate = self._inputs.optional(context, "landmarks") or estimate
        if not mission.stage == estimate.stage == tfg.stage == near.stage:
            return now
        promise = judged(now.promise, estimate, self._parameters.explorer.prior_sigma)
        goal = self._Choose(context, now.goal, promise, estimate.given_shared())
        stop_gain = self._parameters.explorer.stop_gain
        chosen = _SelectorState(goal, now.sent, promised(goal, estimate, promise, stop_gain))
        return self._Send(context, chosen, mission)

    @metered("goal")
    def _Choose(self, context: Context, previous: GoalChoice, promise: Promise, landmarks: MapEstimate) -> GoalChoice:
        recalled = number(self._recall, context, 0.0) > 0.5
        (tags, tfg, near), parameters = self._inputs.each(context, "map", "tfg", "local_roadmap"), self._parameters
        is_large, radius = not tags.is_joint, planning_radius(tags, parameters.explorer)
        explorer = dataclasses.replace(parameters.explorer, density=density_shown(landmarks, tfg, parameters.explorer))
        if not promise.believed:
            explorer = dataclasses.replace(explorer, stop_gain=math.inf)
        parameters = dataclasses.replace(parameters, explorer=explorer)
        hypotheses = self._inputs.optional(context, "hypotheses")
        if math.isfinite(radius):
            part = local(landmarks, tfg, radius, parameters.sensor.range)
            now = self._frontiers(Situation(*part, near, parameters, is_large, hypotheses))
            goal = choose_near(now, previous, radius, recalled=recalled)
            if goal is not None:
                return goal
        roadmap = self._inputs(context, "roadmap")
        now = self._frontiers(Situation(landmarks, tfg, roadmap, parameters, is_large, hypotheses))
        return choose(now, previous, recalled=recalled, kept=promise.kept)

    def _Send(self, context: Context, now: _SelectorState, mission: MissionStatus) -> _SelectorState:
        """The state with another goal, where somebody has sent the robot there."""
        requested = self._inputs.optional(context, "requested_goal") or RequestedGoal()
        if now.sent.node < 0 and requested.count == now.sent.count:
            return now
        roadmap, estimate = self._inputs.each(context, "roadmap", "map")
        sent = where_sent(now.sent, requested, roadmap, mission, estimate.X_MA[-1, :2])
        goal = goal_there(now.goal, sent.node, roadmap) if sent.node >= 0 else now.goal
        return replace(now, goal=goal, sent=sent)
