"""The explorer: five components and the mission sequencer, from a TurtleBot's sensor messages to velocity commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pydrake.systems.framework import Context, Diagram, DiagramBuilder, InputPort, OutputPort, System

from tfg_drake.diagrams.parts import Factory, MakePart, PartsOf
from tfg_drake.diagrams.scenario import CheckScenario, MakeKeepOut, Scenario
from tfg_drake.mapfile.saved_map import SavedMap, saved_map, state_of_map
from tfg_drake.messages import FloatArray, MapEstimate, TfgMap, replace
from tfg_drake.planning.candidates import Situation
from tfg_drake.planning.parameters import EdgeCost, PlanningParameters, cost_of_edge
from tfg_drake.slam.estimator_state import EstimatorState
from tfg_drake.systems.info_gain_goal_selector import InfoGainGoalSelector
from tfg_drake.systems.message_delay import MessageDelay
from tfg_drake.systems.mission_sequencer import MissionSequencer
from tfg_drake.systems.prm_planner import PrmPlanner
from tfg_drake.systems.pure_pursuit_follower import PurePursuitFollower
from tfg_drake.systems.slam_estimator import SlamEstimator
from tfg_drake.systems.tfg_builder import TfgBuilder
from tfg_drake.tfg.graph import resolve

# The explorer's input names by the station's ports.
SENSED = {
    "base.odometry": "odometry",
    "base.hazards": "hazards",
    "base.enabled": "enable",
    "tags.detections": "detections",
    "scan.ranges": "scan",
}
COMMANDED = "base.velocity_commanded"
HEARD_AS = {name: port for port, name in SENSED.items()}


def of_station(port: str) -> bool:
    """True if a port is named like the station's: device.signal."""
    return "." in port


def MakeTfgExplorer(
    scenario: Scenario,
    goal_selector: Factory | None = None,
    *,
    estimator: Factory | None = None,
    planner: Factory | None = None,
    follower: Factory | None = None,
    ends_simulation: bool = True,
) -> Diagram:
    """Make the explorer for a scenario's robot, sensors and method; it does not read the scenario's world.

    .. pydrake_system::

        name: explorer
        input_ports:
        - base.odometry
        - base.hazards
        - base.enabled
        - tags.detections
        - scan.ranges
        - pause
        - stop
        - recall
        - requested_goal
        - said_pose
        output_ports:
        - base.velocity_commanded
        - pose
        - map
        - tfg
        - roadmap
        - local_roadmap
        - goal
        - path
        - path_status
        - follower_status
        - mission
        - landmarks
        - hypotheses
        - estimator_state
        - tfg_graph

    base.odometry, base.hazards, tags.detections, scan.ranges: Odometry, Hazards, TagDetections and LaserScan messages.
    base.enabled, pause, stop, recall: vectors of size 1, true above 0.5, requested_goal: a RequestedGoal and
    said_pose: a SaidPose message; all of these may stay unconnected. There are recall and requested_goal if the goal
    selector has them, said_pose if the estimator has it. While pause is true the robot stands; then the mission goes
    on. stop ends the mission at once, with the outcome interrupted. recall lets it choose no goal any more, so it ends
    with the outcome budget, at home only if explorer.return_home is true. base.velocity_commanded: forward speed (m/s)
    and turn rate (rad/s).

    requested_goal counts from the next choice of a goal on, if its count has changed: the robot drives to the reachable
    node of the roadmap that is nearest to p_MG, however far that is, looks around, and continues. goal.p_MG is that
    node while it is on its way, and goal.reason says so. Without a reachable node the request has no effect.

    In the mission `house` of tfg_drake.explore, in memory and simulated, this pauses, and this sends the robot to a
    place; of a clone of its Context it does so in the clone alone:
    `house.explorer.GetInputPort("pause").FixValue(house.explorer.GetMyMutableContextFromRoot(house.context), 1.0)`
    `house.explorer.GetInputPort("requested_goal").FixValue(..., RequestedGoal(1, np.array([2.0, 0.5])))`
    with RequestedGoal of `tfg_drake.planning.requested_goal`.

    For inspection: pose: PoseEstimate, map: MapEstimate of the tags, tfg: TfgMap, roadmap: Roadmap, goal: GoalChoice,
    path: Path, path_status: PathStatus, follower_status: FollowerStatus, mission: MissionStatus, all in M.
    local_roadmap: Roadmap, the part of roadmap that planning needs at a stage.
    landmarks: MapEstimate of tags and walls. hypotheses: Hypotheses, the places of a known map where the robot may be.
    estimator_state: EstimatorState and tfg_graph: TfgGraph, for the map file; with an estimator that has no
    estimator_state the file is made from map.

    Each keyword argument is a factory: a function of the scenario that returns a System in place of the default part,
    with the outputs of that part, unless Args says otherwise, and any of its inputs. Further inputs named like ports of
    the station, such as truth.pose of a simulated one, become inputs of the explorer.

    Args:
        scenario: see Scenario; parts named in its explorer.parts are used unless given here.
        goal_selector: replaces InfoGainGoalSelector.
        estimator: replaces SlamEstimator; all outputs except pose and map may be missing.
        planner: replaces PrmPlanner; roadmap and local_roadmap may be missing if the goal selector needs none. See Path
            and PathStatus in `tfg_drake.messages`.
        follower: replaces PurePursuitFollower. See FollowerStatus there.
        ends_simulation: after the end of the mission every update, 16 a second, requests termination. False for several
            explorers in one diagram, or to simulate on; mission.phase is then `done`.

    Raises:
        ScenarioError: the scenario has an invalid value.
        TypeError: a part is not a factory.
    """
    CheckScenario(scenario)
    given = {"estimator": estimator, "goal_selector": goal_selector, "planner": planner, "follower": follower}
    own = PartsOf(scenario) | {role: factory for role, factory in given.items() if factory is not None}
    wiring = Wiring(scenario.reality.planning_time)
    slam, tfg_builder = wiring.AddMapping(scenario, own.get("estimator"))
    selector = wiring.Add(
        "goal_selector", MakePart("goal_selector", own.get("goal_selector"), MakeGoalSelector, scenario)
    )
    prm = wiring.Add("prm_planner", MakePart("planner", own.get("planner"), MakePlanner, scenario))
    pursuit = wiring.Add("follower", MakePart("follower", own.get("follower"), MakeFollower, scenario))
    sequencer = wiring.Add(
        "mission_sequencer",
        MissionSequencer(scenario.robot, scenario.explorer.glance_period, ends_simulation=ends_simulation),
    )

    wiring.FeedAll(slam, tfg_builder, selector, prm, pursuit, sequencer)
    return wiring.Build(pursuit, sequencer, selector)


