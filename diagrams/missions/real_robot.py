"""The real robot, as an explorer drives it: its devices opened, its operator listened to."""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import math
import threading
from collections.abc import Callable, Iterator, Sequence

from pydrake.systems.framework import Diagram, DiagramBuilder, System

from tfg_drake.diagrams.hardware_station import Bounded, MakeHardwareStation
from tfg_drake.diagrams.methods import Method
from tfg_drake.diagrams.missions.mission import Mission, MissionRequest
from tfg_drake.diagrams.missions.mission_runner import MissionRunner
from tfg_drake.diagrams.robots import Robot
from tfg_drake.diagrams.scenario import LoadScenario, Scenario
from tfg_drake.hardware.base import HardwareBase
from tfg_drake.hardware.checks import check, refuse
from tfg_drake.hardware.keyboard import HELP, KEYS, Keyboard
from tfg_drake.hardware.remarks import RobotRequests
from tfg_drake.hardware.robot_devices import RobotDevices, open_devices
from tfg_drake.hardware.ros.map_publisher import MapPublisher
from tfg_drake.messages import SaidPose
from tfg_drake.mission.operation import Request

# Duration of the simulated rehearsal before a real mission, s: it covers some stages, as its first look is short.
REHEARSAL = 30.0


@contextlib.contextmanager
def OpenRobot(
    scenario: Scenario, method: Method, interrupted: threading.Event, *, checked: bool = True
) -> Iterator[tuple[Robot, Scenario]]:
    """The robot that scenario.hardware names, and the scenario within the limits of robot, scanner and camera; closed
    at the end. Its mission has been rehearsed, until interrupted.

    checked: what it says while it stands is looked at. All is told on standard output. Keys on standard input and the
    robot's own buttons operate it. Raises DeviceError, also where a check fails.
    """
    if not checked:
        print("--skip-checks: battery, sensors and clocks are not checked, nor is the first turn", flush=True)
    devices = dataclasses.replace(open_devices(scenario.hardware, scenario.robot), checked=checked)
    with contextlib.closing(devices), contextlib.closing(Keyboard(KEYS)) as keyboard:
        bounded = Bounded(scenario, devices)
        if checked:
            checks = check(devices)
            print("".join(f"{line}\n" for line in checks), end="", flush=True)
            refuse(checks)
        robot = RobotOf(scenario, devices, [keyboard.requests])
        print(f"{robot.name}: connected; a short rehearsal in simulation, then it is yours", flush=True)
        Rehearse(scenario, method, interrupted)
        print(HELP, flush=True)
        yield robot, bounded


def RobotOf(
    scenario: Scenario,
    devices: RobotDevices,
    operated: Sequence[Callable[[], Sequence[Request]]] = (),
    MakeStation: Callable[[Scenario], System] | None = None,
    *,
    enabled: bool = False,
) -> Robot:
    """The robot of open devices, operated by its own buttons, too, and told on ROS where it is. MakeStation: makes its
    station, where that is not MakeHardwareStation's. enabled: its base may move from the beginning."""
    own, publisher, frames = RobotRequests(devices.base), devices.publisher, devices.frames
    said = [] if publisher is None else [lambda: publisher.take(SaidPose, math.inf)]

    def Announce(builder: DiagramBuilder, station: System, explorer: System) -> None:
        if publisher is not None and frames is not None:
            MapPublisher.AddToBuilder(builder, station, explorer, publisher, frames, devices.clock)

    return Robot(
        scenario.hardware.robot,
        MakeStation or (lambda scenario: MakeHardwareStation(scenario, devices)),
        world_known=False,
        real=True,
        enabled=enabled,
        operated=[*operated, *said, own.requests],
        empty=own.empty,
        Announce=Announce,
        close=devices.close,
    )


def DevicesOf(station: System) -> RobotDevices | None:
    """The devices of a real robot's station, None of another one."""
    if isinstance(station, HardwareBase):
        return station.devices
    parts = station.GetSystems() if isinstance(station, Diagram) else ()
    return next((found for found in map(DevicesOf, parts) if found is not None), None)


def Rehearse(scenario: Scenario, method: Method, interrupted: threading.Event) -> None:
    """Runs the beginning of a simulated mission of the same explorer: all its kernels are compiled then, and a real
    robot need not wait for them in the middle of its way."""
    rehearsed = copy.deepcopy(scenario)
    rehearsed.world, rehearsed.explorer.keep_out = LoadScenario("paper").world, []
    rehearsed.explorer.first_look, rehearsed.explorer.first_turns = 0.0, 1
    mission = Mission(MissionRequest(rehearsed, method, max_time=REHEARSAL))
    MissionRunner(mission, interrupted).run()
