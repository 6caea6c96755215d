"""Compiles the kernels that a mission calls before one needs them, once per installation.

    python -m tfg_drake.diagrams.warm_up

Two processes go through the same half minute of a mission in a small room. Each has numba compile the kernels of its
own folders and leaves those of the other's to the interpreter, which is quick enough in such a room: so none is
compiled twice. What another mission calls besides, numba compiles when it is called.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from tfg_drake import kernels
from tfg_drake.bad_input import BadInput

# The kernels of these folders compile about equally long; no kernel calls one of the other share's, but for a few of
# geometry/.
SHARES = (("slam", "safety", "simulation"), ("geometry", "tfg", "planning"))
MODULE = "tfg_drake.diagrams.warm_up"
# A mission needs no other kernels while it stands and turns than it has called by then, s; the rest comes until END, s.
LOOKED, END = 1.0, 30.0
ROOM = """
world:
  walls: [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0], [3, 0, 3, 2.5]]
  start: [1, 1, 0]
explorer: {first_look: 0, first_turns: 1}
"""


class WarmUp:
    """Two processes that compile what is missing while this one does something else; to be closed."""

    def __init__(self) -> None:
        """Starts them. Raises ChildProcessError where one cannot be started, OSError where nothing can be kept."""
        kernels.folder().mkdir(parents=True, exist_ok=True)
        self._folder = tempfile.TemporaryDirectory(prefix="tfg_drake-")
        self._times = [Path(self._folder.name) / f"time{share}" for share in range(len(SHARES))]
        files = [path for path in kernels.kernel_files() if path.parent.name in sum(SHARES, ())]
        self._newest = {
            (path.parent.name, path.stem): max(one.stat().st_mtime for one in kernels.sources(path)) for path in files
        }
        self._functions = sum(path.read_text(encoding="utf-8").count("\n@njit") for path in files)
        self._since, self._before = time.monotonic(), self._done()
        self._processes = [_start(share, path) for share, path in enumerate(self._times)]

    def _done(self) -> int:
        """How many kernels are kept and newer than what they are compiled of."""
        kept = 0
        for entry in kernels.folder().glob("*/*.nbi"):
            newest = self._newest.get((entry.parent.name, entry.name.split(".")[0]), math.inf)
            with contextlib.suppress(FileNotFoundError):  # It is just being replaced.
                kept += entry.stat().st_mtime > newest
        return kept

    @property
    def left(self) -> float:
        """How long it will take at the speed so far, s: by the number of kernels, of which some take ten times as long
        as others. inf before a tenth of them tells the speed."""
        done, left = self._done() - self._before, self._functions - self._before
        return (time.monotonic() - self._since) * (left - done) / done if done > left / 10 else math.inf

    @property
    def word(self) -> str:
        """What is done, in words; "" where nothing is any more."""
        if self.ended:
            return ""
        left = self.left
        about = "" if math.isinf(left) else f", about {10 * math.ceil(left / 10 + 0.1)} s left"
        return f"compiling kernels, once per installation{about}"

    @property
    def ready(self) -> bool:
        """Whether all are there that the first look of a mission needs, or nobody compiles them any more."""
        return self.ended or all(path.exists() for path in self._times)

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


def _start(share: int, looked: Path) -> subprocess.Popen[bytes]:
    """A process that compiles a share, and makes a file when it has what the first look needs. Ctrl-C passes it by.

    Raises ChildProcessError where it cannot be started.
    """
    nothing, command = subprocess.DEVNULL, [sys.executable, "-m", MODULE, str(share), str(looked)]
    try:
        return subprocess.Popen(command, stdin=nothing, stdout=nothing, stderr=nothing, process_group=0)
    except OSError as error:
        raise ChildProcessError(error.errno, error.strerror, command[0]) from error


def _import_kernels(folders: tuple[str, ...]) -> None:
    for path in kernels.kernel_files():
        if path.parent.name in folders:
            importlib.import_module(f"tfg_drake.{path.parent.name}.{path.stem}")


def _compile(share: int, looked: Path) -> None:
    """What such a process does. Raises what its mission raises."""
    numba: Any = importlib.import_module("numba")
    # First those that are compiled, with all that they call.
    _import_kernels(SHARES[share])
    numba.config.DISABLE_JIT = True
    _import_kernels(SHARES[1 - share])
    # numba compiles functions of its own only without it.
    numba.config.DISABLE_JIT = False
    from tfg_drake.diagrams.missions.run import run_mission
    from tfg_drake.diagrams.scenario import ApplyWorldFile, LoadScenario

    room = ApplyWorldFile(LoadScenario(data=ROOM), tag_spacing=1.0)
    with tempfile.TemporaryDirectory(prefix="tfg_drake-") as folder:
        result = run_mission(
            room,
            max_time=END,
            out_dir=Path(folder),
            on_progress=lambda progress: looked.touch() if progress.time >= LOOKED else None,
            interrupted=threading.Event(),
        )
    if result.mission.failure is not None:
        raise result.mission.failure


def main() -> None:
    """Compile a share, or what is missing and say so."""
    if len(sys.argv) == 3:
        _compile(int(sys.argv[1]), Path(sys.argv[2]))
        return
    from tfg_drake.diagrams.commands.command_line import wait_for_kernels
    from tfg_drake.diagrams.commands.screen import Screen

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
