"""`tfg-drake kobuki`: a look at the base on its serial port, or an emulated one. Needs no Drake without a scenario."""

from __future__ import annotations

import math
import signal
import threading
import time
from typing import TYPE_CHECKING, Annotated

import typer

from tfg_drake.diagrams.command_line import bad_input

if TYPE_CHECKING:
    from tfg_drake.hardware.kobuki.driver import KobukiDriver
    from tfg_drake.hardware.kobuki.emulator import Emulator
    from tfg_drake.hardware.kobuki.link import Report

# How far `check --drive` goes, m, how fast, m/s, how it slows down, m/s^2, and how long that may take, s.
DISTANCE, SPEED, DECELERATION, DRIVE_WITHIN = 0.2, 0.1, 0.2, 6.0
# The vendor calls a battery below this low, V.
LOW_BATTERY = 14.0

kobuki_app = typer.Typer(add_completion=False, rich_markup_mode=None)


@kobuki_app.callback()
def _commands() -> None:
    """The Kobuki base on its serial port, or an emulated one."""


@kobuki_app.command()
def check(
    port: Annotated[str, typer.Option(metavar="DEV", help="The base's serial port.")] = "/dev/kobuki",
    drive: Annotated[bool, typer.Option("--drive", help="Drive 20 cm ahead; make room for it.")] = False,
) -> None:
    """Say how a base is: its versions, battery and sensors."""
    from tfg_drake.hardware.kobuki.driver import KobukiDriver
    from tfg_drake.hardware.kobuki.link import KobukiError

    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with KobukiDriver(port) as driver:
            for name, value in report_rows(driver.wait_connected()):
                print(f"{name:<12}{value}", flush=True)
            if drive:
                print(f"{'drive':<12}{_drive_ahead(driver)}")
    except KobukiError as error:
        bad_input(str(error))
    except KeyboardInterrupt:
        raise typer.Exit(130) from None


def report_rows(report: Report) -> list[tuple[str, str]]:
    """What a connected base says, as names and values."""
    assert report.hazards is not None
    low = "; charge it" if report.battery < LOW_BATTERY and not report.charging else ""
    return [
        ("firmware", report.firmware),
        ("hardware", report.hardware),
        ("id", report.unique_id),
        ("battery", f"{report.battery:.1f} V, {'charging' if report.charging else 'discharging'}{low}"),
        ("bumper", _where(report.hazards.bumper)),
        ("cliff", _where(report.hazards.cliff)),
        ("wheel drop", _where(report.hazards.wheel_drop)),
    ]


def _where(bits: int) -> str:
    return ", ".join(name for bit, name in ((4, "left"), (2, "centre"), (1, "right")) if bits & bit) or "none"


def _drive_ahead(driver: KobukiDriver) -> str:
    """Drives DISTANCE ahead and says how that went; raises KobukiError where something is in the way."""
    from tfg_drake.geometry.se2 import between
    from tfg_drake.hardware.kobuki.link import KobukiError

    driver.enable()
    begin, start, driven = time.monotonic(), driver.report().odometry, False
    while True:
        report = driver.report()
        if report.odometry is None or report.hazards is None or start is None:
            raise KobukiError(report.detail)
        if report.hazards.bumper or report.hazards.cliff or report.hazards.wheel_drop:
            raise KobukiError("the drive was stopped by bumper, cliff or wheel drop; make room ahead of the base")
        if time.monotonic() - begin > DRIVE_WITHIN:
            raise KobukiError(f"the base did not drive {DISTANCE:g} m within {DRIVE_WITHIN:g} s; let its wheels turn")
        x, y, turned = between(start.X_OB, report.odometry.X_OB)
        left = DISTANCE - x
        driven = driven or left < 1e-3
        if driven and report.odometry.at_rest:
            return f"{x:.3f} m ahead, {y:+.3f} m to the left, {math.degrees(turned):+.1f} degrees"
        driver.command(0.0 if driven else min(SPEED, math.sqrt(2.0 * DECELERATION * left)), 0.0)
        time.sleep(0.02)


@kobuki_app.command()
def emulate(
    world: Annotated[
        str, typer.Option(metavar="none|SCENARIO", help="Where it stands: on an empty plane, or in a scenario.")
    ] = "none",
) -> None:
    """Emulate a Kobuki until Ctrl-C; prints its device, then the address that serves its tags and scans."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with _emulator(world) as emulator:
            print(emulator.device, flush=True)
            print("{}:{}".format(*emulator.sensors), flush=True)
            threading.Event().wait()
    except KeyboardInterrupt:
        print()


def _emulator(world: str) -> Emulator:
    from tfg_drake.hardware.kobuki.emulator import Emulator

    if world == "none":
        return Emulator()

    from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld, ScenarioError

    try:
        scenario = LoadScenario(world)
    except ScenarioError as error:
        bad_input(str(error))
    return Emulator(MakeWorld(scenario.world), scenario.robot, scenario.tags, scenario.scan, scenario.seed)
