"""Typed access to abstract ports and state with messages (tfg_drake/messages.py).

Drake's abstract values do not check Python types; these functions do.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Mapping
from typing import Any, Generic, TypeVar, cast

from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    Context,
    DiagramBuilder,
    EventStatus,
    InputPort,
    LeafSystem,
    OutputPort,
    State,
    System,
)

from tfg_drake import messages

# Period of the odometry and of its consumers, s; a power of two, so that their instants coincide.
PERIOD = 1.0 / 16.0
# Period of the base, its commands and the safety filter, s.
COMMAND_PERIOD = 1.0 / 32.0
# Message of each port name that systems share, as input and as output.
KINDS: Mapping[str, type] = {
    "odometry": messages.Odometry,
    "hazards": messages.Hazards,
    "detections": messages.TagDetections,
    "scan": messages.LaserScan,
    "said_pose": messages.SaidPose,
    "pose": messages.PoseEstimate,
    "map": messages.MapEstimate,
    "landmarks": messages.MapEstimate,
    "hypotheses": messages.Hypotheses,
    "tfg": messages.TfgMap,
    "grid": messages.GridMap,
    "roadmap": messages.Roadmap,
    "local_roadmap": messages.Roadmap,
    "goal": messages.GoalChoice,
    "path": messages.Path,
    "path_status": messages.PathStatus,
    "follower_status": messages.FollowerStatus,
    "mission": messages.MissionStatus,
}

T = TypeVar("T")


def declare_message_output(
    system: LeafSystem, name: str, calc: Callable[[Context], object], prerequisites_of_calc: set[Any]
) -> OutputPort:
    """Declare an output port whose message is calc(context), which depends on the prerequisites (tickets) only."""

    def calc_value(context: Context, output: AbstractValue) -> None:
        output.set_value(calc(context))

    port = system.DeclareAbstractOutputPort(
        name, lambda: AbstractValue.Make(object()), calc_value, prerequisites_of_calc
    )
    return cast(OutputPort, port)


class MessageInputs:
    """Input ports for messages, by name; calling it with a context and a name returns the message there."""

    def __init__(self, system: LeafSystem, *names: str, **kinds: type) -> None:
        """Declare the ports. names: of KINDS. kinds: message types of other ports, by port name. Raises ValueError."""
        if unknown := [name for name in names if name not in KINDS]:
            raise ValueError(f"no message is known as {unknown[0]}; name its kind, or one of {', '.join(KINDS)}")
        self._kinds = {name: KINDS[name] for name in names} | kinds
        anything = AbstractValue.Make(object())
        self.ports = {name: system.DeclareAbstractInputPort(name, anything) for name in self._kinds}

    def __call__(self, context: Context, name: str) -> Any:
        """Return the message. Raises TypeError if the port is not connected or holds another type."""
        port, kind = self.ports[name], self._kinds[name]
        try:
            value = port.Eval(context)
        except (RuntimeError, SystemExit) as error:
            if port.HasValue(context):
                raise
            raise TypeError(f"{_name(port)} must be connected to an output of {kind.__name__}.") from error
        if not isinstance(value, kind):
            raise TypeError(f"{_name(port)} must hold {kind.__name__}, not {type(value).__name__}.")
        return value

    def optional(self, context: Context, name: str) -> Any:
        """Return the message, None if the port is not connected."""
        return self(context, name) if self.ports[name].HasValue(context) else None

    def each(self, context: Context, *names: str) -> list[Any]:
        """Return the messages at some of the ports, by default at all."""
        return [self(context, name) for name in names or self.ports]


class MessageState(Generic[T]):
    """An abstract state variable with messages of one type; calling it with a context returns the message."""

    def __init__(
        self,
        system: LeafSystem,
        initial: T,
        update: Callable[[Context, T], T] | None = None,
        period: float = PERIOD,
    ) -> None:
        """Declare the variable. initial: the first message, which determines the type. update: computes the next
        message from the previous one every `period`, s."""
        self._kind = type(initial)
        self.index = system.DeclareAbstractState(AbstractValue.Make(initial))
        self._number = int(self.index)
        self.tickets = {system.abstract_state_ticket(self.index)}
        if update is not None:
            event = lambda context, state: self.set(state, update(context, self(context)))  # noqa: E731
            system.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, event)

    def __call__(self, context: Context | State) -> T:
        """Return the message. Raises TypeError if the variable holds another type."""
        value = context.get_abstract_state(self._number).get_value()
        if not isinstance(value, self._kind):
            found = type(value).__name__
            raise TypeError(f"abstract state {self._number} must hold {self._kind.__name__}, not {found}.")
        return value

    def set(self, state: State, value: T) -> EventStatus:
        """Set the message. Returns the status of an event that only does this: DidNothing if the message is
        unchanged."""
        variable = state.get_mutable_abstract_state(self._number)
        if variable.get_value() is value:
            return EventStatus.DidNothing()
        variable.set_value(value)
        return EventStatus.Succeeded()

    def declare_outputs(self, system: LeafSystem, *names: str, **parts: Callable[[T], object]) -> None:
        """Declare output ports of the system: for fields of the message with these names, and for functions of the
        message, by port name."""
        named: dict[str, Callable[[T], object]] = {name: operator.attrgetter(name) for name in names}
        for name, part in (named | parts).items():
            declare_message_output(system, name, functools.partial(self._part, part), self.tickets)

    def declare_numbers(self, system: LeafSystem, **parts: Callable[[T], float]) -> None:
        """Declare output ports of the system: vectors of size 1 computed by functions of the message, by port name."""
        for name, part in parts.items():
            calc = lambda context, output, part=part: output.SetAtIndex(0, float(part(self(context))))  # noqa: E731
            system.DeclareVectorOutputPort(name, 1, calc, self.tickets)

    def _part(self, part: Callable[[T], object], context: Context) -> object:
        return part(self(context))


def number(port: InputPort, context: Context, default: float) -> float:
    """Return the first entry of an input vector, the default if the port is not connected."""
    return float(port.Eval(context)[0]) if port.HasValue(context) else default


def connect_by_name(builder: DiagramBuilder, listener: System, *speakers: System, **heard_as: str) -> None:
    """Connect the unconnected inputs of a system to outputs of other systems with the same names, as far as they exist.
    heard_as: output names for inputs with other names."""
    for port in (listener.get_input_port(i) for i in range(listener.num_input_ports())):
        name = heard_as.get(port.get_name(), port.get_name())
        speaker = next((one for one in speakers if one.HasOutputPort(name)), None)
        if speaker is not None and not builder.IsConnectedOrExported(port):
            builder.Connect(speaker.GetOutputPort(name), port)


def _name(port: InputPort) -> str:
    return f"{port.get_system().get_name()}.{port.get_name()}"
