"""The explorer of a recorded drive, which maps: without goals, paths and wheels."""

from __future__ import annotations

import functools
from collections.abc import Callable

from pydrake.systems.framework import Diagram

from tfg_drake.diagrams.explorer import Wiring
from tfg_drake.diagrams.methods import Method, MethodError
from tfg_drake.diagrams.parts import Factory
from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.systems.grid_mapper import GridMapper
from tfg_drake.systems.piece_sequencer import PieceSequencer
from tfg_drake.systems.slam_estimator import SlamEstimator


def MakeMappingExplorer(scenario: Scenario, end_time: float, *, estimator: Factory | None = None) -> Diagram:
    """Estimator and TFG builder as of MakeTfgExplorer, on a drive that is recorded up to a time, s.

    Its ports are as far as it has them those of MakeTfgExplorer; base.velocity_commanded is zero. estimator: makes one
    in place of a SlamEstimator; in phase "map" it maps the piece of the way since the last view.
    """
    wiring = Wiring()
    usual = lambda of: SlamEstimator(of.odometry, of.tags, of.scan, of.explorer, recorded=True)  # noqa: E731
    slam, tfg_builder = wiring.AddMapping(scenario, estimator or usual)
    sequencer = wiring.Add("piece_sequencer", PieceSequencer(end_time))
    wiring.FeedAll(slam, tfg_builder, sequencer)
    return wiring.Build(sequencer, sequencer, sequencer)


def MakeGridMappingExplorer(scenario: Scenario, end_time: float) -> Diagram:
    """GMapping on a drive that is recorded up to a time, s; with grid in place of map and tfg."""
    wiring = Wiring()
    mapper = wiring.Add("grid_mapper", GridMapper(scenario.grid, scenario.odometry, scenario.seed))
    sequencer = wiring.Add("piece_sequencer", PieceSequencer(end_time, maps=[]))
    wiring.FeedAll(mapper, sequencer)
    return wiring.Build(sequencer, sequencer, sequencer)


# Methods that map a laser recording, by name.
MAPPING_METHODS: dict[str, Callable[..., Diagram]] = {
    "walls": MakeMappingExplorer,
    "grid": MakeGridMappingExplorer,
}


def MappingMethod(name: str, end_time: float, **own: Factory) -> Method:
    """The method of MAPPING_METHODS that maps a drive which is recorded up to a time, s. own: parts in place of its
    usual ones. Raises MethodError where it has no such part, or where there is no such method."""
    if name not in MAPPING_METHODS:
        raise MethodError(f"{name}: does not map a recording; take {' or '.join(MAPPING_METHODS)}")
    if others := set(own) - ({"estimator"} if name == "walls" else set()):
        raise MethodError(f"{name}: maps a recording without {', '.join(sorted(others))}; leave it out")
    make = functools.partial(MAPPING_METHODS[name], end_time=end_time, **own)
    return Method(name, make, keeps_budget=False, knows_map=name != "grid")
