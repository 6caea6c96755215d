"""`tfg-drake slam` on recordings and graphs: its CPU time and what comes of it, beside those of an older version.

    python benchmarks/recordings.py --data FOLDER --old CHECKOUT
    python benchmarks/recordings.py --seeds 5 --only park

FOLDER holds MR.CLAM's Dataset1, 2 and 6 in mrclam/ and TagSLAM's test_11 in tagslam/; what is missing is left out.
Victoria Park (6969 poses, 151 trees) comes with GTSAM. The `park` graphs are like it and made here: 2500 poses on a way
between places of a park, trees seen in x and y, loops closed by trees alone; of the `wrong` ones 3 % of the sightings
name another tree nearby. All graphs state dead reckoning; a `true` one states the truth, to tell which optimum is the
best. A row a case and version is kept in --rows as soon as it is there, and no row that is there is measured again.

The table: CPU s of all but the online estimator, of this version and the old one (--old, in a process of its own), and
their ratio; error (half chi square) of the graph that starts the solution, and of both solutions; RMSE, m, of the
smoothed trajectories and landmarks of both.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import gtsam
import numpy as np

from tfg_drake.datasets.g2o import read_g2o, write_g2o
from tfg_drake.datasets.pose_graph import PoseGraph, half_chi_square
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, replace

ROOT = Path(__file__).parents[1]
FIELDS = ("case", "version", "own_cpu_s", "start_error", "final_error", "robot_rmse_m", "landmark_rmse_m", "rejected")
# The park: number of POSES, SIDE of its square, m, number of TREES, number of PLACES on the way, length of a STEP, m.
POSES, SIDE, TREES, PLACES, STEP = 2500, 300.0, 200, 12, 0.9
# Deviations of a step in x, y, m, and heading, rad, and of a tree's x, y, m; range, m, and probability of a sighting.
STEP_SIGMA, TREE_SIGMA = np.array([0.05, 0.05, 0.02]), 0.3
REACH, SEEN = 25.0, 0.1
WRONG = 0.03


def dead_reckoned(graph: PoseGraph) -> PoseGraph:
    """The graph with the values of a robot that believes its odometry and a tree where it is seen first."""
    row = {int(i): k for k, i in enumerate(graph.pose_ids)}
    X_MB = np.zeros((len(row), 3))
    for (i, j), X_ij in zip(graph.edges.tolist(), graph.X_ij, strict=True):
        X_MB[row[j]] = se2.compose(X_MB[row[i]], X_ij)
    p_ML = np.empty((len(graph.landmark_ids), 2))
    for (i, j), p_BL in zip(graph.sightings[::-1].tolist(), graph.p_BL[::-1], strict=True):
        p_ML[np.searchsorted(graph.landmark_ids, j)] = se2.transform(X_MB[row[i]], p_BL)
    return replace(graph, X_MB=X_MB, p_ML=p_ML)


def chain(
    ids: IntArray,
    edges: IntArray,
    X_ij: FloatArray,
    step: FloatArray,
    sightings: IntArray,
    p_BL: FloatArray,
    tree: float,
) -> PoseGraph:
    """Poses of these ids in a chain; step (3,) and tree: variances of a step and of a tree's x and y."""
    trees = np.unique(sightings[:, 1])
    return PoseGraph(
        pose_ids=ids,
        X_MB=np.zeros((len(ids), 3)),
        landmark_ids=trees,
        p_ML=np.zeros((len(trees), 2)),
        fixed=ids[:1],
        edges=edges,
        X_ij=X_ij,
        edge_information=np.tile(np.diag(1.0 / step), (len(edges), 1, 1)),
        sightings=sightings,
        p_BL=p_BL,
        sighting_information=np.tile(np.eye(2) / tree, (len(sightings), 1, 1)),
    )


def victoria_park() -> PoseGraph:
    """GTSAM's copy of it, which gives variances."""
    lines = [line.split() for line in Path(gtsam.findExampleDataFile("victoria_park.txt")).read_text().splitlines()]
    steps = np.array([line[1:] for line in lines if line[0] == "ODOMETRY"], dtype=float)
    seen = np.array([line[1:] for line in lines if line[0] == "LANDMARK"], dtype=float)
    edges, sightings = steps[:, :2].astype(np.int64), seen[:, :2].astype(np.int64)
    variances = steps[0, [5, 8, 10]]
    graph = chain(np.unique(edges), edges, steps[:, 2:5], variances, sightings, seen[:, 2:4], float(seen[0, 4]))
    return dead_reckoned(graph)


def park(seed: int, wrong: float, true: bool) -> PoseGraph:
    """A drive between the park's places, with the values that dead reckoning or the truth gives."""
    rng = np.random.default_rng(seed)
    p_ML = rng.uniform(-0.5 * SIDE, 0.5 * SIDE, (TREES, 2))
    places = rng.uniform(-0.4 * SIDE, 0.4 * SIDE, (PLACES, 2))
    way, goal = [np.zeros(3)], places[0]
    for _ in range(POSES - 1):
        if np.hypot(*(goal - way[-1][:2])) < 6.0:
            goal = places[rng.integers(PLACES)]
        dx, dy = goal - way[-1][:2]
        turn = np.clip(se2.wrap_angle(math.atan2(dy, dx) - way[-1][2]), -0.15, 0.15) + 0.01 * rng.standard_normal()
        way.append(se2.compose(way[-1], np.array([STEP * math.cos(0.5 * turn), STEP * math.sin(0.5 * turn), turn])))
    X_MB = np.array(way)
    X_ij = se2.between(X_MB[:-1], X_MB[1:]) + STEP_SIGMA * rng.standard_normal((POSES - 1, 3))
    sightings, points = [], []
    for i, X in enumerate(X_MB):
        p_BL = se2.transform(se2.inverse(X), p_ML)
        for j in np.flatnonzero((p_BL[:, 0] > 0.0) & (np.hypot(*p_BL.T) < REACH) & (rng.random(TREES) < SEEN)):
            points.append(p_BL[j] + TREE_SIGMA * rng.standard_normal(2))
            near = np.argsort(np.hypot(*(p_ML - p_ML[j]).T))[1:4]
            sightings.append((i, POSES + (rng.choice(near) if rng.random() < wrong else j)))
    numbers = np.arange(POSES)
    edges = np.column_stack([numbers[:-1], numbers[1:]])
    graph = chain(numbers, edges, X_ij, STEP_SIGMA**2, np.array(sightings), np.array(points), TREE_SIGMA**2)
    if true:
        return replace(graph, X_MB=X_MB, p_ML=p_ML[graph.landmark_ids - POSES])
    return dead_reckoned(graph)


