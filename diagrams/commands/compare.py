"""`tfg-drake compare`: runs methods on the same seeds and reports on them."""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import Annotated, Any

from tfg_drake.diagrams.commands import command
from tfg_drake.diagrams.commands.command import argument, bad_input, option
from tfg_drake.diagrams.compile_kernels import wait_for_kernels
from tfg_drake.diagrams.missions import run_folder
from tfg_drake.diagrams.screen import Screen


def _seeds(text: str) -> range:
    """Return the seeds of an option's value, N or A:B."""
    first, _, last = text.rpartition(":")
    try:
        seeds = range(int(first or 0), int(last))
    except ValueError:
        bad_input(f"--seeds {text}: must be a number of seeds, or A:B for A to B - 1")
    if seeds.start < 0 or not seeds:
        bad_input(f"--seeds {text}: must be 1 or more")
    return seeds


def compare(
    scenario: Annotated[str, argument(None, "A shipped scenario or a YAML file.")] = "paper",
    world: command.World = None,
    tag_spacing: command.TagSpacing = None,
    start: command.Start = None,
    methods: Annotated[
        str, option("NAME,...", "The methods; the first is the reference for the others.")
    ] = "tfg,tfg-nearest,grid-nearest",
    seeds: Annotated[str, option("N|A:B", "Run every method on the seeds 0 to N - 1, or A to B - 1.")] = "10",
    max_time: command.MaxTime = 3600.0,
    settings: command.Settings = None,
    jobs: Annotated[int | None, option("N", "Run N missions at a time [default: 1].")] = None,
    ray: Annotated[str | None, option("ADDRESS", "Run on a Ray cluster; local starts one on this machine.")] = None,
    out: Annotated[Path | None, option("DIR", "Output folder [default: runs/<time>-compare-<scenario>].")] = None,
) -> None:
    """Compare methods on the same seeds and write a report. With the same DIR, continue an interrupted comparison."""
    each_seed = _seeds(seeds)
    for setting in settings or []:
        if setting.split("=")[0].strip() == "seed":
            bad_input(f"--set {setting}: the seeds are those of --seeds; leave it out")
    if jobs is not None and jobs < 1:
        bad_input(f"--jobs {jobs}: must be 1 or more")
    if jobs is not None and ray is not None:
        bad_input("--jobs and --ray exclude each other; a cluster knows how many missions it can run")

    with Screen("loading") as show:
        from tfg_drake.diagrams.missions import comparison_report
        from tfg_drake.diagrams.missions.mission import MissionRequest
        from tfg_drake.diagrams.missions.sweep import parse_methods, run_sweep
        from tfg_drake.diagrams.scenario import PrepareScenario

        name = run_folder.run_name(scenario, None if "{seed}" in str(world) else world)
        place = command.parse_start(start)
        pairs = [(seed, world and str(world).replace("{seed}", str(seed))) for seed in each_seed]
        of_seed = [PrepareScenario(scenario, settings or [], *pair, tag_spacing, place) for pair in pairs]
        compared = parse_methods(methods, of_seed[0], settings or [])
        given: dict[str, Any] = {"name": name, "world_name": str(world or scenario), "max_time": max_time}
        # All methods of a seed run before the next seed, so that a partial report compares equal seeds.
        tasks = [MissionRequest(one, method, **given) for one in of_seed for method in compared]
        if out is not None:
            command.make_writable(out)
        folder = run_folder.make_run_folder(out, f"compare-{name}")
        wait_for_kernels(show, command.interruption)
        spacing = "none" if tag_spacing == math.inf else tag_spacing
        told = [("--world", world), ("--tag-spacing", spacing), ("--start", start), ("--methods", methods)]
        told += [("--seeds", seeds), ("--max-time", f"{max_time:g}"), *(("--set", one) for one in settings or [])]
        words = [str(word) for key, value in told if value is not None for word in (key, value)]
        repeated = shlex.join(["tfg-drake", "compare", scenario, *words])
        with run_folder.claimed(folder):
            runs = run_sweep(tasks, folder, jobs or 1, ray, command.interruption, show)
            comparison_report.write_comparison(runs, tasks, folder, repeated, show)
    for line in comparison_report.closing_lines(runs, [method.name for method in compared]):
        print(line)
    print(f"report: {folder / 'report.html'}")
    command.end_unless_interrupted(command.EXIT_CODES["fault"] if any(not run.counts for run in runs) else 0)
