"""Somebody who pushes a simulated robot when he is asked to."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, InputPort, LeafSystem, State

from tfg_drake.config import DisturbanceConfig
from tfg_drake.simulation.disturbance import Pushes, push
from tfg_drake.systems.ports import declare_message_output, eval_message, set_state_message, state_message

PERIOD = 1.0 / 16.0

_log = logging.getLogger("tfg_drake.operator")


def disturbances_now(
    scripted: Sequence[DisturbanceConfig], port: InputPort, context: Context
) -> Sequence[DisturbanceConfig]:
    """The disturbances of the scenario, and those at a port for Pushes messages, where that is connected."""
    return (*scripted, *eval_message(port, context, Pushes).pushes) if port.HasValue(context) else scripted


class Pusher(LeafSystem):
    """Turns requests for a push into what moves the base, see tfg_drake.simulation.disturbance.

    .. pydrake_system::

        name: Pusher
        output_ports:
        - pushes

    pushes: a Pushes message. The requests come from outside the context: a run in which there were any repeats only
    with the same ones.
    """

    def __init__(self, asked: Callable[[], int]) -> None:
        """asked: returns how many pushes were asked for since it was last called."""
        super().__init__()
        self._asked = asked
        self._state = self.DeclareAbstractState(AbstractValue.Make(Pushes()))
        declare_message_output(
            self,
            "pushes",
            lambda context: state_message(context, self._state, Pushes),
            {self.abstract_state_ticket(self._state)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Update(self, context: Context, state: State) -> EventStatus:
        if not self._asked():
            return EventStatus.DidNothing()
        now, before = context.get_time(), state_message(context, self._state, Pushes).pushes
        _log.info("%.2f s: push", now)
        # From the next instant on, which plant and odometry have both still before them.
        set_state_message(state, self._state, Pushes((*before, push(now + PERIOD))))
        return EventStatus.Succeeded()
