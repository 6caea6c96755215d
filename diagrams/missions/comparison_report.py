"""The files of a comparison, made from its runs' folders: runs.csv, figures, report.md and report.html."""

from __future__ import annotations

import math
import platform
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from tfg_drake import __version__
from tfg_drake.comparison.curves import Band, Curve, averaged, band, coverage_curve, error_curves
from tfg_drake.comparison.figures import FinalMap, draw_costs, draw_coverage, draw_errors, draw_maps
from tfg_drake.comparison.measures import CPU_IDLE, MAP_SIZE, MOVING, TIME, VARIABLES
from tfg_drake.comparison.report import Comparison, Picture, markdown, page
from tfg_drake.comparison.runs import Run, of_shared_seeds, sample, to_csv
from tfg_drake.comparison.statistics import spread
from tfg_drake.diagrams.missions.best_tours import over_tours
from tfg_drake.diagrams.missions.errors import KnownWorld
from tfg_drake.diagrams.missions.mission import MissionRequest
from tfg_drake.diagrams.scenario import MakeWorld, Scenario
from tfg_drake.grid.saved_grid import load_grid
from tfg_drake.io.files import write_atomic
from tfg_drake.mapfile.saved_map import load_map
from tfg_drake.messages import FloatArray
from tfg_drake.pictures.figure_file import write_formats
from tfg_drake.storage.trajectory import read_tum

# Approximate number of time intervals over which errors are averaged; spacing of the coverage, m of way.
_STRETCHES, _DISTANCE_STEP = 150, 0.5


def write_comparison(
    runs: Sequence[Run],
    tasks: Sequence[MissionRequest],
    out: Path,
    command: str,
    show: Callable[[str], object] = lambda line: None,
) -> None:
    """Write runs.csv, the figures, report.md and report.html, and the worlds' best tours where they are not there yet.

    command: what repeats it. show: is told how far it is. Raises OSError where a file cannot be written.
    """
    scenarios = {task.scenario.seed: task.scenario for task in tasks}
    runs = over_tours(runs, scenarios, out / "tours", show)
    show("drawing and writing the comparison")
    methods = list(dict.fromkeys(task.method.name for task in tasks))
    write_atomic(out / "runs.csv", to_csv(runs))
    packages = ", ".join(f"{name} {version(name)}" for name in ("drake", "gtsam", "numpy", "numba"))
    where = "a world of each seed" if "{seed}" in tasks[0].world_name else tasks[0].name
    comparison = Comparison(
        title=f"{' against '.join(methods) if len(methods) < 3 else f'{len(methods)} methods'} in {where}",
        methods=methods,
        runs=runs,
        planned=len(tasks),
        command=command,
        versions=f"tfg-drake {__version__}{of_commits(runs)}, Python {platform.python_version()}, {packages};"
        f" {platform.system()} on {platform.machine()}.",
        need_tags=list(dict.fromkeys(task.method.name for task in tasks if task.method.needs_tags)),
    )
    pictures = list(_pictures(methods, runs, scenarios, out))
    write_atomic(out / "report.md", markdown(comparison, pictures))
    write_atomic(out / "report.html", page(comparison, pictures))


def of_commits(runs: Sequence[Run]) -> str:
    """Return " of commit " and the commit of the runs, or all of their commits with the number of runs of each; "" of
    runs of no clone."""
    commits = Counter(run.summary["commit"] for run in runs if run.summary and run.summary.get("commit"))
    told = ", ".join(f"{one} (runs: {count})" if len(commits) > 1 else one for one, count in commits.items())
    return f" of commit {told}" if told else ""


def closing_lines(runs: Sequence[Run], methods: Sequence[str]) -> list[str]:
    """Return a line per method: outcomes, and the means of time and position error over the seeds common to all."""
    lines, shared = [], of_shared_seeds(runs, methods)
    for method in methods:
        outcomes = Counter(run.outcome for run in runs if run.method == method)
        counts = ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()) or "no run"
        time, position = (spread(sample(shared, method, measure.read)).mean.value for measure in (TIME, MOVING))
        error = f", position error {position:.3f} m from the first drive on" if math.isfinite(position) else ""
        means = f"; time {time:.0f} s{error}" if math.isfinite(time) else ""
        lines.append(f"{method:<13} {counts}{means}")
    return lines


