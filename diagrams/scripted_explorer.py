"""An explorer that drives where a human operator would, and maps as the TFG explorer does (the paper's Sec. IV-C)."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Diagram

from tfg_drake.diagrams.explorer import MakeFollower, Wiring
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
    wiring = Wiring()
    estimator, tfg_builder = wiring.AddMapping(scenario)
    driver = wiring.Add("scripted_driver", ScriptedDriver(p_MG))
    follower = wiring.Add("follower", MakeFollower(scenario))
    sequencer = wiring.Add("mission_sequencer", MissionSequencer(scenario.robot))

    wiring.FeedAll(estimator, tfg_builder, driver, follower, sequencer)
    return wiring.Build(follower, sequencer, driver)
