"""What the explorers share whose goals somebody else chooses: they map as the TFG explorer does, without a roadmap."""

from __future__ import annotations

from pydrake.systems.framework import Diagram, LeafSystem

from tfg_drake.diagrams.explorer import Wiring
from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.systems.mission_sequencer import MissionSequencer
from tfg_drake.systems.pure_pursuit_follower import PurePursuitFollower
from tfg_drake.systems.slam_estimator import SlamEstimator
from tfg_drake.systems.tfg_builder import TfgBuilder


def MakeDrivenExplorer(scenario: Scenario, name: str, driver: LeafSystem, sequencer: MissionSequencer) -> Diagram:
    """The explorer whose goals and paths a driver gives; its ports are those of MakeTfgExplorer, less the roadmap.

    name: the driver's in the diagram. driver: a system with the outputs goal, path and path_status. One that drives
    itself has velocity_commanded and follower_status, too, and gets those of the follower, which turns the robot where
    it observes, at turn_commanded and turn_status.
    """
    robot, explorer = scenario.robot, scenario.explorer
    wiring = Wiring()
    estimator = wiring.Add(
        "slam_estimator", SlamEstimator(scenario.odometry, scenario.tags, explorer.path_keyframe_period)
    )
    tfg_builder = wiring.Add("tfg_builder", TfgBuilder(scenario.tags, scenario.scan, robot, explorer))
    wiring.Add(name, driver)
    follower = wiring.Add("follower", PurePursuitFollower(robot, explorer, scenario.field_of_view))
    wiring.Add("mission_sequencer", sequencer)

    wiring.Sense("base.odometry", estimator)
    wiring.Sense("tags.detections", estimator)
    wiring.Sense("scan.ranges", estimator, tfg_builder)
    wiring.Sense("base.hazards", sequencer)
    wiring.Feed(estimator, "pose", tfg_builder, driver, follower)
    wiring.Feed(estimator, "map", tfg_builder, sequencer)
    wiring.Feed(tfg_builder, "tfg", driver, sequencer)
    wiring.Feed(tfg_builder, "working_map")
    wiring.Feed(driver, "goal", follower, sequencer)
    wiring.Feed(driver, "path", follower, sequencer)
    wiring.Feed(driver, "path_status", sequencer)
    drives = follower
    if driver.HasInputPort("turn_commanded"):
        drives = driver
        wiring.Join(follower.GetOutputPort("follower_status"), driver.GetInputPort("turn_status"))
        wiring.Join(follower.GetOutputPort("velocity_commanded"), driver.GetInputPort("turn_commanded"))
    wiring.Feed(drives, "follower_status", sequencer)
    wiring.Feed(sequencer, "mission", estimator, tfg_builder, driver, follower)
    return wiring.Build(drives, sequencer, driver)
