"""Shared by the commands: their options, how bad input ends one, its folder and exit code, and waiting for the user."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
import typer.core

from tfg_drake.bad_input import BadInput, not_radians
from tfg_drake.diagrams.missions import run_folder
from tfg_drake.io.extras import pip_install
from tfg_drake.mission.interruption import Interruption

EXIT_CODES = {
    "complete": 0,
    "budget": 0,
    "battery": 0,
    "time_limit": 0,
    "stuck": 1,
    "apart": 1,
    "fault": 3,
    "interrupted": 130,
}
# Tags nearer to each other than this would lie on top of one another, m.
LEAST_SPACING = 0.05

# The signals that end a command.
interruption = Interruption()


def bad_input(message: str) -> NoReturn:
    """Ends a command: the message goes to standard error, the exit code is 2."""
    raise BadInput(message)


@contextlib.contextmanager
def naming(what: str, kind: type[Exception]) -> Iterator[None]:
    """Names what the user gave, such as an option, in the complaint about it. Raises BadInput in place of errors of a
    kind."""
    try:
        yield
    except kind as error:
        bad_input(f"{what}{error}")


@contextlib.contextmanager
def installed(extra: str) -> Iterator[None]:
    """While packages of an extra are imported. Raises BadInput where one is missing."""
    try:
        yield
    except ImportError as error:
        bad_input(f"{error.name} is not installed; get it with {pip_install(extra)}")


def one_line(message: str) -> str:
    """A message that may quote a file: no terminal takes what is in it for an order."""
    words = " ".join(message.split())
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in words)


# Arguments and options, as the help tells them, with what is wrong with their values.


def option(metavar: str, told: str, *names: str, **given: Any) -> Any:
    """An option with a value, as its help tells it; names: where they are not its parameter's. given: see typer."""
    return typer.Option(*names, metavar=metavar, help=told, **given)


def flag(name: str, told: str, **given: Any) -> Any:
    """An option that is given or not, likewise."""
    return typer.Option(name, help=told, **given)


def argument(metavar: str | None, told: str, **given: Any) -> Any:
    """An argument, likewise; metavar: None for its parameter's name."""
    return typer.Argument(metavar=metavar, help=told, **given)


def check_positive(option: str, value: float, unit: str) -> None:
    """Raises BadInput unless the value of an option is greater than 0."""
    if not (math.isfinite(value) and value > 0.0):
        bad_input(f"{option} {value:g}: must be greater than 0 {unit}")


def positive(metavar: str, told: str, unit: str = "") -> Any:
    """An option whose value, of a unit, must be greater than 0."""

    def checked(parameter: typer.CallbackParam, value: float | None) -> float | None:
        if value is not None:
            check_positive(parameter.opts[0], value, unit)
        return value

    return option(metavar, told, callback=checked)


def checked_rate(rate: float) -> float:
    """The number of --realtime-rate. Raises BadInput."""
    if not (math.isfinite(rate) and rate >= 0.0):
        bad_input(f"--realtime-rate {rate:g}: must be 0 (no limit) or more")
    return rate


def checked_seed(seed: int | None) -> int | None:
    """The number of --seed. Raises BadInput."""
    if seed is not None and not 0 <= seed < 2**31:
        bad_input(f"--seed {seed}: must be between 0 and 2147483647")
    return seed


def _spacing(text: str) -> float:
    """Metres between tags, inf for none."""
    if text == "none":
        return math.inf
    try:
        spacing = float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is neither a distance in metres nor none") from None
    check_positive("--tag-spacing", spacing, "m")
    if spacing < LEAST_SPACING:
        bad_input(f"--tag-spacing {spacing:g}: must be {LEAST_SPACING:g} m at least; tags are no smaller")
    return spacing


