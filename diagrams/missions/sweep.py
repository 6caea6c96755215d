"""Many missions, each in a process of its own: several methods on the same seeds, into one folder that can be resumed.

    DIR/runs/<method>/seed-<n>/          a run's folder as `tfg-drake explore` leaves it, but for ports.mcap
    DIR/runs/<method>/seed-<n>/task.json its receipt, written last: without one the run is done again, and a folder
                                         with one of another sweep is refused

A mission is a process because Drake never frees a diagram of Python systems, and so that one that dies takes no other
with it. It depends on its task alone: how many run beside it, or where, changes no bit of it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from tfg_drake import __version__
from tfg_drake.bad_input import BadInput
from tfg_drake.comparison.runs import Run
from tfg_drake.diagrams.interruption import NAMES
from tfg_drake.diagrams.methods import Method, NamedMethod
from tfg_drake.diagrams.missions.mission import MissionRequest
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import DumpScenario, Scenario, WorldConfig
from tfg_drake.diagrams.screen import say
from tfg_drake.io.commit import commit
from tfg_drake.io.files import FileError, read_object, write_atomic

# Period of the checks for an interrupt, s.
POLL = 0.2


class SweepError(BadInput):
    """The sweep cannot be run; the message is one line that names the culprit and the mend."""


def folder_of(task: MissionRequest, out: Path) -> Path:
    """The folder of a run in its sweep's."""
    return out / "runs" / task.method.name / f"seed-{task.scenario.seed}"


def run_of(task: MissionRequest, out: Path, summary: dict[str, Any] | None, failure: str = "") -> Run:
    """A run of a sweep that has ended, in the folder `out`."""
    return Run(task.method.name, task.scenario.seed, folder_of(task, out), summary, failure)


def _receipt(task: MissionRequest) -> dict[str, Any]:
    """Return the fields that identify a run of a sweep."""
    method, digest = task.method, _digest(task.scenario)
    # The seeds may differ in world and start.
    settings = _digest(dataclasses.replace(task.scenario, seed=0, world=WorldConfig()))
    code = hashlib.sha256(Path(method.source).read_bytes()).hexdigest() if method.source else None
    named = {"version": __version__, "scenario": task.name, "world": task.world_name, "settings_sha256": settings}
    run = {"max_time_s": task.max_time, "method": method.name, "method_sha256": code, "seed": task.scenario.seed}
    return {**named, **run, "scenario_sha256": digest}


def _digest(scenario: Scenario) -> str:
    return hashlib.sha256(DumpScenario(scenario).encode()).hexdigest()


def parse_methods(text: str, scenario: Scenario, settings: Sequence[str] = ()) -> list[Method]:
    """The methods that a list such as "tfg,mine.py" names. settings: the user's, which are in the scenario.

    Raises BadInput for one that there is not, or that the scenario lacks something for, and for a setting that all of
    them fix to another value.
    """
    methods: list[Method] = []
    for word in (word.strip() for word in text.split(",")):
        method = NamedMethod("--methods", word, scenario)
        if method.needs_keys:
            mend = "name the keys.csv of a run that was driven by hand"
            raise SweepError(f"--methods {word}: nobody is at the keys; {mend}")
        if method.name in [one.name for one in methods]:
            raise SweepError(f"--methods {text}: names {method.name} twice; name each once")
        methods.append(method)
    for setting in settings:
        refused = [method.Refused(scenario, [setting]) for method in methods]
        if all(refused):
            raise SweepError(f"--methods {refused[0]}")
    return methods


def run_one(task: MissionRequest, folder: Path) -> dict[str, Any]:
    """Run a mission in this process, leave its folder and its receipt, and return its summary."""
    (folder / "task.json").unlink(missing_ok=True)
    # The parent process handles signals. A recording takes 1.5 MB a minute and can be made again from the seed.
    result = run_mission(task, out_dir=folder, interrupted=threading.Event(), record=False)
    write_atomic(folder / "task.json", json.dumps(_receipt(task), indent=2) + "\n")
    return result.summary


