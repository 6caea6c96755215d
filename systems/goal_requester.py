"""Somebody who sends the robot to places, as a system."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.planning.requested_goal import RequestedGoal
from tfg_drake.systems.ports import declare_message_output, set_state_message, state_message

PERIOD = 1.0 / 16.0

_log = logging.getLogger("tfg_drake.operator")


class GoalRequester(LeafSystem):
    """Holds the place that somebody has sent the robot to last.

    .. pydrake_system::

        name: GoalRequester
        output_ports:
        - requested_goal

    requested_goal: a RequestedGoal message. The requests come from outside the context: they are recorded with the
    station's ports, so that a replay has them again.
    """

    def __init__(self, asked: Callable[[], Sequence[tuple[float, float]]]) -> None:
        """asked: returns the places (x, y), m in M, that were asked for since it was last called."""
        super().__init__()
        self._asked = asked
        self._state = self.DeclareAbstractState(AbstractValue.Make(RequestedGoal()))
        declare_message_output(
            self,
            "requested_goal",
            lambda context: state_message(context, self._state, RequestedGoal),
            {self.abstract_state_ticket(self._state)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Update(self, context: Context, state: State) -> EventStatus:
        asked = self._asked()
        if not asked:
            return EventStatus.DidNothing()
        x, y = asked[-1]
        _log.info("%.2f s: sent to (%.2f, %.2f) in M", context.get_time(), x, y)
        before = state_message(context, self._state, RequestedGoal)
        set_state_message(state, self._state, RequestedGoal(before.count + len(asked), np.array([x, y])))
        return EventStatus.Succeeded()
