"""The real robot, as an explorer drives it: its devices opened, its operator listened to."""

from __future__ import annotations

import contextlib
import copy
import threading
from collections.abc import Callable, Iterator

from pydrake.systems.framework import Diagram, DiagramBuilder

from tfg_drake.diagrams.hardware_station import MakeHardwareStation
from tfg_drake.diagrams.methods import Method
from tfg_drake.diagrams.missions.mission import Mission
from tfg_drake.diagrams.missions.mission_runner import MissionRunner
from tfg_drake.diagrams.robots import Robot
from tfg_drake.diagrams.scenario import LoadScenario, Scenario
from tfg_drake.hardware.battery_watch import BatteryWatch
from tfg_drake.hardware.keyboard import KEYS, Keyboard
from tfg_drake.hardware.robot_buttons import RobotButtons
from tfg_drake.hardware.robot_devices import RobotDevices, open_devices
from tfg_drake.hardware.ros.map_publisher import MapPublisher

# Of the simulated mission that is run before a real one, s: some stages, as it does not look round for long first.
REHEARSAL = 30.0


@contextlib.contextmanager
def OpenRobot(scenario: Scenario) -> Iterator[tuple[Robot, Scenario]]:
    """The robot that scenario.hardware names, and the scenario within the limits of robot, scanner and camera; closed
    at the end.

    Keys on standard input and the robot's own buttons operate it. Raises DeviceError.
    """
    devices = open_devices(scenario.hardware, scenario.robot)
    with contextlib.closing(devices), contextlib.closing(Keyboard(KEYS)) as keyboard:
        watch = BatteryWatch(devices.base)
        operated = [keyboard.requests, RobotButtons(devices.base).requests, watch.requests]
        robot = Robot(
            scenario.hardware.robot,
            lambda scenario: MakeHardwareStation(scenario, devices),
            world_known=False,
            real=True,
            operated=operated,
            empty=watch.empty,
            Announce=_Announcer(devices),
            close=devices.close,
        )
        yield robot, Bounded(scenario, devices)


def Bounded(scenario: Scenario, devices: RobotDevices) -> Scenario:
    """The scenario within the limits of the robot, and of what its scanner and camera see."""
    bounded = copy.deepcopy(scenario)
    bounded.robot.max_speed, bounded.robot.max_turn_rate = devices.limits.speed, devices.limits.turn_rate
    bounded.robot.max_acceleration = devices.limits.acceleration
    bounded.robot.max_turn_acceleration = devices.limits.turn_acceleration
    bounded.scan.least_range = max(scenario.scan.least_range, devices.least_range)
    if devices.view is not None:
        bounded.tags.field_of_view = min(scenario.tags.field_of_view, devices.view.field_of_view)
        bounded.tags.range = min(scenario.tags.range, devices.view.range)
        bounded.tags.max_incidence = min(scenario.tags.max_incidence, devices.view.max_incidence)
    return bounded


def _Announcer(devices: RobotDevices) -> Callable[[DiagramBuilder, Diagram, Diagram], object] | None:
    publisher, frames = devices.publisher, devices.frames
    if publisher is None or frames is None:
        return None
    return lambda builder, station, explorer: MapPublisher.AddToBuilder(
        builder, station, explorer, publisher, frames, devices.clock
    )


def Rehearse(scenario: Scenario, method: Method, interrupted: threading.Event) -> None:
    """Runs the beginning of a simulated mission of the same explorer: all its kernels are compiled then, and a real
    robot need not wait for them in the middle of its way."""
    rehearsed = copy.deepcopy(scenario)
    rehearsed.world = LoadScenario("paper").world
    rehearsed.explorer.first_look, rehearsed.explorer.first_turns = 0.0, 1
    mission = Mission(rehearsed, method, None, "rehearsal")
    MissionRunner(mission, interrupted, max_time=REHEARSAL).run()
