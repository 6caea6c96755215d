"""The state of a diagram's Context as plain values, and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, System
from pydrake.systems.primitives import RandomSource


def state_of(diagram: Diagram, root: Context) -> dict[str, list[Any]]:
    """Discrete and abstract state of the systems of a diagram that have any, by path, such as "/explorer/follower".

    A RandomSource is left out: the time says what it has drawn.
    """
    found = {}
    for path, system in _systems(diagram):
        context = system.GetMyContextFromRoot(root)
        parts: list[Any] = []
        if not isinstance(system, RandomSource):
            parts += [context.get_discrete_state(i).CopyToVector() for i in range(context.num_discrete_state_groups())]
            parts += [context.get_abstract_state(i).get_value() for i in range(context.num_abstract_states())]
        if parts:
            found[path] = parts
    return found


def restore_state(diagram: Diagram, root: Context, states: Mapping[str, list[Any]], time: float, under: str) -> None:
    """Sets the time, s, and the state of the systems whose path begins with `under`.

    Systems that are new keep their first state. A RandomSource, whose seed the Context has, draws alone up to that
    time.
    """
    for path, system in _systems(diagram):
        context = system.GetMyMutableContextFromRoot(root)
        if not path.startswith(under):
            continue
        if isinstance(system, RandomSource):
            alone = Simulator(system)
            alone.get_mutable_context().SetStateAndParametersFrom(context)
            alone.Initialize()
            alone.AdvanceTo(time)
            context.SetStateAndParametersFrom(alone.get_context())
        elif path in states:
            parts = iter(states[path])
            for i in range(context.num_discrete_state_groups()):
                context.SetDiscreteState(i, next(parts))
            for i in range(context.num_abstract_states()):
                context.get_mutable_abstract_state(i).set_value(next(parts))
    root.SetTime(time)


def _systems(part: System, path: str = "") -> Iterator[tuple[str, System]]:
    """The systems of a diagram that are none themselves, with their paths."""
    if not isinstance(part, Diagram):
        yield path, part
        return
    for one in part.GetSystems():
        yield from _systems(one, f"{path}/{one.get_name()}")
