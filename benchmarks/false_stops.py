"""Does the filter before the base stop a robot that has nothing in its way?

    python benchmarks/false_stops.py house --seeds 20 --jobs 2

Whole missions whose scans are as in the scenario, without noise, or lack 20 % of their rays. Each command is filtered
twice: as it is, and with what was not seen taken for free and every scan believed. A false stop is a moment when the
first lets the base stand and the second lets it drive at 0.05 m/s or more, and the scan shows nothing within 15 cm of
the outline in its way; the base is slowed where the first is slower by as much, whatever is in its way. Prints a row a
kind of scan; a mission a line is kept in --out, and it goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.messages import LaserScan, replace
from tfg_drake.safety.scan_watch import ScanWatch
from tfg_drake.safety.velocity_filter import SPEED, filter_command, free_distance
from tfg_drake.systems import laser_scanner, safety_filter

SCANS = ("as they are", "noiseless", "20 % lost")
LOST = 0.2
# The base is slowed if, with all scans believed, the filter would let it drive more than SLOWER, m/s, faster.
SLOWER = 0.05
# A stop is false if the free distance ahead of the outline exceeds NEAR, m.
NEAR = 0.15


def mission(world: str, kind: str, seed: int) -> dict[str, Any]:
    """The figures of one mission."""
    scenario, random, stops, slowed = LoadScenario(world), np.random.default_rng(seed), [], []
    scenario.seed = seed
    if kind == "noiseless":
        scenario.scan.noise = 0.0
    scan = laser_scanner.scan

    def with_losses(*arguments: Any) -> LaserScan:
        whole = scan(*arguments)
        return replace(whole, ranges=np.where(random.random(len(whole.ranges)) < LOST, np.nan, whole.ranges))

    def compared(state: Any, stamp: float, command: Any, hazards: Any, seen: Any, watch: ScanWatch, *rest: Any) -> Any:
        free = np.full_like(watch.space.seen, np.inf), np.zeros_like(watch.space.met)
        trusting = replace(watch, doubt="", space=replace(watch.space, seen=free[0], met=free[1]))
        after = filter_command(state, stamp, command, hazards, seen, watch, *rest)
        if after[SPEED] < filter_command(state, stamp, command, hazards, seen, trusting, *rest)[SPEED] - SLOWER:
            robot, safety = scenario.robot, scenario.safety
            curvature = float(command[1] / command[0])
            way = seen.angles, seen.ranges, np.zeros(3), curvature, robot.radius, safety.side_margin, np.inf
            told = command[0] > SLOWER and after[SPEED] == 0.0
            (stops if told and free_distance(*way) > NEAR else slowed).append(stamp)
        return after

    if kind == "20 % lost":
        laser_scanner.scan = with_losses
    safety_filter.filter_command = compared
    try:
        with tempfile.TemporaryDirectory() as folder:
            summary = run_mission(scenario, out_dir=Path(folder), record=False).summary
    finally:
        laser_scanner.scan, safety_filter.filter_command = scan, filter_command
    kept = ("outcome", "sim_time_s", "contacts", "min_clearance_m", "landmarks_mapped", "landmarks_reachable")
    return {"scans": kind, "seed": seed, "stops": stops, "slowed": slowed} | {key: summary[key] for key in kept}


def _mission(task: tuple[str, str, int]) -> dict[str, Any]:
    return mission(*task)


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("world", nargs="?", default="house")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--scans", choices=SCANS, action="append", help="only these")
    parser.add_argument("--out", type=Path, default=Path("runs/false_stops.jsonl"), help="a line a mission")
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    done = {(row["scans"], row["seed"]) for row in rows}
    kinds = options.scans or SCANS
    tasks = [(options.world, kind, seed) for seed in range(options.seeds) for kind in kinds if (kind, seed) not in done]
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool, options.out.open("a") as file:
        for row in pool.imap_unordered(_mission, tasks):
            file.write(json.dumps(row) + "\n")
            file.flush()
            rows.append(row)
    print(f"{'scans':<14}{'missions':>9}{'complete':>9}{'contacts':>9}{'time s':>8}{'false stops':>13}{'slowed s':>10}")
    for kind in kinds:
        of_kind = [row for row in rows if row["scans"] == kind and row["seed"] < options.seeds]
        slowed = sum(len(row["slowed"]) for row in of_kind) * safety_filter.COMMAND_PERIOD
        print(
            f"{kind:<14}{len(of_kind):>9}{sum(row['outcome'] == 'complete' for row in of_kind):>9}"
            f"{sum(row['contacts'] for row in of_kind):>9}{np.mean([row['sim_time_s'] for row in of_kind]):>8.0f}"
            f"{sum(len(row['stops']) for row in of_kind):>13}{slowed:>10.2f}"
        )


if __name__ == "__main__":
    main()
