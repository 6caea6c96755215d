"""Shared by the commands: how bad input ends one, how one waits for the user, and for the kernels."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NoReturn

import typer
import typer.core

from tfg_drake import kernels
from tfg_drake.bad_input import BadInput, not_radians
from tfg_drake.diagrams.commands.screen import Screen, say
from tfg_drake.diagrams.warm_up import WarmUp
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
    """A command whose help tells its options in groups, by their names here."""

    class Grouped(typer.core.TyperCommand):
        def format_options(self, ctx: Any, formatter: Any) -> None:
            told = {one.name or "": one.get_help_record(ctx) or ("", "") for one in self.get_params(ctx)}
            for group, names in groups.items():
                with formatter.section(group):
                    formatter.write_dl([told[name] for name in names])

    return Grouped


@contextlib.contextmanager
def complaining(out: Path | None) -> Iterator[None]:
    """While a run is made whose files go to a folder, None for one in `runs`. Raises BadInput where a file cannot be
    written."""
    try:
        yield
    except OSError as error:
        bad_input(f"{error.filename or out or 'runs'}: cannot be written: {error.strerror or error}")


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


@contextlib.contextmanager
def compiling_beside() -> Iterator[WarmUp | None]:
    """The processes that compile the missing kernels while the command goes on, None where none is missing.

    Raises BadInput where there is no folder to keep them in.
    """
    warm_up: Any = contextlib.nullcontext()
    try:
        if not kernels.are_compiled():
            say(f"compiling kernels, once per installation, into {kernels.folder()}")
            warm_up = contextlib.closing(WarmUp())
    except ChildProcessError as error:
        bad_input(f"{error.filename}: cannot be started to compile kernels: {(error.strerror or str(error)).lower()}")
    except OSError as error:
        given = "NUMBA_CACHE_DIR=" if os.environ.get("NUMBA_CACHE_DIR") else ""
        bad_input(f"{given}{error.filename}: cannot be written; name a folder that can be in NUMBA_CACHE_DIR")
    with warm_up as beside:
        yield beside


def wait_for_kernels(show: Callable[[str], object], warm_up: WarmUp | None = None, *, all_of_them: bool = True) -> None:
    """Until all is compiled that a mission needs, or what it begins with. warm_up: who compiles already; by default it
    is begun here. Raises KeyboardInterrupt where somebody interrupts it: the mission would compile by itself."""
    with compiling_beside() if warm_up is None else contextlib.nullcontext(warm_up) as at_work:
        while at_work is not None and not (at_work.ended if all_of_them else at_work.ready):
            if interruption.is_set():
                raise KeyboardInterrupt
            show(at_work.word)
            time.sleep(0.1)


@functools.cache
def make_kernels_ready() -> None:
    """For a program of somebody's own, which may wait for them: compiles what is missing, and tells so on standard
    error; silent where nothing is. Raises BadInput as `compiling_beside` does."""
    if not kernels.are_compiled():
        with contextlib.redirect_stdout(sys.stderr), Screen() as show:
            wait_for_kernels(show)
