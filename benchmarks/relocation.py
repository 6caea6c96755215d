"""Sessions that begin somewhere in a building of which there is a map, without tags: when they know where they are.

    python benchmarks/relocation.py house paper --starts 4
    python benchmarks/relocation.py --world FILE --starts 8 --seeds 2
    python benchmarks/relocation.py offices --starts 2 --chairs 3
    python benchmarks/relocation.py house --map RUN

The map is made by a mission from the building's own start; offices are those of offices.py. --chairs: so many stand
elsewhere in each session; --later: a tenth of an office's furniture has been moved and a door shut. --time: a session
ends after so long, s. --map: that of another building, in which no session should find itself. A row a session:
when it found itself, s, nan where it did not; whether it was wrong then, off by more than 0.3 m from then on; the mean
error, m, and NEES of the pose; time, s. Goes on where it ended.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

import numpy as np
import offices
from sessions import ROOM, chair

from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import MakeWorld, PrepareScenario, Scenario
from tfg_drake.geometry.distance import point_distance
from tfg_drake.world.reachability import make_grid, reachable_cells

WRONG, OFFICES, NEAR_WALL, LONGEST = 0.3, 20, 0.35, 3600.0


def elsewhere(scenario: Scenario, chairs: int, rng: np.random.Generator) -> Scenario:
    """The building with chairs in other places, and the robot at another start."""
    bare = MakeWorld(scenario.world)
    grid = make_grid(bare)
    free = grid.centers(reachable_cells(grid, bare, scenario.robot.radius))
    from_wall = point_distance(free, bare.walls)
    at = free[from_wall > ROOM][rng.integers(np.count_nonzero(from_wall > ROOM), size=chairs)]
    start = at[:1]
    while not len(start) or np.any(np.hypot(*(start - at).T) < ROOM):
        start = free[from_wall > NEAR_WALL][rng.integers(np.count_nonzero(from_wall > NEAR_WALL), size=1)]
    walls = [*scenario.world.walls, *(wall for place in at for wall in chair(place))]
    world = dataclasses.replace(scenario.world, walls=walls, start=[*start[0].tolist(), float(rng.uniform(-3.1, 3.1))])
    return dataclasses.replace(scenario, world=world)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("worlds", nargs="*")
    parser.add_argument("--world", type=Path, action="append", default=[])
    parser.add_argument("--starts", type=int, default=2)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--chairs", type=int, default=0)
    parser.add_argument("--later", action="store_true")
    parser.add_argument("--time", type=float, default=3600.0)
    parser.add_argument("--map", type=Path)
    parser.add_argument("--offices", type=int, default=OFFICES)
    parser.add_argument("--out", type=Path, default=Path("runs/relocation"))
    options = parser.parse_args()
    worlds: dict[str, tuple[str, Path | None]] = {file.stem: ("paper", file) for file in options.world}
    for name in options.worlds:
        if name == "offices":
            for plan in range(options.offices):
                offices.write(plan, options.out / f"office_{plan}.yaml")
                worlds[f"office_{plan}"] = ("paper_real", options.out / f"office_{plan}.yaml")
        else:
            worlds[name] = (name, None)
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "rows.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    for name, (base, plan_file) in worlds.items():
        known = options.map or options.out / f"{name}-map"
        for start in range(options.starts):
            for seed in range(options.seeds):
                which = {"world": name, "start": start, "seed": seed, "chairs": options.chairs, "map": str(options.map)}
                which |= {"later": options.later}
                if any(which.items() <= row.items() for row in rows):
                    continue
                kind = "-other" if options.map else "-later" if options.later else ""
                folder = options.out / f"{name}-{start}-{seed}-{options.chairs}{kind}"
                scenario = PrepareScenario(base, [], 0, plan_file or base, np.inf)
                if not (known / "map.npz").exists():
                    run_mission(scenario, name=name, out_dir=known, max_time=LONGEST)
                if options.later:
                    then = folder.with_suffix(".yaml")
                    offices.write(int(name.removeprefix("office_")), then, np.random.default_rng([start, 5]))
                    scenario = PrepareScenario(base, [], 0, then, np.inf)
                scenario = elsewhere(scenario, options.chairs, np.random.default_rng([start, 3]))
                scenario.seed, scenario.explorer.known_map = 100 + 10 * start + seed, str(known.resolve())
                summary = run_mission(scenario, name=name, out_dir=folder, max_time=options.time).summary
                found, error = summary["changes"]["found_at_s"], summary["position_error_m"]
                row = which | {
                    "found_at_s": found,
                    "places": summary["changes"]["places"],
                    "wrong": found is not None and error["max"] > WRONG,
                    "outcome": summary["outcome"],
                    "error_m": error["mean"],
                    "nees": summary["online_pose_anees"],
                    "time_s": summary["sim_time_s"],
                }
                rows.append(row)
                with file.open("a") as out:
                    out.write(json.dumps(row) + "\n")
                print(*(f"{key} {value}" for key, value in row.items()), flush=True)
    print(f"\n{'world':16s} sessions found  wrong  median s  last s  position m  NEES")
    worlds_of = [row["world"].partition("_")[0] for row in rows]
    for name in dict.fromkeys(worlds_of):
        some = [row for row, world in zip(rows, worlds_of, strict=True) if world == name]
        at = np.array([row["found_at_s"] for row in some if row["found_at_s"] is not None] or [np.nan])
        error, nees = (np.mean([row[key] for row in some]) for key in ("error_m", "nees"))
        print(
            f"{name:16s} {len(some):8d} {np.count_nonzero(np.isfinite(at)):5d} {sum(row['wrong'] for row in some):6d}"
            f" {np.median(at):9.1f} {np.max(at):7.1f} {error:11.4f} {nees:5.2f}"
        )


if __name__ == "__main__":
    main()
