"""A robot that is moved behind its wheels' back: how soon it knows where it is again, and what the map suffers.

    python benchmarks/disturbances.py slip --seeds 50
    python benchmarks/disturbances.py kidnap --seeds 50 --scenario paper
    python benchmarks/disturbances.py carry --seeds 20 --scenario house house_real

Once a mission, at a random time after its third goal, the robot is put elsewhere and neither wheels nor gyro notice:
slip, 0.5 m in a random direction and 30 degrees; kidnap, any reachable pose with five mapped tags in view; carry, 3 m
in a random direction and 90 degrees, in the building without its tags. A row a seed: seconds with three mapped tags in
view, without tags all seconds, until the error of the online position stays below 0.1 m, without tags that of the pose
below 0.3 m and 0.1 rad, and until it does as seen from those tags, whose own places in the map may be off by as much;
the error after a minute, for how many of its seconds, but for the first ten, it was beyond 0.3 m and three stated
deviations, the landmarks' RMSE before and at the end, and whether the robot is put where its map has free space. A row
a scenario: how many find themselves within a minute, and of those put where the map is free; how many were falsely sure
of their position, and for how long at most. What is in --out is not run again.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator
from threadpoolctl import threadpool_limits

from tfg_drake.comparison.metrics import landmark_rmse
from tfg_drake.diagrams.mission_diagram import MakeMissionDiagram
from tfg_drake.diagrams.scenario import MakeWorld, PrepareScenario
from tfg_drake.geometry.alignment import align
from tfg_drake.geometry.distance import point_distance
from tfg_drake.geometry.se2 import between, compose, inverse, transform, wrap_angle
from tfg_drake.geometry.star import inside_any
from tfg_drake.simulation.differential_drive import THETA, X, Y
from tfg_drake.simulation.odometry import TRUTH
from tfg_drake.simulation.tag_sensor import visible_tags
from tfg_drake.world.reachability import CELL, make_grid, reachable_cells

SLIP, SLIP_ANGLE = 0.5, np.deg2rad(30.0)
CARRIED, CARRIED_ANGLE = 3.0, np.deg2rad(90.0)
# An estimate is false if SOON, s, after the robot was moved it is off by FALSE, m, and by DEVIATIONS stated deviations.
FALSE, DEVIATIONS, SOON = 0.3, 3.0, 10.0
ROOM = 0.1
FOUND, FOUND_WITHOUT_TAGS = (0.1, np.inf), (0.3, 0.1)
PATIENCE = 60.0


class Disturbed:
    """One mission, simulated in small steps."""

    def __init__(self, name: str, seed: int, bare: bool) -> None:
        """bare: the building of that scenario without its tags."""
        self.scenario = PrepareScenario(name, [], seed, *((name, np.inf) if bare else ()))
        self.world = MakeWorld(self.scenario.world)
        diagram, *_ = MakeMissionDiagram(self.scenario, self.world)
        self.simulator = Simulator(diagram)
        self.context = self.simulator.get_mutable_context()
        diagram.SetRandomContext(self.context, RandomGenerator(seed))
        self.explorer = diagram.GetSubsystemByName("explorer")
        station = diagram.GetSubsystemByName("station")
        self.plant = station.GetSubsystemByName("differential_drive_plant")
        self.odometry = station.GetSubsystemByName("odometry")
        self.rng = np.random.default_rng(seed)

    def port(self, name: str):
        """The explorer's message at a port."""
        return self.explorer.GetOutputPort(name).Eval(self.explorer.GetMyContextFromRoot(self.context))

    def pose(self) -> np.ndarray:
        """The true pose X_WB (3,)."""
        context = self.plant.GetMyContextFromRoot(self.context)
        return np.array(context.get_discrete_state_vector().value()[[X, Y, THETA]])

    def put(self, X_WB: np.ndarray) -> None:
        """Puts the robot elsewhere; its odometry takes that for where it was all along."""
        for system, rows in ((self.plant, [X, Y, THETA]), (self.odometry, [TRUTH, TRUTH + 1, TRUTH + 2])):
            context = system.GetMyMutableContextFromRoot(self.context)
            state = np.array(context.get_discrete_state_vector().value())
            state[rows] = X_WB
            context.SetDiscreteState(state)

    def advance(self, seconds: float) -> None:
        self.simulator.AdvanceTo(self.context.get_time() + seconds)

    def off(self) -> np.ndarray:
        """The error (2,) of the pose now, m and rad: the newest odometry message is a little older."""
        pose = self.port("pose")
        speed, rate = pose.speed * (self.context.get_time() - pose.stamp)
        X_WB = compose(self.world.start, compose(pose.X_MB, np.array([speed, 0.0, rate])))
        x, y, turn = between(self.pose(), X_WB)
        return np.abs([np.hypot(x, y), wrap_angle(turn)])

    def error(self) -> float:
        return float(self.off()[0])

    def is_mapped(self, X_WB: np.ndarray) -> bool:
        """Whether a place is in free space that the map has seen."""
        tfg, p_MB = self.port("tfg"), transform(inverse(self.world.start), X_WB[None, :2])
        return bool(inside_any(p_MB, tfg.star_offsets, tfg.star_vertices)[0])

    def is_false(self) -> bool:
        covariance = self.port("pose").covariance[:2, :2]
        return self.error() > max(FALSE, DEVIATIONS * float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])))

    def error_among_tags(self) -> float:
        """As seen from the mapped tags in view: nan with fewer than three."""
        estimate, X_WB = self.port("map"), self.pose()
        ids, row, _ = np.intersect1d(estimate.ids, self.in_view(X_WB), return_indices=True)
        if len(ids) < 3:
            return np.nan
        p_WT = self.world.p_WT[np.searchsorted(self.world.tag_ids, ids)]
        X_WM = align(p_WT, estimate.p_ML[row])
        return float(np.hypot(*(compose(X_WM, self.port("pose").X_MB)[:2] - X_WB[:2])))

    def mapped_in_view(self, X_WB: np.ndarray) -> int:
        return len(np.intersect1d(self.in_view(X_WB), self.port("map").ids))

    def in_view(self, X_WB: np.ndarray) -> np.ndarray:
        """Ids of the tags that the camera sees from a pose."""
        world, camera = self.world, self.scenario.tags
        reach = camera.range, camera.field_of_view, camera.max_incidence
        return world.tag_ids[visible_tags(world.p_WT, world.tag_facing, world.walls, X_WB, *reach)]

    def map_rmse(self) -> float:
        estimate = self.port("map")
        if not len(estimate.ids):
            return np.nan
        row = np.searchsorted(self.world.tag_ids, estimate.ids)
        return landmark_rmse(estimate.p_ML, transform(inverse(self.world.start), self.world.p_WT[row]))

    def place(self, kind: str) -> np.ndarray | None:
        """Where the robot is put, X_WB (3,): free of walls by ROOM; None where there is no such place."""
        here = self.pose()
        grid = make_grid(self.world)
        cells = grid.centers(reachable_cells(grid, self.world, self.scenario.robot.radius))
        for _ in range(500):
            if kind != "kidnap":
                far, turn = (SLIP, SLIP_ANGLE) if kind == "slip" else (CARRIED, CARRIED_ANGLE)
                direction = self.rng.uniform(-np.pi, np.pi)
                angle = self.rng.choice([-1.0, 1.0]) * turn
                there = here + np.array([far * np.cos(direction), far * np.sin(direction), angle])
                enough = kind == "slip" or float(np.hypot(*(cells - there[:2]).T).min()) < CELL
            else:
                there = np.append(cells[self.rng.integers(len(cells))], self.rng.uniform(-np.pi, np.pi))
                enough = self.mapped_in_view(there) >= 5
            room = point_distance(there[None, :2], self.world.walls)[0] - self.scenario.robot.radius
            if enough and room >= ROOM:
                return there
        return None


