"""Recordings that went wrong for a while: RMSE of the online estimate with and without the fault.

    python benchmarks/recording_faults.py DATASET --robots 1 2 3 4 5

DATASET is an MR.CLAM folder with the robots' truth. A fault is put into its rows, a folder is written and read again:

    odometry lost   odometry rows of 10 s cut out
    ids swapped     the two barcodes seen most in 60 s exchanged for so long
    blind           measurement rows of 60 s cut out
    rows cut        odometry and measurement rows of 20 s cut out
    lifted          20 s in which the wheels stand and nothing is seen, while the robot goes on

Each begins at the shares --at of the run: 20 cases a fault with the five robots, about a second each. The first table:
online RMSE (m, where landmarks were in view) clean and faulty and their ratio; seconds from the third sighting after
the fault's end until the online error, aligned as the clean run is, stays under 0.3 m for ten seconds, inf where it
never does, nan where fewer sightings follow; RMSE of the online landmarks, clean and faulty; with --batch RMSE of the
batch smoother likewise. The second: of each fault median and worst of these, how many miss the bounds (ratio 1.3, 30
s), in how many of the latter the clean run takes as long from the same instant, and the ratio of the RMSE over all
cases.
"""

from __future__ import annotations

import argparse
import logging
import math
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from tfg_drake.datasets.batch_smoother import smooth
from tfg_drake.datasets.evaluation import landmark_error, robot_error
from tfg_drake.datasets.mrclam import load_mrclam
from tfg_drake.datasets.online import OnlineRun, run_online
from tfg_drake.datasets.recording import GroundTruth, Recording
from tfg_drake.datasets.rows import find_file, read_text
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray

# The robot is found again once its position error stays below FOUND, m, for STAYS, s.
FOUND, STAYS = 0.3, 10.0
# That time counts from the SIGHTINGS-th sighting after the fault. Bounds: on the ratio of RMSE, and on that time, s.
SIGHTINGS, MOST_RATIO, MOST_BACK = 3, 1.3, 30.0

# Maps odometry (n, 3), measurements (m, 4) and the fault's begin, s, to odometry and measurements with the fault.
Fault = Callable[[FloatArray, FloatArray, float], tuple[FloatArray, FloatArray]]


def within(rows: FloatArray, begin: float, seconds: float) -> np.ndarray:
    """(n,) whether a row's time lies in so many seconds from the begin."""
    return (rows[:, 0] >= begin) & (rows[:, 0] < begin + seconds)


def odometry_lost(odometry: FloatArray, seen: FloatArray, begin: float) -> tuple[FloatArray, FloatArray]:
    """The odometry without 10 s of its rows."""
    return odometry[~within(odometry, begin, 10.0)], seen


def ids_swapped(odometry: FloatArray, seen: FloatArray, begin: float) -> tuple[FloatArray, FloatArray]:
    """The measurements with two barcodes exchanged for 60 s."""
    wrong, seen = within(seen, begin, 60.0), seen.copy()
    codes, counts = np.unique(seen[wrong, 1], return_counts=True)
    if len(codes) > 1:
        a, b = codes[np.argsort(-counts, kind="stable")[:2]]
        code = seen[:, 1].copy()
        seen[wrong & (code == a), 1], seen[wrong & (code == b), 1] = b, a
    return odometry, seen


def blind(odometry: FloatArray, seen: FloatArray, begin: float) -> tuple[FloatArray, FloatArray]:
    """The measurements without 60 s of their rows."""
    return odometry, seen[~within(seen, begin, 60.0)]


def rows_cut(odometry: FloatArray, seen: FloatArray, begin: float) -> tuple[FloatArray, FloatArray]:
    """Both without 20 s of their rows."""
    return odometry[~within(odometry, begin, 20.0)], seen[~within(seen, begin, 20.0)]


def lifted(odometry: FloatArray, seen: FloatArray, begin: float) -> tuple[FloatArray, FloatArray]:
    """Wheels that stand for 20 s in which nothing is seen."""
    odometry = odometry.copy()
    odometry[within(odometry, begin, 20.0), 1:] = 0.0
    return odometry, seen[~within(seen, begin, 20.0)]


# The faults by name, and the duration of each, s.
FAULTS: dict[str, tuple[Fault, float]] = {
    "odometry lost": (odometry_lost, 10.0),
    "ids swapped": (ids_swapped, 60.0),
    "blind": (blind, 60.0),
    "rows cut": (rows_cut, 20.0),
    "lifted": (lifted, 20.0),
}


def read_rows(folder: Path, robot: int) -> tuple[FloatArray, FloatArray]:
    """A robot's odometry (n, 3) and measurements (m, 4) as they stand in the files."""
    names = (f"Robot{robot}_Odometry.dat", f"Robot{robot}_Measurement.dat")
    odometry, seen = (np.loadtxt(read_text(find_file(folder, name)).splitlines(), ndmin=2) for name in names)
    return odometry, seen


def with_fault(folder: Path, robot: int, fault: Fault, share: float) -> tuple[Recording, float]:
    """The recording with a fault that begins at a share of the run, and when that is, s."""
    odometry, seen = read_rows(folder, robot)
    begin = float((1.0 - share) * odometry[0, 0] + share * odometry[-1, 0])
    odometry, seen = fault(odometry, seen, begin)
    with tempfile.TemporaryDirectory() as name:
        copy = Path(name) / folder.name
        copy.mkdir()
        for file in ("Barcodes.dat", "Landmark_Groundtruth.dat", f"Robot{robot}_Groundtruth.dat"):
            shutil.copy(find_file(folder, file), copy)
        np.savetxt(copy / f"Robot{robot}_Odometry.dat", odometry, fmt="%.6f")
        np.savetxt(copy / f"Robot{robot}_Measurement.dat", seen, fmt="%.6f")
        return load_mrclam(copy, robot), begin


