"""The explorer: five components and the mission sequencer, from what a TurtleBot senses to what its base is told.

odometry, detections -> slam estimator -> tfg builder -> prm planner <-> goal selector
                             |                               |
velocity_commanded  <- follower  <-----------------------  path
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, LeafSystem

from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.geometry.se2 import compose
from tfg_drake.mapfile.saved_map import SavedMap, saved_map
from tfg_drake.messages import FloatArray, MapEstimate, TfgMap
from tfg_drake.slam.estimator_state import EstimatorState
from tfg_drake.systems.info_gain_goal_selector import InfoGainGoalSelector
from tfg_drake.systems.message_delay import MessageDelay
from tfg_drake.systems.mission_sequencer import MissionSequencer
from tfg_drake.systems.prm_planner import PrmPlanner
from tfg_drake.systems.pure_pursuit_follower import PurePursuitFollower
from tfg_drake.systems.slam_estimator import SlamEstimator
from tfg_drake.systems.tfg_builder import TfgBuilder


def MakeTfgExplorer(scenario: Scenario, goal_selector: LeafSystem | None = None) -> Diagram:
    """The explorer for a scenario's robot, sensors and method; of the scenario's world it reads nothing.

    Input ports: odometry, detections, scan, hazards (messages), pause, enable, stop, recall (vectors of size 1,
    optional).
    Output ports: velocity_commanded (v in m/s, w in rad/s), and for whoever wants to look: pose, map, tfg, roadmap,
    goal, path, mission and the status of path and follower; working_map and working_roadmap are as much of map, tfg and
    roadmap as planning needs at a stage.

    goal_selector: chooses where to go instead of the information gain; a system with any of the inputs above and any of
    those outputs but velocity_commanded as its inputs, and the output goal: a GoalChoice, see InfoGainGoalSelector.
    """
    robot, explorer = scenario.robot, scenario.explorer
    if goal_selector is None:
        goal_selector = InfoGainGoalSelector(robot, scenario.odometry, scenario.tags, explorer, scenario.seed)
    return AssembleExplorer(
        {
            "slam_estimator": SlamEstimator(scenario.odometry, scenario.tags, explorer.path_keyframe_period),
            "tfg_builder": TfgBuilder(scenario.tags, scenario.scan, robot, explorer),
            "goal_selector": goal_selector,
            "prm_planner": PrmPlanner(
                robot,
                scenario.odometry,
                scenario.tags,
                explorer,
                scenario.planner,
                scenario.seed,
                scenario.scan.least_range,
            ),
            "follower": PurePursuitFollower(robot, explorer, scenario.field_of_view),
            "mission_sequencer": MissionSequencer(robot, explorer.glance_period),
        },
        scenario.reality.planning_time,
    )


def AssembleExplorer(systems: Mapping[str, LeafSystem], planning_time: float = 0.0) -> Diagram:
    """An explorer of some systems, by the name each is to have, connected by port name.

    An output feeds every input of its name and is an output of the explorer; an input that no output feeds is an input
    of the explorer. goal and path come out planning_time (s) later. Raises ValueError where two outputs have the same
    name.
    """
    builder = DiagramBuilder()
    outputs = {}
    for name, system in systems.items():
        builder.AddNamedSystem(name, system)
        for i in range(system.num_output_ports()):
            port = system.get_output_port(i)
            if port.get_name() in outputs:
                raise ValueError(f"{name}.{port.get_name()}: another system of the explorer has an output of that name")
            outputs[port.get_name()] = port
    for name in ("goal", "path") if planning_time > 0.0 else ():
        delay = builder.AddNamedSystem(f"{name}_delay", MessageDelay(name, planning_time))
        builder.Connect(outputs[name], delay.get_input_port())
        outputs[name] = delay.get_output_port()
    exported = set()
    for system in systems.values():
        for i in range(system.num_input_ports()):
            port = system.get_input_port(i)
            name = port.get_name()
            if name in outputs:
                builder.Connect(outputs[name], port)
            elif name in exported:
                builder.ConnectInput(name, port)
            else:
                builder.ExportInput(port, name)
                exported.add(name)
    for name, port in outputs.items():
        builder.ExportOutput(port, name)
    diagram = builder.Build()
    diagram.set_name("explorer")
    return diagram


def StateOfExplorer(explorer: Diagram, context: Context) -> EstimatorState:
    """All that the slam_estimator of a running explorer knows; context: the explorer's own."""
    estimator = explorer.GetSubsystemByName("slam_estimator")
    state: EstimatorState = estimator.estimator(explorer.GetSubsystemContext(estimator, context))
    return state


def MapOfExplorer(
    explorer: Diagram, context: Context, X_WS: FloatArray | None, final: EstimatorState | None = None
) -> tuple[SavedMap, MapEstimate, TfgMap] | None:
    """The map of a running explorer, to be kept with `tfg_drake.mapfile.saved_map.save_map`, its estimate and TFG.

    Args:
        explorer: with a slam_estimator and a tfg_builder, context: its own.
        X_WS: (3,) the true start pose, m and rad, None where it is not known: then the world is the map frame.
        final: what the estimator knows, `settled`; else the map is taken as it is.

    Returns None before the first goal is in the map and its surfaces are.
    """
    builder = explorer.GetSubsystemByName("tfg_builder")
    builder_context = explorer.GetSubsystemContext(builder, context)
    state, tfg_graph = final or StateOfExplorer(explorer, context), builder.graph(builder_context)
    if state.map is None or tfg_graph.stage == 0:
        return None
    tfg = builder.tfg(builder_context, state.map) if final else explorer.GetOutputPort("tfg").Eval(context)
    return saved_map(map_frame(X_WS, state), state, tfg_graph, tfg), state.map, tfg


def map_frame(X_WS: FloatArray | None, state: EstimatorState) -> FloatArray:
    """(3,) pose X_WM of the map frame in the world, as far as is known: where the robot started, X_WS (3,), the x axis
    where its camera looked; zeros where the start is not known."""
    return np.zeros(3) if X_WS is None else compose(X_WS, np.array([0.0, 0.0, state.graph.yaw[0]]))
