"""`tfg-drake compare`: a sweep run, or resumed, with its progress."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

from tfg_drake.comparison.measures import MOVING, TIME
from tfg_drake.comparison.runs import Run, sample
from tfg_drake.comparison.statistics import spread
from tfg_drake.diagrams.missions.sweep import Task, open_sweep, run_local
from tfg_drake.diagrams.screen import say


def run_sweep(
    tasks: Sequence[Task],
    out: Path,
    jobs: int,
    address: str | None,
    interrupted: threading.Event,
    show: Callable[[str], object],
) -> list[Run]:
    """Run what is missing of a sweep, on this machine or on the Ray cluster at `address`; `show` says how far it is.

    Returns all runs there are, in the order of the tasks.

    Raises:
        SweepError: the folder holds another sweep, or there is no such cluster.
        OSError: a file cannot be written.
    """
    runs = {(run.method, run.seed): run for run in open_sweep(tasks, out)}
    missing = [task for task in tasks if (task.method, task.seed) not in runs]
    there, since = len(runs), time.monotonic()

    def progress() -> str:
        """How many runs are done, and how long the rest will take at the speed so far."""
        done, left = len(runs) - there, len(tasks) - len(runs)
        if not done or not left:
            return f"{len(runs)} of {len(tasks)} runs"
        seconds = left * (time.monotonic() - since) / done
        remaining = f"{seconds:.0f} s" if seconds < 90.0 else f"{seconds / 60.0:.0f} min"
        return f"{len(runs)} of {len(tasks)} runs, about {remaining} left"

    if there:
        say(f"{there} of {len(tasks)} runs are there already")
    show(progress())
    if address is None or not missing:
        ended = run_local(missing, out, jobs, interrupted)
    else:
        from tfg_drake.diagrams.missions.ray_sweep import run_on_ray

        ended = run_on_ray(missing, out, address, interrupted)
    for run in ended:
        runs[run.method, run.seed] = run
        show(progress())
        if not sys.stdout.isatty():
            say(f"{run.method}, seed {run.seed}: {run.outcome}; {progress()}")
    keys = [(task.method, task.seed) for task in tasks]
    return [runs[key] for key in keys if key in runs]


def closing_lines(runs: Sequence[Run], methods: Sequence[str]) -> list[str]:
    """A line a method: outcomes, and the means of time and position error."""
    lines = []
    for method in methods:
        outcomes = Counter(run.outcome for run in runs if run.method == method)
        counts = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()) or "no run"
        time, position = (spread(sample(runs, method, measure.read)).mean.value for measure in (TIME, MOVING))
        error = f", position error {position:.3f} m from the first drive on" if math.isfinite(position) else ""
        means = f"; time {time:.0f} s{error}" if math.isfinite(time) else ""
        lines.append(f"{method:<13} {counts}{means}")
    return lines
