"""Whether the robot is home before its budget ends: a mission a seed with half the time that it would take.

    python benchmarks/budget.py paper --time 340 --seeds 20

A row a seed: outcome, time, metres driven, what was mapped, and how far from its start the robot truly is at the end.
Anything after the known options goes to `tfg-drake explore` unchanged.
"""

from __future__ import annotations

import argparse
import tempfile
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

import numpy as np
from missions import run_seed

# The robot is home if its true position is at most HOME, m, from its start.
HOME = 0.5


def main() -> None:
    """Run, print a row as each mission ends, then how many were home in time."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--time", type=float, default=0.0, help="s; 0: no limit")
    parser.add_argument("--distance", type=float, default=0.0, help="m; 0: no limit")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=2)
    options, arguments = parser.parse_known_args()
    out = Path(tempfile.mkdtemp(prefix="budget-"))
    for key, value in (("budget_time", options.time), ("budget_distance", options.distance)):
        arguments += ["--set", f"explorer.{key}={value}"]
    arguments += ["--set", "explorer.return_home=true"]

    print("seed     outcome   time s   dist m   mapped  from home m")
    good = 0
    with ThreadPoolExecutor(options.jobs) as pool:
        for done in as_completed([pool.submit(run_seed, arguments, seed, out) for seed in range(options.seeds)]):
            run = done.result()
            if "sim_time_s" not in run:
                print(f"{run['seed']:>4}{run['outcome']:>12}  {run['reason']}", flush=True)
                continue
            truth = np.loadtxt(out / f"seed-{run['seed']}" / "truth.tum")
            away = float(np.hypot(*(truth[-1, 1:3] - truth[0, 1:3])))
            within = run["sim_time_s"] <= (options.time or np.inf) and run["distance_m"] <= (options.distance or np.inf)
            good += within and away <= HOME
            mapped = run["landmarks_mapped"] / run["landmarks_reachable"]
            row = f"{run['seed']:>4}{run['outcome']:>12}{run['sim_time_s']:>9.0f}{run['distance_m']:>9.1f}"
            print(f"{row}{mapped:>9.3f}{away:>13.2f}", flush=True)
    print(f"{good} of {options.seeds} home within the budget")


if __name__ == "__main__":
    main()