def parse_place(option: str, text: str, form: str = "X,Y,YAW") -> list[float]:
    """The numbers of an option, m and rad. Raises BadInput."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != len(form.split(",")):
        units, example = ("metres and radians", "1.5,2,0") if "YAW" in form else ("metres", "1.5,2")
        bad_input(f"{option} {text}: must be {form} in {units}, such as {example}{',0' * form.count('PITCH')}")
    if not all(map(math.isfinite, numbers)):
        bad_input(f"{option} {text}: must be finite")
    if told := next(filter(None, map(not_radians, numbers[2:])), ""):
        bad_input(f"{option} {text}: {told}")
    return numbers


def parse_start(text: str | None) -> list[float] | None:
    """The place that --start says, x, y (m) and yaw (rad)."""
    return None if text is None else parse_place("--start", text)


World = Annotated[Path | None, option("FILE", "Other walls: a scenario, a map_server .yaml or a *.vectormap.txt.")]
TagSpacing = Annotated[
    float | None,
    option("M|none", "Place tags along every reachable surface, this far apart, or none at all.", parser=_spacing),
]
Start = Annotated[str | None, option("X,Y,YAW", "Where to start in W, m and rad.")]
MaxTime = Annotated[float, positive("S", "Give up after S simulated seconds.", "s")]
Settings = Annotated[list[str] | None, option("KEY=VALUE", "Change a key of the scenario; repeatable.", "--set")]
AsJson = Annotated[bool, flag("--json", "Print the summary as the last line, on one line.")]
RunArgument = Annotated[Path, argument("RUN", "The folder of a run.")]
Host = Annotated[str, option("ADDRESS", "Where the page is served; 0.0.0.0 for other computers, too.")]
PagePort = Annotated[int | None, option("N", "The page's port [default: 7000 or the next that is free].")]


def group(name: str, told: str) -> typer.Typer:
    """Commands under a name; told: what their help says of them."""
    return typer.Typer(name=name, help=told, add_completion=False, rich_markup_mode=None)


def grouped_help(groups: dict[str, tuple[str, ...]]) -> type[typer.core.TyperCommand]:
    """A command whose help tells its options in groups, by their names; a group of none has those of no other."""

    class Grouped(typer.core.TyperCommand):
        def format_options(self, ctx: Any, formatter: Any) -> None:
            told = {one.name or "": one.get_help_record(ctx) or ("", "") for one in self.get_params(ctx)}
            rest = [name for name in told if name not in itertools.chain(*groups.values())]
            for group, names in groups.items():
                with formatter.section(group):
                    formatter.write_dl([told[name] for name in names or rest])

    return Grouped


# The folder of a command, and its end.


def make_ready(out: Path | None, replayed: Path | None = None, read: Sequence[Path] = ()) -> None:
    """Makes the folder of a run, if one is named; what is read may lie in it. Raises BadInput as `check_kept` does, and
    where it cannot be written."""
    if out is not None:
        run_folder.check_kept(out, replayed, [file for file in read if file.is_file()])
        make_writable(out)


def make_writable(folder: Path) -> None:
    """Makes the folder that --out names. Raises BadInput where it cannot be written, or somebody writes in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        bad_input(f"--out {folder}: is a file; name a folder")
    except OSError as error:
        bad_input(f"--out {folder}: {(error.strerror or str(error)).lower()}; name a folder that can be written")
    if not os.access(folder, os.W_OK | os.X_OK):
        bad_input(f"--out {folder}: permission denied; name a folder that can be written")
    try:
        with run_folder.claimed(folder):
            pass  # Better now than when the robot is connected.
    except BlockingIOError as error:
        bad_input(f"--out {folder}: {error.strerror}")


@contextlib.contextmanager
def writing(named: object) -> Iterator[None]:
    """While a file is written, which the command line names like this. Raises BadInput where it cannot be."""
    try:
        yield
    except OSError as error:
        bad_input(f"{named}: cannot be written: {(error.strerror or str(error)).lower()}")


def print_rows(rows: Sequence[tuple[str, str]], width: int = 12) -> None:
    """A table of names and values."""
    for name, value in rows:
        print(f"{name:<{width}}{value}", flush=True)


def end(summary: dict[str, Any], code: int, as_json: bool) -> NoReturn:
    """Ends a command whose run has a summary."""
    if as_json:
        print(json.dumps(summary), flush=True)
    raise typer.Exit(code)


def end_unless_interrupted(code: int = 0) -> NoReturn:
    """Ends a command that keeps what it has when it is interrupted."""
    raise typer.Exit(EXIT_CODES["interrupted"] if interruption.is_set() else code)


def wait_for_enter() -> None:
    """Until the user presses Enter or Ctrl-C; without a keyboard, until Ctrl-C. Not where a signal has told to end."""
    if interruption.is_set() and interruption.number != signal.SIGINT:
        return
    interruption.first = interruption.again = signal.default_int_handler
    try:
        if sys.stdin.isatty():
            input("The scene stays open; press Enter to close it. ")
        else:
            print("The scene stays open until Ctrl-C.", flush=True)
            while True:
                time.sleep(0.1)
    except (EOFError, KeyboardInterrupt):
        print()
