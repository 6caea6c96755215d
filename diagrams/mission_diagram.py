"""The diagram of a mission: station, explorer, recorders and operator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from tfg_drake.diagrams.explorer import COMMANDED, MakeTfgExplorer, of_station
from tfg_drake.diagrams.robots import SIMULATED, Robot
from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.mission.operation import Request
from tfg_drake.storage.port_recording import REQUESTS, PortWriter
from tfg_drake.storage.timeline import TimelineWriter
from tfg_drake.systems.operator import Operator
from tfg_drake.systems.port_recorder import PortRecorder
from tfg_drake.systems.ports import PERIOD as ODOMETRY_PERIOD
from tfg_drake.systems.pose_vector import PoseVector
from tfg_drake.systems.timeline_recorder import TimelineRecorder
from tfg_drake.world.world import World

# Period at which poses are logged with their covariance, s.
COVARIANCE_PERIOD = 1.0

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat


def ConnectStation(builder: DiagramBuilder, station: System, explorer: System) -> None:
    """Connect the station's outputs to the explorer's inputs of the same names, and the explorer's command and pose to
    the station. Raises TypeError where the station lacks some of the outputs."""
    names = [explorer.get_input_port(i).get_name() for i in range(explorer.num_input_ports())]
    asked = [name for name in names if of_station(name)]
    if missing := [name for name in asked if not station.HasOutputPort(name)]:
        raise TypeError(f"station: lacks the output ports {', '.join(missing)}; see MakeTurtlebotStation")
    for name in asked:
        builder.Connect(station.GetOutputPort(name), explorer.GetInputPort(name))
    builder.Connect(explorer.GetOutputPort(COMMANDED), station.GetInputPort(COMMANDED))
    if station.HasInputPort("base.pose") and explorer.HasOutputPort("pose"):
        builder.Connect(explorer.GetOutputPort("pose"), station.GetInputPort("base.pose"))


def MakeMissionDiagram(
    scenario: Scenario,
    world: World | None,
    meshcat: Meshcat | None = None,
    MakeExplorer: Callable[[Scenario], Diagram] = MakeTfgExplorer,
    robot: Robot = SIMULATED,
    writer: PortWriter | None = None,
    timeline: TimelineWriter | None = None,
    operated: Sequence[Callable[[], Sequence[Request]]] = (),
) -> tuple[Diagram, VectorLogSink | None, VectorLogSink, VectorLogSink]:
    """Make the diagram of station and explorer, drawn in Meshcat if one is given, recorded if writers are given, and
    with an Operator if the robot is real or there are sources of requests. A recorded robot repeats the recorded
    requests for goals and the recorded poses that it was told.

    Returns the diagram and its logs: true pose (x, y, theta, v, w in W), None if the station does not know it;
    estimated pose (PoseVector); once a second, the estimated pose with its covariance.
    """
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("station", robot.MakeStation(scenario))
    explorer = MakeExplorer(scenario)
    if not isinstance(explorer, System):
        raise TypeError(f"MakeExplorer must return the explorer's Diagram, not {type(explorer).__name__}")
    builder.AddNamedSystem("explorer", explorer)

    ConnectStation(builder, station, explorer)

    operator = _AddOperator(builder, station, explorer, robot, operated) if robot.real or operated else None
    requested: dict[str, OutputPort] = {}
    for name, port in REQUESTS.items():
        source = station if station.HasOutputPort(port) else operator
        if source is not None and explorer.HasInputPort(name):
            requested[port] = source.GetOutputPort(port if source is station else name)
            builder.Connect(requested[port], explorer.GetInputPort(name))
    robot.Announce(builder, station, explorer)

    pose_vector = builder.AddNamedSystem("pose_vector", PoseVector())
    builder.Connect(explorer.GetOutputPort("pose"), pose_vector.GetInputPort("pose"))
    pose_log = LogVectorOutput(pose_vector.GetOutputPort("vector"), builder, ODOMETRY_PERIOD)
    covariance_log = LogVectorOutput(pose_vector.GetOutputPort("with_covariance"), builder, COVARIANCE_PERIOD)
    pose_log.set_name("pose_log")
    covariance_log.set_name("covariance_log")
    truth_log = None
    if station.HasOutputPort("truth.pose"):
        truth_log = LogVectorOutput(station.GetOutputPort("truth.pose"), builder, ODOMETRY_PERIOD)
        truth_log.set_name("truth_log")

    if writer is not None:
        ports = builder.AddNamedSystem("port_recorder", PortRecorder(writer))
        ports.Connect(builder, station, explorer, requested)
    if timeline is not None:
        picture = builder.AddNamedSystem("timeline_recorder", TimelineRecorder(timeline))
        picture.Connect(builder, station, explorer, *filter(None, [operator]))
    if meshcat is not None:
        # Only a picture needs what this imports.
        from tfg_drake.systems.visualizer import TfgVisualizer

        TfgVisualizer.AddToBuilder(builder, station, explorer, meshcat, world, scenario.robot.radius)

    diagram = builder.Build()
    diagram.set_name("mission")
    return diagram, truth_log, pose_log, covariance_log


def _AddOperator(
    builder: DiagramBuilder,
    station: System,
    explorer: System,
    robot: Robot,
    operated: Sequence[Callable[[], Sequence[Request]]],
) -> Operator:
    """Add an Operator and connect it to base and mission as far as they have its ports, except requested_goal."""
    recalls, sources = explorer.HasInputPort("recall"), [*robot.operated, *operated]
    enabled = robot.enabled or not robot.real
    operator = builder.AddNamedSystem("operator", Operator(sources, recalls=recalls, enabled=enabled))
    for name, port in (("enable", "base.enable"), ("pushes", "truth.pushes")):
        if station.HasInputPort(port):
            builder.Connect(operator.GetOutputPort(name), station.GetInputPort(port))
    for name in ("pause", "stop", "recall"):
        if explorer.HasInputPort(name):
            builder.Connect(operator.GetOutputPort(name), explorer.GetInputPort(name))
    return operator