def MakeGoalSelector(of: Scenario, frontiers: Callable[[Situation], Situation] | None = None) -> InfoGainGoalSelector:
    """The usual goal selector for a scenario."""
    return InfoGainGoalSelector(MakeParameters(of), frontiers)


def MakePlanner(of: Scenario, cost: EdgeCost = cost_of_edge) -> PrmPlanner:
    """The usual planner for a scenario."""
    return PrmPlanner(MakeParameters(of, cost))


def MakeParameters(of: Scenario, cost: EdgeCost = cost_of_edge) -> PlanningParameters:
    """The parameters of planning for a scenario."""
    sheets = of.robot, of.view, of.odometry, of.explorer, of.planner
    return PlanningParameters(*sheets, of.seed, of.scan.least_range, of.scan.range, cost)


def MakeFollower(of: Scenario) -> PurePursuitFollower:
    """The usual follower for a scenario."""
    return PurePursuitFollower(of.robot, of.explorer, of.field_of_view)


class Wiring:
    """An explorer under construction: its systems, and what flows between them."""

    def __init__(self, planning_time: float = 0.0) -> None:
        """planning_time: delay of goal and path, s, see RealityConfig."""
        self._builder = DiagramBuilder()
        self._delays = {"goal": planning_time, "path": planning_time}
        self._inputs: set[str] = set()

    def Add(self, name: str, system: System) -> System:
        """Add a system; the order of additions is the order of events."""
        return self._builder.AddNamedSystem(name, system)

    def AddMapping(self, scenario: Scenario, estimator: Factory | None = None) -> tuple[System, System]:
        """Adds an estimator, by default a SlamEstimator, and a TfgBuilder for a scenario."""
        tags, scan, explorer = scenario.tags, scenario.scan, scenario.explorer
        usual = lambda _: SlamEstimator(scenario.odometry, tags, scan, explorer)  # noqa: E731
        slam = self.Add("slam_estimator", MakePart("estimator", estimator, usual, scenario))
        if slam.HasInputPort("said_pose"):
            self._Export(slam.GetInputPort("said_pose"), "said_pose")
        building = TfgBuilder(scenario.view, scan, scenario.robot, explorer, MakeKeepOut(scenario))
        return slam, self.Add("tfg_builder", building)

    def _Export(self, port: InputPort, name: str) -> None:
        """Export an input as the explorer's, or join it to an exported one of the same name."""
        if name in self._inputs:
            self._builder.ConnectInput(name, port)
        else:
            self._builder.ExportInput(port, name)
        self._inputs.add(name)

    def Feed(self, source: System, name: str, *listeners: System) -> None:
        """Connect an output to all inputs of its name, and export it as the explorer's."""
        output = source.GetOutputPort(name)
        if self._delays.get(name, 0.0) > 0.0:
            later = self.Add(f"{name}_delay", MessageDelay(name, self._delays[name]))
            self._builder.Connect(output, later.get_input_port())
            output = later.get_output_port()
        for system in listeners:
            if system.HasInputPort(name):
                self._builder.Connect(output, system.GetInputPort(name))
        self._builder.ExportOutput(output, name)

    def FeedAll(self, *systems: System, others: Sequence[System] = ()) -> None:
        """Feed each output of these systems, except the command, to the inputs of its name among them and others."""
        for source in systems:
            for name in (source.get_output_port(i).get_name() for i in range(source.num_output_ports())):
                if name != "velocity_commanded":
                    self.Feed(source, name, *systems, *others)

    def Join(self, output: OutputPort, port: InputPort) -> None:
        """Connect two ports of different names, without exporting them."""
        self._builder.Connect(output, port)

    def Build(self, follower: System, sequencer: System, selector: System) -> Diagram:
        """Return the explorer: the follower commands the base, an operator's requests go to sequencer and selector, and
        the station's signals to the unconnected inputs of their names."""
        for system in self._builder.GetSystems():
            for port in (system.get_input_port(i) for i in range(system.num_input_ports())):
                name = HEARD_AS.get(port.get_name(), port.get_name())
                if of_station(name) and not self._builder.IsConnectedOrExported(port):
                    self._Export(port, name)
        self._builder.ExportOutput(follower.GetOutputPort("velocity_commanded"), COMMANDED)
        for name in ("pause", "stop"):
            self._builder.ExportInput(sequencer.GetInputPort(name), name)
        for name in ("recall", "requested_goal"):
            if selector.HasInputPort(name):
                self._builder.ExportInput(selector.GetInputPort(name), name)
        diagram = self._builder.Build()
        diagram.set_name("explorer")
        return diagram


