"""Where the CPU time of a run goes: an account of what the components of a diagram spend.

    @metered("estimator")
    def _Update(self, context, state): ...

A method is charged where its system has a meter (`CpuMeter.attach`), once a call: what finds nothing due costs less
than to read the clock, and is left out by whoever decorates.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from typing import Any, TypeVar

from pydrake.systems.framework import Diagram, System

F = TypeVar("F", bound=Callable[..., Any])


class CpuMeter:
    """CPU seconds of this thread, by what they were spent on.

    A call inside another is charged to the inner name only, so that the accounts add up: Drake evaluates an output
    port when somebody asks for it, often in the middle of another component's event. The CPU clock is read once a
    call, for it may be slow: a call has taken no more than the wall time since it began, and no more CPU time than has
    passed since the clock was read last. The lesser of the two is charged.
    """

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self._read = time.thread_time()
        self._inner = 0.0

    def attach(self, system: System) -> None:
        """Charges the metered methods of a system, or of all systems in a diagram, from now on."""
        for part in system.GetSystems() if isinstance(system, Diagram) else ():
            self.attach(part)
        system.cpu_meter = self

    def call(self, name: str, function: Callable[..., Any], *args: Any) -> Any:
        """function(*args), charged to a name."""
        read, outside, begin = self._read, self._inner, time.perf_counter()
        self._inner = 0.0
        try:
            return function(*args)
        finally:
            self._read = time.thread_time()
            spent = min(self._read - read, time.perf_counter() - begin)
            self.spent[name] = self.spent.get(name, 0.0) + spent - self._inner
            self._inner = outside + spent


def metered(name: str) -> Callable[[F], F]:
    """Decorates a system's method: its calls are charged to a name where the system has a meter."""

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def inner(system: System, *args: Any) -> Any:
            meter = getattr(system, "cpu_meter", None)
            return function(system, *args) if meter is None else meter.call(name, function, system, *args)

        return inner  # type: ignore[return-value]

    return decorate
