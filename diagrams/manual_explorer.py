"""An explorer that somebody drives by hand, and that maps as the TFG explorer does."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from pydrake.systems.framework import Diagram

from tfg_drake.diagrams.explorer import Wiring
from tfg_drake.diagrams.scenario import MakeKeepOut, Scenario
from tfg_drake.mission.manual_drive import Pressed
from tfg_drake.systems.manual_driver import ManualDriver
from tfg_drake.systems.mission_sequencer import MissionSequencer
from tfg_drake.systems.prm_planner import PrmPlanner
from tfg_drake.systems.pure_pursuit_follower import PurePursuitFollower
from tfg_drake.systems.slam_estimator import SlamEstimator
from tfg_drake.systems.tfg_builder import TfgBuilder

# The sequencer plans anew when a way takes much longer than at full speed, m/s: nobody knows how long a driver takes.
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
    estimator = wiring.Add(
        "slam_estimator",
        SlamEstimator(scenario.odometry, scenario.tags, scenario.scan, explorer),
    )
    building = TfgBuilder(scenario.tags, scenario.scan, robot, explorer, MakeKeepOut(scenario))
    tfg_builder = wiring.Add("tfg_builder", building)
    driver = wiring.Add("manual_driver", ManualDriver(robot, keys, drive, explorer.glance_period > 0.0))
    parameters = robot, scenario.odometry, scenario.tags, explorer, scenario.planner, scenario.seed
    planner = wiring.Add("prm_planner", PrmPlanner(*parameters, scenario.scan.least_range))
    follower = wiring.Add("follower", PurePursuitFollower(robot, explorer, scenario.field_of_view))
    patient = dataclasses.replace(robot, max_speed=NO_HURRY)
    sequencer = wiring.Add("mission_sequencer", MissionSequencer(patient, explorer.glance_period))

    wiring.Feed(estimator, "pose", tfg_builder, driver, planner, follower)
    wiring.Feed(estimator, "map", tfg_builder, driver, planner, sequencer)
    wiring.Feed(estimator, "landmarks", tfg_builder)
    wiring.Feed(tfg_builder, "tfg", driver, planner, sequencer)
    wiring.Feed(planner, "roadmap", driver)
    wiring.Feed(planner, "local_roadmap")
    for source, name in ((estimator, "estimator_state"), (tfg_builder, "tfg_graph"), (driver, "pressed")):
        wiring.Feed(source, name)
    wiring.Feed(driver, "goal", follower, sequencer)
    wiring.Feed(driver, "path", follower, sequencer)
    wiring.Feed(driver, "path_status", sequencer)
    wiring.Join(driver.GetOutputPort("planned_goal"), planner.GetInputPort("goal"))
    wiring.Join(planner.GetOutputPort("path"), driver.GetInputPort("planned_path"))
    wiring.Join(planner.GetOutputPort("path_status"), driver.GetInputPort("planned_status"))
    wiring.Join(follower.GetOutputPort("follower_status"), driver.GetInputPort("following_status"))
    wiring.Join(follower.GetOutputPort("velocity_commanded"), driver.GetInputPort("following_commanded"))
    wiring.Feed(driver, "follower_status", sequencer)
    wiring.Feed(sequencer, "mission", estimator, tfg_builder, driver, planner, follower)
    return wiring.Build(driver, sequencer, driver)
