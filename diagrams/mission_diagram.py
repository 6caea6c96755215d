"""The whole of a mission in one diagram: station, explorer, and who looks on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from pydrake.systems.framework import Diagram, DiagramBuilder, OutputPort, System
from pydrake.systems.primitives import LogVectorOutput, VectorLogSink

from tfg_drake.diagrams.explorer import COMMANDED, SENSED, MakeTfgExplorer
from tfg_drake.diagrams.robots import SIMULATED, Robot
from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.mission.operation import Request
from tfg_drake.planning.requested_goal import RequestedGoal, goal_asked_for
from tfg_drake.simulation.disturbance import Pushes, with_push
from tfg_drake.storage.port_recording import GOAL, PortWriter
from tfg_drake.storage.timeline import TimelineWriter
from tfg_drake.systems.odometry import PERIOD as ODOMETRY_PERIOD
from tfg_drake.systems.operator import Operator
from tfg_drake.systems.port_recorder import PortRecorder
from tfg_drake.systems.pose_vector import PoseVector
from tfg_drake.systems.requester import Requester
from tfg_drake.systems.timeline_recorder import TimelineRecorder
from tfg_drake.world.world import World

if TYPE_CHECKING:
    from tfg_drake.systems.visualizer import TfgVisualizer


def ConnectStation(builder: DiagramBuilder, station: System, explorer: System) -> None:
    """Connects what a station senses to the explorer's inputs of the same names, as far as it has them, and the
    explorer's command to the station."""
    for name in SENSED:
        if explorer.HasInputPort(name):
            builder.Connect(station.GetOutputPort(name), explorer.GetInputPort(name))
    builder.Connect(explorer.GetOutputPort(COMMANDED), station.GetInputPort(COMMANDED))


def MakeMissionDiagram(
    scenario: Scenario,
    world: World | None,
    visualizer: TfgVisualizer | None = None,
    MakeExplorer: Callable[[Scenario], Diagram] = MakeTfgExplorer,
    robot: Robot = SIMULATED,
    writer: PortWriter | None = None,
    timeline: TimelineWriter | None = None,
    operated: Sequence[Callable[[], Sequence[Request]]] = (),
    pushed: Callable[[], int] | None = None,
    sent: Callable[[], Sequence[tuple[float, float]]] | None = None,
) -> tuple[Diagram, VectorLogSink | None, VectorLogSink]:
    """Station and explorer, with the picture if there is one, recorded if there are writers, and under an operator if
    the robot is real or there is what it is operated by, besides what the robot has itself; see Operator. pushed, sent:
    tell how often somebody pushed the robot, and to what places, m in M, he sent it, since they were last called, see
    Requester; a recording has requests of its own.

    Returns the diagram and its logs of the true pose (x, y, theta, v, w in W), None where the station does not know
    it, and of the estimated one (PoseVector).
    """
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("station", robot.MakeStation(scenario))
    explorer = MakeExplorer(scenario)
    if not isinstance(explorer, System):
        raise TypeError(f"MakeExplorer must return the explorer's Diagram, not {type(explorer).__name__}")
    builder.AddNamedSystem("explorer", explorer)

    ConnectStation(builder, station, explorer)

    if robot.real or operated:
        _AddOperator(builder, station, explorer, robot, operated)
    if pushed is not None and station.HasInputPort("truth.pushes"):
        pusher = builder.AddNamedSystem("pusher", Requester("pushes", Pushes(), pushed, with_push))
        builder.Connect(pusher.get_output_port(), station.GetInputPort("truth.pushes"))
    requested = _AddRequests(builder, station, explorer, sent)
    if robot.Announce is not None:
        robot.Announce(builder, station, explorer)

    pose_vector = builder.AddNamedSystem("pose_vector", PoseVector())
    builder.Connect(explorer.GetOutputPort("pose"), pose_vector.GetInputPort("pose"))
    pose_log = LogVectorOutput(pose_vector.get_output_port(), builder, ODOMETRY_PERIOD)
    truth_log = None
    if station.HasOutputPort("truth.pose"):
        truth_log = LogVectorOutput(station.GetOutputPort("truth.pose"), builder, ODOMETRY_PERIOD)

    if writer is not None:
        PortRecorder.AddToBuilder(builder, station, explorer, writer, requested)
    if timeline is not None:
        TimelineRecorder.AddToBuilder(builder, station, explorer, timeline)
    if visualizer is not None:
        visualizer.Connect(builder, station, explorer)

    diagram = builder.Build()
    diagram.set_name("mission")
    return diagram, truth_log, pose_log


def _AddOperator(
    builder: DiagramBuilder,
    station: System,
    explorer: System,
    robot: Robot,
    operated: Sequence[Callable[[], Sequence[Request]]],
) -> None:
    """Base and mission under an operator, as far as they have ports for that."""
    recalls, sources = explorer.HasInputPort("recall"), [*robot.operated, *operated]
    operator = builder.AddNamedSystem("operator", Operator(sources, recalls=recalls, enabled=not robot.real))
    if station.HasInputPort("base.enable"):
        builder.Connect(operator.GetOutputPort("enable"), station.GetInputPort("base.enable"))
    for name in ("pause", "stop", "recall"):
        if explorer.HasInputPort(name):
            builder.Connect(operator.GetOutputPort(name), explorer.GetInputPort(name))


def _AddRequests(
    builder: DiagramBuilder,
    station: System,
    explorer: System,
    sent: Callable[[], Sequence[tuple[float, float]]] | None,
) -> OutputPort | None:
    """Where the places come from that somebody sends the robot to: a recording's own, else those of `sent`; None where
    there are none, or the explorer does not ask."""
    if not explorer.HasInputPort("requested_goal"):
        return None
    if station.HasOutputPort(GOAL):
        requested = station.GetOutputPort(GOAL)
    elif sent is not None:
        requester = Requester("requested_goal", RequestedGoal(), sent, goal_asked_for)
        requested = builder.AddNamedSystem("goal_requester", requester).get_output_port()
    else:
        return None
    builder.Connect(requested, explorer.GetInputPort("requested_goal"))
    return requested
