"""Where the CPU time of one headless mission goes: by system, per stage, and per simulated second.

python benchmarks/speed.py paper
python benchmarks/speed.py office --seed 3 --max-time 300
python benchmarks/speed.py paper --details

Without --details the station's systems count as the rest, as they do in every other run: they are called so often that
reading the clock for each call would take its share of the time.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from pathlib import Path

from pydrake.systems.framework import Diagram

from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.robots import SIMULATED
from tfg_drake.diagrams.scenario import FindScenario, LoadScenario, Scenario
from tfg_drake.systems.cpu_meter import CpuMeter


def main() -> None:
    """Run one mission in this process and print its account."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--max-time", type=float, default=3600.0)
    parser.add_argument("--details", action="store_true", help="the station by system, too")
    options = parser.parse_args()
    scenario = LoadScenario(FindScenario(options.scenario))
    scenario.seed = options.seed

    station = CpuMeter()

    def MakeMeteredStation(scenario: Scenario) -> Diagram:
        diagram = SIMULATED.MakeStation(scenario)
        station.attach(diagram)
        return diagram

    robot = dataclasses.replace(SIMULATED, MakeStation=MakeMeteredStation) if options.details else SIMULATED

    # Compiled code is read from its cache on first use: the short mission before the measured one pays for that.
    run_mission(scenario, robot=robot, max_time=60.0, out_dir=Path(tempfile.mkdtemp(prefix="speed-")))
    station.spent.clear()
    out = Path(tempfile.mkdtemp(prefix="speed-"))
    result = run_mission(scenario, robot=robot, max_time=options.max_time, out_dir=out)
    summary, spent = result.summary, result.spent | station.spent
    spent["Drake and the rest"] = summary["cpu_time_s"] - sum(spent.values())

    duration = summary["sim_time_s"]
    print(f"{'':24}{'CPU s':>9}{'ms per simulated s':>20}")
    for name, seconds in sorted(spent.items(), key=lambda item: -item[1]):
        print(f"{name:24}{seconds:9.3f}{1e3 * seconds / duration:20.2f}")
    print(f"{'all':24}{summary['cpu_time_s']:9.3f}{1e3 * summary['cpu_time_s'] / duration:20.2f}")
    stage = "  ".join(f"{name} {value:.0f}" for name, value in summary["stage_ms"].items())
    print(f"{summary['outcome']} after {duration:.1f} s, {summary['stages']} stages; planning of a stage, ms: {stage}")
    mind = (summary["estimator_cpu_s"] + summary["planner_cpu_s"]) / duration
    print(f"simulated s per CPU s: {duration / summary['cpu_time_s']:.1f}")
    print(f"estimator and planner, CPU s per simulated s: {mind:.4f}")


if __name__ == "__main__":
    main()
