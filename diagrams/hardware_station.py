"""The station of a real robot: the simulated one's ports, but for the truth."""

from __future__ import annotations

import copy

from pydrake.systems.framework import Diagram, DiagramBuilder

from tfg_drake.diagrams.scenario import MakeKeepOut, Scenario, WorldConfig
from tfg_drake.diagrams.station_ports import MakePorts
from tfg_drake.hardware.base import HardwareBase
from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.robot_devices import RobotDevices
from tfg_drake.hardware.sensor import HardwareSensor
from tfg_drake.simulation.laser_scanner import no_scan
from tfg_drake.simulation.tag_sensor import no_detections
from tfg_drake.systems.safety_filter import SafetyFilter


def MakeHardwareStation(scenario: Scenario, devices: RobotDevices) -> Diagram:
    """The station of a robot's open devices, within their limits; see MakeTurtlebotStation for the ports.

    Whoever opened them closes them, when the simulation is over.
    """
    scenario, builder, clock = Bounded(scenario, devices), DiagramBuilder(), devices.clock
    # The robot's own watchdog locks and enables the base.
    filtering = SafetyFilter(scenario.robot, scenario.safety, scenario.scan, MakeKeepOut(scenario), locks=False)
    safety_filter = builder.AddNamedSystem("safety_filter", filtering)
    wheels = builder.AddNamedSystem("base", HardwareBase(devices))
    tags = HardwareSensor("detections", devices.tags, no_detections(), clock)
    tag_sensor = builder.AddNamedSystem("tag_sensor", tags)
    ranges = HardwareSensor("ranges", devices.scan, no_scan(scenario.scan), clock)
    scanner = builder.AddNamedSystem("laser_scanner", ranges)

    # A rejected scan counts as missing: the base stands as if the scanner were silent.
    builder.Connect(safety_filter.GetOutputPort("scan_believed"), wheels.GetInputPort("scan"))
    builder.Connect(tag_sensor.GetOutputPort("detections"), wheels.GetInputPort("detections"))

    sources = wheels, wheels, wheels, tag_sensor, scanner
    MakePorts(builder, safety_filter, wheels.GetInputPort("velocity"), sources)
    builder.ConnectInput("base.enable", wheels.GetInputPort("enable"))
    station = builder.Build()
    station.set_name("station")
    return station


def Bounded(scenario: Scenario, devices: RobotDevices) -> Scenario:
    """The scenario within the limits of the robot, and of what its scanner and camera see, without its world: that is
    another one, and the frame of the start is W. Of a robot without tags walls are the landmarks; raises DeviceError
    where landmarks or gain are of tags alone."""
    bounded = copy.deepcopy(scenario)
    bounded.world = WorldConfig()
    bounded.robot.max_speed, bounded.robot.max_turn_rate = devices.limits.speed, devices.limits.turn_rate
    bounded.robot.max_acceleration = devices.limits.acceleration
    bounded.robot.max_turn_acceleration = devices.limits.turn_acceleration
    bounded.scan.least_range = max(scenario.scan.least_range, devices.least_range)
    if devices.tags is None:
        for key, usual in (("landmarks", ("walls", "both")), ("gain", ("exact",))):
            if (value := getattr(scenario.explorer, key)) not in usual:
                mend = "give --tags, or leave it out"
                raise DeviceError(f"explorer.{key}={value}: the robot has no source of tags; {mend}")
        bounded.explorer.landmarks = "walls"
    if devices.view is not None:
        bounded.tags.field_of_view = min(scenario.tags.field_of_view, devices.view.field_of_view)
        bounded.tags.range = min(scenario.tags.range, devices.view.range)
        bounded.tags.max_incidence = min(scenario.tags.max_incidence, devices.view.max_incidence)
    return bounded
