"""`tfg-drake kobuki`: an emulated Kobuki to try things on. Needs no Drake without a scenario."""

from __future__ import annotations

import signal
import threading
from typing import TYPE_CHECKING, Annotated

import typer

from tfg_drake.diagrams.command_line import bad_input

if TYPE_CHECKING:
    from tfg_drake.hardware.kobuki.emulator import Emulator

kobuki_app = typer.Typer(add_completion=False, rich_markup_mode=None)


@kobuki_app.callback()
def _commands() -> None:
    """The Kobuki base on its serial port, or an emulated one."""


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
