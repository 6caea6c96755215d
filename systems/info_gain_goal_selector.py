"""The goal selector: chooses the next roadmap node once a stage."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.messages import GoalChoice, MapEstimate, MissionStatus, message, replace
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.goal_choice import choose, choose_near, empty_choice
from tfg_drake.planning.information_gain import density_shown
from tfg_drake.planning.local import local, planning_radius
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.promises import Promise, judged, promised
from tfg_drake.planning.requested_goal import RequestedGoal, Sent, goal_there, where_sent
from tfg_drake.systems.blas_threads import keep_to_one_thread
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageInputs, MessageState, number


@message
class _SelectorState:
    """The choice at the newest stage, the requested place, and the promises of the goals."""

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
    all in M. local_roadmap: the part of roadmap that planning uses. landmarks: MapEstimate of tags and walls, optional;
    without it, and with the approximations to the exact gain, only tags count. hypotheses: Hypotheses, optional, the
    places of a known map where the robot may be, see `tfg_drake.planning.which_place`.

    On a large map goals near the newest view are considered first, see `tfg_drake.planning.goal_choice.choose_near`.
    recall: (1,), 0 if unconnected: above 0.5 the robot is called back, and no goal is worth a visit.
    requested_goal: a RequestedGoal message, optional: the place that the operator has sent the robot to, see
    tfg_drake.planning.requested_goal.
    """

    def __init__(
        self, parameters: PlanningParameters, frontiers: Callable[[Situation], Situation] | None = None
    ) -> None:
        """frontiers: replaces the frontiers of a situation, such as by the paper's."""
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
        """Replace the newest choice in the system's context, as if the rule had chosen it. It must have the same stage
        and a reachable node of the roadmap."""
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
        """Return the state with the requested goal, if there is a new request."""
        requested = self._inputs.optional(context, "requested_goal") or RequestedGoal()
        if now.sent.node < 0 and requested.count == now.sent.count:
            return now
        roadmap, estimate = self._inputs.each(context, "roadmap", "map")
        sent = where_sent(now.sent, requested, roadmap, mission, estimate.X_MA[-1, :2])
        goal = goal_there(now.goal, sent.node, roadmap) if sent.node >= 0 else now.goal
        return replace(now, goal=goal, sent=sent)
