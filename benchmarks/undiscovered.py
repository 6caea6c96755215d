"""Whether a room is undiscovered as often as is stated: missions cut at random, stated probabilities against outcomes.

    python benchmarks/undiscovered.py
    python benchmarks/undiscovered.py --rows house --seeds 2
    python benchmarks/undiscovered.py --fit

No world has tags. A mission is driven once and looked at where its map covers shares of the reachable floor that are
drawn between 30 and 95 %, as if it had been cut there, and at its end. Undiscovered is floor that no star polygon of
the TFG, placed in W, covers; a room is what a disc of the robot's radius sweeps there without leaving it, its middle on
connected cells that `world.reachability` says the robot can reach. Each mission is a line of --out (JSON) with the
openings of each cut and the largest such room, so that other constants are judged without driving again; what is there
is not run again. --fit prints the constants of `planning/undiscovered.py` that make the outcomes of the row "fitted"
most likely; the table has the other rows, and intervals (95 %) over missions drawn anew, as cuts of one are alike.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import offices
import results
from scipy import ndimage
from scipy.optimize import minimize

from tfg_drake.diagrams.missions.mission import Mission
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld, PrepareScenario, Scenario
from tfg_drake.geometry.se2 import inverse, transform
from tfg_drake.geometry.star import inside_any
from tfg_drake.io.files import write_atomic
from tfg_drake.messages import BoolArray, Roadmap
from tfg_drake.planning import undiscovered as model
from tfg_drake.planning.openings import Openings, find_openings
from tfg_drake.world.reachability import CELL, Grid, make_grid, reachable_cells

PLANS = Path("runs/undiscovered")
OFFICES, FITTED = "offices", "fitted"
# Seeds of each row; those of the offices are mostly small plans.
ROWS: dict[str, list[int]] = {
    FITTED: [0, 26, 130, 124, 138, 35, 30, 36],
    OFFICES: [100, 122, 55, 11, 148, 103, 132],
    "house": [40, 50, 51],
    "paper": [50],
}
LEAST, MOST, CUTS = 0.3, 0.95, 14
# LATE_CUTS more cuts, at shares from LATE to 1, are kept and fitted to, but counted apart.
LATE, LATE_CUTS = 0.88, 10
BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
DRAWN_ANEW = 1000


def scenario_of(row: str, seed: int) -> Scenario:
    """The scenario of a row's mission: without tags, and without a second look, which discovers nothing."""
    if row in (OFFICES, FITTED):
        offices.write(seed, PLANS / f"{seed}.yaml")
        scenario = LoadScenario(PLANS / f"{seed}.yaml")
        scenario.seed = seed
    else:
        scenario = PrepareScenario(row, seed=seed, tag_spacing=math.inf)
    scenario.explorer.revisit = False
    return scenario


def largest_room(cells: BoolArray, covered: BoolArray, radius: float) -> float:
    """The area, m^2, of the largest undiscovered room. cells, covered: (h, w) of a grid with sides of CELL, those that
    the middle of a robot of a radius, m, can reach, and those that are discovered."""
    label, _ = ndimage.label(cells & (ndimage.distance_transform_edt(~covered) * CELL >= radius), np.ones((3, 3)))
    swept, edge = [], math.ceil(radius / CELL)
    for number, (rows, columns) in enumerate(ndimage.find_objects(np.pad(label, edge)), start=1):
        window = np.pad(label, edge)[rows.start - edge : rows.stop + edge, columns.start - edge : columns.stop + edge]
        swept.append(np.count_nonzero(ndimage.distance_transform_edt(window != number) * CELL <= radius))
    return CELL**2 * max(swept, default=0)


