"""Coverage over the way on public office floors, by the protocol of MapEx (Ho et al., ICRA 2025), nearest and ours.

    python benchmarks/mapex.py FOLDER
    python benchmarks/mapex.py FOLDER --floors 50052749 --methods nearest exact --starts 1

FOLDER has floors as map_server maps, NAME.yaml, with NAME.valid.png, white where a cell counts, and NAME.json, the
starts. Whatever a method does, it is judged by its way: from a pose each 0.3 m MapEx's sensor, 20 m and 2500 rays all
round, sees cells of 0.1 m; coverage is the share of the cells that count, up to 300 m.

nearest: MapEx's, the centre of the nearest frontier region of more than ten cells, kept until it is within 1 m, on ways
over four neighbours that cost more near walls; exact pose. exact: `tfg` with that range, and errors of wheels, gyro and
scanner a hundredth of the data sheets'. ours: `tfg` with the sensors of `paper`, without tags, until it ends. tour: the
best tour of the known map that sees 99 % of the floor, with MapEx's sensor.

Each is a line of --out, and what is there is not run again. Area: mean coverage over 300 m; after a method's end it
stays. Closed: the share of the area between nearest and the tour that exact has, over the starts whose tour is enough:
from some no tour with room to all sides leaves the first room.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import results
from numba import njit
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from tfg_drake.diagrams.missions.best_tours import kept_tour
from tfg_drake.diagrams.scenario import PrepareScenario
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.storage.trajectory import read_tum

CELL, RANGE, RAYS = 0.1, 20.0, 2500
STEP, MOST = 0.3, 300.0
REGION, REACHED = 10, 1.0
# Path cost of a cell: NEAR up to DILATED cells from a wall, then below 2, falling to 1 at COSTLY cells from walls.
DILATED, NEAR, COSTLY = 3, 100.0, 10
SHARES = (0.5, 0.9, 0.95)
METHODS = ("nearest", "exact", "ours", "tour")
SENSOR = ("scan.range=20", f"scan.field_of_view={2 * math.pi}")
EXACT = (*SENSOR, "scan.noise=1.5e-4", "odometry.distance_noise=2e-4", "odometry.gyro_noise=5e-5")


@njit(cache=True)
def look(known: BoolArray, wall: BoolArray, x: float, y: float) -> None:
    """Marks the cells of a grid (h, w) that are seen from a place, in cells."""
    for k in range(RAYS):
        dx, dy = math.cos(2.0 * math.pi * k / RAYS), math.sin(2.0 * math.pi * k / RAYS)
        for i in range(int(2.0 * RANGE / CELL)):
            row, column = int(y + 0.5 * i * dy), int(x + 0.5 * i * dx)
            if not (0 <= row < known.shape[0] and 0 <= column < known.shape[1]):
                break
            known[row, column] = True
            if wall[row, column]:
                break


class Floor:
    """A floor. wall, valid: (h, w), row 0 at y = 0. starts: (4, 2) m."""

    def __init__(self, folder: Path, name: str) -> None:
        self.name, self.map = name, folder / f"{name}.yaml"
        self.wall = np.flipud(cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_GRAYSCALE) < 128).copy()
        self.valid = np.flipud(cv2.imread(str(folder / f"{name}.valid.png"), cv2.IMREAD_GRAYSCALE) >= 128).copy()
        self.starts = np.array(json.loads((folder / f"{name}.json").read_text())["starts_xy_m"])

    def coverage(self, way: FloatArray) -> FloatArray:
        """Coverage (n,) at each 0.3 m of a way (m, 2), m, that begins at its first point."""
        at = np.append(0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T)))
        known, covered = np.zeros_like(self.wall), []
        for s in np.arange(0.0, min(at[-1], MOST) + 1e-9, STEP):
            look(known, self.wall, np.interp(s, at, way[:, 0]) / CELL, np.interp(s, at, way[:, 1]) / CELL)
            covered.append(np.count_nonzero(known & self.valid) / np.count_nonzero(self.valid))
        return np.array(covered)


def ways_from(free: BoolArray, wall: BoolArray, cell: IntArray) -> tuple[IntArray, FloatArray, IntArray]:
    """Numbers (h, w) of the free cells, -1 for others; their costs (n,) from a cell, and predecessors (n,)."""
    number = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)
    away = ndimage.distance_transform_cdt(~wall, "chessboard")
    cost = np.where(away <= DILATED, NEAR, 1.0 + np.maximum(COSTLY - away, 0) / COSTLY)
    a, b, costs = [], [], []
    for first, second in (((slice(None), slice(0, -1)), (slice(None), slice(1, None))), (np.s_[:-1], np.s_[1:])):
        both = free[first] & free[second]
        a.append(number[first][both])
        b.append(number[second][both])
        costs.append(0.5 * (cost[first][both] + cost[second][both]))
    n = np.count_nonzero(free)
    graph = coo_array((np.concatenate(costs), (np.concatenate(a), np.concatenate(b))), shape=(n, n)).tocsr()
    far, before = dijkstra(graph, directed=False, indices=number[tuple(cell)], return_predecessors=True)
    return number, far, before


def nearest(floor: Floor, start: FloatArray) -> FloatArray:
    """The way (n, 2), m, of MapEx's nearest frontier."""
    known, at = np.zeros_like(floor.wall), np.floor(start[::-1] / CELL).astype(np.int64)
    way, goal, path = [at], None, []
    while STEP * (len(way) - 1) < MOST:
        look(known, floor.wall, at[1] + 0.5, at[0] + 0.5)
        free = known & ~floor.wall
        if goal is not None and np.hypot(*(goal - at)) * CELL <= REACHED:
            goal = None
        if goal is None or len(path) < 2:
            label, count = ndimage.label(free & ndimage.binary_dilation(~known), np.ones((3, 3)))
            size = np.bincount(label.ravel(), minlength=count + 1)
            big = [k for k in range(1, count + 1) if size[k] > REGION]
            number, far, before = ways_from(free, known & floor.wall, at)
            targets = []
            for k in big:
                cells = np.argwhere(label == k)
                centre = cells.mean(axis=0)
                target = cells[np.argmin(np.hypot(*(cells - centre).T))]
                if np.isfinite(far[number[tuple(target)]]) and np.hypot(*(target - at)) * CELL > REACHED:
                    targets.append((float(np.hypot(*(centre - at))), *target))
            if not targets:
                break
            goal = np.array(min(targets)[1:], dtype=np.int64)
            cells = np.argwhere(free)
            chain = [int(number[tuple(goal)])]
            while before[chain[-1]] >= 0:
                chain.append(int(before[chain[-1]]))
            path = list(cells[chain[::-1]])
        path = path[round(STEP / CELL) :] or path[-1:]
        at = path[0]
        way.append(at)
    return CELL * (np.array(way)[:, ::-1] + 0.5)


