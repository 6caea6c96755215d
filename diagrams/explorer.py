"""The explorer: seven components and the mission sequencer, from what a TurtleBot senses to what its base is told.

odometry, detections -> slam estimator -> tfg builder -> prm planner <-> goal selector
                             |                               |
velocity_commanded  <- follower  <-----------------------  path
"""

from __future__ import annotations

from pydrake.systems.framework import Context, Diagram, DiagramBuilder

from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.mapfile.saved_map import SavedMap, saved_map
from tfg_drake.messages import FloatArray, MapEstimate, TfgMap
from tfg_drake.slam.estimator import settled
from tfg_drake.systems.info_gain_goal_selector import InfoGainGoalSelector
from tfg_drake.systems.mission_sequencer import MissionSequencer
from tfg_drake.systems.prm_planner import PrmPlanner
from tfg_drake.systems.pure_pursuit_follower import PurePursuitFollower
from tfg_drake.systems.slam_estimator import SlamEstimator
from tfg_drake.systems.tfg_builder import TfgBuilder


def MakeTfgExplorer(scenario: Scenario) -> Diagram:
    """The explorer for a scenario's robot, sensors and method; of the scenario's world it reads nothing.

    Input ports: odometry, detections, scan, hazards (messages), pause, enable, stop (vectors of size 1, optional).
    Output ports: velocity_commanded (v in m/s, w in rad/s), and for whoever wants to look: pose, map, tfg, roadmap,
    goal, path, mission.
    """
    builder = DiagramBuilder()
    robot, explorer = scenario.robot, scenario.explorer

    estimator = builder.AddNamedSystem(
        "slam_estimator", SlamEstimator(scenario.odometry, explorer.path_keyframe_period)
    )
    tfg_builder = builder.AddNamedSystem("tfg_builder", TfgBuilder(scenario.tags, scenario.scan, robot, explorer))
    selector = builder.AddNamedSystem(
        "goal_selector", InfoGainGoalSelector(robot, scenario.odometry, scenario.tags, explorer)
    )
    planner = builder.AddNamedSystem(
        "prm_planner",
        PrmPlanner(robot, scenario.odometry, scenario.tags, explorer, scenario.planner, seed=scenario.seed),
    )
    follower = builder.AddNamedSystem("follower", PurePursuitFollower(robot, explorer))
    sequencer = builder.AddNamedSystem("mission_sequencer", MissionSequencer(robot))

    def connect(source, output, *targets):
        for system, port in targets:
            builder.Connect(source.GetOutputPort(output), system.GetInputPort(port))

    connect(estimator, "pose", (tfg_builder, "pose"), (planner, "pose"), (follower, "pose"))
    connect(estimator, "map", (tfg_builder, "map"), (selector, "map"), (planner, "map"), (sequencer, "map"))
    connect(tfg_builder, "tfg", (selector, "tfg"), (planner, "tfg"), (sequencer, "tfg"))
    connect(planner, "roadmap", (selector, "roadmap"))
    connect(selector, "goal", (planner, "goal"), (sequencer, "goal"))
    connect(planner, "path", (follower, "path"), (sequencer, "path"))
    connect(planner, "status", (sequencer, "path_status"))
    connect(follower, "status", (sequencer, "follower_status"))
    connect(
        sequencer,
        "mission",
        *((system, "mission") for system in (estimator, tfg_builder, selector, planner, follower)),
    )

    builder.ExportInput(estimator.GetInputPort("odometry"), "odometry")
    builder.ExportInput(estimator.GetInputPort("detections"), "detections")
    builder.ExportInput(tfg_builder.GetInputPort("scan"), "scan")
    builder.ConnectInput("scan", estimator.GetInputPort("scan"))
    builder.ConnectInput("scan", planner.GetInputPort("scan"))
    builder.ExportInput(sequencer.GetInputPort("hazards"), "hazards")
    for name in ("pause", "enable", "stop"):
        builder.ExportInput(sequencer.GetInputPort(name), name)

    builder.ExportOutput(follower.GetOutputPort("velocity_commanded"), "velocity_commanded")
    for source, name in (
        (estimator, "pose"),
        (estimator, "map"),
        (tfg_builder, "tfg"),
        (planner, "roadmap"),
        (selector, "goal"),
        (planner, "path"),
        (sequencer, "mission"),
    ):
        builder.ExportOutput(source.GetOutputPort(name), name)

    diagram = builder.Build()
    diagram.set_name("explorer")
    return diagram


def MapOfExplorer(explorer: Diagram, context: Context, X_WM: FloatArray) -> tuple[SavedMap, MapEstimate, TfgMap] | None:
    """The map of a running explorer, to be kept with `tfg_drake.mapfile.saved_map.save_map`, its estimate and TFG.

    A large map, of which the estimator solves a window at a time, is solved as a whole here.

    Args:
        explorer: of MakeTfgExplorer, context: its own.
        X_WM: (3,) pose of the map frame in the world, m and rad: the true start pose, zeros where none is known.

    Returns None before the first goal is in the map and its surfaces are.
    """
    estimator, builder = explorer.GetSubsystemByName("slam_estimator"), explorer.GetSubsystemByName("tfg_builder")
    state = settled(estimator.estimator(explorer.GetSubsystemContext(estimator, context)))
    builder_context = explorer.GetSubsystemContext(builder, context)
    tfg_graph = builder.graph(builder_context)
    if state.map is None or tfg_graph.stage == 0:
        return None
    tfg = builder.tfg(builder_context, state.map)
    return saved_map(X_WM, state, tfg_graph, tfg), state.map, tfg