def seconds_until_found(truth: GroundTruth, X_WM: FloatArray, run: OnlineRun, after: float) -> float:
    """From a time on, s, until the error stays under FOUND for STAYS; inf where it never does."""
    late = (run.stamps >= after) & (run.stamps <= truth.stamps[-1])
    at = run.stamps[late]
    p_WB = np.column_stack([np.interp(at, truth.stamps, truth.X_WB[:, i]) for i in range(2)])
    good = np.hypot(*(se2.transform(X_WM, run.X_MB[late, :2]) - p_WB).T) < FOUND
    bad = at[~good]
    for stamp in at[good]:
        until = bad[bad > stamp]
        if not len(until) or until[0] - stamp >= STAYS:
            return float(stamp - after)
    return math.inf


class Figures(NamedTuple):
    """RMSE of the parts of a run, m; its online poses and their alignment X_WM (3,); s until it was right again, and
    how long the clean run took from there, nan without three sightings."""

    online: float
    landmarks: float
    batch: float
    run: OnlineRun
    X_WM: FloatArray
    back: float
    clean_back: float


def measure(recording: Recording, batch: bool, clean: Figures | None = None, end: float = math.inf) -> Figures:
    """The figures of a run. batch: with the batch smoother's. clean: those without the fault that ends at `end`, s."""
    truth = recording.truth
    if truth is None or not len(truth.stamps):
        raise SystemExit(f"{recording.name} comes without a truth to compare with.")
    online = run_online(recording)
    error = robot_error(truth, online.stamps[online.seen], online.X_MB[online.seen])
    landmarks = math.nan if online.map is None else landmark_error(truth, online.map.ids, online.map.p_ML).rmse
    smoothed, back, clean_back = math.nan, math.nan, math.nan
    if batch:
        way = online.stamps, online.X_MB
        solution = smooth(recording.odometry, recording.detections, recording.model, way=way)
        smoothed = robot_error(truth, solution.stamps, solution.X_MB).rmse
    sightings = [frame.stamp for frame in recording.detections for _ in frame.ids if frame.stamp >= end]
    if clean is not None and len(sightings) >= SIGHTINGS:
        after = sightings[SIGHTINGS - 1]
        back, clean_back = (seconds_until_found(truth, clean.X_WM, run, after) for run in (online, clean.run))
    return Figures(error.rmse, landmarks, smoothed, online, error.X_WM, back, clean_back)


def line(case: str, clean: Figures, faulty: Figures) -> str:
    """A row of the table of cases."""
    cells = f"{clean.online:>9.3f}{faulty.online:>9.3f}{faulty.online / clean.online:>8.2f}{faulty.back:>8.0f}"
    cells += f"{clean.landmarks:>11.3f}{faulty.landmarks:>9.3f}"
    if not math.isnan(faulty.batch):
        cells += f"{clean.batch:>11.3f}{faulty.batch:>9.3f}"
    return f"{case:40}{cells}"


def summary(fault: str, pairs: list[tuple[Figures, Figures]]) -> str:
    """A row of the table of faults, from runs without and with it."""
    clean, faulty = (np.array([one.online for one in runs]) for runs in zip(*pairs, strict=True))
    ratio = faulty / clean
    back, without = np.array([(one.back, one.clean_back) for _, one in pairs if not math.isnan(one.back)]).T
    cells = f"{len(pairs):>7}{np.median(ratio):>8.2f}{ratio.max():>8.2f}{np.count_nonzero(ratio > MOST_RATIO):>10}"
    cells += f"{np.sqrt(np.sum(faulty**2) / np.sum(clean**2)):>8.2f}"
    cells += f"{np.median(back):>10.0f}{back.max():>8.0f}{np.count_nonzero(back > MOST_BACK):>10}"
    cells += f"{np.count_nonzero((back > MOST_BACK) & (without > MOST_BACK)):>7}"
    return f"{fault:15}{cells}"


def main() -> None:
    """Measure all cases and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--at", type=float, nargs="+", default=[0.2, 0.4, 0.6, 0.8])
    parser.add_argument("--only", default="", help="faults whose name contains this")
    parser.add_argument("--batch", action="store_true", help="run the batch smoother, too")
    options = parser.parse_args()
    logging.getLogger("tfg_drake").setLevel(logging.ERROR)  # Each sighting left out is a line.
    heads = f"{'online':>9}{'faulty':>9}{'ratio':>8}{'back s':>8}{'tags':>11}{'faulty':>9}"
    heads += f"{'batch':>11}{'faulty':>9}" if options.batch else ""
    print(f"{'case':40}{heads}", flush=True)
    pairs: dict[str, list[tuple[Figures, Figures]]] = {kind: [] for kind in FAULTS if options.only in kind}
    for robot in options.robots:
        clean = measure(load_mrclam(options.dataset, robot), options.batch)
        for kind, found in pairs.items():
            fault, seconds = FAULTS[kind]
            for share in options.at:
                spoilt, begin = with_fault(options.dataset, robot, fault, share)
                faulty = measure(spoilt, options.batch, clean, begin + seconds)
                found.append((clean, faulty))
                print(line(f"{spoilt.name}, {kind} at {share:g}", clean, faulty), flush=True)
    heads = f"{'ratio':>8}{'worst':>8}{'over 1.3':>10}{'of all':>8}"
    heads += f"{'back s':>10}{'worst':>8}{'over 30 s':>10}{'clean':>7}"
    print(f"\n{'fault':15}{'cases':>7}{heads}")
    for kind, found in pairs.items():
        print(summary(kind, found))


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()
