"""One map over many sessions in a building that changes between them, each beside a fresh map of the same building.

    python benchmarks/sessions.py --sessions 10 --scenario house

Before each session one tag in twenty is put elsewhere on a wall, 0.3 m away or farther, and a chair stands in another
place; the robot starts elsewhere, and begins with the map of the session before. A row a session: when it found itself,
s; outcome; tags moved, and moves told, rightly and falsely; pieces of surface told as new and gone; RMSE, that of a
fresh map, NEES of the online pose; the map's bytes. Goes on where it ended.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

import numpy as np

from tfg_drake.config import TagConfig
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import MakeWorld, PrepareScenario, Scenario
from tfg_drake.geometry.distance import point_distance
from tfg_drake.world.reachability import make_grid, reachable_cells
from tfg_drake.world.tag_placement import place_tags

SHARE, FAR, APART = 0.05, 0.3, 0.25
CHAIR, ROOM = 0.4, 0.8


def chair(p_WC: np.ndarray) -> list[list[float]]:
    """The outline of a chair at a place (2,), m."""
    x, y = (float(value) - 0.5 * CHAIR for value in p_WC)
    corners = [(x, y), (x + CHAIR, y), (x + CHAIR, y + CHAIR), (x, y + CHAIR)]
    return [[*a, *b] for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]


def changed(scenario: Scenario, tags: list[TagConfig], rng: np.random.Generator) -> tuple[Scenario, set[int]]:
    """The building as the robot finds it, some of its tags moved, a chair, another start; the ids moved."""
    bare = MakeWorld(scenario.world)
    radius = scenario.robot.radius
    _, places, facing = place_tags(bare.walls, bare.start, 0.35, radius)
    grid = make_grid(bare)
    free = grid.centers(reachable_cells(grid, bare, radius))
    free = free[point_distance(free, bare.walls) > ROOM]
    at, start = free[rng.integers(len(free))], None
    while start is None or np.hypot(*(start - at)) < 1.5:
        start = free[rng.integers(len(free))]
    moved = rng.choice(len(tags), max(1, round(SHARE * len(tags))), replace=False)
    for k in moved:
        taken = np.array([tag.position for j, tag in enumerate(tags) if j != k])
        off = np.hypot(*(places - tags[k].position).T)
        beside = np.hypot(*(places[:, None] - taken).transpose(2, 0, 1)).min(axis=1)
        row = rng.choice(np.flatnonzero((off > FAR) & (beside > APART)))
        tags[k] = TagConfig(tags[k].id, places[row].tolist(), float(facing[row]))
    world = dataclasses.replace(
        scenario.world,
        walls=[*scenario.world.walls, *chair(at)],
        tags=list(tags),
        start=[*start.tolist(), float(rng.uniform(-np.pi, np.pi))],
    )
    return dataclasses.replace(scenario, world=world), {tags[k].id for k in moved}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=10)
    parser.add_argument("--scenario", default="house")
    parser.add_argument("--out", type=Path, default=Path("runs/sessions"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows = options.out / f"{options.scenario}.jsonl"
    done = [json.loads(line) for line in rows.read_text().splitlines()] if rows.exists() else []
    original = PrepareScenario(options.scenario)
    tags = list(original.world.tags)
    for session in range(options.sessions + 1):
        rng = np.random.default_rng(session)
        scenario, moved = changed(original, tags, rng) if session else (original, set())
        scenario.seed = session
        if session < len(done):
            continue
        folder = options.out / f"{options.scenario}-{session}"
        fresh = run_mission(scenario, name=options.scenario, out_dir=Path(f"{folder}-fresh")).summary
        if session:
            known = str((options.out / f"{options.scenario}-{session - 1}").resolve())
            explorer = dataclasses.replace(scenario.explorer, known_map=known)
            scenario = dataclasses.replace(scenario, explorer=explorer)
        summary = run_mission(scenario, name=options.scenario, out_dir=folder).summary
        changes = summary["changes"] or {"found_at_s": 0.0, "tags_moved": [], "surfaces_new": [], "surfaces_gone": []}
        told = set(changes["tags_moved"])
        row = {
            "session": session,
            "found_at_s": changes["found_at_s"],
            "outcome": summary["outcome"],
            "moved": len(moved),
            "told": len(told & moved),
            "false": sorted(told - moved),
            "missed": sorted(moved - told),
            "new": len(changes["surfaces_new"]),
            "gone": len(changes["surfaces_gone"]),
            "tags": f"{summary['landmarks_mapped']} of {summary['landmarks_reachable']}",
            "rmse_m": summary["landmark_rmse_m"],
            "fresh_rmse_m": fresh["landmark_rmse_m"],
            "nees": summary["online_pose_anees"],
            "time_s": summary["sim_time_s"],
            "fresh_time_s": fresh["sim_time_s"],
            "map_bytes": summary["map_bytes"],
        }
        with rows.open("a") as file:
            file.write(json.dumps(row) + "\n")
        done.append(row)
        print(*(f"{key} {value}" for key, value in row.items()), flush=True)
    print("\nsessions  last found s  moved  told rightly  falsely  RMSE m  of a fresh map m  NEES")
    later = done[1:]
    found = max(np.inf if row["found_at_s"] is None else row["found_at_s"] for row in later)
    rmse, fresh, nees = (np.mean([row[key] for row in later]) for key in ("rmse_m", "fresh_rmse_m", "nees"))
    moved, told = (sum(row[key] for row in later) for key in ("moved", "told"))
    false = sum(len(row["false"]) for row in later)
    print(f"{len(later):8d} {found:13.1f} {moved:6d} {told:13d} {false:8d} {rmse:7.4f} {fresh:17.4f} {nees:5.2f}")


if __name__ == "__main__":
    main()
