"""Simulates a scenario, or drives the robot that it names: scenario in, diagram in the order of the data, run.

    python examples/robot_sim.py house
    python examples/robot_sim.py mine.yaml --meshcat --seed 3
    python examples/robot_sim.py house --graphviz house.dot
    python examples/robot_sim.py house --landmarks 60    # a monitor ends it when so many are mapped
    python examples/robot_sim.py robot.yaml --hardware --enable

The explorer cannot tell a simulated station from a robot's: they have the same ports, but for truth.*. In the way of
Drake's examples/hardware_sim; `tfg_drake.explore` does the same in a line, and tells and keeps more.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.geometry import StartMeshcat
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, DiagramBuilder, EventStatus, System
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput

from tfg_drake.diagrams.explorer import MakeTfgExplorer
from tfg_drake.diagrams.mission_diagram import ConnectStation
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld, Scenario
from tfg_drake.diagrams.station import MakeTurtlebotStation
from tfg_drake.mapfile.summary import landmark_counts
from tfg_drake.messages import is_tag
from tfg_drake.systems.visualizer import TfgVisualizer


def MakeRobotDiagram(scenario: Scenario, *, meshcat: bool, hardware: bool, enable: bool) -> Diagram:
    """Station and explorer, and a picture of both."""
    builder = DiagramBuilder()

    # What senses and moves: a simulated TurtleBot or a real one.
    station = builder.AddNamedSystem("station", MakeTurtlebotStation(scenario, hardware=hardware))

    # What decides: tags and scans in, velocities out. It reads nothing of the world.
    explorer = builder.AddNamedSystem("explorer", MakeTfgExplorer(scenario))
    ConnectStation(builder, station, explorer)

    # A real base moves for nobody who has not said so.
    if enable:
        enabled = builder.AddNamedSystem("enable", ConstantVectorSource([1.0]))
        builder.Connect(enabled.get_output_port(), station.GetInputPort("base.enable"))

    # What a simulation knows and a robot does not is for pictures and figures alone.
    if not hardware:
        LogVectorOutput(station.GetOutputPort("truth.pose"), builder, publish_period=1.0).set_name("truth_log")
    if meshcat:
        world = None if hardware else MakeWorld(scenario.world)
        TfgVisualizer.AddToBuilder(builder, station, explorer, StartMeshcat(), world, scenario.robot.radius)

    diagram = builder.Build()
    diagram.set_name("robot_sim")
    return diagram


def Run(scenario: Scenario, *, max_time: float, graphviz: Path | None, landmarks: int | None, **made_of: bool) -> None:
    """Simulates until the mission ends, for max_time, s, or until so many landmarks are mapped."""
    diagram = MakeRobotDiagram(scenario, **made_of)
    if graphviz is not None:
        graphviz.write_text(diagram.GetGraphvizString(max_depth=2), encoding="utf-8")

    station, explorer = diagram.GetSubsystemByName("station"), diagram.GetSubsystemByName("explorer")
    simulated = station.HasOutputPort("truth.pose")
    simulator = Simulator(diagram)
    simulator.set_target_realtime_rate(0.0 if simulated else 1.0)
    diagram.SetRandomContext(simulator.get_mutable_context(), RandomGenerator(scenario.seed))

    context = simulator.get_context()

    def Look(system: System, port: str) -> Any:
        return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(context))

    def Monitor(_root: Context) -> EventStatus:
        if landmarks is not None and len(Look(explorer, "map").ids) >= landmarks:
            return EventStatus.ReachedTermination(explorer, f"{landmarks} landmarks are mapped")
        return EventStatus.DidNothing()

    # The explorer requests termination when its mission is over; the monitor may do so before, after any step.
    simulator.set_monitor(Monitor)
    status = simulator.AdvanceTo(max_time)

    tags = is_tag(Look(explorer, "landmarks").ids)
    mapped = landmark_counts(np.count_nonzero(tags), np.count_nonzero(~tags) // 2)  # a wall has two points
    print(f"{status.FormatMessage()}\n{mapped} after {context.get_time():.0f} s")
    if simulated:
        truth = diagram.GetSubsystemByName("truth_log").FindLog(context).data()
        driven = np.hypot(*np.diff(truth[:2], axis=1)).sum()
        print(f"{driven:.0f} m driven, {Look(station, 'truth.contacts')[0]:.0f} contacts")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", help="a shipped scenario's name, or a YAML file")
    parser.add_argument("--seed", type=int, help="of all noise, instead of the scenario's")
    parser.add_argument("--max-time", type=float, default=3600.0, help="s")
    parser.add_argument("--landmarks", type=int, help="end when so many are mapped")
    parser.add_argument("--meshcat", action="store_true", help="show it in Meshcat")
    parser.add_argument("--hardware", action="store_true", help="drive the robot of scenario.hardware")
    parser.add_argument("--enable", action="store_true", help="with --hardware: the base may move at once")
    parser.add_argument("--graphviz", type=Path, help="file for the diagram in dot's language")
    options = vars(parser.parse_args())
    scenario, seed = LoadScenario(options.pop("scenario")), options.pop("seed")
    if seed is not None:
        scenario.seed = seed
    Run(scenario, **options)


if __name__ == "__main__":
    main()
