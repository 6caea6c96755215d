"""Measures the CPU time of the components of a diagram.

    @metered("estimator")
    def _Update(self, context, state): ...

Each call of a decorated method is charged if its system has a meter (`CpuMeter.attach`). Do not decorate methods that
mostly find nothing to do: reading the clock costs more than such a call.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from typing import Any, TypeVar

from pydrake.systems.framework import Diagram, System

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")


class CpuMeter:
    """CPU seconds of this thread by name.

    A call inside another is charged to the inner name only, so that the times add up: Drake evaluates an output port on
    demand, often in the middle of another component's event.
    """

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self._inner = 0.0

    def attach(self, system: System) -> None:
        """Charge the metered methods of a system, or of all systems in a diagram, from now on."""
        for part in system.GetSystems() if isinstance(system, Diagram) else ():
            self.attach(part)
        system.cpu_meter = self

    def call(self, name: str, function: Callable[..., Any], *args: Any) -> Any:
        """Return function(*args) and charge its time to a name."""
        outside, self._inner = self._inner, 0.0
        begin = time.thread_time()
        try:
            return function(*args)
        finally:
            spent = time.thread_time() - begin
            self.spent[name] = self.spent.get(name, 0.0) + spent - self._inner
            self._inner = outside + spent


def measured(system: System, name: str, function: Callable[..., T], *args: Any) -> T:
    """Call a function, return its result, and charge its CPU time to a name if the system has a meter."""
    meter = getattr(system, "cpu_meter", None)
    result: T = function(*args) if meter is None else meter.call(name, function, *args)
    return result


def metered(name: str) -> Callable[[F], F]:
    """Decorate a system's method so that its calls are charged to a name if the system has a meter."""

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def inner(system: System, *args: Any) -> Any:
            return measured(system, name, function, system, *args)

        return inner  # type: ignore[return-value]

    return decorate
