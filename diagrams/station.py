"""The station: a TurtleBot, its sensors and its safety filter, behind ports that any explorer can use."""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING

from pydrake.common import RandomDistribution
from pydrake.systems.framework import Diagram, DiagramBuilder, InputPort, System
from pydrake.systems.primitives import RandomSource

from tfg_drake.diagrams.parts import Factory, MakePart, NameOf
from tfg_drake.diagrams.scenario import MakeKeepOut, MakeWorld, Scenario
from tfg_drake.diagrams.station_ports import MakePorts
from tfg_drake.systems import surroundings
from tfg_drake.systems.changing_world import ChangingWorld
from tfg_drake.systems.differential_drive_plant import DifferentialDrivePlant
from tfg_drake.systems.laser_scanner import LaserScanner
from tfg_drake.systems.odometry import Odometry
from tfg_drake.systems.people import PeopleWalking
from tfg_drake.systems.ports import PERIOD, connect_by_name
from tfg_drake.systems.safety_filter import SafetyFilter
from tfg_drake.systems.tag_sensor import TagSensor
from tfg_drake.world.world import World

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

# Period of random numbers that are drawn once, s: longer than any run.
_ONCE = 2.0**30
# Keys of a scenario that need an input of the plant, by input.
_NEEDS = {"people": "reality.people", "world": "reality.changes", "pushes": "disturbances"}
# Output ports with ground truth of the simulation.
_TRUTH = ("pose", "contacts", "clearance", "contacts_received", "people", "world")


def MakeTurtlebotStation(
    scenario: Scenario, meshcat: Meshcat | None = None, *, hardware: bool = False, plant: Factory | None = None
) -> Diagram:
    """Make the station of a scenario: simulated or, with `hardware`, the robot that scenario.hardware names.

    plant: a factory of a System that replaces DifferentialDrivePlant and has its ports. The inputs people, world and
    pushes may be missing if the scenario has no reality.people, reality.changes and disturbances; a plant with pushes
    is itself moved by scenario.disturbances. The outputs contacts, clearance and contacts_received may always be
    missing and are then not reported. Its name in the station is its own, or else its class's.

    meshcat: shows a simulated robot in its world, for a station without an explorer; TfgVisualizer.AddToBuilder draws a
    mission.

    .. pydrake_system::

        name: station
        input_ports:
        - base.velocity_commanded
        - base.enable
        - base.pose
        - truth.pushes
        output_ports:
        - base.odometry
        - base.hazards
        - base.enabled
        - tags.detections
        - scan.ranges
        - truth.pose
        - truth.contacts
        - truth.clearance
        - truth.contacts_received
        - truth.people
        - truth.world

    base.velocity_commanded: forward speed (m/s) and turn rate (rad/s); left unconnected, the base stands. base.enable:
    0: the base stands; any other number enables it once: after a fault it stays locked until the number changes. Left
    unconnected, a simulated base is enabled and a real one is not. base.enabled: 1 while the base may move, else 0.
    base.pose: PoseEstimate, by which the base keeps out of explorer.keep_out; left unconnected, it does not.
    base.odometry: Odometry, base.hazards: Hazards, tags.detections: TagDetections and scan.ranges: LaserScan, messages.
    truth.pose: x, y, theta of X_WB (m, rad), forward speed (m/s), turn rate (rad/s). truth.contacts:
    contacts so far with walls, and with people whom the robot moved towards; truth.contacts_received: those that people
    made, or walls while it was pushed. truth.clearance: least distance of the outline to any wall so far, m.
    truth.people: a People message, if the scenario has people. truth.world: a WorldNow message, if the world changes.
    truth.pushes: a Pushes message, motions of the base not caused by its wheels; for plants that can be pushed. A real
    robot's station has no truth and must run in real time: Simulator.set_target_realtime_rate(1.0).

    scenario.station.eyes selects the simulated sensors: ideal ones, or a rendered camera.

    All noise of a simulated station comes from Drake's random sources: diagram.SetRandomContext(context,
    RandomGenerator(seed)) makes a run reproducible.

    A real robot's devices are closed by RobotDevices.close, or when the program ends. Raises DeviceError if the robot
    cannot be used, TypeError if the plant lacks a port.
    """
    if hardware:
        # Only a robot needs what these import.
        from tfg_drake.diagrams.hardware_station import MakeHardwareStation
        from tfg_drake.hardware.robot_devices import open_devices

        return MakeHardwareStation(scenario, open_devices(scenario.hardware, scenario.robot))
    world, reality, disturbances = MakeWorld(scenario.world), scenario.reality, scenario.disturbances
    builder = DiagramBuilder()

    filtering = SafetyFilter(scenario.robot, scenario.safety, scenario.scan, MakeKeepOut(scenario))
    safety_filter = builder.AddNamedSystem("safety_filter", filtering)
    base = MakePart("plant", plant, lambda _: DifferentialDrivePlant(world, scenario.robot, disturbances), scenario)
    for name, key in _NEEDS.items():
        if attrgetter(key)(scenario) and not base.HasInputPort(name):
            raise TypeError(
                f"plant {NameOf(base)}: lacks the input port {name}, which {key} needs; add it or empty {key}"
            )
    builder.AddNamedSystem("differential_drive_plant" if plant is None else NameOf(base), base)
    wheels = builder.AddNamedSystem(
        "odometry", Odometry(world.start, scenario.odometry, disturbances, reality.odometry)
    )
    tag_sensor, scanner = _AddEyes(builder, scenario, world)
    eyes = [tag_sensor] if scanner is tag_sensor else [tag_sensor, scanner]

    _AddNoise(builder, "odometry_noise", wheels.GetInputPort("noise"), PERIOD)
    _AddNoise(builder, "odometry_run_errors", wheels.GetInputPort("run_errors"), _ONCE)
    _AddSensorNoise(builder, scenario, tag_sensor, scanner)

    around = _AddSurroundings(builder, scenario, world)
    connect_by_name(builder, base, *around)
    for system in (wheels, *eyes, *around):
        connect_by_name(builder, system, base, *around)
    if meshcat is not None:
        # Only a picture needs what this imports.
        from tfg_drake.systems.visualizer import TfgVisualizer

        picture = builder.AddNamedSystem("visualizer", TfgVisualizer(meshcat, world, radius=scenario.robot.radius))
        builder.Connect(base.GetOutputPort("pose"), picture.GetInputPort("truth"))
        connect_by_name(builder, picture, *around)

    sources = wheels, base, safety_filter, tag_sensor, scanner
    MakePorts(builder, safety_filter, base.GetInputPort("velocity_commanded"), sources)
    if base.HasInputPort("pushes"):
        pushes = builder.ExportInput(base.GetInputPort("pushes"), "truth.pushes")
        builder.ConnectInput(pushes, wheels.GetInputPort("pushes"))

    # The truth is for metrics and pictures. A robot has none: never wire it into an explorer.
    for system in (base, *around):
        for name in filter(system.HasOutputPort, _TRUTH):
            builder.ExportOutput(system.GetOutputPort(name), f"truth.{name}")
    station = builder.Build()
    station.set_name("station")
    return station