def StateOfExplorer(explorer: Diagram, context: Context) -> EstimatorState:
    """All that the estimator of a running explorer knows, or has said with its map; context: the explorer's own."""
    known = explorer.HasOutputPort("estimator_state")
    state = explorer.GetOutputPort("estimator_state" if known else "map").Eval(context)
    return state if known else state_of_map(state)


def MapOfExplorer(
    explorer: Diagram,
    context: Context,
    X_WM: FloatArray,
    final: EstimatorState | None = None,
    scenario: Scenario | None = None,
) -> tuple[SavedMap | None, MapEstimate, TfgMap] | None:
    """The map of a running explorer, to be kept with `tfg_drake.mapfile.saved_map.save_map`, its estimate and TFG.

    Args:
        explorer: with the ports map and tfg; without tfg_graph nothing can be kept. context: its own.
        X_WM: (3,) pose of the map frame in the world, m and rad, see `MapFrame`.
        final: what the estimator knows, `finished_map`; else the map is taken as it is.
        scenario: with `final`, whose explorer it is.

    Returns None before the first view is in the map and its surfaces are.
    """
    state, tfg = final or StateOfExplorer(explorer, context), explorer.GetOutputPort("tfg").Eval(context)
    estimate = None if state.map is None else state.map.of_tags
    if estimate is None or estimate.stage == 0 or tfg.stage == 0:
        return None
    if not explorer.HasOutputPort("tfg_graph"):
        return None, estimate, tfg
    tfg_graph = explorer.GetOutputPort("tfg_graph").Eval(context)
    if final is not None and scenario is not None and tfg_graph.stage == estimate.stage:
        now = resolve(tfg_graph, state.map or estimate, scenario.robot, scenario.explorer)
        tfg = replace(now, keep_out=tfg.keep_out)
    return saved_map(X_WM, state, tfg_graph, tfg), estimate, tfg
