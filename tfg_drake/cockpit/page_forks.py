"""The forks that a run's page asks for."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

from tfg_drake.comparison.differences import difference_rows
from tfg_drake.io.files import FileError, read_object
from tfg_drake.storage.timeline import FILE_NAME


def _begun(number: int, stage: int, folder: Path, line: str) -> dict[str, Any]:
    """A fork as the page has it; the rows of the comparison, or why there are none, come into it later."""
    return {"number": number, "stage": stage, "folder": str(folder), "line": line, "rows": [], "failure": ""}


class PageForks:
    """Other futures of a run that has ended, one at a time: each is a process of the command `tfg-drake fork`, in a
    folder beside its run's, <run>-fork-<number>."""

    def __init__(self, run: Path) -> None:
        self._run = run.resolve()
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None
        self._newest = _begun(0, 0, self._run, "")

    @property
    def timeline(self) -> Path:
        """The newest fork's, which may not be there yet."""
        return Path(self._newest["folder"], FILE_NAME)

    @property
    def is_running(self) -> bool:
        """True while the newest fork runs."""
        return self._process is not None

    def start(self, stage: int, goal: tuple[float, float]) -> bool:
        """Fork a stage to the place (x, y), m in W; whether there was no other one under way."""
        with self._lock:
            if self._process is not None:
                return False
            number = self._newest["number"] + 1
            while (folder := self._run.with_name(f"{self._run.name}-fork-{number}")).exists():
                number += 1
            x, y = goal
            command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "fork", str(self._run), "--stage", str(stage)]
            command += [f"--goal={x:.4f},{y:.4f}", "--out", str(folder)]
            self._newest = _begun(number, stage, folder, "beginning")
            try:
                self._process = process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    text=True,
                    env=os.environ | {"PYTHONUNBUFFERED": "1"},
                )
            except OSError as error:
                reason = f"the fork cannot be started: {error.strerror}; end other programs, and ask again"
                self._newest["failure"] = reason
                return True
        threading.Thread(target=self._follow, args=(process,), daemon=True).start()
        return True

    def state(self) -> dict[str, Any]:
        """The newest fork's number, stage and folder, whether it is running, what it says, and in the end the
        rows of the comparison or why there are none; number 0 before the first."""
        with self._lock:
            return {**self._newest, "running": self.is_running}

    def close(self) -> None:
        """End what is under way; what there is of it stays."""
        process = self._process
        if process is not None:
            process.kill()
            process.wait()

    def _follow(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            if self._process is process and line.strip():
                self._newest["line"] = line.strip()
        process.wait()
        with self._lock:
            try:
                before, after = (read_object(Path(one, "summary.json")) for one in (self._run, self._newest["folder"]))
                self._newest["rows"] = list(difference_rows(before, after))
            except FileError:
                self._newest["failure"] = self._newest["line"].removeprefix("tfg-drake: ")
                shutil.rmtree(self._newest["folder"], ignore_errors=True)  # Nothing of it is of use.
            self._process = None
