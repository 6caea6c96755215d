"""Code shared by the commands: options, complaints about bad input, output folders, exit codes, waiting for the
user."""

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
from tfg_drake.diagrams.interruption import Interruption
from tfg_drake.diagrams.missions import run_folder
from tfg_drake.io.extras import pip_install

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
# Least spacing of tags, m; closer tags would overlap.
LEAST_SPACING = 0.05

# The signals that end a command.
interruption = Interruption()


def bad_input(message: str) -> NoReturn:
    """End a command: the message goes to standard error, the exit code is 2."""
    raise BadInput(message)


@contextlib.contextmanager
def naming(what: str, kind: type[Exception]) -> Iterator[None]:
    """Turn errors of one kind into a BadInput whose message begins with the user's input, such as an option."""
    try:
        yield
    except kind as error:
        bad_input(f"{what}{error}")


@contextlib.contextmanager
def installed(extra: str) -> Iterator[None]:
    """Turn an ImportError into a BadInput that says how to install the extra."""
    try:
        yield
    except ImportError as error:
        bad_input(f"{error.name} is not installed; get it with {pip_install(extra)}")


def one_line(message: str) -> str:
    """Return a message on one line, with escaped control characters: it may quote a file."""
    words = " ".join(message.split())
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in words)


# Arguments and options with their help texts and checks.


def option(metavar: str, told: str, *names: str, **given: Any) -> Any:
    """Declare an option with a value and its help text; names: if they differ from the parameter's. given: see
    typer."""
    return typer.Option(*names, metavar=metavar, help=told, **given)


def flag(name: str, told: str, **given: Any) -> Any:
    """Declare an option without a value, with its help text."""
    return typer.Option(name, help=told, **given)


def argument(metavar: str | None, told: str, **given: Any) -> Any:
    """Declare an argument with its help text; metavar: None for its parameter's name."""
    return typer.Argument(metavar=metavar, help=told, **given)


def check_positive(option: str, value: float, unit: str) -> None:
    """Raise BadInput unless the value of an option is greater than 0."""
    if not (math.isfinite(value) and value > 0.0):
        bad_input(f"{option} {value:g}: must be greater than 0 {unit}")


def positive(metavar: str, told: str, unit: str = "") -> Any:
    """Declare an option whose value, in a unit, must be greater than 0."""

    def checked(parameter: typer.CallbackParam, value: float | None) -> float | None:
        if value is not None:
            check_positive(parameter.opts[0], value, unit)
        return value

    return option(metavar, told, callback=checked)


def checked_rate(rate: float) -> float:
    """Return the value of --realtime-rate. Raises BadInput if it is negative or not finite."""
    if not (math.isfinite(rate) and rate >= 0.0):
        bad_input(f"--realtime-rate {rate:g}: must be 0 (no limit) or more")
    return rate


def checked_seed(seed: int | None) -> int | None:
    """Return the value of --seed. Raises BadInput if it is out of range."""
    if seed is not None and not 0 <= seed < 2**31:
        bad_input(f"--seed {seed}: must be between 0 and 2147483647")
    return seed


def _spacing(text: str) -> float:
    """Return the distance between tags, m; inf for no tags."""
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
    """Return the numbers of an option, m and rad. Raises BadInput if they do not have the form."""
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
    """Return x, y (m) and yaw (rad) of --start."""
    return None if text is None else parse_place("--start", text)


World = Annotated[Path | None, option("FILE", "Other walls: a scenario, a map_server .yaml or a *.vectormap.txt.")]
TagSpacing = Annotated[
    float | None,
    option("M|none", "Place a tag every M metres along each reachable surface; none removes all.", parser=_spacing),
]
Start = Annotated[str | None, option("X,Y,YAW", "Start pose in the world frame, m and rad.")]
MaxTime = Annotated[float, positive("S", "End a mission after S seconds.", "s")]
Settings = Annotated[list[str] | None, option("KEY=VALUE", "Change a key of the scenario; repeatable.", "--set")]
AsJson = Annotated[bool, flag("--json", "Print the summary as the last line, on one line.")]
RunArgument = Annotated[Path, argument("RUN", "The folder of a run.")]
Host = Annotated[str, option("ADDRESS", "Address on which to serve the page; 0.0.0.0 lets other computers see it.")]
PagePort = Annotated[int | None, option("N", "Port of the page [default: 7000 or the next free one].")]


def group(name: str, told: str) -> typer.Typer:
    """Create a group of commands; told: its help text."""
    return typer.Typer(name=name, help=told, add_completion=False, rich_markup_mode=None)


def grouped_help(groups: dict[str, tuple[str, ...]]) -> type[typer.core.TyperCommand]:
    """Return a command class whose help lists parameters in groups, by name; an empty group lists all remaining
    ones."""

    class Grouped(typer.core.TyperCommand):
        def format_options(self, ctx: Any, formatter: Any) -> None:
            told = {one.name or "": one.get_help_record(ctx) or ("", "") for one in self.get_params(ctx)}
            rest = [name for name in told if name not in itertools.chain(*groups.values())]
            for group, names in groups.items():
                with formatter.section(group):
                    formatter.write_dl([told[name] for name in names or rest])

    return Grouped


# The output folder of a command, and its end.


def make_ready(out: Path | None, replayed: Path | None = None, read: Sequence[Path] = ()) -> None:
    """Create the folder of a run, if --out names one. replayed, read: input that may lie in it. Raises BadInput as
    `check_kept` does, or if the folder cannot be written."""
    if out is not None:
        run_folder.check_kept(out, replayed, [file for file in read if file.is_file()])
        make_writable(out)


def make_writable(folder: Path) -> None:
    """Create the folder that --out names. Raises BadInput if it cannot be written or another process writes in it."""
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
            pass  # Complain now, before the robot is connected.
    except BlockingIOError as error:
        bad_input(f"--out {folder}: {error.strerror}")


@contextlib.contextmanager
def writing(named: object) -> Iterator[None]:
    """Turn an OSError while writing into a BadInput; named: the file or option as given on the command line."""
    try:
        yield
    except OSError as error:
        bad_input(f"{named}: cannot be written: {(error.strerror or str(error)).lower()}")


def print_rows(rows: Sequence[tuple[str, str]], width: int = 12) -> None:
    """Print a table of names and values."""
    for name, value in rows:
        print(f"{name:<{width}}{value}", flush=True)


def end(summary: dict[str, Any], code: int, as_json: bool) -> NoReturn:
    """End a command whose run has a summary, which is printed if as_json."""
    if as_json:
        print(json.dumps(summary), flush=True)
    raise typer.Exit(code)


def end_unless_interrupted(code: int = 0) -> NoReturn:
    """End a command that keeps its partial results when interrupted."""
    raise typer.Exit(EXIT_CODES["interrupted"] if interruption.is_set() else code)


def wait_for_enter() -> None:
    """Wait for Enter or Ctrl-C; without a keyboard, for Ctrl-C. Return at once after SIGTERM or SIGHUP."""
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
