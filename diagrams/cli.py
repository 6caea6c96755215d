"""The command line `tfg-drake`. Heavy modules are imported only when a command needs them."""

from __future__ import annotations

import contextlib
import gc
import io
import locale
import os
import resource
import signal
import sys
import traceback
from pathlib import Path
from typing import Annotated, Any

import typer

from tfg_drake import __version__
from tfg_drake.bad_input import BadInput, EstimateLost
from tfg_drake.diagrams.commands import command, explore
from tfg_drake.diagrams.commands.camera import camera_app
from tfg_drake.diagrams.commands.command import bad_input, flag
from tfg_drake.diagrams.commands.compare import compare
from tfg_drake.diagrams.commands.figures import figures
from tfg_drake.diagrams.commands.fork import fork
from tfg_drake.diagrams.commands.kobuki import kobuki_app
from tfg_drake.diagrams.commands.map import map_app
from tfg_drake.diagrams.commands.ros import ros2_app
from tfg_drake.diagrams.commands.slam import slam
from tfg_drake.diagrams.commands.tags import tags_app
from tfg_drake.diagrams.commands.view import export, view
from tfg_drake.diagrams.interruption import NAMES

# Commands that write all their files when a signal interrupts them; a signal ends the others at once.
WRITING = ("explore", "compare", "fork", "slam", "figures")
# Least address space for a command, bytes; the libraries take two thirds of it.
LEAST_MEMORY = 2**30

# The parser's exception for an invalid command line; typer does not export it.
_UsageError: Any = typer.BadParameter.__base__

app = typer.Typer(
    context_settings={"help_option_names": ["-h", "--help"]}, rich_markup_mode=None, pretty_exceptions_enable=False
)
app.command(cls=command.grouped_help(explore.GROUPS), epilog=explore.ENDS)(explore.explore)
for one in (view, export, compare, fork, slam, figures):
    app.command()(one)
for group in (map_app, kobuki_app, ros2_app, camera_app, tags_app):
    app.add_typer(group)


def _print_version(asked: bool) -> None:
    if asked:
        print(f"tfg-drake {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _commands(
    context: typer.Context,
    _version: Annotated[bool, flag("--version", "Print the version.", callback=_print_version, is_eager=True)] = False,
) -> None:
    """Active SLAM on topological feature graphs: a robot explores and maps an unknown building by itself."""
    if context.invoked_subcommand is None:
        print(context.get_help(), file=sys.stderr)
        raise typer.Exit(2)
    if context.invoked_subcommand in WRITING:
        command.interruption.first, command.interruption.again = _tell_interruption, _leave


def main(arguments: list[str] | None = None) -> None:
    """Run a command. Bad input gives one line on standard error and exit code 2, never a traceback."""
    # Collect garbage less often: importing libraries creates none, and the default threshold costs a quarter of a
    # second.
    gc.set_threshold(50_000)
    command.interruption.clear()
    command.interruption.first = command.interruption.again = signal.default_int_handler
    try:
        with command.interruption.heard():
            _check_environment()
            code = app(arguments, prog_name="tfg-drake", standalone_mode=False)
    except BadInput as error:
        code = _complain(str(error))
    except EstimateLost as error:
        _complain(str(error))
        code = command.EXIT_CODES["stuck"]
    except _UsageError as error:
        complaint = command.one_line(error.format_message()).rstrip(".")
        path = error.ctx.command_path if error.ctx is not None else "tfg-drake"
        code = _complain(f"{complaint[:1].lower()}{complaint[1:]}; see {path} --help")
    except (KeyboardInterrupt, typer.Abort):
        code = command.EXIT_CODES["interrupted"]
    except BrokenPipeError:
        code = 141  # The reader of the output has gone.
    except OSError as error:
        # Refused by the operating system: a deleted folder, too many processes or open files.
        where = "" if error.filename is None else f"{error.filename}: "
        code = _complain(f"{where}{(error.strerror or str(error)).lower()}")
    except Exception as error:
        if isinstance(error, MemoryError) or "start new thread" in str(error):
            sys.exit(_complain("no memory or thread is left; end other programs, or raise the limits (ulimit -v, -u)"))
        # A bug outside the simulation; one inside it ends the mission with outcome "fault".
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(last.filename).name}, line {last.lineno}"
        _complain(f"internal error: {type(error).__name__}: {error} ({place})")
        code = 3
    if code == command.EXIT_CODES["interrupted"] and command.interruption.is_set():
        code = 128 + command.interruption.number
    try:
        sys.stdout.flush()
    except OSError:
        # The remaining output cannot be written; discard it, or Python's own flush at exit changes the exit code.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code if isinstance(code, int) else 0)


def _check_environment() -> None:
    """Supply missing standard streams and a UTF-8 locale. Raises BadInput for what cannot be supplied."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass  # A file opened later must not get the descriptor of a standard stream.
    os.close(descriptor)
    sys.stdin = sys.stdin or os.fdopen(0, encoding="utf-8")
    sys.stdout = sys.stdout or os.fdopen(1, "w", encoding="utf-8")
    sys.stderr = sys.stderr or os.fdopen(2, "w", encoding="utf-8")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    # Drake reads its UTF-8 files in the locale's encoding; child processes take theirs from PYTHONUTF8.
    if "utf" not in locale.getencoding().lower():
        os.environ["PYTHONUTF8"] = "1"
        with contextlib.suppress(locale.Error):
            locale.setlocale(locale.LC_CTYPE, "C.UTF-8")
    try:
        os.getcwd()
    except OSError as error:
        bad_input(f"the working directory: {(error.strerror or str(error)).lower()}; change to another")
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < LEAST_MEMORY:
        bad_input(f"ulimit -v: {limit / 1e6:.0f} MB of address space; raise it to {LEAST_MEMORY / 1e6:.0f} or more")


def _complain(line: str) -> int:
    """Print a complaint; returns the exit code of bad input."""
    print(f"tfg-drake: {command.one_line(line)}", file=sys.stderr)
    return 2


def _tell_interruption(number: int, _frame: Any) -> None:
    """Announce the stop. The signal is only noted, so it may arrive at any time, even during imports; the mission ends
    when it checks."""
    _tell_at_once(f"stopping; {NAMES[signal.Signals(number)]} again leaves at once")


def _leave(number: int, _frame: Any) -> None:
    """Exit at once on the second signal: an exception might be lost in a callback or print a traceback."""
    if keyboard := sys.modules.get("tfg_drake.hardware.keyboard"):
        keyboard.restore_terminals()
    _tell_at_once("interrupted; nothing more is written")
    os._exit(128 + number)


def _tell_at_once(line: str) -> None:
    with contextlib.suppress(OSError):  # The terminal may be gone.
        os.write(2, f"\ntfg-drake: {line}\n".encode())


if __name__ == "__main__":
    main()
