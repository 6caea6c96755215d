"""Shared by the commands: how bad input ends one, and how one waits for the user."""

from __future__ import annotations

import contextlib
import itertools
import math
import signal
import sys
import time
from collections.abc import Iterator
from typing import Any, NoReturn

import typer
import typer.core

from tfg_drake.bad_input import BadInput, not_radians
from tfg_drake.mission.interruption import Interruption

# The signals that end a command.
interruption = Interruption()


def bad_input(message: str) -> NoReturn:
    """Ends a command: the message goes to standard error, the exit code is 2."""
    raise BadInput(message)


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


def check_positive(option: str, value: float | None, unit: str) -> None:
    """Raises BadInput unless an option is greater than 0, or is not given."""
    if value is not None and not (math.isfinite(value) and value > 0.0):
        bad_input(f"{option} {value:g}: must be greater than 0 {unit}")


def command_group(told: str) -> typer.Typer:
    """Commands under a name of their own; told: what their help says of them."""
    return typer.Typer(help=told, add_completion=False, rich_markup_mode=None)


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


@contextlib.contextmanager
def writing(named: object) -> Iterator[None]:
    """While a file is written, which the command line names like this. Raises BadInput where it cannot be."""
    try:
        yield
    except OSError as error:
        bad_input(f"{named}: cannot be written: {(error.strerror or str(error)).lower()}")


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