def mission(floor: Floor, start: FloatArray, settings: tuple[str, ...], folder: Path, most: float) -> dict[str, Any]:
    """The way of one of our missions, and its figures."""
    command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "explore", "paper", "--world", str(floor.map)]
    command += ["--tag-spacing", "none", f"--start={start[0]},{start[1]},0", "--headless", "--out", str(folder)]
    command += ["--max-time", str(most), *(part for one in settings for part in ("--set", one))]
    if not (folder / "summary.json").exists():
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if not (folder / "summary.json").exists():
            raise SystemExit(f"{folder}: {done.stderr.strip()[-300:]}")
    summary = json.loads((folder / "summary.json").read_text())
    told = {name: summary[name] for name in ("outcome", "explored_s", "online_pose_anees", "contacts")}
    return {"way": read_tum(folder / "truth.tum")[1][:, :2], "error_m": summary["position_error_m"]["mean"], **told}


def run(floor: Floor, start: int, method: str, out: Path) -> dict[str, Any]:
    """The line of one floor, start and method."""
    p, folder = floor.starts[start], out.with_suffix("") / f"{floor.name}-{start}-{method}"
    if method == "nearest":
        found: dict[str, Any] = {"way": nearest(floor, p)}
    elif method == "tour":
        scenario = PrepareScenario("paper", list(SENSOR), 0, str(floor.map), np.inf)
        scenario.world.start = [*p.tolist(), 0.0]
        tour = kept_tour(scenario, out.with_suffix("") / "tours", lambda line: None)
        found = {"way": tour.X_WB[:, :2], "is_enough": tour.is_enough}
    else:
        found = mission(floor, p, EXACT if method == "exact" else (), folder, 1000.0 if method == "exact" else 10_000.0)
    way = found.pop("way")
    covered = floor.coverage(way)
    length = float(np.hypot(*np.diff(way, axis=0).T).sum())
    row = {"floor": floor.name, "start": start, "method": method, "version": results.version(), "length_m": length}
    return row | found | {"coverage": covered.round(4).tolist()}