def _AddEyes(builder: DiagramBuilder, scenario: Scenario, world: World) -> tuple[System, System]:
    """Add tag sensor and scanner, a single system if both use the same rendered camera."""
    if scenario.station.eyes == "camera":
        # Imported here, as few missions need it.
        from tfg_drake.diagrams.rendered_eyes import MakeRenderedEyes

        camera = builder.AddNamedSystem("eyes", MakeRenderedEyes(scenario, world))
        return camera, camera
    reality = scenario.reality
    tag_sensor = builder.AddNamedSystem("tag_sensor", TagSensor(world, scenario.tags, reality.tags))
    return tag_sensor, builder.AddNamedSystem("laser_scanner", LaserScanner(world, scenario.scan, reality.scan))


def _AddSurroundings(builder: DiagramBuilder, scenario: Scenario, world: World) -> list[System]:
    """Add the scenario's walking people and changes of the world, if it has any."""
    radius, reality, added = scenario.robot.radius, scenario.reality, list[System]()
    if reality.people:
        added.append(builder.AddNamedSystem("people", PeopleWalking(world, radius, reality.people)))
        numbers = added[0].GetInputPort("numbers")
        _AddNoise(builder, "people_numbers", numbers, surroundings.PERIOD, RandomDistribution.kUniform)
    if reality.changes:
        added.append(builder.AddNamedSystem("world", ChangingWorld(world, reality.changes, radius)))
    return added


def _AddSensorNoise(builder: DiagramBuilder, scenario: Scenario, tag_sensor: System, scanner: System) -> None:
    if scenario.station.eyes == "camera":
        port = tag_sensor.GetInputPort("noise")
        _AddNoise(builder, "image_noise", port, 1.0 / scenario.tags.rate, RandomDistribution.kUniform)
        return
    _AddNoise(builder, "tag_noise", tag_sensor.GetInputPort("noise"), 1.0 / scenario.tags.rate)
    _AddNoise(builder, "scan_noise", scanner.GetInputPort("noise"), 1.0 / scenario.scan.rate)

    # Added after the noise of every simulation, so that options of reality do not change its random numbers.
    if tag_sensor.has_tag_errors:
        _AddNoise(builder, "tag_errors", tag_sensor.GetInputPort("tag_errors"), _ONCE)
    if tag_sensor.has_frame_noise:
        _AddNoise(builder, "frame_noise", tag_sensor.GetInputPort("frame_noise"), 1.0 / scenario.tags.rate)
    if scanner.has_ray_faults:
        port = scanner.GetInputPort("ray_faults")
        _AddNoise(builder, "ray_faults", port, 1.0 / scenario.scan.rate, RandomDistribution.kUniform)


def _AddNoise(
    builder: DiagramBuilder,
    name: str,
    port: InputPort,
    period: float,
    distribution: RandomDistribution = RandomDistribution.kGaussian,
) -> None:
    """Connect random numbers of a distribution, redrawn every period (s), to a port."""
    source = RandomSource(distribution, port.size(), period)
    builder.Connect(builder.AddNamedSystem(name, source).get_output_port(), port)
