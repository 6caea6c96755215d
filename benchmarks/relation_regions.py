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
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import scipy.linalg
from scipy.optimize import minimize
from scipy.stats import chi2

from tfg_drake.datasets.relations import off_relations, read_relations
from tfg_drake.geometry import se2
from tfg_drake.hardware.recordings import load_laser_recording
from tfg_drake.mapfile.saved_map import SavedMap, load_map
from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.dissection import DissectionSolver
from tfg_drake.slam.shared import SCANNER_X, SCANNER_Y, SCANNER_YAW
from tfg_drake.slam.solver import Values
from tfg_drake.slam.surface_fit import poses_by_surfaces
from tfg_drake.storage.trajectory import read_tum

SHARE = 0.9
# Standard deviation of a log's relations along an axis, m, as its authors state it.
TOLD = {"aces": 0.025 / math.sqrt(3.0)}


def run_of(data: Path, runs: Path, name: str) -> Path:
    """The folder of a log's run, made if it is absent or was interrupted."""
    folder = runs / name
    summary = folder / "summary.json"
    if not summary.exists() or json.loads(summary.read_text())["outcome"] == "interrupted":
        command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "slam", str(data / f"{name}.clf.bz2")]
        subprocess.run([*command, "--out", str(folder)], check=True, stdout=subprocess.DEVNULL)
    return folder


def stated(saved: SavedMap, starts: IntArray, X_MB: FloatArray, own: FloatArray, rows: IntArray) -> FloatArray:
    """(k, 3, 3) covariances of the poses in rows[:, 1] of a trajectory (n, 3) as seen from those in rows[:, 0]. starts:
    (g,) the row at which each view begins. own: (n, 3, 3) covariances of the poses given the keyframes' on either side.
    """
    graph = saved.graph
    solver = DissectionSolver(graph)
    system = solver.linearised(Values(graph.X_MN, graph.p_ML, graph.shared.mean, np.zeros(graph.p_ML.shape)), 0.0)
    nodes = solver.unknowns.node_at
    joint = np.zeros((3 * len(nodes), 3 * len(nodes)))
    joint[3:, 3:] = system.covariance((nodes[1:, None] + np.arange(3)).ravel())
    keyframes, first = np.unique(graph.view_keyframe, return_index=True)
    begin = np.append(starts[first], len(X_MB))
    at = np.clip(np.searchsorted(begin, rows, side="right") - 1, 0, len(keyframes) - 1)
    node, share = keyframes[at], np.clip((rows - begin[at]) / (begin[at + 1] - begin[at]), 0.0, 1.0)

    def moves(row: int, k: int) -> FloatArray:
        """(3, 3) how the pose in a row moves with a node."""
        x, y = X_MB[row, :2] - graph.X_MN[k, :2]
        return np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])

    def relative(a: int, b: int) -> FloatArray:
        """(3, 6) how the pose in row b as seen from that in row a moves with both."""
        c, s, (x, y) = math.cos(X_MB[a, 2]), math.sin(X_MB[a, 2]), X_MB[b, :2] - X_MB[a, :2]
        R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        return R @ np.hstack([-np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]]), np.eye(3)])

    covariances = np.empty((len(rows), 3, 3))
    for i, (ends, of, s) in enumerate(zip(rows, node, share, strict=True)):
        G, J = relative(*ends), np.zeros((3, 3 * len(nodes)))
        for j, (row, k) in enumerate(zip(ends, of, strict=True)):
            some = slice(3 * j, 3 * j + 3)
            A, D = moves(row, k), moves(row, k + 1)
            J[:, 3 * k : 3 * k + 3] += (1.0 - s[j]) * G[:, some] @ A
            J[:, 3 * k + 3 : 3 * k + 6] += s[j] * G[:, some] @ D
        of_scans = scipy.linalg.block_diag(*own[ends])
        covariances[i] = J @ joint @ J.T + G @ of_scans @ G.T
    return covariances


def held(name: str, data: Path, runs: Path) -> str:
    """How many of the judged relations of a log lie in their stated region."""
    folder = run_of(data, runs, name)
    saved, relations = load_map(folder), read_relations(data / f"{name}.relations.gz")
    recording = load_laser_recording(data / f"{name}.clf.bz2")
    # The trajectory has the log's own stamps, which told_stamps lead to those that are here.
    stamps, (_, X_MB) = np.array([scan.stamp for scan in recording.scans]), read_tum(folder / "trajectory.tum")
    far = se2.between(X_MB[None], saved.X_MA[:, None])
    starts = np.argmin(np.hypot(far[..., 0], far[..., 1]) + np.abs(far[..., 2]), axis=1)
    X_BS = saved.graph.shared.mean[[SCANNER_X, SCANNER_Y, SCANNER_YAW]]
    X_MS = se2.compose(se2.compose(X_MB, X_BS), recording.X_BS)
    times, error = off_relations(stamps, X_MS, relations, recording.told_stamps)
    rows = np.minimum(np.searchsorted(stamps, times), len(stamps) - 1)
    some, own_of = np.unique(rows), np.zeros((len(X_MB), 3, 3))
    _, own_of[some] = poses_by_surfaces(saved.graph, [recording.scans[row] for row in some], X_MB[some])
    covariance = stated(saved, starts, X_MB, own_of, rows)
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
    print(f"{name:<8}own {TOLD.get(name, sigma[0]):.4f} m, {sigma[1]:.4f} rad; stated {deviation:.4f} m", flush=True)
    return f"{np.mean(squared < chi2.ppf(SHARE, 3)):.3f} of {len(squared)} relations in {name}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--logs", default="aces,intel,fr079")
    options = parser.parse_args()
    shares = [held(name, options.data, options.runs) for name in options.logs.split(",")]
    print(f"\nin their stated region of {100 * SHARE:g} %: {', '.join(shares)}")


if __name__ == "__main__":
    main()
