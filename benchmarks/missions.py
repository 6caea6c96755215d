"""Whole missions over many seeds: outcome, completeness, accuracy, time and speed, one row a seed and their summary.

    python benchmarks/missions.py paper --seeds 20
    python benchmarks/missions.py --seeds 3 --world FILE --tag-spacing 1

Anything after the known options goes to `tfg-drake explore` unchanged. Each mission is a process of its own.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np


def seed(text: str) -> int:
    """A seed of the command line."""
    if int(text) < 0:
        raise argparse.ArgumentTypeError(f"{text}: must be 0 or more")
    return int(text)


def draw(write: Callable[[Any, Path], object], kind: Callable[[str], Any] = seed, names: Sequence[str] = ()) -> None:
    """With `draw SEED FILE` on the command line: write what is drawn, and exit. names: of all there is, for SEED."""
    if sys.argv[1:2] == ["draw"]:
        parser = argparse.ArgumentParser(f"{Path(sys.argv[0]).name} draw")
        parser.add_argument("name" if names else "seed", type=kind, choices=names or None)
        parser.add_argument("file", type=Path, help="what is written, .yaml")
        write(*vars(parser.parse_args(sys.argv[2:])).values())
        sys.exit()


def run_seed(arguments: list[str], seed: int, out: Path) -> dict:
    """summary.json of one headless mission."""
    command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "explore", *arguments]
    command += ["--headless", "--json", "--seed", str(seed), "--out", str(out / f"seed-{seed}")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = done.stdout.strip().splitlines()
    if not lines or not lines[-1].startswith("{"):
        return {"seed": seed, "outcome": f"exit {done.returncode}", "reason": done.stderr.strip()[-200:]}
    return json.loads(lines[-1])


COLUMNS = {
    "outcome": lambda s: s["outcome"],
    "mapped": lambda s: s["landmarks_mapped"] / max(s["landmarks_reachable"], 1),
    "contacts": lambda s: s["contacts"],
    "clearance": lambda s: s["min_clearance_m"],
    "pos mean": lambda s: s["position_error_m"]["mean"],
    "pos max": lambda s: s["position_error_m"]["max"],
    "heading": lambda s: s["heading_error_rad"]["mean"],
    "lm rmse": lambda s: s["landmark_rmse_m"],
    "aligned": lambda s: s["landmark_rmse_aligned_m"],
    "lm anees": lambda s: s["landmark_anees"],
    "pose anees": lambda s: s["pose_anees"],
    "online": lambda s: s["online_pose_anees"],
    "area": lambda s: s["area_coverage"],
    "surface": lambda s: s["surface_coverage"],
    "within 5cm": lambda s: s["surface_coverage_5cm"],
    "phantom": lambda s: s["surface_phantom_m"],
    "time s": lambda s: s["sim_time_s"],
    "dist m": lambda s: s["distance_m"],
    "stages": lambda s: s["stages"],
    "sim/cpu": lambda s: s["sim_time_s"] / s["cpu_time_s"],
    "est+plan": lambda s: (s["estimator_cpu_s"] + s["planner_cpu_s"]) / s["sim_time_s"],
}


def row(summary: dict) -> list[str]:
    """One line of the table."""
    cells = []
    for read in COLUMNS.values():
        try:
            value = read(summary)
        except (KeyError, TypeError):
            value = None
        cells.append("-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value))
    return cells


def main() -> None:
    """Run, print a row as each mission ends, then the summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=None)
    options, arguments = parser.parse_known_args()
    out = options.out or Path(tempfile.mkdtemp(prefix="missions-"))
    out.mkdir(parents=True, exist_ok=True)

    print("seed  " + "  ".join(f"{name:>10}" for name in COLUMNS), flush=True)
    summaries = []
    with ThreadPoolExecutor(options.jobs) as pool:
        seeds = range(options.first_seed, options.first_seed + options.seeds)
        for done in as_completed([pool.submit(run_seed, arguments, seed, out) for seed in seeds]):
            summary = done.result()
            summaries.append(summary)
            print(f"{summary['seed']:>4}  " + "  ".join(f"{cell:>10}" for cell in row(summary)), flush=True)
            if summary["outcome"] != "complete":
                print(f"      {summary['reason']}", flush=True)

    for name, reduce in (("mean", np.mean), ("min", np.min), ("max", np.max)):
        cells = []
        for read in COLUMNS.values():
            try:
                values = [read(s) for s in summaries]
                cells.append(f"{reduce(values):.4g}" if not isinstance(values[0], str) else "")
            except (KeyError, TypeError):
                cells.append("-")
        print(f"{name:>4}  " + "  ".join(f"{cell:>10}" for cell in cells))
    complete = sum(s["outcome"] == "complete" for s in summaries)
    print(f"{complete} of {len(summaries)} complete; runs in {out}")


if __name__ == "__main__":
    main()
