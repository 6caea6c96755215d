"""The operator, by keyboard, the page's buttons or buttons of the robot, as a system."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, EventStatus, LeafSystem, State

from tfg_drake.mission.operation import Operation, Request, requested
from tfg_drake.systems.ports import set_state_message, state_message

PERIOD = 1.0 / 16.0

_log = logging.getLogger("tfg_drake.operator")


class Operator(LeafSystem):
    """Turns an operator's requests into what base and mission are told, see tfg_drake.mission.operation.

    .. pydrake_system::

        name: Operator
        output_ports:
        - enable
        - pause
        - stop
        - recall

    All are vectors of size 1. enable: for the base; 0 while it must stand, otherwise a number that is another one each
    time it is enabled. pause, stop, recall: for the mission, 1 or 0.

    The requests come from outside the context: a run in which there were any repeats only with the same ones.
    """

    def __init__(
        self, sources: Sequence[Callable[[], Sequence[Request]]], *, recalls: bool = True, enabled: bool = False
    ) -> None:
        """sources: each returns the requests since it was last called. recalls: the mission knows what a recall is;
        where it does not a recall ends it. enabled: the base may move from the beginning, as a simulated one may."""
        super().__init__()
        self._sources, self._recalls, self._enabled = tuple(sources), recalls, enabled
        beginning = requested(Operation(), "enable") if enabled else Operation()
        self._state = self.DeclareAbstractState(AbstractValue.Make(beginning))
        depends = {self.abstract_state_ticket(self._state)}
        for name, calc in (
            ("enable", lambda operation: operation.enabling),
            ("pause", lambda operation: operation.paused),
            ("stop", lambda operation: operation.ended),
            ("recall", lambda operation: operation.recalled),
        ):
            self.DeclareVectorOutputPort(name, 1, self._Calc(calc), depends)
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Calc(self, calc: Callable[[Operation], float]) -> Callable[[Context, BasicVector], None]:
        return lambda context, output: output.SetAtIndex(0, float(calc(state_message(context, self._state, Operation))))

    def _Update(self, context: Context, state: State) -> EventStatus:
        before = after = state_message(context, self._state, Operation)
        requests = [request for source in self._sources for request in source()]
        if context.get_time() < 0.5 * PERIOD:
            # What was asked for before the mission began was not meant for it, unless it was to stop.
            requests = [request for request in requests if request in ("stop", "end")]
            if not self._enabled:
                _log.info("nothing moves before it is enabled")
        if not self._recalls:
            requests = ["end" if request == "recall" else request for request in requests]
        if "stop" in requests or "end" in requests:
            # Nobody knows in which order they came: who asked for a stop gets it.
            requests = [request for request in requests if request != "enable"]
        for request in requests:
            _log.info("%.2f s: %s", context.get_time(), request)
            after = requested(after, request)
        if after is before:
            return EventStatus.DidNothing()
        set_state_message(state, self._state, after)
        return EventStatus.Succeeded()