def cases(data: Path | None, seeds: int) -> Iterator[tuple[str, Path | Callable[[], PoseGraph], int | None]]:
    """Name; folder or what makes a graph; robot."""
    yield "victoria park", victoria_park, None
    for seed in range(seeds):
        for name, wrong in (("park", 0.0), ("park, wrong", WRONG)):
            yield f"{name}, {seed}", lambda seed=seed, wrong=wrong: park(seed, wrong, False), None
            yield f"{name}, true, {seed}", lambda seed=seed, wrong=wrong: park(seed, wrong, True), None
    if data is not None:
        for number in (1, 2, 6):
            folder = data / "mrclam" / f"Dataset{number}"
            for robot in range(1, 6):
                if folder.is_dir():
                    yield f"mrclam {number}, robot {robot}", folder, robot
        folder = data / "tagslam" / "test_11"
        if folder.is_dir():
            yield "tagslam test_11", folder, None


def measure(checkout: Path, dataset: Path, robot: int | None, out: Path) -> dict[str, object]:
    """Results of a version on a data set, in a process of its own."""
    command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "slam", str(dataset), "--out", str(out)]
    command += [] if robot is None else ["--robot", str(robot)]
    environment = os.environ | {"PYTHONPATH": str(checkout.resolve()), "OMP_NUM_THREADS": "1"}
    subprocess.run(command, cwd=out.parent, env=environment, check=True, stdout=subprocess.DEVNULL)
    summary = json.loads((out / "summary.json").read_text())
    return {
        "own_cpu_s": round(summary["cpu_time_s"] - (summary["online_cpu_s"] or 0.0), 3),
        "final_error": summary["final_error"],
        "robot_rmse_m": summary["robot_rmse_m"],
        "landmark_rmse_m": summary["landmark_rmse_without_misfits_m"],
        "rejected": summary["measurements_rejected"],
    }


def read_rows(file: Path) -> dict[tuple[str, str], dict[str, str]]:
    """Rows by case and version."""
    if not file.is_file():
        return {}
    with file.open(newline="") as lines:
        return {(row["case"], row["version"]): row for row in csv.DictReader(lines)}


def keep(file: Path, row: dict[str, object]) -> None:
    """Append a row."""
    new = not file.is_file()
    with file.open("a", newline="") as lines:
        writer = csv.DictWriter(lines, FIELDS)
        if new:
            writer.writeheader()
        writer.writerow(row)


def print_case(case: str, new: dict[str, str], old: dict[str, str]) -> None:
    """A line of the table."""

    def number(row: dict[str, str], key: str, form: str) -> str:
        return format(float(row[key]), form) if row.get(key) else "-"

    ratio = f"{float(old['own_cpu_s']) / float(new['own_cpu_s']):.1f}" if old else "-"
    cells = [number(new, "own_cpu_s", ".2f"), number(old, "own_cpu_s", ".2f"), ratio, number(new, "start_error", ".4g")]
    cells += [number(row, "final_error", ".7g") for row in (new, old)]
    cells += [number(row, key, ".4f") for key in ("robot_rmse_m", "landmark_rmse_m") for row in (new, old)]
    print(f"{case:22}" + "".join(f"{cell:>11}" for cell in cells), flush=True)


def main() -> None:
    """Measure what has no row yet and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--old", type=Path, help="the checkout of an older version")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--rows", type=Path, default=Path("recordings.csv"))
    options = parser.parse_args()
    versions = {"new": ROOT} | ({"old": options.old} if options.old else {})
    heads = ("CPU s", "old", "ratio", "start", "error", "old", "robot m", "old", "tags m", "old")
    print(f"{'case':22}" + "".join(f"{head:>11}" for head in heads))
    warm: set[tuple[str, bool]] = set()
    for case, source, robot in cases(options.data, options.seeds):
        if options.only not in case:
            continue
        for version, checkout in versions.items():
            if (case, version) in read_rows(options.rows) or (version == "old" and ", true" in case):
                continue
            with tempfile.TemporaryDirectory() as name:
                folder, start = Path(name), ""
                dataset = source
                if not isinstance(source, Path):
                    dataset = folder / "graph.g2o"
                    write_g2o(dataset, source())
                    start = half_chi_square(read_g2o(dataset))
                recording = isinstance(source, Path)
                if (version, recording) not in warm:  # The first run compiles.
                    (folder / "two.g2o").write_text("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n")
                    measure(checkout, dataset if recording else folder / "two.g2o", robot, folder / "warm")
                    warm.add((version, recording))
                row = measure(checkout, dataset, robot, folder / "run")
            keep(options.rows, {"case": case, "version": version, "start_error": start, **row})
        rows = read_rows(options.rows)
        print_case(case, rows[case, "new"], rows.get((case, "old"), {}))


if __name__ == "__main__":
    main()