class Looks:
    """Looks at a map where it first covers each of some shares of the floor. moments: what was found."""

    def __init__(self, scenario: Scenario, rng: np.random.Generator) -> None:
        self.scenario, self.world = scenario, MakeWorld(scenario.world)
        self.grid: Grid = make_grid(self.world)
        self.cells = reachable_cells(self.grid, self.world, scenario.robot.radius)
        self.places = self.grid.centers(np.ones(self.grid.shape, dtype=np.bool_))
        self.floor = self.grid.centers(self.cells)[::16]
        cuts = [(share, "cut") for share in rng.uniform(LEAST, MOST, CUTS)]
        self.due = sorted(cuts + [(share, "late") for share in rng.uniform(LATE, 1.0, LATE_CUTS)])
        self.stage, self.moments = 0, []

    def __call__(self, mission: Mission) -> None:
        """Looks where a share is due and the newest stage is all planned."""
        tfg = mission.tfg
        if tfg is not None and tfg.stage != self.stage and mission.status.phase not in ("map", "choose"):
            self.stage = tfg.stage
            places = transform(inverse(mission.X_WM), self.floor)
            share = float(inside_any(places, tfg.star_offsets, tfg.star_vertices).mean())
            if kind := self.kind_at(share):
                self.look_at(mission, share, kind)

    def kind_at(self, share: float) -> str:
        """The kind of cut that is due where this share of the floor is covered, "" for none."""
        kinds = [kind for at, kind in self.due if at <= share]
        self.due = self.due[len(kinds) :]
        return min(kinds, default="")

    def look_at(self, mission: Mission, share: float, kind: str) -> None:
        """Notes the openings of a mission's map and the largest room that it lacks."""
        tfg, places = mission.tfg, transform(inverse(mission.X_WM), self.places)
        roadmap, p_MB = mission.look("roadmap", Roadmap), mission.pose.X_MB[:2]
        covered = inside_any(places, tfg.star_offsets, tfg.star_vertices).reshape(self.grid.shape)
        robot = self.scenario.robot
        found = find_openings(tfg, roadmap, p_MB, robot, self.scenario.view)
        kept = {name: getattr(found, name).round(3).tolist() for name in Openings.__annotations__}
        largest = largest_room(self.cells, covered, robot.radius)
        self.moments.append({"kind": kind, "share": share, "stage": tfg.stage, "largest_m2": largest, **kept})


def run(row: str, seed: int) -> dict[str, Any]:
    """The line of one mission."""
    scenario = scenario_of(row, seed)
    looks, observe = Looks(scenario, np.random.default_rng([seed, 1])), Mission.observe

    def observed(mission: Mission) -> None:
        observe(mission)
        looks(mission)

    with tempfile.TemporaryDirectory() as folder, mock.patch.object(Mission, "observe", observed):
        result = run_mission(scenario, out_dir=Path(folder) / "run", record=False)
        looks.look_at(result.mission, math.nan, "end")
    told = {"world": row, "seed": seed, "version": results.version(), "outcome": result.summary["outcome"]}
    return told | {"moments": looks.moments}


def openings_of(moment: dict[str, Any]) -> Openings:
    """The openings of a cut as they are kept in its line."""
    arrays = {name: np.array(moment[name]) for name in Openings.__annotations__}
    return Openings(**(arrays | {"p": arrays["p"].reshape(-1, 2), "why": arrays["why"].astype(np.int64)}))


def judged(lines: list[dict[str, Any]], kinds: tuple[str, ...]) -> Iterator[tuple[int, float, float, bool]]:
    """A row for each cut of some kinds and each area: the mission's number, area (m^2), stated probability, outcome."""
    for mission, line in enumerate(lines):
        for moment in line["moments"]:
            if moment["kind"] in kinds:
                stated = model.undiscovered(openings_of(moment))
                for area, probability in zip(model.AREAS, stated, strict=True):
                    yield mission, area, float(probability), moment["largest_m2"] >= area


def table(lines: list[dict[str, Any]], kinds: tuple[str, ...], areas: tuple[float, ...]) -> None:
    """Prints the bins of what was stated of rooms of some areas, m^2."""
    rows = np.array(list(judged(lines, kinds)))
    rng = np.random.default_rng(0)
    print(f"{'area':>8s} {'stated':>12s} {'cuts':>6s} {'mean stated':>12s} {'were there':>11s} {'95 %':>14s}")
    for area in areas:
        some = rows[rows[:, 1] == area]
        for low, high in itertools.pairwise(BINS):
            ours = some[(some[:, 2] >= low) & ((some[:, 2] < high) | (high == 1.0))]
            if not len(ours):
                continue
            sums = np.array([[ours[ours[:, 0] == k, 3].sum(), (ours[:, 0] == k).sum()] for k in range(len(lines))])
            anew = sums[rng.integers(len(lines), size=(DRAWN_ANEW, len(lines)))].sum(axis=1)
            shares = anew[anew[:, 1] > 0, 0] / anew[anew[:, 1] > 0, 1]
            interval = "{:.2f} to {:.2f}".format(*np.percentile(shares, [2.5, 97.5]))
            print(
                f"{f'{area:g} m2':>8s} {f'{low:g} to {high:g}':>12s} {len(ours):6d} {ours[:, 2].mean():12.2f}"
                f" {ours[:, 3].mean():11.2f} {interval:>14s}"
            )


