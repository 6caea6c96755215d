"""How much longer missions take, and drive, than the best tour of the known map, and what they spend the rest on.

    python benchmarks/regret.py
    python benchmarks/regret.py --rows "house, no tags" --seeds 1

The best tour sees what a mission is judged by: 99 % of the cells of `area_seen_s`, and each tag that can be reached. A
mission is counted until nothing was left to explore. It takes longer than the tour by what it stands more, turns more
in place, drives slower than the limit, and by what its way is longer. *bound*: no tour takes less.

Each mission is a process of its own, and kept in a folder of its own (--out, row, seed; unless it is given, --out has
the commit in its name), each world's tour in --tours: what is there is not made again, so that a run that was ended
goes on.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import offices
import results
from time_spent import time_spent
from tour_bound import tour_bound

from tfg_drake.diagrams.missions.best_tours import kept_tour, to_see_in
from tfg_drake.diagrams.missions.errors import KnownWorld, path_length
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.storage.trajectory import read_tum

# Of each row: arguments, where {seed} is replaced by the seed, and the seeds.
OFFICE = str(offices.PLANS / "{seed}.yaml")
ROWS: dict[str, tuple[list[str], range]] = {
    "house, no tags": (["house", "--tag-spacing", "none"], range(40, 43)),
    "paper, a tag every metre": (["paper", "--world", "paper", "--tag-spacing", "1"], range(40, 42)),
    "paper, no tags": (["paper", "--tag-spacing", "none"], range(40, 42)),
    "offices, no tags": (["paper_real", "--world", OFFICE, "--tag-spacing", "none"], range(3)),
}
PARTS = ("standing", "turning", "slower", "longer way")
HEADER = (
    f"{'':26s}{'seed':>4s}{'tour s':>8s}{'m':>7s}{'bound s':>8s}{'m':>7s}{'mission s':>10s}{'m':>7s}{'time over':>10s}"
    f"{'way over':>9s}{'99 % seen':>10s}" + "".join(f"{part:>11s}" for part in PARTS)
)


def mission(row: str, seed: int, out: Path) -> Path | None:
    """The folder of one mission, run where it is not there yet; None of one that left nothing."""
    folder = out / row.replace(" ", "_").replace(",", "") / f"seed-{seed}"
    if not (folder / "summary.json").exists():
        if row.startswith("offices"):
            offices.write(seed, Path(OFFICE.format(seed=seed)))
        command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "explore", "--headless", "--seed", str(seed)]
        command += ["--max-time", "3600", "--out", str(folder), *(one.format(seed=seed) for one in ROWS[row][0])]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if not (folder / "summary.json").exists():
            print(f"{row}, seed {seed}: {done.stderr.strip()[-200:]}", flush=True)
            return None
    return folder


def figures(folder: Path, tours: Path) -> dict[str, float] | None:
    """The times and lengths of a mission beside those of the best tour; None if it never explored all."""
    summary = json.loads((folder / "summary.json").read_text())
    scenario = LoadScenario(folder / "scenario.yaml")
    tour = kept_tour(scenario, tours, lambda line: print(f"  tour, {folder.parent.name}: {line}", flush=True))
    if summary["explored_s"] is None or not tour.is_enough:
        print(f"{folder}: {summary['outcome']}, {summary['reason']}; tour enough: {tour.is_enough}", flush=True)
        return None
    stamps, X_WB = read_tum(folder / "truth.tum")
    until = stamps <= summary["explored_s"]
    world, speed = MakeWorld(scenario.world), scenario.robot.max_speed
    see = to_see_in(KnownWorld(world, scenario), world, scenario)
    bound_s, bound_m = tour_bound(world.walls, world.start[:2], see, scenario.robot)
    mine, best = time_spent(stamps[until], X_WB[until], speed), time_spent(tour.stamps, tour.X_WB, speed)
    length, seen = path_length(X_WB[until]), summary["area_seen_s"]
    return {
        "tour_s": tour.time,
        "tour_m": tour.distance,
        "bound_s": bound_s,
        "bound_m": bound_m,
        "explored_s": summary["explored_s"],
        "explored_m": length,
        "time_over": summary["explored_s"] / tour.time,
        "way_over": length / tour.distance,
        "seen_over": float("nan") if seen is None else seen / tour.time,
        "standing": mine.standing - best.standing,
        "turning": mine.turning - best.turning,
        "slower": mine.slower - best.slower,
        "longer way": mine.driving - best.driving,
    }


def line(row: str, seed: str, one: dict[str, float]) -> str:
    """A row of the table."""
    cells = f"{row:26s}{seed:>4s}{one['tour_s']:8.0f}{one['tour_m']:7.1f}{one['bound_s']:8.0f}{one['bound_m']:7.1f}"
    cells += f"{one['explored_s']:10.0f}{one['explored_m']:7.1f}{one['time_over']:10.2f}{one['way_over']:9.2f}"
    return cells + f"{one['seen_over']:10.2f}" + "".join(f"{one[part]:11.1f}" for part in PARTS)


def main() -> None:
    """Run what is missing, print a row a mission, then the means of each row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), default=list(ROWS))
    parser.add_argument("--seeds", type=int, help="Of each row at most, instead of its own number.")
    parser.add_argument("--out", type=Path, default=Path("runs") / f"regret-{results.version().split(',')[0]}")
    parser.add_argument("--tours", type=Path, default=Path("runs/tours"))
    options = parser.parse_args()

    print(f"Version {results.version()}\n{HEADER}", flush=True)
    means = []
    for row in options.rows:
        found = []
        for seed in ROWS[row][1][: options.seeds]:
            folder = mission(row, seed, options.out)
            one = None if folder is None else figures(folder, options.tours)
            if one is not None:
                found.append(one)
                print(line(row, str(seed), one), flush=True)
        if found:
            means.append(line(row, "mean", {name: float(np.mean([one[name] for one in found])) for name in found[0]}))
    print("\n".join(["", HEADER, *means]))


if __name__ == "__main__":
    main()
