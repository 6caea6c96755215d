"""The state of a diagram's Context as values with their annotations, and back."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, System
from pydrake.systems.primitives import RandomSource

from tfg_drake.messages import FloatArray


def state_of(diagram: Diagram, root: Context, under: str) -> dict[str, tuple[Any, Any]]:
    """State of the systems of a diagram that have any, by path, such as "/explorer/follower"; of those whose path
    begins with `under`: continuous, discrete, abstract. Each with its annotation: (FloatArray, ..., kind of the first
    message, ...).

    A RandomSource is left out: the time says what it has drawn.
    """
    found = {}
    for path, system in _systems(diagram):
        vectors, messages = _values(system.GetMyContextFromRoot(root))
        if path.startswith(under) and (vectors or messages) and not isinstance(system, RandomSource):
            kinds = tuple([FloatArray] * len(vectors) + [type(one) for one in messages])
            found[path] = tuple[kinds], (*vectors, *messages)  # type: ignore[valid-type]
    return found


def restore_state(
    diagram: Diagram, root: Context, states: Mapping[str, tuple[Any, ...]], time: float, under: str
) -> None:
    """Sets the time, s, and the state of systems by path.

    Systems that are new keep their first state. A RandomSource whose path begins with `under`, and whose seed the
    Context has, draws alone up to that time. Raises what Drake raises of a vector that has another size.
    """
    for path, system in _systems(diagram):
        context = system.GetMyMutableContextFromRoot(root)
        if isinstance(system, RandomSource) and path.startswith(under):
            alone = Simulator(system)
            alone.get_mutable_context().SetStateAndParametersFrom(context)
            alone.Initialize()
            alone.AdvanceTo(time)
            context.SetStateAndParametersFrom(alone.get_context())
        elif path in states:
            parts = iter(states[path])
            if context.num_continuous_states():
                context.SetContinuousState(next(parts))
            for i in range(context.num_discrete_state_groups()):
                context.SetDiscreteState(i, next(parts))
            for i in range(context.num_abstract_states()):
                context.get_mutable_abstract_state(i).set_value(next(parts))
    root.SetTime(time)


def _values(context: Context) -> tuple[list[FloatArray], list[Any]]:
    vectors = [context.get_discrete_state(i).CopyToVector() for i in range(context.num_discrete_state_groups())]
    if context.num_continuous_states():
        vectors.insert(0, context.get_continuous_state_vector().CopyToVector())
    return vectors, [_value(context.get_abstract_state(i)) for i in range(context.num_abstract_states())]


def _value(state: AbstractValue) -> Any:
    try:
        return state.get_value()
    except RuntimeError:  # A type of C++ alone.
        return state


def _systems(part: System, path: str = "") -> Iterator[tuple[str, System]]:
    """The systems of a diagram that are none themselves, with their paths."""
    if not isinstance(part, Diagram):
        yield path, part
        return
    for one in part.GetSystems():
        yield from _systems(one, f"{path}/{one.get_name()}")
