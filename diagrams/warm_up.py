"""The processes that compile what a mission calls, beside a program that does something else meanwhile."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

from tfg_drake import kernels

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
def listed() -> tuple[list[Listed], int]:
    """All that missions call, each after what it calls, and how many of them, the first, their first look does."""
    first, rest = (
        [
            Listed(module, name, float(cost), types)
            for line in part.splitlines()
            for module, name, cost, types in [line.split(maxsplit=3)]
        ]
        for part in (kernels.PACKAGE / "mission_kernels.txt").read_text(encoding="utf-8").split("\n\n")
    )
    return first + rest, len(first)


class WarmUp:
    """Processes that compile what is missing while this one does something else; to be closed."""

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
        cost = [one.cost for one in listed()[0]]
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
    def ready(self) -> bool:
        """Whether all are there that the first look of a mission needs, or nobody compiles them any more."""
        return self.ended or self._done("*").issuperset(range(listed()[1]))

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