def run_seed(kind: str, name: str, seed: int) -> dict:
    """Figures of one mission."""
    with threadpool_limits(limits=1):
        run = Disturbed(name, seed, kind == "carry")
        while run.port("mission").stage < 3:
            run.advance(1.0)
        run.advance(float(run.rng.uniform(0.0, 60.0)))
        there = run.place(kind)
        if there is None:
            return {"seed": seed, "seconds": np.nan}
        before, mapped = run.map_rmse(), run.is_mapped(there)
        found = FOUND_WITHOUT_TAGS if kind == "carry" else FOUND
        run.put(there)
        in_view, lost_until, astray_until, elapsed, false = 0.0, 0.0, 0.0, 0.0, 0.0
        while in_view < PATIENCE and elapsed < 4.0 * PATIENCE and run.port("mission").phase != "done":
            run.advance(0.25)
            elapsed += 0.25
            in_view += 0.25 * (kind == "carry" or run.mapped_in_view(run.pose()) >= 3)
            false += 0.25 * (elapsed > SOON and run.is_false())
            if np.any(run.off() >= found):
                lost_until = in_view
            if run.error_among_tags() >= FOUND[0]:
                astray_until = in_view
        return {
            "seed": seed,
            "seconds": lost_until,
            "among_tags": astray_until,
            "error": run.error(),
            "false": false,
            "before": before,
            "after": run.map_rmse(),
            "mapped": mapped,
        }


