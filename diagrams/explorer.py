"""The explorer: five components and the mission sequencer, from what a TurtleBot senses to what its base is told."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, InputPort, LeafSystem, OutputPort

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

# The station's ports, and what the explorer's systems call what comes from there.
SENSED = {
    "base.odometry": "odometry",
    "base.hazards": "hazards",
    "base.enabled": "enable",
    "tags.detections": "detections",
    "scan.ranges": "scan",
}
COMMANDED = "base.velocity_commanded"


def MakeTfgExplorer(scenario: Scenario, goal_selector: LeafSystem | None = None) -> Diagram:
    """The explorer for a scenario's robot, sensors and method; of the scenario's world it reads nothing.

    Input ports: base.odometry, base.hazards, tags.detections, scan.ranges (messages), base.enabled, pause, stop, recall
    (vectors of size 1, optional), requested_goal (a RequestedGoal message, optional).
    Output ports: base.velocity_commanded (v in m/s, w in rad/s), and for whoever wants to look: pose, map, tfg,
    roadmap, goal, path, mission and the status of path and follower; working_map and working_roadmap are as much of
    map, tfg and roadmap as planning needs at a stage.

    goal_selector: chooses where to go instead of the information gain; a system with any of pose, map, tfg, roadmap,
    working_map, working_roadmap, path, path_status, mission, recall and requested_goal as its inputs, and the
    output goal: a GoalChoice, see InfoGainGoalSelector.
    """
    robot, tags, explorer = scenario.robot, scenario.tags, scenario.explorer
    wiring = Wiring(scenario.reality.planning_time)
    estimator = wiring.Add("slam_estimator", SlamEstimator(scenario.odometry, tags, explorer.path_keyframe_period))
    tfg_builder = wiring.Add("tfg_builder", TfgBuilder(tags, scenario.scan, robot, explorer))
    if goal_selector is None:
        goal_selector = InfoGainGoalSelector(robot, scenario.odometry, tags, explorer, scenario.seed)
    selector = wiring.Add("goal_selector", goal_selector)
    least_range = scenario.scan.least_range
    planner = wiring.Add(
        "prm_planner",
        PrmPlanner(robot, scenario.odometry, tags, explorer, scenario.planner, scenario.seed, least_range),
    )
    follower = wiring.Add("follower", PurePursuitFollower(robot, explorer, scenario.field_of_view))
    sequencer = wiring.Add("mission_sequencer", MissionSequencer(robot, explorer.glance_period))

    wiring.Sense("base.odometry", estimator)
    wiring.Sense("tags.detections", estimator)
    wiring.Sense("scan.ranges", estimator, tfg_builder, planner)
    wiring.Sense("base.hazards", sequencer)
    wiring.Feed(estimator, "pose", tfg_builder, selector, planner, follower)
    wiring.Feed(estimator, "map", tfg_builder, selector, planner, sequencer)
    wiring.Feed(tfg_builder, "tfg", selector, planner, sequencer)
    wiring.Feed(tfg_builder, "working_map", selector, planner)
    wiring.Feed(planner, "roadmap", selector)
    wiring.Feed(planner, "working_roadmap", selector)
    wiring.Feed(selector, "goal", estimator, planner, follower, sequencer)
    wiring.Feed(planner, "path", selector, follower, sequencer)
    wiring.Feed(planner, "path_status", selector, sequencer)
    wiring.Feed(follower, "follower_status", sequencer)
    wiring.Feed(sequencer, "mission", estimator, tfg_builder, selector, planner, follower)
    return wiring.Build(follower, sequencer, selector)


class Wiring:
    """An explorer under construction: its systems, and what flows between them."""

    def __init__(self, planning_time: float = 0.0) -> None:
        """planning_time: s, so much later come goal and path out, see RealityConfig."""
        self._builder = DiagramBuilder()
        self._delays = {"goal": planning_time, "path": planning_time}

    def Add(self, name: str, system: LeafSystem) -> LeafSystem:
        """Adds a system; the order in which they are added is that of their events."""
        return self._builder.AddNamedSystem(name, system)

    def Sense(self, port: str, *listeners: LeafSystem) -> None:
        """Makes a port of the station, one of SENSED, an input of the explorer, for some systems."""
        self._builder.ExportInput(listeners[0].GetInputPort(SENSED[port]), port)
        for system in listeners[1:]:
            self._builder.ConnectInput(port, system.GetInputPort(SENSED[port]))

    def Feed(self, source: LeafSystem, name: str, *listeners: LeafSystem) -> None:
        """Connects an output to the inputs of its name, as far as there are such, and makes it one of the explorer."""
        output = source.GetOutputPort(name)
        if self._delays.get(name, 0.0) > 0.0:
            later = self.Add(f"{name}_delay", MessageDelay(name, self._delays[name]))
            self._builder.Connect(output, later.get_input_port())
            output = later.get_output_port()
        for system in listeners:
            if system.HasInputPort(name):
                self._builder.Connect(output, system.GetInputPort(name))
        self._builder.ExportOutput(output, name)

    def Join(self, output: OutputPort, port: InputPort) -> None:
        """Connects two ports of different names, between systems alone."""
        self._builder.Connect(output, port)

    def Build(self, follower: LeafSystem, sequencer: LeafSystem, selector: LeafSystem) -> Diagram:
        """The explorer: the follower commands the base; what an operator asks for goes to sequencer and selector."""
        self._builder.ExportOutput(follower.GetOutputPort("velocity_commanded"), COMMANDED)
        self._builder.ExportInput(sequencer.GetInputPort("enable"), "base.enabled")
        for name in ("pause", "stop"):
            self._builder.ExportInput(sequencer.GetInputPort(name), name)
        for name in ("recall", "requested_goal"):
            if selector.HasInputPort(name):
                self._builder.ExportInput(selector.GetInputPort(name), name)
        diagram = self._builder.Build()
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
        final: what the estimator knows, `finished_map`; else the map is taken as it is.

    Returns None before the first view is in the map and its surfaces are.
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
