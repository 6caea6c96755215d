"""Where the CPU time of one headless mission goes: by system, per stage, and per simulated second.

python benchmarks/speed.py paper
python benchmarks/speed.py office --seed 3 --max-time 300
python benchmarks/speed.py paper --details

Without --details the station's systems count as the rest, as they do in every other run: reading the clock for each of
their calls takes a tenth of the time.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from tfg_drake.cpu_meter import charge_details, cpu_totals
from tfg_drake.diagrams.run import explore
from tfg_drake.diagrams.scenario import FindScenario, LoadScenario


def main() -> None:
    """Run one mission in this process and print its account."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--max-time", type=float, default=3600.0)
    parser.add_argument("--details", action="store_true", help="the station by system, too")
    options = parser.parse_args()
    if options.details:
        charge_details()
    scenario = LoadScenario(FindScenario(options.scenario))
    scenario.seed = options.seed

    # Compiled code is read from its cache on first use: the short mission before the measured one pays for that.
    explore(scenario, max_time=60.0, out_dir=Path(tempfile.mkdtemp(prefix="speed-")))
    before = cpu_totals()
    summary = explore(scenario, max_time=options.max_time, out_dir=Path(tempfile.mkdtemp(prefix="speed-"))).summary
    spent = {name: total - before.get(name, 0.0) for name, total in cpu_totals().items()}
    spent["Drake and the rest"] = summary["cpu_time_s"] - sum(spent.values())

    duration = summary["sim_time_s"]
    print(f"{'':24}{'CPU s':>9}{'ms per simulated s':>20}")
    for name, seconds in sorted(spent.items(), key=lambda item: -item[1]):
        print(f"{name:24}{seconds:9.3f}{1e3 * seconds / duration:20.2f}")
    print(f"{'all':24}{summary['cpu_time_s']:9.3f}{1e3 * summary['cpu_time_s'] / duration:20.2f}")
    stage = "  ".join(f"{name} {value:.0f}" for name, value in summary["stage_ms"].items())
    print(f"{summary['outcome']} after {duration:.1f} s, {summary['stages']} stages; planning of a stage, ms: {stage}")
    robot = (summary["estimator_cpu_s"] + summary["planner_cpu_s"]) / duration
    print(f"simulated s per CPU s: {duration / summary['cpu_time_s']:.1f}")
    print(f"estimator and planner, CPU s per simulated s: {robot:.4f}")


if __name__ == "__main__":
    main()
