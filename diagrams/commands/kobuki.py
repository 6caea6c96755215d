"""`tfg-drake kobuki`: checks a Kobuki base, or emulates one. Needs no Drake without a scenario."""

from __future__ import annotations

import contextlib
import json
import math
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tfg_drake.diagrams.commands import command
from tfg_drake.diagrams.commands.command import flag, option

if TYPE_CHECKING:
    from tfg_drake.diagrams.scenario import Scenario
    from tfg_drake.hardware.device import BaseState, Device
    from tfg_drake.hardware.emulation.emulator import Emulator
    from tfg_drake.messages import Hazards, Odometry
    from tfg_drake.world.world import World

# Standard deviation of a range of the emulated scanner, m.
LIDAR_NOISE = 0.01
# `check --drive`: distance, m, speed, m/s, deceleration, m/s^2, and time limit, s.
DISTANCE, SPEED, DECELERATION, DRIVE_WITHIN = 0.2, 0.1, 0.2, 6.0

kobuki_app = command.group("kobuki", "Check a Kobuki base, or emulate one.")


@kobuki_app.command()
def check(
    port: Annotated[str, option("DEV", "The base's serial port.")] = "/dev/kobuki",
    drive: Annotated[bool, flag("--drive", "Drive 20 cm ahead; make room for that.")] = False,
) -> None:
    """Print a base's firmware, battery, charger, bumper and cliff sensors."""
    from tfg_drake.hardware.kobuki.driver import connect

    with connect(port) as device:
        _, hazards, state = _newest(device)
        command.print_rows(report_rows(state, hazards))
        if drive:
            command.print_rows([("drive", _drive_ahead(device))])


def _newest(device: Device) -> tuple[Odometry, Hazards, BaseState]:
    """Return the base's newest messages. Raises DeviceError if one is missing."""
    from tfg_drake.hardware.device import BaseState, DeviceError
    from tfg_drake.messages import Hazards, Odometry

    try:
        return device.first(Odometry), device.first(Hazards), device.first(BaseState)
    except DeviceError:
        raise DeviceError(device.locked or "the base says nothing of itself; switch it off and on again") from None


def report_rows(state: BaseState, hazards: Hazards) -> list[tuple[str, str]]:
    """Return the state of a connected base as names and values."""
    from tfg_drake.hardware.remarks import where

    low = "; charge it" if state.battery_level != "good" else ""
    charger = f"{state.charger}, {'charging' if state.charging else 'full'}" if state.charger else "none"
    return [
        ("firmware", state.firmware),
        ("hardware", state.hardware),
        ("id", state.unique_id),
        ("battery", f"{state.battery:.1f} V{low}" if state.battery > 0.0 else "says nothing of its voltage"),
        ("charger", charger),
        ("overcurrent", where(state.overcurrent)),
        ("bumper", where(hazards.bumper)),
        ("cliff", where(hazards.cliff)),
        ("wheel drop", where(hazards.wheel_drop)),
    ]


def _drive_ahead(device: Device) -> str:
    """Drive DISTANCE ahead and return a line with the motion. Raises DeviceError if something is in the way."""
    from tfg_drake.geometry.se2 import between
    from tfg_drake.hardware.device import DeviceError

    device.enable()
    begin, (start, _, _), driven = time.monotonic(), _newest(device), False
    while device.locked is None:
        odometry, hazards, _ = _newest(device)
        if hazards.bumper or hazards.cliff or hazards.wheel_drop:
            raise DeviceError("the drive was stopped by bumper, cliff or wheel drop; make room ahead of the base")
        if time.monotonic() - begin > DRIVE_WITHIN:
            raise DeviceError(f"the base did not drive {DISTANCE:g} m within {DRIVE_WITHIN:g} s; let its wheels turn")
        x, y, turned = between(start.X_OB, odometry.X_OB)
        left = DISTANCE - x
        driven = driven or left < 1e-3
        if driven and odometry.at_rest:
            return f"{x:.3f} m ahead, {y:+.3f} m to the left, {math.degrees(turned):+.1f} degrees"
        device.command(0.0 if driven else min(SPEED, math.sqrt(2.0 * DECELERATION * left)), 0.0)
        time.sleep(0.02)
    raise DeviceError(device.locked or "the drive was broken off")


