"""Parts of a diagram that a user may put in place of the usual ones: each comes from a factory, of one kind."""

from __future__ import annotations

import inspect
from collections.abc import Callable

from pydrake.systems.framework import System

from tfg_drake.diagrams.scenario import Scenario

# A diagram needs a part of its own, and a scenario says of what: so a part is given as a function that makes one.
Factory = Callable[[Scenario], System]


def CheckFactory(role: str, factory: Factory | None) -> None:
    """Raises TypeError where what is given for a part, called `role` in messages, is no function that makes one."""
    if factory is not None and (isinstance(factory, System) or not callable(factory)):
        kind = type(factory).__name__
        raise TypeError(f"{role}: must be a function that makes one, not a {kind}: write lambda scenario: ...")


def MakePart(role: str, factory: Factory | None, usual: Factory, scenario: Scenario) -> System:
    """The System that a factory makes for the scenario, or the usual one where there is none.

    Raises TypeError as CheckFactory does, and where the factory makes no system.
    """
    CheckFactory(role, factory)
    try:
        inspect.signature(factory or usual).bind(scenario)
    except TypeError as error:
        raise TypeError(f"{role}: must be a function of a scenario: {error}; write lambda scenario: ...") from None
    part = (factory or usual)(scenario)
    if not isinstance(part, System):
        raise TypeError(f"{role}: its function must return a Drake System, not {type(part).__name__}")
    return part