def open_sweep(tasks: Sequence[MissionRequest], out: Path) -> list[Run]:
    """The runs of a sweep that its folder has already.

    The seeds and methods may be others than before; what all runs share must be the same. Raises SweepError.
    """
    receipts = [_receipt(task) for task in tasks]
    named = ("version", "scenario", "world", "max_time_s")
    for path in sorted(out.glob("runs/*/seed-*/task.json")):
        if not (there := _read(path)):
            continue
        different = [key for key in named if there.get(key) != receipts[0][key]]
        # Runs of a method whose file was edited since do not count: it is run again.
        ours = [one for one in receipts if all(one[key] == there.get(key) for key in ("method", "method_sha256"))]
        same = [one for one in ours if one["seed"] == there.get("seed")]
        values = [(one, "settings_sha256") for one in ours[:1]] + [(one, "scenario_sha256") for one in same]
        if any(one[key] != there.get(key) for one, key in values):
            different.append("scenario's values")
        if different:
            what = ", ".join(different)
            raise SweepError(f"{out}: holds another comparison ({what} differ); name another folder with --out")
    finished = [(task, _finished(task, out)) for task in tasks]
    return [run_of(task, out, summary) for task, summary in finished if summary]


def run_sweep(
    tasks: Sequence[MissionRequest],
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
    keys = [(task.method.name, task.scenario.seed) for task in tasks]
    missing = [task for task, key in zip(tasks, keys, strict=True) if key not in runs]
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
        others = sum(run.summary is not None and run.summary.get("commit") != commit() for run in runs.values())
        say(f"{there} of {len(tasks)} runs are there already" + (f", {others} of another commit" if others else ""))
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
    return [runs[key] for key in keys if key in runs]


def run_local(tasks: Sequence[MissionRequest], out: Path, jobs: int, interrupted: threading.Event) -> Iterator[Run]:
    """Run the tasks, at most `jobs` at a time, and yield each as it ends; when interrupted, end them all at once.

    A task whose process raises or is killed is a run without a summary; its folder keeps what there was.
    """
    waiting, running = list(reversed(tasks)), dict[Any, tuple[MissionRequest, Any]]()  # by connection: task and process
    try:
        while (waiting or running) and not interrupted.is_set():
            while waiting and len(running) < jobs:
                task = waiting.pop()
                connection, process = _start(task, folder_of(task, out))
                running[connection] = (task, process)
            for ready in wait(list(running), timeout=POLL):
                task, process = running.pop(ready)
                summary, failure = _result(ready, process)
                yield run_of(task, out, summary, failure)
    finally:
        for _, process in running.values():
            process.kill()
        for _, process in running.values():
            process.join()


def _start(task: MissionRequest, folder: Path) -> tuple[Connection, Any]:
    """Start a process for a task; returns it and the connection for its result."""
    context = multiprocessing.get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(task, folder, sending), daemon=True)
    # A terminal sends Ctrl-C to all of its processes, `timeout` or a cluster SIGTERM; a mask is inherited, and the
    # parent alone answers. Whoever starts the resource tracker lifts the mask: it is to run before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, NAMES)
    try:
        process.start()
    except OSError as error:
        raise SweepError(f"{sys.executable}: cannot be started: {error.strerror}; try fewer --jobs") from None
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    sending.close()
    return receiving, process


def _work(task: MissionRequest, folder: Path, sending: Connection) -> None:
    """Run one task in a process that ends with its parent."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    sending.send(attempt(task, folder))


def attempt(task: MissionRequest, folder: Path) -> tuple[dict[str, Any] | None, str]:
    """`run_one`, with an error outside the mission as one line instead of an exception."""
    try:
        return run_one(task, folder), ""
    except (Exception, SystemExit) as error:
        return None, " ".join(f"{type(error).__name__}: {error}".split())


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _result(connection: Any, process: Any) -> tuple[dict[str, Any] | None, str]:
    """Return summary and failure of a process that has sent its result, or ended without one."""
    with connection, contextlib.suppress(EOFError):
        summary, failure = connection.recv()
        process.join()
        return summary, failure
    process.join()
    code = process.exitcode
    return None, f"killed by {signal.Signals(-code).name}" if code < 0 else f"the process ended with exit code {code}"


def _finished(task: MissionRequest, out: Path) -> dict[str, Any] | None:
    """Return the summary of a task's run in the sweep's folder, None if it must be run."""
    folder = folder_of(task, out)
    return _read(folder / "summary.json") if _read(folder / "task.json") == _receipt(task) else None


def _read(path: Path) -> dict[str, Any] | None:
    try:
        return read_object(path)
    except FileError:
        return None
