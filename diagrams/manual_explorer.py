"""An explorer that somebody drives by hand, and that maps as the TFG explorer does."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from pydrake.systems.framework import Diagram

from tfg_drake.diagrams.driven_explorer import MakeDrivenExplorer
from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.mission.manual_drive import Pressed
from tfg_drake.systems.manual_driver import ManualDriver
from tfg_drake.systems.mission_sequencer import MissionSequencer

# The sequencer plans anew when a way takes much longer than at full speed, m/s: nobody knows how long a driver takes.
NO_HURRY = 1e-9


def MakeManualExplorer(
    scenario: Scenario, keys: Callable[[], Sequence[str]] = tuple, drive: Sequence[Pressed] = ()
) -> Diagram:
    """The explorer that keys drive; its ports are those of MakeTfgExplorer, less the roadmap.

    keys: returns those pressed since it was last called, of `tfg_drake.mission.manual_drive.KEYS`. drive: keys that are
    pressed at their times.
    """
    patient = dataclasses.replace(scenario.robot, max_speed=NO_HURRY)
    sequencer = MissionSequencer(patient, scenario.explorer.glance_period)
    return MakeDrivenExplorer(scenario, "manual_driver", ManualDriver(scenario.robot, keys, drive), sequencer)
