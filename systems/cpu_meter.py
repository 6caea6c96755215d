"""CPU time of a run: an account of what the components of a diagram spend.

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
T = TypeVar("T")


class CpuMeter:
    """CPU seconds of this thread, by what they were spent on.

    A call inside another is charged to the inner name only, so that the accounts add up: Drake evaluates an output
    port when somebody asks for it, often in the middle of another component's event.
    """

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self._inner = 0.0

    def attach(self, system: System) -> None:
        """Charges the metered methods of a system, or of all systems in a diagram, from now on."""
        for part in system.GetSystems() if isinstance(system, Diagram) else ():
            self.attach(part)
        system.cpu_meter = self

    def call(self, name: str, function: Callable[..., Any], *args: Any) -> Any:
        """function(*args), charged to a name."""
        outside, self._inner = self._inner, 0.0
        begin = time.thread_time()
        try:
            return function(*args)
        finally:
            spent = time.thread_time() - begin
            self.spent[name] = self.spent.get(name, 0.0) + spent - self._inner
            self._inner = outside + spent


def measured(system: System, name: str, function: Callable[..., T], *args: Any) -> T:
    """Call a function and return its result, its CPU time charged to a name where the system has a meter."""
    meter = getattr(system, "cpu_meter", None)
    result: T = function(*args) if meter is None else meter.call(name, function, *args)
    return result


def metered(name: str) -> Callable[[F], F]:
    """Decorates a system's method: its calls are charged to a name where the system has a meter."""

    def decorate(function: F) -> F:
        @functools.wraps(function)
        def inner(system: System, *args: Any) -> Any:
            return measured(system, name, function, system, *args)

        return inner  # type: ignore[return-value]

    return decorate
