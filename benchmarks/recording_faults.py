"""What a recording that went wrong for a while does to the online estimate: RMSE with and without the fault.

    python benchmarks/recording_faults.py DATASET --robots 1 2 3 4 5

DATASET is an MR.CLAM folder with the robots' truth. A fault is put into its rows, a folder is written and read again:

    odometry lost   odometry rows of 10 s cut out
    ids swapped     the two barcodes seen most in 60 s exchanged for so long
    blind           measurement rows of 60 s cut out
    rows cut        odometry and measurement rows of 20 s cut out
    lifted          20 s in which the wheels stand and nothing is seen, while the robot goes on

Each begins at the shares --at of the run. A row a case is kept in --rows as soon as it is there, and no row that is
there is measured again. The table: online RMSE (m, where landmarks were in view) clean and faulty and their ratio;
seconds from the fault's end until the online error, aligned as the clean run is, stays under 0.3 m for ten seconds,
"-" where it never does; RMSE of the batch smoother, clean and faulty, and of the online landmarks likewise.
"""

from __future__ import annotations

import argparse
import csv
import logging
import math
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from tfg_drake.datasets.evaluation import landmark_error, robot_error
from tfg_drake.datasets.mrclam import load_mrclam
from tfg_drake.datasets.online import OnlineRun, run_online
from tfg_drake.datasets.recording import GroundTruth, Recording
from tfg_drake.datasets.text import find_file, read_text
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray
from tfg_drake.slam.batch_smoother import smooth

FIELDS = ("case", "online_m", "online_landmarks_m", "batch_m", "back_s")
# The error that counts as found again, m, and for how long it must stay below, s.
FOUND, STAYS = 0.3, 10.0

# Rows (n, 3) of odometry and (m, 4) of measurements, and the fault's begin, s, to both with the fault.
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


# What is done, and how long it lasts, s.
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
    """From a time on, s, until the error stays under FOUND for STAYS; nan where it never does."""
    late = (run.stamps >= after) & (run.stamps <= truth.stamps[-1])
    at = run.stamps[late]
    p_WB = np.column_stack([np.interp(at, truth.stamps, truth.X_WB[:, i]) for i in range(2)])
    good = np.hypot(*(se2.transform(X_WM, run.X_MB[late, :2]) - p_WB).T) < FOUND
    bad = at[~good]
    for stamp in at[good]:
        until = bad[bad > stamp]
        if not len(until) or until[0] - stamp >= STAYS:
            return float(stamp - after)
    return math.nan


def measure(recording: Recording, X_WM: FloatArray | None, after: float) -> tuple[dict[str, float], FloatArray]:
    """RMSE of all parts of a run, m, and when it was right again; and the alignment of its online poses."""
    truth = recording.truth
    if truth is None or not len(truth.stamps):
        raise SystemExit(f"{recording.name} comes without a truth to compare with.")
    online = run_online(recording)
    batch = smooth(recording.odometry, recording.detections, recording.model)
    error = robot_error(truth, online.stamps[online.seen], online.X_MB[online.seen])
    landmarks = math.nan if online.map is None else landmark_error(truth, online.map.ids, online.map.p_ML).rmse
    figures = {
        "online_m": error.rmse,
        "online_landmarks_m": landmarks,
        "batch_m": robot_error(truth, batch.stamps, batch.X_MB).rmse,
        "back_s": 0.0 if X_WM is None else seconds_until_found(truth, X_WM, online, after),
    }
    return figures, error.X_WM


def kept_rows(file: Path) -> dict[str, dict[str, float]]:
    """The figures that are there, by case."""
    if not file.is_file():
        return {}
    with file.open(newline="") as lines:
        return {row["case"]: {key: float(row[key]) for key in FIELDS[1:]} for row in csv.DictReader(lines)}


def keep(file: Path, case: str, figures: dict[str, float]) -> None:
    """Append a row."""
    new = not file.is_file()
    with file.open("a", newline="") as lines:
        writer = csv.DictWriter(lines, FIELDS)
        if new:
            writer.writeheader()
        writer.writerow({"case": case} | {key: f"{value:.4f}" for key, value in figures.items()})


def line(case: str, clean: dict[str, float], faulty: dict[str, float]) -> str:
    """A row of the table."""
    online, spoilt, back = clean["online_m"], faulty["online_m"], faulty["back_s"]
    cells = f"{online:>9.3f}{spoilt:>9.3f}{spoilt / online:>8.2f}{'-' if math.isnan(back) else f'{back:.0f}':>8}"
    for key in ("batch_m", "online_landmarks_m"):
        cells += f"{clean[key]:>11.3f}{faulty[key]:>9.3f}"
    return f"{case:40}{cells}"


def main() -> None:
    """Measure what has no row yet and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--at", type=float, nargs="+", default=[0.3, 0.6])
    parser.add_argument("--only", default="", help="faults whose name contains this")
    parser.add_argument("--rows", type=Path, default=Path("recording_faults.csv"))
    options = parser.parse_args()
    logging.getLogger("tfg_drake").setLevel(logging.ERROR)  # Each sighting left out is a line.
    heads = f"{'online':>9}{'faulty':>9}{'ratio':>8}{'back s':>8}{'batch':>11}{'faulty':>9}{'tags':>11}{'faulty':>9}"
    print(f"{'case':40}{heads}", flush=True)
    for robot in options.robots:
        name = f"{options.dataset.resolve().name} robot {robot}"
        recording, X_WM = load_mrclam(options.dataset, robot), None
        if name not in kept_rows(options.rows):
            figures, X_WM = measure(recording, None, 0.0)
            keep(options.rows, name, figures)
        for kind, (fault, seconds) in FAULTS.items():
            for share in options.at if options.only in kind else ():
                case = f"{name}, {kind} at {share:g}"
                if case not in kept_rows(options.rows):
                    if X_WM is None:
                        X_WM = measure(recording, None, 0.0)[1]
                    spoilt, begin = with_fault(options.dataset, robot, fault, share)
                    keep(options.rows, case, measure(spoilt, X_WM, begin + seconds)[0])
                rows = kept_rows(options.rows)
                print(line(case, rows[name], rows[case]), flush=True)


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()