def area(row: dict[str, Any]) -> float:
    """Mean coverage over 300 m."""
    covered, n = row["coverage"], round(MOST / STEP) + 1
    return float(np.mean(covered[:n] + covered[-1:] * (n - len(covered))))


def reached(row: dict[str, Any], share: float) -> float:
    """When a share is covered, m; nan: never."""
    over = np.flatnonzero(np.array(row["coverage"]) >= share)
    return STEP * float(over[0]) if len(over) else math.nan


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--floors", nargs="+")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--starts", type=int, default=4)
    parser.add_argument("--out", type=Path, default=Path("runs/mapex.jsonl"))
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    rows = {(row["floor"], row["start"], row["method"]): row for row in lines}
    names = options.floors or sorted(file.stem for file in options.folder.glob("*.json"))
    for name in names:
        floor = Floor(options.folder, name)
        for start in range(options.starts):
            for method in options.methods:
                if (name, start, method) not in rows:
                    row = rows[name, start, method] = run(floor, start, method, options.out)
                    with options.out.open("a") as file:
                        file.write(json.dumps(row) + "\n")
                row = rows[name, start, method]
                at = " ".join(f"{reached(row, share):7.1f}" for share in SHARES)
                rest = " ".join(
                    f"{key} {row[key]}" for key in ("outcome", "error_m", "online_pose_anees") if key in row
                )
                print(
                    f"{name:18s} {start} {method:8s} area {area(row):.3f}; m to 50, 90, 95 %: {at} {rest}", flush=True
                )
    kept = [(name, start) for name in names for start in range(options.starts)]
    print(f"\n{len(kept)} starts  area, mean metres to 50, 90, 95 %; reached by")
    for method in options.methods:
        some = [rows[*which, method] for which in kept]
        at = np.array([[reached(row, share) for share in SHARES] for row in some])
        means = " ".join(f"{np.nanmean(column):6.1f}" if np.isfinite(column).any() else "   nan" for column in at.T)
        ends = Counter(row["outcome"] for row in some if "outcome" in row)
        ended = "".join(f"; {ends[name]} {name}" for name in sorted(ends))
        if "error_m" in some[0]:
            off, nees = (np.array([row[key] for row in some]) for key in ("error_m", "online_pose_anees"))
            ended += (
                f"; off by {off.mean():.3f} m (worst {off.max():.3f}), NEES {nees.mean():.2f} (worst {nees.max():.2f})"
            )
            ended += f", {sum(row['contacts'] for row in some)} contacts"
        print(f"{method:9s} {np.mean([area(row) for row in some]):.3f} {means}; {np.isfinite(at).sum(axis=0)}{ended}")
    areas = {m: np.mean([area(rows[*which, m]) for which in kept]) for m in options.methods}
    if {"nearest", "exact"} <= set(areas):
        print(f"exact over nearest {areas['exact'] / areas['nearest']:.3f}")
    if {"nearest", "exact", "tour"} <= set(areas):
        enough = [which for which in kept if rows[*which, "tour"]["is_enough"]]
        nearest, exact, tour = (sum(area(rows[*which, m]) for which in enough) for m in ("nearest", "exact", "tour"))
        print(f"closed {(exact - nearest) / (tour - nearest):.2f} from {len(enough)} starts")


if __name__ == "__main__":
    main()
