"""Advised tags against as many evenly spaced ones: the robot's position error at the same places of one drive.

    python benchmarks/tag_advice.py house
    python benchmarks/tag_advice.py house --world FILE --out runs/tag_advice

The even tags are those of `--tag-spacing`, as far apart as the rule allows: at most 4 m, and every place within 8 m of
two. The drive is one round of the floor by straight legs; where each ends the robot looks round, and its position as
estimated then is compared with the truth, at the first 50 places. Each seed is driven with either set of tags. A seed
is a row of DIR/NAME.jsonl; what is there is not driven again.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from tfg_drake.diagrams.methods import METHODS
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import ApplyWorldFile, LoadScenario, MakeWorld, MakeWorldConfig, Scenario
from tfg_drake.geometry.distance import point_distance
from tfg_drake.messages import FloatArray, replace
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.storage.run import load_run
from tfg_drake.storage.trajectory import poses_at
from tfg_drake.world.reachability import CELL, free_cells, make_grid, reachable_cells
from tfg_drake.world.tag_advice import advise_tags
from tfg_drake.world.tag_placement import place_tags
from tfg_drake.world.world import World

# The rule for evenly spaced tags: at most APART, m, apart, and from every place two of them within WITHIN, m.
APART, WITHIN = 4.0, 8.0
# PLACES: number of the drive's places that count. GOALS: number of its goals; the corners between them are places, too.
PLACES, GOALS = 50, 30
# ROOM: clearance of the drive from walls beyond the robot's radius, m. LEG: greatest length of a leg, m.
ROOM, LEG = 0.15, 3.0


def with_tags(world: World, p_WT: FloatArray, facing: FloatArray) -> World:
    """The world with these tags alone."""
    return replace(world, tag_ids=np.arange(len(p_WT)), p_WT=p_WT, tag_facing=facing)


def even_tags(world: World, radius: float) -> World:
    """The world with as few evenly spaced tags as the rule allows."""
    grid = make_grid(world)
    cells = grid.centers(reachable_cells(grid, world, radius))
    spacing = APART
    while True:
        ids, p_WT, facing = place_tags(world.walls, world.start, spacing, radius)
        if len(ids) >= 2 and cKDTree(p_WT).query(cells, k=2)[0][:, 1].max() <= WITHIN:
            return with_tags(world, p_WT, facing)
        spacing *= 0.9


def drive(world: World, radius: float) -> list[list[float]]:
    """Places of a round of the floor: goals as far apart as may be, each time the nearest that is left, the way cut
    into straight legs that are clear of walls."""
    grid = make_grid(world)
    mask = reachable_cells(grid, world, radius) & free_cells(grid, world.walls, radius + ROOM)
    cells = grid.centers(mask)
    tree = cKDTree(cells)
    pairs = tree.query_pairs(1.5 * CELL, output_type="ndarray")
    length = np.hypot(*(cells[pairs[:, 0]] - cells[pairs[:, 1]]).T)
    graph = coo_array((length, (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells))).tocsr()
    start = int(tree.query(world.start[:2])[1])
    way, before = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    far = np.where(np.isfinite(way), way, -1.0)
    goals: list[int] = []
    while len(goals) < GOALS:
        goals.append(int(np.argmax(far)))
        far = np.minimum(far, np.hypot(*(cells - cells[goals[-1]]).T))
    places, here, left = [], start, set(goals)
    while left:
        way, before = dijkstra(graph, directed=False, indices=here, return_predecessors=True)
        goal = min(left, key=lambda i: way[i])
        left.remove(goal)
        line = [goal]
        while line[-1] != here:
            line.append(int(before[line[-1]]))
        points = cells[line[::-1]]
        k = 0
        while k < len(points) - 1:
            last = k + 1
            while last + 1 < len(points) and clear(points[k], points[last + 1], world.walls, radius + ROOM - CELL):
                last += 1
            k = last
            places.append(points[k].round(3).tolist())
        here = goal
    return places


def clear(p: FloatArray, q: FloatArray, walls: FloatArray, room: float) -> bool:
    """Whether a straight leg from p to q is short enough and keeps this far from all walls, m."""
    length = float(np.hypot(*(q - p)))
    steps = np.linspace(0.0, 1.0, int(length / CELL) + 2)[:, None]
    return length <= LEG and bool(point_distance(p + steps * (q - p), walls).min() >= room)


def errors(scenario: Scenario, world: World, seed: int) -> FloatArray:
    """Position errors (PLACES,), m, of one drive, as known at the end of each look round."""
    scenario.world, scenario.seed = MakeWorldConfig(world), seed
    with tempfile.TemporaryDirectory() as folder:
        done = run_mission(scenario, method=METHODS["scripted"], out_dir=Path(folder) / "run", record=False)
        if len(done.stages) <= PLACES or done.summary["outcome"] == "fault":
            sys.exit(f"seed {seed}: {len(done.stages)} places: {done.summary['reason']}")
        run = load_run(done.folder)
    # Stage 1 is the first look.
    at = np.array([stage["time_s"] for stage in run.stages[1 : PLACES + 1]])
    off = poses_at(at, run.stamps, run.X_WB) - poses_at(at, run.true_stamps, run.X_WB_true)
    return np.hypot(off[:, 0], off[:, 1])


def main() -> None:
    """Drive what is missing, a row a seed, and print what it comes to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="house")
    parser.add_argument("--world", type=Path, default=None)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--out", type=Path, default=Path("runs/tag_advice"))
    options = parser.parse_args()
    scenario = LoadScenario(options.scenario)
    if options.world is not None:
        scenario = ApplyWorldFile(scenario, options.world)
    bare = with_tags(MakeWorld(scenario.world), np.zeros((0, 2)), np.zeros(0))
    even = even_tags(bare, scenario.robot.radius)
    mapper = PlanningParameters(scenario.robot, scenario.tags, scenario.odometry, scenario.explorer)
    advice = advise_tags(bare, len(even.tag_ids), mapper)
    advised = with_tags(bare, advice.p_WT, advice.facing)
    scenario.drive = drive(bare, scenario.robot.radius)
    name = options.world.name.partition(".")[0] if options.world is not None else options.scenario
    print(f"{name}: {len(even.tag_ids)} tags either way, a drive of {len(scenario.drive)} places", flush=True)

    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / f"{name}.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    for seed in range(options.seeds):
        if any(row["seed"] == seed for row in rows):
            continue
        row = {
            "seed": seed,
            "even": errors(scenario, even, seed).round(5).tolist(),
            "advised": errors(scenario, advised, seed).round(5).tolist(),
        }
        rows.append(row)
        with file.open("a") as opened:
            opened.write(json.dumps(row) + "\n")
        print(f"seed {seed}: {np.mean(row['even']):.4f} m even, {np.mean(row['advised']):.4f} m advised", flush=True)
    each = np.array([[np.mean(row["even"]), np.mean(row["advised"])] for row in rows])
    lower = 1.0 - each[:, 1].mean() / each[:, 0].mean()
    better = int(np.count_nonzero(each[:, 1] < each[:, 0]))
    print(
        f"{name}: mean position error {each[:, 0].mean():.4f} m even, {each[:, 1].mean():.4f} m advised:"
        f" {100.0 * lower:.0f} % lower, better in {better} of {len(each)} seeds"
    )


if __name__ == "__main__":
    main()
