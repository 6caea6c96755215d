"""The processes that compile what a mission calls, beside a program that does something else meanwhile."""

from __future__ import annotations

import contextlib
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tfg_drake import kernels

# The kernels of these folders compile about equally long; no kernel calls one of the other share's, but for a few of
# geometry/.
SHARES = (("slam", "safety", "simulation"), ("geometry", "tfg", "planning"))
MODULE = "tfg_drake.diagrams.compile_kernels"


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
        self._told = math.inf  # The least time left that was told, s.
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
        return (time.monotonic() - self._since) * max(left - done, 0) / done if done > max(left / 10, 0) else math.inf

    @property
    def word(self) -> str:
        """Progress in words, in minutes that never become more; "" where nothing is compiled any more. Of the last
        minute it says only that: what comes after the last kernel is not counted."""
        if self.ended:
            return ""
        self._told = min(self._told, self.left)
        about = "" if math.isinf(self._told) else f", about {math.ceil(self._told / 60)} min left"
        about = about if self._told > 60 else ", soon done"
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
