"""The station: a TurtleBot, its sensors and its safety filter, behind ports that any explorer can use."""

from __future__ import annotations

from pydrake.common import RandomDistribution
from pydrake.systems.framework import Diagram, DiagramBuilder, InputPort
from pydrake.systems.primitives import RandomSource

from tfg_drake.diagrams.scenario import MakeWorld, Scenario
from tfg_drake.systems import odometry
from tfg_drake.systems.differential_drive_plant import DifferentialDrivePlant
from tfg_drake.systems.laser_scanner import LaserScanner
from tfg_drake.systems.odometry import Odometry
from tfg_drake.systems.safety_filter import SafetyFilter
from tfg_drake.systems.tag_sensor import TagSensor

# Longer than any run: drawn once.
_ONCE = 2.0**30


def MakeTurtlebotStation(scenario: Scenario) -> Diagram:
    """The simulated station of a scenario.

    .. pydrake_system::

        name: station
        input_ports:
        - base.velocity_commanded
        output_ports:
        - base.odometry
        - base.hazards
        - tags.detections
        - scan.ranges
        - truth.pose
        - truth.contacts
        - truth.clearance

    base.velocity_commanded: forward speed (m/s) and turn rate (rad/s); left unconnected, the base stands. The next four
    are messages: Odometry, Hazards, TagDetections, LaserScan. truth.pose: x, y, theta of X_WB (m, rad), forward speed
    (m/s), turn rate (rad/s). truth.contacts: contacts with walls so far. truth.clearance: least distance of the outline
    to any wall so far, m.

    All noise comes from Drake's random sources: diagram.SetRandomContext(context, RandomGenerator(seed)) makes a run
    reproducible; each seed gives another one.
    """
    world, disturbances = MakeWorld(scenario.world), scenario.disturbances
    builder = DiagramBuilder()

    safety_filter = builder.AddNamedSystem("safety_filter", SafetyFilter(scenario.robot, scenario.safety))
    plant = builder.AddNamedSystem(
        "differential_drive_plant", DifferentialDrivePlant(world, scenario.robot, disturbances)
    )
    wheels = builder.AddNamedSystem("odometry", Odometry(world.start, scenario.odometry, disturbances))
    tag_sensor = builder.AddNamedSystem("tag_sensor", TagSensor(world, scenario.tags))
    scanner = builder.AddNamedSystem("laser_scanner", LaserScanner(world, scenario.scan))

    builder.Connect(safety_filter.GetOutputPort("velocity"), plant.GetInputPort("velocity_commanded"))
    builder.Connect(plant.GetOutputPort("hazards"), safety_filter.GetInputPort("hazards"))
    builder.Connect(scanner.GetOutputPort("ranges"), safety_filter.GetInputPort("scan"))
    for sensor in (wheels, tag_sensor, scanner):
        builder.Connect(plant.GetOutputPort("pose"), sensor.GetInputPort("pose"))

    _AddNoise(builder, "odometry_noise", wheels.GetInputPort("noise"), odometry.PERIOD)
    _AddNoise(builder, "odometry_run_errors", wheels.GetInputPort("run_errors"), _ONCE)
    _AddNoise(builder, "tag_noise", tag_sensor.GetInputPort("noise"), 1.0 / scenario.tags.rate)
    _AddNoise(builder, "scan_noise", scanner.GetInputPort("noise"), 1.0 / scenario.scan.rate)

    builder.ExportInput(safety_filter.GetInputPort("velocity_commanded"), "base.velocity_commanded")
    builder.ExportOutput(wheels.GetOutputPort("odometry"), "base.odometry")
    builder.ExportOutput(plant.GetOutputPort("hazards"), "base.hazards")
    builder.ExportOutput(tag_sensor.GetOutputPort("detections"), "tags.detections")
    builder.ExportOutput(scanner.GetOutputPort("ranges"), "scan.ranges")

    # The truth, for metrics and pictures. A simulation knows it, a robot does not: never wire it into an explorer.
    builder.ExportOutput(plant.GetOutputPort("pose"), "truth.pose")
    builder.ExportOutput(plant.GetOutputPort("contacts"), "truth.contacts")
    builder.ExportOutput(plant.GetOutputPort("clearance"), "truth.clearance")

    station = builder.Build()
    station.set_name("station")
    return station


def _AddNoise(builder: DiagramBuilder, name: str, port: InputPort, period: float) -> None:
    """Connects standard normal numbers, redrawn every period (s), to a port."""
    source = RandomSource(RandomDistribution.kGaussian, port.size(), period)
    builder.Connect(builder.AddNamedSystem(name, source).get_output_port(), port)
