"""The operator, by keyboard, the page's buttons or buttons of the robot, as a system."""

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
    """Requests of the operator so far. begun: the sources have been asked once."""

    operation: Operation
    goal: RequestedGoal = RequestedGoal()
    pushes: Pushes = Pushes()
    said: SaidPose = SaidPose()
    begun: bool = False


class Operator(LeafSystem):
    """Turns an operator's requests into what base and mission are told, see tfg_drake.mission.operation.

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

    The first four are vectors of size 1. enable: for the base; 0 while it must stand, otherwise a number that is
    another one each time it is enabled. pause, stop, recall: for the mission, 1 or 0. requested_goal: where the robot
    is sent, a RequestedGoal message. pushes: what moves a simulated robot besides its wheels, a Pushes message.
    said_pose: where the robot is said to be, a SaidPose message.

    The requests come from outside the context: a run in which there were any repeats only with the same ones, as a
    replay has the places to which the robot was sent, and where it was said to be.
    """

    def __init__(
        self, sources: Sequence[Callable[[], Sequence[Request]]], *, recalls: bool = True, enabled: bool = False
    ) -> None:
        """sources: each returns the requests since it was last called. recalls: the mission knows what a recall is;
        where it does not a recall ends it. enabled: the base may move from the beginning, as a simulated one may."""
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
        # It holds from the next instant on, which all who listen still have before them.
        then = context.get_time() + PERIOD
        places = [request for request in requests if isinstance(request, tuple)]
        if places:
            after = replace(after, goal=goal_asked_for(after.goal, places, then))
        if "push" in requests:  # However often that was asked for at once, it is one.
            after = replace(after, pushes=with_push(after.pushes, then))
        said = [request for request in requests if isinstance(request, SaidPose)]
        if said:
            after = replace(after, said=replace(said[-1], stamp=then, count=before.said.count + len(said)))
            _log.info("%.2f s: said to be at (%.2f, %.2f) m in the world of its map", then, *said[-1].X_WB[:2])
        commands = [request for request in requests if isinstance(request, str) and request != "push"]
        if begins:
            # What was asked for before the mission began was not meant for it, unless it was to stop.
            commands = [command for command in commands if command in ("stop", "end")]
        if not self._recalls:
            commands = ["end" if command == "recall" else command for command in commands]
        if "stop" in commands or "end" in commands:
            # Nobody knows in which order they came: who asked for a stop gets it.
            commands = [command for command in commands if command != "enable"]
        for command in commands:
            _log.info("%.2f s: %s", context.get_time(), command)
            after = replace(after, operation=requested(after.operation, command))
        return after
