"""Replaceable parts of a diagram, each made by a factory."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import sys
from collections.abc import Callable
from pathlib import Path as FilePath

from pydrake.systems.framework import PortDataType, System

from tfg_drake.diagrams.scenario import Scenario, ScenarioError
from tfg_drake.messages import FollowerStatus, GoalChoice, Hazards, MapEstimate, Path, PathStatus, PoseEstimate

# A function that makes a part for a scenario: every diagram needs its own instance.
Factory = Callable[[Scenario], System]

# Output ports of each role, by name: the type of the message, or the size of the vector.
OUTPUTS: dict[str, dict[str, type | int]] = {
    "estimator": {"pose": PoseEstimate, "map": MapEstimate},
    "goal_selector": {"goal": GoalChoice},
    "planner": {"path": Path, "path_status": PathStatus},
    "follower": {"velocity_commanded": 2, "follower_status": FollowerStatus},
    "plant": {"pose": 5, "hazards": Hazards},
}


def CheckFactory(role: str, factory: Factory | None) -> None:
    """Raise TypeError if the value given for a part, called `role` in messages, is not a factory."""
    if factory is not None and (isinstance(factory, System) or not callable(factory)):
        kind = type(factory).__name__
        raise TypeError(f"{role}: must be a function that makes one, not a {kind}: write lambda scenario: ...")


def PartsOf(scenario: Scenario) -> dict[str, Factory]:
    """Return the factories that explorer.parts names, by role; a module may lie in the working folder.

    Raises ScenarioError if a name does not exist.
    """
    names = dataclasses.asdict(scenario.explorer.parts)
    return {role: _FindFactory(f"explorer.parts.{role}", name) for role, name in names.items() if name}


def _FindFactory(key: str, name: str) -> Factory:
    """Return the function or class of a dotted name. Raises ScenarioError if there is none."""
    module, _, factory = name.rpartition(".")
    here = str(FilePath.cwd())
    if here not in sys.path:
        sys.path.append(here)
    try:
        found = getattr(importlib.import_module(module), factory)
    except (Exception, SystemExit) as error:
        raise ScenarioError(f"{key}: {name}: {error}; name a function of a scenario or a class: module.Name") from error
    if not callable(found):
        raise ScenarioError(f"{key}: {name} is no function of a scenario, and no class")
    return found


def MakePart(role: str, factory: Factory | None, usual: Factory, scenario: Scenario) -> System:
    """Return the System that a factory makes for the scenario; without a factory, the default one.

    Raises TypeError as CheckFactory does, and if the factory returns no System or one that lacks an output that other
    systems read.
    """
    CheckFactory(role, factory)
    try:
        inspect.signature(factory or usual).bind(scenario)
    except TypeError as error:
        given = f"{role}: is called with the scenario and nothing else: {error}"
        raise TypeError(f"{given}; write lambda scenario: ...") from None
    part = (factory or usual)(scenario)
    if not isinstance(part, System):
        raise TypeError(f"{role}: its function must return a Drake System, not {type(part).__name__}")
    for name, kind in OUTPUTS.get(role, {}).items():
        _CheckOutput(role, part, name, kind)
    return part


def NameOf(part: System) -> str:
    """Return the name of a user's part: its own, or else its class's."""
    return str(part.get_name()) or type(part).__name__


def _CheckOutput(role: str, part: System, name: str, kind: type | int) -> None:
    """Raise TypeError if a part lacks the output, or has a vector instead of a message there, or vice versa."""
    what = f"a vector of size {kind}" if isinstance(kind, int) else f"a message {kind.__name__}"
    called = f"{role} {NameOf(part)}"
    if not part.HasOutputPort(name):
        names = ", ".join(part.get_output_port(i).get_name() for i in range(part.num_output_ports())) or "none"
        hint = "; MakePoseEstimator makes an estimator of a pose alone" if role == "estimator" else ""
        raise TypeError(f"{called}: lacks the output port {name}, {what}; it has {names}{hint}")
    port = part.GetOutputPort(name)
    is_vector = port.get_data_type() == PortDataType.kVectorValued
    if is_vector != isinstance(kind, int) or (is_vector and port.size() != kind):
        found = f"a vector of size {port.size()}" if is_vector else "a message"
        raise TypeError(f"{called}: its output port {name} must carry {what}, not {found}")
