"""Somebody who asks for something while a mission runs, as a system."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.systems.ports import declare_message_output, set_state_message, state_message

PERIOD = 1.0 / 16.0


class Requester(LeafSystem):
    """Holds a message that changes whenever somebody asks for something: a RequestedGoal, or Pushes.

    .. pydrake_system::

        name: Requester
        output_ports:
        - (name)

    The requests come from outside the context: a run in which there were any repeats only with the same ones, as a
    replay has them where they were recorded.
    """

    def __init__(
        self, name: str, beginning: object, asked: Callable[[], Any], after: Callable[[Any, Any, float], object]
    ) -> None:
        """name: of the output. beginning: the message before the first request. asked: returns the requests since it
        was last called, something false where there are none. after: returns the message after the one before, such
        requests, and the time from which on it holds, s."""
        super().__init__()
        self._asked, self._after, self._kind = asked, after, type(beginning)
        self._state = self.DeclareAbstractState(AbstractValue.Make(beginning))
        declare_message_output(
            self,
            name,
            lambda context: state_message(context, self._state, self._kind),
            {self.abstract_state_ticket(self._state)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Update(self, context: Context, state: State) -> EventStatus:
        asked = self._asked()
        if not asked:
            return EventStatus.DidNothing()
        before = state_message(context, self._state, self._kind)
        # It holds from the next instant on, which all who listen still have before them.
        set_state_message(state, self._state, self._after(before, asked, context.get_time() + PERIOD))
        return EventStatus.Succeeded()