def all_areas(lines: list[dict[str, Any]], kinds: dict[str, str]) -> None:
    """Prints the bins of rooms of all areas, columns for each kind of cut: how many, stated on average, were there."""
    print(f"{len(lines)} missions " + "".join(f"{when:>26s}" for when in kinds.values()))
    print(f"{'stated':>11s} " + f"{'n':>10s}{'mean':>8s}{'there':>8s}" * len(kinds))
    each = [np.array(list(judged(lines, (kind,)))) for kind in kinds]
    for low, high in itertools.pairwise(BINS):
        of_bin = [some[(some[:, 2] >= low) & ((some[:, 2] < high) | (high == 1.0))] for some in each]
        cells = [
            f"{len(one):10d}{one[:, 2].mean():8.2f}{one[:, 3].mean():8.2f}" if len(one) else 26 * " " for one in of_bin
        ]
        print(f"{f'{low:g} to {high:g}':>11s} " + "".join(cells))


def fit(lines: list[dict[str, Any]]) -> None:
    """Prints the constants that make the outcomes most likely, each mission of one weight, under a wide prior."""
    names = ("BIAS", "BY_UNKNOWN", "BY_WIDTH", "IMPASSABLE", "NO_OPENING")
    before = np.array([getattr(model, name) for name in names])
    before[4] = math.log(before[4] / (1.0 - before[4]))

    def cost(constants: np.ndarray) -> float:
        values = [*constants[:4], 1.0 / (1.0 + math.exp(-constants[4]))]
        with mock.patch.multiple(model, **dict(zip(names, values, strict=True))):
            rows = np.array(list(judged(lines, ("cut", "late"))))
        stated = np.clip(rows[:, 2], 1e-6, 1.0 - 1e-6)
        prior = np.square((constants - [0.0, 0.0, 0.0, -5.0, -5.0]) / [3.0, 1.0, 1.0, 3.0, 2.0]).sum()
        return 0.5 * float(prior) - float(np.where(rows[:, 3] > 0, np.log(stated), np.log(1.0 - stated)).sum())

    best = minimize(cost, before, method="Nelder-Mead", options={"maxiter": 400, "xatol": 0.01, "fatol": 0.01})
    values = [*best.x[:4], 1.0 / (1.0 + math.exp(-best.x[4]))]
    print(", ".join(names), "=", ", ".join(f"{value:.3g}" for value in values))


def main() -> None:
    """Run what is missing, then print the table, or the fit."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="+", choices=list(ROWS), default=list(ROWS))
    parser.add_argument("--seeds", type=int, help="Of each row at most.")
    parser.add_argument("--out", type=Path, default=Path("runs/undiscovered.jsonl"))
    parser.add_argument("--fit", action="store_true")
    options = parser.parse_args()
    lines = [json.loads(text) for text in options.out.read_text().splitlines()] if options.out.exists() else []
    options.out.parent.mkdir(parents=True, exist_ok=True)
    done = {(line["world"], line["seed"]) for line in lines}
    wanted = [(row, seed) for row in options.rows for seed in ROWS[row][: options.seeds]]
    for row, seed in wanted:
        if (row, seed) not in done:
            lines.append(run(row, seed))
            write_atomic(options.out, "".join(json.dumps(line) + "\n" for line in lines))
            print(f"{row}, seed {seed}: {lines[-1]['outcome']}, {len(lines[-1]['moments'])} cuts", flush=True)
    lines = [line for line in lines if (line["world"], line["seed"]) in wanted]
    if options.fit:
        fit([line for line in lines if line["world"] == FITTED])
        return
    others = [line for line in lines if line["world"] != FITTED]
    kinds = {"cut": "cut between 30 and 95 %", "late": "cut between 88 and 100 %", "end": "at the end"}
    for kind, when in kinds.items():
        print(f"\n{len(others)} missions, {when}, each area")
        table(others, (kind,), model.AREAS)
    print()
    all_areas(others, kinds)


if __name__ == "__main__":
    main()
