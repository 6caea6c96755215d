"""Robots for an explorer: the simulated one and, by the same ports, others."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

from pydrake.systems.framework import DiagramBuilder, System

from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.diagrams.station import MakeTurtlebotStation
from tfg_drake.mission.operation import Request

# Name of the robot that is a laser recording.
RECORDED = "recording"


# The functions of a simulated robot; named functions, unlike lambdas, can be sent to another process.


def _never(_recalls: bool) -> str:
    return ""


def _nothing(*_: object) -> None:
    pass


@dataclasses.dataclass(frozen=True)
class Robot:
    """name. MakeStation: the station for a scenario, with the ports of MakeTurtlebotStation; those of the truth only
    where it is known. world_known: the scenario's world is the one that the robot is in and its start the true one.
    end_time: s, when the station has nothing more to say; a mission that gets there ends. real: its time is real time,
    and an operator enables its base. enabled: it is from the beginning. operated: what the operator asks for, see
    Operator. empty(recalls): why its battery ends the mission, "" as long as it does not; recalls: the mission ends by
    itself when it is recalled. Announce(builder, station, explorer): adds what tells others of the map. close: stops it
    for good."""

    name: str
    MakeStation: Callable[[Scenario], System]
    world_known: bool
    end_time: float = math.inf
    real: bool = False
    enabled: bool = False
    operated: Sequence[Callable[[], Sequence[Request]]] = ()
    empty: Callable[[bool], str] = _never
    Announce: Callable[[DiagramBuilder, System, System], object] = _nothing
    close: Callable[[], object] = _nothing


SIMULATED = Robot("sim", MakeTurtlebotStation, world_known=True)
