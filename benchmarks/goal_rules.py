"""Rules for choosing goals on the same seeds: time to complete, accuracy, completeness.

    python benchmarks/goal_rules.py paper --seeds 12 --jobs 2

Every rule runs with and without the price of the arrival pose, and with at least 8 known tags in view asked for, all on
the same map and roadmap. All end when nothing is left to explore, but for the tour: it first looks again where that
makes the map more accurate, and once does not. A row a variant: means over the seeds, and the mean ratio of its time to
that of the nearest frontier, with the 95 % bootstrap interval of that mean. Anything after the known options goes to
`tfg-drake explore` unchanged.
"""

from __future__ import annotations

import argparse
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from missions import run_seed
from scipy.stats import bootstrap

BASELINE = "nearest_frontier"
PRICES = {"": [], ", no price": ["explorer.pose_price=false"], ", 8 tags": ["explorer.least_tags=8"]}
VARIANTS: dict[str, list[str]] = {BASELINE: [f"explorer.goal={BASELINE}"]}
VARIANTS |= {
    rule + name: [f"explorer.goal={rule}", *settings]
    for rule in ("argmax", "gain_per_time", "tour")
    for name, settings in PRICES.items()
}
VARIANTS["tour, no second look"] = ["explorer.goal=tour", "explorer.revisit=false"]


def interval(ratios: np.ndarray) -> str:
    """Mean and its 95 % bootstrap interval."""
    if np.ptp(ratios) == 0.0:
        return f"{ratios.mean():.3f}"
    bounds = bootstrap((ratios,), np.mean, rng=np.random.default_rng(0)).confidence_interval
    return f"{ratios.mean():.3f} ({bounds.low:.3f}-{bounds.high:.3f})"


def main() -> None:
    """Run all and print the table, a row as soon as it is complete."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=12)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(VARIANTS))
    options, arguments = parser.parse_known_args()
    out = Path(tempfile.mkdtemp(prefix="goal-rules-"))
    print(f"{'':24}complete  mapped contacts    time s     dist m  goals   lm rmse  pos mean  time / nearest frontier")
    baseline: dict[int, float] = {}
    with ThreadPoolExecutor(options.jobs) as pool:
        for name in options.variants:
            settings = [word for setting in VARIANTS[name] for word in ("--set", setting)]
            folder = out / name.replace(", ", "-").replace(" ", "-")
            tasks = [pool.submit(run_seed, [*arguments, *settings], seed, folder) for seed in range(options.seeds)]
            runs = [task.result() for task in tasks]
            done = [run for run in runs if "sim_time_s" in run]
            if not done:
                print(f"{name:24}   0/{len(runs):<4} {runs[0]['reason']}", flush=True)
                continue
            if name == BASELINE:
                baseline = {run["seed"]: run["sim_time_s"] for run in done}

            def mean(key: str, done: list[dict] = done) -> float:
                return float(np.mean([run[key] for run in done]))

            mapped = min(run["landmarks_mapped"] / run["landmarks_reachable"] for run in done)
            position = np.mean([run["position_error_m"]["mean"] for run in done])
            ratios = np.array([run["sim_time_s"] / baseline[run["seed"]] for run in done if run["seed"] in baseline])
            complete = sum(run["outcome"] == "complete" for run in runs)
            print(
                f"{name:24}{complete:>4}/{len(runs):<4}{mapped:>7.3f}{sum(run['contacts'] for run in done):>9}"
                f"{mean('sim_time_s'):>10.0f}{mean('distance_m'):>11.0f}{mean('stages'):>7.1f}"
                f"{mean('landmark_rmse_m'):>10.4f}{position:>10.4f}  {interval(ratios) if len(ratios) else '-'}",
                flush=True,
            )


if __name__ == "__main__":
    main()