def _pictures(
    methods: Sequence[str], runs: Sequence[Run], scenarios: dict[int, Scenario], out: Path
) -> Iterator[Picture]:
    """Write the figures, none if no run counts."""
    counted = [run for run in of_shared_seeds(runs, methods) if run.counts]
    if not counted:
        return
    errors = {run.folder: _errors(run.folder) for run in counted}
    stretch = _round(max((run.summary or {})["sim_time_s"] for run in counted) / _STRETCHES)
    position, heading = (
        _bands(methods, counted, lambda run, i=i: averaged(errors[run.folder][i], stretch), stretch)  # type: ignore[misc]
        for i in range(2)
    )
    worlds = {seed: KnownWorld(MakeWorld(scenarios[seed].world), scenarios[seed]) for seed in {r.seed for r in counted}}
    cells = {seed: known.counted_places() for seed, known in worlds.items()}
    share = _bands(
        methods, counted, lambda run: _coverage(run, scenarios[run.seed], cells[run.seed]), _DISTANCE_STEP, hold=True
    )
    number = max(sum(run.method == method for run in counted) for method in methods)
    lines = f"Lines: mean over {number} seeds, thin where some of the runs have ended; shade: their range."
    costs = {
        measure.label: {method: spread(sample(counted, method, measure.read)) for method in methods}
        for measure in (VARIABLES, MAP_SIZE, CPU_IDLE)
    }
    maps = _maps(methods, counted, scenarios)
    shown = f" (seed {maps[0].seed})" if len({one.seed for one in maps}) == 1 else ""
    for name, caption, figure in (
        (
            "errors",
            f"Error of the online estimate against time, averaged over {stretch:g} s. {lines}",
            draw_errors(position, heading),
        ),
        (
            "coverage",
            "Share of the reachable area that the scanner has seen from the robot's true poses, against the distance"
            f" driven. {lines}",
            draw_coverage(share),
        ),
        ("maps", f"The map at the end of a run of each method{shown}.", draw_maps(maps)),
        (
            "costs",
            "What a map takes: its variables, its file, and the share of one core that estimator and planner leave"
            " idle at real time; means over the runs.",
            draw_costs(costs),
        ),
    ):
        png = next(path for path in write_formats(out, name, figure) if path.suffix == ".png")
        yield Picture(name, caption, png.read_bytes())


def _bands(
    methods: Sequence[str], runs: Sequence[Run], curve: Callable[[Run], Curve], step: float, *, hold: bool = False
) -> dict[str, Band]:
    """Return the band of each method that has one."""
    bands = {m: band([curve(run) for run in runs if run.method == m], step, hold=hold) for m in methods}
    return {method: one for method, one in bands.items() if one is not None}


def _round(step: float) -> float:
    """Return the next greater 1, 2 or 5 times a power of ten, at least 0.1, as for a run that ended at once."""
    if step < 0.1:
        return 0.1
    power = 10.0 ** np.floor(np.log10(step))
    return float(next(digit * power for digit in (1.0, 2.0, 5.0, 10.0) if digit * power >= step))


def _errors(folder: Path) -> tuple[Curve, Curve]:
    return error_curves(*read_tum(folder / "trajectory.tum"), *read_tum(folder / "truth.tum"))


def _coverage(run: Run, scenario: Scenario, p_WC: FloatArray) -> Curve:
    _, X_WB = read_tum(run.folder / "truth.tum")
    walls = MakeWorld(scenario.world).walls
    return coverage_curve(X_WB, p_WC, walls, scenario.scan.range, scenario.scan.field_of_view)


def _maps(methods: Sequence[str], runs: Sequence[Run], scenarios: dict[int, Scenario]) -> list[FinalMap]:
    """Return one map per method: of the first seed common to all methods, or else of the method's first."""
    seeds = [{run.seed for run in runs if run.method == method} for method in methods]
    common = min(set.intersection(*seeds), default=None)
    chosen = [next((run for run in runs if run.method == m and common in (run.seed, None)), None) for m in methods]
    return [_final_map(run, scenarios[run.seed]) for run in chosen if run is not None]


def _final_map(run: Run, scenario: Scenario) -> FinalMap:
    _, X_WB = read_tum(run.folder / "truth.tum")
    landmarks, cells = run.folder / "map.npz", run.folder / "grid.npz"
    return FinalMap(
        method=run.method,
        seed=run.seed,
        world=MakeWorld(scenario.world),
        X_WB=X_WB,
        saved=load_map(landmarks) if landmarks.exists() else None,
        grid=load_grid(cells) if cells.exists() else None,
    )
