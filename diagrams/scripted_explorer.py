"""An explorer that drives where a human operator would, and maps as the TFG explorer does (the paper's Sec. V-C)."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Diagram

from tfg_drake.diagrams.driven_explorer import MakeDrivenExplorer
from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.geometry.se2 import inverse, transform
from tfg_drake.systems.mission_sequencer import MissionSequencer
from tfg_drake.systems.scripted_driver import ScriptedDriver


def MakeScriptedExplorer(scenario: Scenario) -> Diagram:
    """The explorer for a scenario with a drive; its ports are those of MakeTfgExplorer, less the roadmap."""
    # The operator stands beside the robot and knows where in the building it began.
    p_MG = transform(
        inverse(np.array(scenario.world.start, dtype=float)), np.array(scenario.drive, dtype=float).reshape(-1, 2)
    )
    return MakeDrivenExplorer(scenario, "scripted_driver", ScriptedDriver(p_MG), MissionSequencer(scenario.robot))
