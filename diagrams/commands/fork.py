"""`tfg-drake fork`: a run's other future, and how it differs from the one that was.

The forks that a run's page asks for are processes of this command, one at a time.
"""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams.missions.fork import forkable
from tfg_drake.io.files import FileError, read_object
from tfg_drake.percent import percent
from tfg_drake.storage.timeline import FILE_NAME

if TYPE_CHECKING:
    from tfg_drake.diagrams.missions.fork import Candidate

# So many candidates of the stage are shown.
SHOWN = 5

# What is compared: name, how to read it of a summary, its format.
_ROWS: tuple[tuple[str, Callable[[dict[str, Any]], Any], str], ...] = (
    ("time", lambda s: s["sim_time_s"], "{:.1f} s"),
    ("driven", lambda s: s["distance_m"], "{:.1f} m"),
    ("stages", lambda s: s["stages"], "{:.0f}"),
    ("position error", lambda s: s.get("position_error_moving_m", {}).get("mean"), "{:.4f} m"),
    ("heading error", lambda s: s["heading_error_rad"]["mean"], "{:.5f} rad"),
    ("map error", lambda s: s["landmark_rmse_m"], "{:.4f} m RMSE"),
    ("tags mapped", lambda s: s["landmarks_mapped"] if s.get("landmarks_reachable") else None, "{:.0f}"),
    ("walls mapped", lambda s: s.get("walls_mapped") or None, "{:.0f}"),
    ("surface within 5 cm", lambda s: _percent(s.get("surface_coverage_5cm")), "{:.2f} %"),
    ("area seen", lambda s: _percent(s["area_coverage"]), "{:.2f} %"),
    ("entropy", lambda s: s["landmark_entropy_nats"], "{:.1f} nats"),
)


def _percent(share: float | None) -> float | None:
    return None if share is None else percent(share, 2)


def difference_rows(before: dict[str, Any], after: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    """Name, the run's value, the fork's and their difference, of all that both summaries have."""
    rows = [("", "run", "fork", "difference"), ("outcome", before["outcome"], after["outcome"], "")]
    for name, read, form in _ROWS:
        one, other = read(before), read(after)
        if one is not None and other is not None:
            unit = form.partition("}")
            difference = f"{unit[0].replace(':', ':+')}}}{unit[2]}".format(other - one) if other != one else "="
            rows.append((name, form.format(one), form.format(other), difference))
    return rows


def candidate_rows(candidates: Sequence[Candidate]) -> list[tuple[str, ...]]:
    """The stage's best candidates and the one that was chosen: number, place, gain and what it is made of (of known
    landmarks, of new ones, the price of the pose), nats, time to get there."""
    rows: list[tuple[str, ...]] = [("candidate", "x m", "y m", "gain", "known", "new", "price", "time s", "")]
    for number, one in enumerate(candidates, start=1):
        if number > SHOWN and not one.chosen:
            continue
        x, y = one.p_WG
        numbers = (one.gain, one.exploitation, one.exploration, one.pose_price, one.time)
        cells = [f"{value:.1f}" if math.isfinite(value) else "-" for value in numbers]
        rows.append((str(number), f"{x:.2f}", f"{y:.2f}", *cells, "chosen" if one.chosen else ""))
    return rows


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table: the first column to the left, numbers to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip() for row in rows]


def can_fork(run: Path) -> bool:
    """True if a folder holds a run that can be forked at its first stage; see `forkable`."""
    try:
        forkable(run, 1)
        return True
    except BadInput:
        return False


def _begun(number: int, stage: int, folder: Path, line: str) -> dict[str, Any]:
    """A fork as the page has it; the rows of the comparison, or why there are none, come into it later."""
    return {"number": number, "stage": stage, "folder": str(folder), "line": line, "rows": [], "failure": ""}


class PageForks:
    """See `tfg_drake.cockpit.server.Forks`. Each fork is in a folder beside its run's, <run>-fork-<number>."""

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
