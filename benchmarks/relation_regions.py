"""Regions that SLAM on raw laser logs states for relations between poses, held against those checked by hand.

    python benchmarks/relation_regions.py DATA RUNS --logs aces,intel,fr079

DATA as of `relations.py`. RUNS/NAME has the run of `tfg-drake slam DATA/NAME.clf.bz2 --out RUNS/NAME`, made if absent.
A relation's region is of its joint covariance in the keyframe graph and of the relation's own error: deviations, m an
axis and rad, by which every second relation is likeliest. Printed are they, the share of the other relations within
their region of 90 %, and the median of their stated deviation, m. For `aces`, whose relations were set by hand on a
screen, the deviation of an axis is that of +-2.5 cm, as its authors say.
"""

from __future__ import annotations

import argparse
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.stats import chi2

from tfg_drake.datasets.relations import Relations, read_relations
from tfg_drake.geometry import se2
from tfg_drake.hardware.recordings import load_dataset
from tfg_drake.mapfile.saved_map import SavedMap, load_map
from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.dissection import DissectionSolver
from tfg_drake.slam.shared import SCANNER_X, SCANNER_Y, SCANNER_YAW
from tfg_drake.slam.solver import Values
from tfg_drake.storage.trajectory import read_tum

SHARE = 0.9
# Deviation of an axis, m, of relations of which it is told.
TOLD = {"aces": 0.025 / math.sqrt(3.0)}


def run_of(data: Path, runs: Path, name: str) -> Path:
    """The folder of a log's run, made if it is absent."""
    folder = runs / name
    if not (folder / "summary.json").exists():
        command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "slam", str(data / f"{name}.clf.bz2")]
        subprocess.run([*command, "--out", str(folder)], check=True, stdout=subprocess.DEVNULL)
    return folder


def stated(saved: SavedMap, starts: IntArray, X_MB: FloatArray, rows: IntArray) -> FloatArray:
    """(k, 3, 3) covariances of the poses in rows[:, 1] of a trajectory (n, 3) as seen from those in rows[:, 0]. starts:
    (g,) the row at which each view begins."""
    graph = saved.graph
    solver = DissectionSolver(graph)
    system = solver.linearised(Values(graph.X_MN, graph.p_ML, graph.shared.mean, np.zeros(graph.p_ML.shape)), 0.0)
    nodes = solver.unknowns.node_at
    joint = np.zeros((3 * len(nodes), 3 * len(nodes)))
    joint[3:, 3:] = system.covariance((nodes[1:, None] + np.arange(3)).ravel())
    view = np.searchsorted(starts, rows, side="right") - 1
    node = graph.view_keyframe[np.maximum(view, 0)]
    covariances = np.empty((len(rows), 3, 3))
    for i, ((first, second), (a, b)) in enumerate(zip(node, rows, strict=True)):
        at = np.concatenate([3 * first + np.arange(3), 3 * second + np.arange(3)])
        # The robot moves with its keyframe's frame, and turns about that.
        J = np.zeros((3, 6))
        R = np.array([[math.cos(X_MB[a, 2]), math.sin(X_MB[a, 2])], [-math.sin(X_MB[a, 2]), math.cos(X_MB[a, 2])]])
        for column, k, row, sign in ((0, first, a, -1.0), (3, second, b, 1.0)):
            arm = X_MB[row, :2] - graph.X_MN[k, :2]
            J[:2, column : column + 2] = sign * R
            J[:2, column + 2] = sign * R @ [-arm[1], arm[0]]
            J[2, column + 2] = sign
        way = X_MB[b, :2] - X_MB[a, :2]
        J[:2, 2] -= R @ [-way[1], way[0]]
        covariances[i] = J @ joint[np.ix_(at, at)] @ J.T
    return covariances


def held(name: str, data: Path, runs: Path) -> str:
    """What is printed of a log."""
    folder = run_of(data, runs, name)
    saved, relations = load_map(folder), read_relations(data / f"{name}.relations.gz")
    recording = load_dataset(data / f"{name}.clf.bz2")
    stamps, X_MB = read_tum(folder / "trajectory.tum")
    rows = _rows(recording.told_stamps, stamps, relations)
    far = se2.between(X_MB[None], saved.X_MA[:, None])
    starts = np.argmin(np.hypot(far[..., 0], far[..., 1]) + np.abs(far[..., 2]), axis=1)
    X_BS = saved.graph.shared.mean[[SCANNER_X, SCANNER_Y, SCANNER_YAW]]
    X_MS = se2.compose(se2.compose(X_MB, X_BS), recording.X_BS)
    error = relations.X_12 - se2.between(X_MS[rows[:, 0]], X_MS[rows[:, 1]])
    error[:, 2] = se2.wrap_angle(error[:, 2])
    covariance = stated(saved, starts, X_MB, rows)
    fitted, judged = slice(0, None, 2), slice(1, None, 2)

    def unlikely(logarithms: FloatArray) -> float:
        total = covariance[fitted] + own(np.exp(logarithms))
        squared = np.einsum("ki,kij,kj->k", error[fitted], np.linalg.inv(total), error[fitted])
        return float(np.sum(squared + np.linalg.slogdet(total)[1]))

    def own(sigma: FloatArray) -> FloatArray:
        axis = TOLD.get(name, sigma[0])
        return np.diag([axis**2, axis**2, sigma[1] ** 2])

    sigma = np.exp(minimize(unlikely, np.log([0.02, 0.005]), method="Nelder-Mead").x)
    total = covariance[judged] + own(sigma)
    squared = np.einsum("ki,kij,kj->k", error[judged], np.linalg.inv(total), error[judged])
    deviation = np.sqrt(np.median(np.trace(covariance[judged, :2, :2], axis1=1, axis2=2) / 2.0))
    return (
        f"{name:<8}own {TOLD.get(name, sigma[0]):.4f} m, {sigma[1]:.4f} rad; stated {deviation:.4f} m; "
        f"{np.mean(squared < chi2.ppf(SHARE, 3)):.3f} of {len(squared)} within their region"
    )


def _rows(told_stamps: FloatArray | None, stamps: FloatArray, relations: Relations) -> IntArray:
    """(k, 2) rows of a trajectory that are nearest to the relations' times."""
    times = relations.times
    if told_stamps is not None and len(told_stamps):
        told, here = told_stamps[np.argsort(told_stamps[:, 0], kind="stable")].T
        times = here[np.clip(np.searchsorted(told, times - 1e-3), 0, len(told) - 1)]
    after = np.clip(np.searchsorted(stamps, times), 1, len(stamps) - 1)
    return np.asarray(after - (times - stamps[after - 1] < stamps[after] - times))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--logs", default="aces,intel,fr079")
    options = parser.parse_args()
    for name in options.logs.split(","):
        print(held(name, options.data, options.runs), flush=True)


if __name__ == "__main__":
    main()
