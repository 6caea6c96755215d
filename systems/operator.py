"""The operator's requests by keyboard, page or buttons of the robot, as a system."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.messages import SaidPose, message, replace
from tfg_drake.mission.operation import Operation, Request, requested
from tfg_drake.planning.requested_goal import RequestedGoal, goal_asked_for
from tfg_drake.simulation.disturbance import Pushes, with_push
from tfg_drake.systems.ports import PERIOD, MessageState

_log = logging.getLogger("tfg_drake.operator")


@message
class _Asked:
    """The operator's requests so far. begun: the sources have been polled once."""

    operation: Operation
    goal: RequestedGoal = RequestedGoal()
    pushes: Pushes = Pushes()
    said: SaidPose = SaidPose()
    begun: bool = False


class Operator(LeafSystem):
    """Converts an operator's requests to inputs of base and mission, see tfg_drake.mission.operation.

    .. pydrake_system::

        name: Operator
        output_ports:
        - enable
        - pause
        - stop
        - recall
        - requested_goal
        - pushes
        - said_pose

    The first four are vectors of size 1. enable: for the base; 0 while it must stand, otherwise a number that changes
    each time the base is enabled. pause, stop, recall: for the mission, 1 or 0. requested_goal: the place to drive to,
    a RequestedGoal message. pushes: motions of a simulated robot that its wheels do not cause, a Pushes message.
    said_pose: the robot's pose as stated by the operator, a SaidPose message.

    The requests come from outside the Context, so a run with requests repeats only with the same requests; a replay
    repeats requested goals and stated poses.
    """

    def __init__(
        self, sources: Sequence[Callable[[], Sequence[Request]]], *, recalls: bool = True, enabled: bool = False
    ) -> None:
        """sources: each returns the requests since its last call. recalls: the mission supports recalls; otherwise a
        recall ends it. enabled: the base may move from the beginning, like a simulated one."""
        super().__init__()
        self._sources, self._recalls, self._enabled = tuple(sources), recalls, enabled
        beginning = requested(Operation(), "enable") if enabled else Operation()
        self._state = MessageState(self, _Asked(beginning), self._Update)
        self._state.declare_numbers(
            self,
            enable=lambda now: now.operation.enabling,
            pause=lambda now: now.operation.paused,
            stop=lambda now: now.operation.ended,
            recall=lambda now: now.operation.recalled,
        )
        goal, said = lambda now: now.goal, lambda now: now.said
        self._state.declare_outputs(self, "pushes", requested_goal=goal, said_pose=said)

    def _Update(self, context: Context, before: _Asked) -> _Asked:
        requests = [request for source in self._sources for request in source()]
        after, begins = replace(before, begun=True), not before.begun
        if begins and not self._enabled:
            _log.info("nothing moves before it is enabled")
        if not (begins or requests):
            return before
        # Requests take effect at the next instant, which no receiver has passed yet.
        then = context.get_time() + PERIOD
        places = [request for request in requests if isinstance(request, tuple)]
        if places:
            after = replace(after, goal=goal_asked_for(after.goal, places, then))
        if "push" in requests:  # Several pushes requested at one instant are one push.
            after = replace(after, pushes=with_push(after.pushes, then))
        said = [request for request in requests if isinstance(request, SaidPose)]
        if said:
            after = replace(after, said=replace(said[-1], stamp=then, count=before.said.count + len(said)))
            _log.info("%.2f s: said to be at (%.2f, %.2f) m in the world of its map", then, *said[-1].X_WB[:2])
        commands = [request for request in requests if isinstance(request, str) and request != "push"]
        if begins:
            # Requests from before the mission do not count, except to stop.
            commands = [command for command in commands if command in ("stop", "end")]
        if not self._recalls:
            commands = ["end" if command == "recall" else command for command in commands]
        if "stop" in commands or "end" in commands:
            # Their order is unknown, so a stop prevails.
            commands = [command for command in commands if command != "enable"]
        for command in commands:
            _log.info("%.2f s: %s", context.get_time(), command)
            after = replace(after, operation=requested(after.operation, command))
        return after
