"""Explorers that somebody drives, by hand or where a human operator would go (the paper's Sec. IV-C); they map as the
TFG explorer does."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from pydrake.systems.framework import Diagram

from tfg_drake.diagrams.explorer import MakeFollower, MakePlanner, Wiring
from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.geometry.se2 import inverse, transform
from tfg_drake.mission.manual_drive import Pressed
from tfg_drake.systems.manual_driver import ManualDriver
from tfg_drake.systems.mission_sequencer import MissionSequencer
from tfg_drake.systems.scripted_driver import ScriptedDriver

# Full speed, m/s, from which the sequencer computes the time limit of a way: tiny, as a driver has no time limit.
NO_HURRY = 1e-9


def MakeManualExplorer(
    scenario: Scenario, keys: Callable[[], Sequence[str]] = tuple, drive: Sequence[Pressed] = ()
) -> Diagram:
    """The explorer that keys drive; its ports are those of MakeTfgExplorer, less recall. Where its driver sends it to a
    place it drives there by itself, on the planner's path.

    keys: returns those pressed since it was last called, of `tfg_drake.mission.manual_drive.KEYS`. drive: keys that are
    pressed at their times.
    """
    robot, explorer = scenario.robot, scenario.explorer
    wiring = Wiring()
    estimator, tfg_builder = wiring.AddMapping(scenario)
    driver = wiring.Add("manual_driver", ManualDriver(robot, keys, drive, explorer.glance_period > 0.0))
    planner, follower = wiring.Add("prm_planner", MakePlanner(scenario)), wiring.Add("follower", MakeFollower(scenario))
    patient = dataclasses.replace(robot, max_speed=NO_HURRY)
    sequencer = wiring.Add("mission_sequencer", MissionSequencer(patient, explorer.glance_period))

    wiring.FeedAll(estimator, tfg_builder, sequencer, others=(driver, planner, follower))
    for name in ("roadmap", "local_roadmap"):
        wiring.Feed(planner, name, driver)
    for name in ("goal", "path", "path_status", "follower_status", "pressed"):
        wiring.Feed(driver, name, follower, sequencer)
    wiring.Join(driver.GetOutputPort("planned_goal"), planner.GetInputPort("goal"))
    wiring.Join(planner.GetOutputPort("path"), driver.GetInputPort("planned_path"))
    wiring.Join(planner.GetOutputPort("path_status"), driver.GetInputPort("planned_status"))
    wiring.Join(follower.GetOutputPort("follower_status"), driver.GetInputPort("following_status"))
    wiring.Join(follower.GetOutputPort("velocity_commanded"), driver.GetInputPort("following_commanded"))
    return wiring.Build(driver, sequencer, driver)


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
