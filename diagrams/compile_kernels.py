"""Compiles the kernels that a mission calls before one needs them, once per installation.

    python -m tfg_drake.diagrams.compile_kernels

The package has a list of them with the types that missions call each with, `mission_kernels.txt`, made by
`benchmarks/mission_kernels.py`. Some processes go through it side by side, and each compiles what no other has begun.
What a mission calls besides, numba compiles when it is called.
"""

from __future__ import annotations

import contextlib
import functools
import importlib
import inspect
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from tfg_drake import kernels
from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams.screen import Screen, say

MODULE = "tfg_drake.diagrams.compile_kernels"
# More processes than this compile much of numba's own once more each, and take 0.3 GB each.
MOST_PROCESSES = 4


class Listed(NamedTuple):
    """A kernel that missions call: its module in the package and name, how long it alone took to compile on some
    machine, s, and the numba types of its arguments as Python spells them."""

    module: str
    name: str
    cost: float
    types: str


@functools.cache
def listed() -> list[Listed]:
    """All that missions call, each after what it calls."""
    text = (kernels.PACKAGE / "mission_kernels.txt").read_text(encoding="utf-8")
    rows = [line.split(maxsplit=3) for line in text.splitlines() if line]
    return [Listed(module, name, float(cost), types) for module, name, cost, types in rows]


def resolved(one: Listed) -> tuple[Any, tuple[Any, ...]]:
    """Its numba dispatcher and the types of its arguments. Raises AttributeError, NameError where it is of another
    version."""
    module = importlib.import_module(f"tfg_drake.{one.module}")
    kernel = inspect.unwrap(getattr(module, one.name), stop=lambda function: hasattr(function, "compile"))
    return kernel, eval(one.types, {**vars(module), **vars(importlib.import_module("numba.types"))})


class WarmUp:
    """Processes that compile what is missing; to be closed."""

    def __init__(self) -> None:
        """Starts them. Raises ChildProcessError where one cannot be started, OSError where nothing can be kept."""
        kernels.folder().mkdir(parents=True, exist_ok=True)
        self._folder = tempfile.TemporaryDirectory(prefix="tfg_drake-")
        self._since = time.monotonic()
        self._told = math.inf  # The least time left that was told, s.
        count = min(max(len(os.sched_getaffinity(0)), 2), MOST_PROCESSES)
        self._processes = [_start(Path(self._folder.name)) for _ in range(count)]

    def _done(self, how: str) -> set[int]:
        """The numbers of those in the list that are there; how: "made" or "kept" from before, "*" for both."""
        return {int(path.stem) for path in Path(self._folder.name).glob(f"*.{how}")}

    @property
    def left(self) -> float:
        """How long it will take at the speed so far, s; inf before a twentieth tells the speed."""
        cost = [one.cost for one in listed()]
        made = sum(cost[number] for number in self._done("made"))
        left = sum(cost) - sum(cost[number] for number in self._done("*"))
        return (time.monotonic() - self._since) * left / made if made > (made + left) / 20 else math.inf

    @property
    def word(self) -> str:
        """Progress in words, in minutes that never become more; "" where nothing is compiled any more. Of the last
        minute it says only that."""
        if self.ended:
            return ""
        self._told = min(self._told, self.left)
        about = "" if math.isinf(self._told) else f", about {math.ceil(self._told / 60)} min left"
        about = about if self._told > 60 else ", soon done"
        return f"compiling kernels, once per installation{about}"

    @property
    def ended(self) -> bool:
        """Whether all are there, or nobody compiles the others any more."""
        return all(process.poll() is not None for process in self._processes)

    def close(self) -> None:
        """Ends what is still at work; takes note that all kernels are there, if they are."""
        if all(process.poll() == 0 for process in self._processes):
            with contextlib.suppress(OSError):
                kernels.note_compiled()
        for process in self._processes:
            process.terminate()
            process.wait()
        self._folder.cleanup()


def _start(folder: Path) -> subprocess.Popen[bytes]:
    """A process that compiles what no other does, and leaves a file in a folder for each. Ctrl-C passes it by.

    It imports the package from where this program did, whatever lies in the folder where that was started: kernels are
    kept beside their sources.

    Raises ChildProcessError where it cannot be started.
    """
    nothing, command = subprocess.DEVNULL, [sys.executable, "-P", "-m", MODULE, str(folder)]
    places = [str(Path(kernels.__file__).parents[1]), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(places)}
    try:
        return subprocess.Popen(
            command, stdin=nothing, stdout=nothing, stderr=nothing, process_group=0, env=environment
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


def _compile(folder: Path) -> None:
    """Compile of the list what no other process has begun, by the files of a folder: NUMBER is one that is begun,
    NUMBER.made one that was compiled, NUMBER.kept one that there was already, or that is of another version. It ends
    with the process that has started it."""
    from numba.core.errors import NumbaError

    parent = os.getppid()
    for number, one in enumerate(listed()):
        begun = folder / str(number)
        if os.getppid() != parent:
            return
        try:
            begun.touch(exist_ok=False)
        except FileExistsError:
            continue
        kernel: Any = None
        with contextlib.suppress(AttributeError, NameError, TypeError, NumbaError):
            kernel, types = resolved(one)
            kernel.compile(types)
        begun.rename(begun.with_suffix(".made" if kernel and kernel.stats.cache_misses else ".kept"))


def main() -> None:
    """Compile by the files of a folder, or what is missing and say so."""
    if len(sys.argv) == 2:
        _compile(Path(sys.argv[1]))
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