@kobuki_app.command()
def emulate(
    world: Annotated[
        str, option("none|SCENARIO|MAP", "The world: an empty plane, or that of a scenario or map file.")
    ] = "none",
    sensors: Annotated[
        bool, flag("--sensors", "Also emulate an RPLidar on its own device, and a network camera.")
    ] = False,
) -> None:
    """Emulate a Kobuki until Ctrl-C. Prints its device, then the address that serves its tags and scans.

    With --sensors it prints three more lines: the scanner and the camera as the options --scan and --tags of explore,
    and the URL of the camera in front of a chessboard.

    Lines on standard input cause faults and events, see docs/kobuki_emulator.md. At the end it prints its true pose.
    """
    from tfg_drake.hardware.emulation.emulator import Emulator, order

    of, walls = _place(world)
    emulated = Emulator(walls, of.robot, of.tags, of.scan, of.seed)
    # Ignored, so that in the background of a terminal the input ends instead of stopping the whole program.
    signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    with contextlib.suppress(KeyboardInterrupt), emulated as emulator, contextlib.ExitStack() as stack:
        try:
            print(emulator.device, flush=True)
            print("{}:{}".format(*emulator.sensors), flush=True)
            own = stack.enter_context(_own_sensors(emulator, world, walls)) if sensors else {}
            with contextlib.suppress(OSError):
                for line in sys.stdin or ():
                    try:
                        if obey := own.get(" ".join(line.split())):
                            obey()
                        elif answer := order(emulator, line):
                            print(answer, flush=True)
                    except ValueError as error:
                        print(f"tfg-drake: {error}", file=sys.stderr, flush=True)
            # Not Event.wait: interrupted as it begins, it releases a lock twice (RuntimeError).
            while True:
                time.sleep(0.1)
        finally:
            print(json.dumps(emulator.report()), flush=True)


@contextlib.contextmanager
def _own_sensors(emulator: Emulator, name: str, world: World) -> Iterator[dict[str, Callable[[], None]]]:
    """Emulate an RPLidar and a camera on the base and print their addresses; yields their commands by name."""
    from tfg_drake.hardware.emulation.rplidar_emulator import RplidarEmulator
    from tfg_drake.world.world import WorldError

    with command.installed("camera"):
        from tfg_drake.diagrams.emulated_camera import EmulatedCamera
    with command.naming(f"{name}: ", WorldError):
        seen = EmulatedCamera(world, lambda: emulator.base.pose)
    lidar = RplidarEmulator(world.walls, lambda: emulator.base.pose, noise=LIDAR_NOISE)
    with contextlib.closing(seen) as camera, lidar:
        for line in (f"rplidar:{lidar.device}", f"camera:{camera.url}", camera.board):
            print(line, flush=True)
        yield {
            "camera off": lambda: camera.switch(False),
            "camera on": lambda: camera.switch(True),
            "lidar unplug": lidar.unplug,
            "lidar plug": lidar.plug,
        }


def _place(name: str) -> tuple[Scenario, World]:
    """Return the scenario of a name and its world; an empty plane for `none`, a tag every metre for a map file."""
    from tfg_drake.diagrams.scenario import IsScenario, LoadScenario, MakeWorld, PrepareScenario, Scenario
    from tfg_drake.hardware.emulation.emulator import empty_plane

    if name == "none":
        return Scenario(), empty_plane()
    is_scenario = IsScenario(Path(name))
    scenario = LoadScenario(name) if is_scenario else PrepareScenario("house", world=name, tag_spacing=1.0)
    return scenario, MakeWorld(scenario.world)