KEYS = ("seconds", "among_tags", "error", "false", "before", "after", "mapped")


def main() -> None:
    """Run, print a row as each mission ends, then the worst."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", choices=["slip", "kidnap", "carry"])
    parser.add_argument("--scenario", nargs="+", default=["paper"])
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, help="A line of JSON a mission; what is there is not run again.")
    options = parser.parse_args()
    lines = options.out.read_text().splitlines() if options.out and options.out.exists() else []
    kept = {(r["kind"], r["scenario"], r["seed"]): r for r in map(json.loads, lines)}
    heads = ("found after s", "among tags s", "error m", "false s", "RMSE before m", "after m", "is mapped")
    print("seed" + "".join(f"{head:>14}" for head in heads), flush=True)
    results = {}
    for name in options.scenario:
        there = {seed: kept.get((options.kind, name, seed)) for seed in range(options.seeds)}
        results[name] = [r for r in there.values() if r]
        with ProcessPoolExecutor(options.jobs) as pool:
            jobs = [pool.submit(run_seed, options.kind, name, seed) for seed, r in there.items() if not r]
            for done in as_completed(jobs):
                r = {"kind": options.kind, "scenario": name} | done.result()
                results[name].append(r)
                figures = [f"{r.get(key, np.nan):>14.3f}" for key in KEYS]
                print(f"{r['seed']:>4}" + "".join(figures), flush=True)
                if options.out:
                    with options.out.open("a") as file:
                        file.write(json.dumps(r, default=float) + "\n")
    carried = options.kind == "carry"
    heads = ("missions", "found", "median s", *(("on the map", "found") if carried else ("among tags", "median s")))
    print(f"\n{f'{options.kind}, {PATIENCE:g} s':<14}" + "".join(f"{head:>12}" for head in (*heads, "false", "most s")))
    for name, rows in results.items():
        seconds, among, false, mapped = (
            np.array([r.get(key, missing) for r in rows], dtype=float)
            for key, missing in (("seconds", np.nan), ("among_tags", np.nan), ("false", 0.0), ("mapped", 0.0))
        )
        cells = [len(rows), (seconds < PATIENCE).sum(), f"{np.nanmedian(seconds):.1f}"]
        if carried:
            cells += [int(mapped.sum()), (seconds[mapped > 0.0] < PATIENCE).sum()]
        else:
            cells += [(among < PATIENCE).sum(), f"{np.nanmedian(among):.1f}"]
        cells += [np.count_nonzero(false), f"{false.max():.1f}"]
        print(f"{name:<14}" + "".join(f"{cell:>12}" for cell in cells))


if __name__ == "__main__":
    main()
