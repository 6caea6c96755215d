"""Whether errors are as large as the estimator states: NEES of whole missions over many seeds, a world a row.

    python benchmarks/consistency.py
    python benchmarks/consistency.py --rows house house_real --seeds 1

Online is the pose that the robot drives by, once a second; departures are the poses at the ends of turns and glances
when these have been mapped. Each mission is a process of its own, and its figures are a line of --out (JSON),
with the commit they are of: what this commit has there is not run again, so that a run that was ended goes on. What
other commits have there stays.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import missions
import numpy as np
import reality
import results
from wall_errors import OFF, wall_errors

from tfg_drake.io.files import write_atomic

# Of each row: arguments, where {seed} is replaced by the seed; the row of reality.py; number of seeds. All missions
# together take some 40 minutes of CPU.
Rows = dict[str, tuple[list[str], str, int]]
ROWS: Rows = {
    "house": (["house"], reality.BELIEVED, 30),
    "house_real": (["house_real"], reality.BELIEVED, 30),
    "paper": (["paper"], reality.BELIEVED, 20),
    "paper_real": (["paper_real"], reality.BELIEVED, 8),
    "house, poor odometry": (["house"], "poor odometry", 10),
    "paper, correlated noise": (["paper"], "correlated noise", 10),
}
# Summary fields that are a NEES.
GROUPS = ("online_pose_anees", "pose_anees", "landmark_nees")
# Summary fields that are kept, under their own names.
FIELDS = (*GROUPS, "landmark_rmse_m", "surface_coverage", "surface_phantom_m", "contacts", "cpu_time_s", "sim_time_s")


def run(key: tuple[str, int], rows: Rows, version: str) -> dict | None:
    """The figures of one mission, key: world and seed; None of one that left none."""
    world, seed = key
    arguments, deviation, _ = rows[world]
    arguments = ["--max-time", "3600", *(one.format(seed=seed) for one in arguments)]
    for setting in reality.settings(deviation, seed):
        arguments += ["--set", setting]
    with tempfile.TemporaryDirectory() as folder:
        summary = missions.run_seed(arguments, seed, Path(folder))
        run_folder = Path(folder) / f"seed-{seed}"
        off = wall_errors(run_folder) if (run_folder / "map.npz").exists() else np.zeros(0)
    if "sim_time_s" not in summary:
        print(f"{world}, seed {seed}: {summary['outcome']}: {summary['reason']}", flush=True)
        return None
    figures = {"world": world, "seed": seed, "version": version, "outcome": summary["outcome"]}
    figures["position_error_mean_m"] = summary["position_error_m"]["mean"]
    figures |= {"walls": len(off), "false_walls": int(np.count_nonzero(off > OFF))}
    return figures | {name: summary.get(name) for name in FIELDS}


def line(world: str, runs: list[dict]) -> str:
    """A row of the table."""

    def values(name: str) -> np.ndarray:
        """The finite values of a figure over the runs; one nan where there are none."""
        known = np.array([one[name] for one in runs], dtype=float)
        return known[np.isfinite(known)] if np.isfinite(known).any() else np.full(1, math.nan)

    complete = sum(one["outcome"] == "complete" for one in runs)
    cells = [f"{world:24s} {len(runs):3d} {complete:8d}"]
    for name in GROUPS:
        cells += [f" {reduce(values(name)):6.2f}" for reduce in (np.mean, np.median, np.max)]
    rmse, position, seen, phantom, time, cpu = (
        f"{np.mean(values(name)):.4g}"
        for name in (
            "landmark_rmse_m",
            "position_error_mean_m",
            "surface_coverage",
            "surface_phantom_m",
            "sim_time_s",
            "cpu_time_s",
        )
    )
    cells += [f" {rmse:>8s} {position:>8s} {seen:>8s} {phantom:>8s} {time:>6s} {cpu:>6s}"]
    return (
        "".join(cells)
        + f" {int(values('contacts').sum()):8d} {int(values('false_walls').sum()):5d} of {int(values('walls').sum())}"
    )


def main(described: str | None = __doc__, rows_of: Rows = ROWS, out: Path = Path("runs/consistency.jsonl")) -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=described, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="+", choices=list(rows_of), default=list(rows_of))
    parser.add_argument("--seeds", type=int, help="Of each row at most, instead of its own number.")
    parser.add_argument("--processes", type=int, default=1, help="Missions at a time.")
    parser.add_argument("--out", type=Path, default=out)
    options = parser.parse_args()

    version = results.version()
    rows = [json.loads(text) for text in options.out.read_text().splitlines()] if options.out.exists() else []
    options.out.parent.mkdir(parents=True, exist_ok=True)
    done = {(row["world"], row["seed"]) for row in rows if row["version"] == version}
    wanted = [(world, seed) for world in options.rows for seed in range(rows_of[world][2])[: options.seeds]]
    with ThreadPoolExecutor(options.processes) as pool:
        for row in pool.map(lambda key: run(key, rows_of, version), [key for key in wanted if key not in done]):
            if row is not None:
                rows.append(row)
                write_atomic(options.out, "".join(json.dumps(each) + "\n" for each in rows))
                print(json.dumps(row), flush=True)

    print(f"\n{'':37s}{'NEES: online pose':>21s}{'departures':>21s}{'landmarks, jointly':>21s}")
    print(
        f"{'':24s}   n complete{3 * '   mean median  worst'}     rmse position  surface  phantom   time    cpu contacts"
        "  false walls"
    )
    counted = [row for row in rows if (row["world"], row["seed"]) in wanted and row["version"] == version]
    for world in options.rows:
        runs = [row for row in counted if row["world"] == world]
        if runs:
            print(line(world, runs))


if __name__ == "__main__":
    main()
