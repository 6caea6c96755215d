"""Compiles the kernels that a mission calls before one needs them, once per installation.

    python -m tfg_drake.diagrams.compile_kernels

The package has a list of them with the types that missions call each with, `mission_kernels.txt`, made by
`benchmarks/mission_kernels.py`. Some processes take the next row of it from one pipe, and tell of each that is done by
another. What a mission calls besides, numba compiles when it is called.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import inspect
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from tfg_drake import kernels
from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams.screen import Screen, say
from tfg_drake.percent import percent

MODULE = "tfg_drake.diagrams.compile_kernels"
# Greatest number of processes; each compiles much of numba's own code again and takes 0.3 GB.
MOST_PROCESSES = 4


class Listed(NamedTuple):
    """A kernel that missions call: its module in the package and name, and the numba types of its arguments as Python
    spells them."""

    module: str
    name: str
    types: str


@functools.cache
def listed() -> list[Listed]:
    """Return the kernels that missions call, each after those that it calls."""
    text = (kernels.PACKAGE / "mission_kernels.txt").read_text(encoding="utf-8")
    return [Listed(*line.split(maxsplit=2)) for line in text.splitlines()]


def resolved(one: Listed) -> tuple[Any, tuple[Any, ...]]:
    """Its numba dispatcher and the types of its arguments. Raises AttributeError, NameError where it is of another
    version."""
    module = importlib.import_module(f"tfg_drake.{one.module}")
    kernel = inspect.unwrap(getattr(module, one.name), stop=lambda function: hasattr(function, "compile"))
    return kernel, eval(one.types, {**vars(module), **vars(importlib.import_module("numba.types"))})


class WarmUp:
    """Processes that compile the list, as far as it is not; to be closed."""

    def __init__(self) -> None:
        """Start the processes. Raises ChildProcessError if one cannot be started, OSError without a writable folder."""
        kernels.folder().mkdir(parents=True, exist_ok=True)
        self._count = 0
        (rows, all_rows), (self._done, done) = os.pipe(), os.pipe()
        os.set_blocking(self._done, False)
        os.write(all_rows, b"".join(row.to_bytes(2) for row in range(len(listed()))))
        os.close(all_rows)
        try:
            count = min(max(len(os.sched_getaffinity(0)), 2), MOST_PROCESSES)
            self._processes = [_start(rows, done) for _ in range(count)]
        finally:
            os.close(rows)
            os.close(done)

    @property
    def word(self) -> str:
        """The progress in words, "" once nothing is being compiled."""
        with contextlib.suppress(BlockingIOError):
            self._count += len(os.read(self._done, len(listed())))
        done = percent(self._count / len(listed()), 0)
        return "" if self.ended else f"compiling kernels, once per installation, {done:.0f} % done"

    @property
    def ended(self) -> bool:
        """True if all kernels are compiled, or no process is left to compile the others."""
        return all(process.poll() is not None for process in self._processes)

    def close(self) -> None:
        """End the remaining processes, and note if all kernels are compiled."""
        if all(process.poll() == 0 for process in self._processes):
            with contextlib.suppress(OSError):
                kernels.note_compiled()
        for process in self._processes:
            process.terminate()
            process.wait()
        os.close(self._done)


def _start(rows: int, done: int) -> subprocess.Popen[bytes]:
    """A process that compiles the rows that it reads from one file, and writes a byte to another after each. Ctrl-C
    passes it by.

    It imports the package from where this program did, whatever lies in the folder where that was started: kernels are
    kept beside their sources.

    Raises ChildProcessError where it cannot be started.
    """
    command = [sys.executable, "-P", "-m", MODULE, "rows"]
    places = [str(Path(kernels.__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    # LLVM's level 3 would take a fifth longer to compile, and missions would be no faster.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(places), "NUMBA_OPT": "1"}
    try:
        return subprocess.Popen(
            command, stdin=rows, stdout=done, stderr=subprocess.DEVNULL, process_group=0, env=environment
        )
    except OSError as error:
        raise ChildProcessError(error.errno, error.strerror, command[0]) from error


def wait_for_kernels(show: Callable[[str], object], interrupted: threading.Event | None = None) -> None:
    """Until all is compiled that a mission needs. show: is told how far it is.

    Raises BadInput where it cannot be compiled or there is no folder to keep it in, KeyboardInterrupt where somebody
    interrupts it: the mission would compile by itself.
    """
    if kernels.are_compiled():
        return
    try:
        say(f"compiling kernels, once per installation, into {kernels.folder()}")
        warm_up = WarmUp()
    except ChildProcessError as error:
        told = f"cannot be started to compile kernels: {(error.strerror or str(error)).lower()}"
        raise BadInput(f"{error.filename}: {told}") from None
    except OSError as error:
        given = "NUMBA_CACHE_DIR=" if os.environ.get("NUMBA_CACHE_DIR") else ""
        mend = "cannot be written; name a folder that can be in NUMBA_CACHE_DIR"
        raise BadInput(f"{given}{error.filename}: {mend}") from None
    with contextlib.closing(warm_up):
        while not warm_up.ended:
            if interrupted is not None and interrupted.is_set():
                raise KeyboardInterrupt
            show(warm_up.word)
            time.sleep(0.1)


@functools.cache
def make_kernels_ready() -> None:
    """For a program of somebody's own, which may wait for them: compiles what is missing, and tells so on standard
    error; silent where nothing is. Raises BadInput as `wait_for_kernels` does."""
    if not kernels.are_compiled():
        with contextlib.redirect_stdout(sys.stderr), Screen() as show:
            wait_for_kernels(show)


def _compile() -> None:
    """Compile the rows of standard input, until there is none or nobody asks for them; one that is of another version
    is left out."""
    from numba.core.errors import NumbaError

    for row in iter(lambda: os.read(0, 2), b""):
        with contextlib.suppress(AttributeError, NameError, TypeError, NumbaError):
            kernel, types = resolved(listed()[int.from_bytes(row)])
            kernel.compile(types)
        os.write(1, b".")


def main() -> None:
    """Compile some rows for another process, or what is missing and say so."""
    if len(sys.argv) == 2:
        with contextlib.suppress(BrokenPipeError):
            _compile()
        return
    try:
        with Screen() as show:
            wait_for_kernels(show)
    except BadInput as error:
        sys.exit(str(error))
    except KeyboardInterrupt:
        sys.exit(130)
    if not kernels.are_compiled():
        print("not all kernels could be compiled beforehand; the others are when they are called", file=sys.stderr)


if __name__ == "__main__":
    main()
