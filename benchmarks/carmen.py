"""Laser logs of the CARMEN toolkit, corrected by SLAM, as the Radish repository keeps them.

One message a line: FLASER n r1..rn x y theta and seven fields more, the fourth a time stamp, ranges in metres over the
half plane ahead. The poses are the scanner's, corrected: they serve as the truth, and odometry is made from them with
errors drawn by a seed.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.recording import DatasetError, GroundTruth, ScanLog
from tfg_drake.datasets.rows import Rows, ShortRowError
from tfg_drake.datasets.text import parse_numbers
from tfg_drake.messages import FloatArray, LaserScan, Odometry
from tfg_drake.simulation import odometry

# A range from here on is one of the scanner's codes for no return, m; whether there was nothing or glass, none tells.
NO_RETURN = 49.9
# Of the scanners' ranges, m: their resolution of 1 cm and what the corrected poses have wrong.
SIGMA = 0.02
# Stamps that stand still or run backwards are moved on by this, s: the order of the lines is right.
LEAST_STEP = 1e-3
# x y theta, the odometry's x y theta, its stamp, host, the logger's stamp.
_TAIL = 9


def load_carmen(path: Path, model: OdometryConfig, seed: int, range_max: float = 20.0) -> ScanLog:
    """The run in a file, which may be gzipped.

    model: errors of the odometry that is made from the corrected poses. seed: of their draws. range_max: m; rays that
    met something farther off are free so far and tell no more, rays without a return are left out.

    Raises:
        DatasetError: the file cannot be read, a line is broken, or there are fewer than two scans in it.
    """
    rows = Rows(path)
    read = rows.read(lambda number, words: _scan_line(path, number, words) if words[0] == "FLASER" else None)
    stamps: list[float] = []
    poses, scans = [], []
    for numbers in rows.once(read):
        values = np.array(numbers)
        ranges, stamp = values[:-4], float(values[-1])
        stamps.append(max(stamp, stamps[-1] + LEAST_STEP) if stamps else stamp)
        poses.append(values[-4:-1])
        angles = (np.arange(len(ranges)) / len(ranges) - 0.5) * math.pi
        met = (ranges > 0.0) & (ranges < NO_RETURN)
        within = np.where(ranges[met] <= range_max, ranges[met], math.inf)
        scans.append(LaserScan(stamps[-1], angles[met], within, range_max, SIGMA))
    if len(scans) < 2:
        raise DatasetError(f"{path}: fewer than two FLASER lines in it; is it a CARMEN log?")
    X_WB = np.array(poses)
    nothing = np.empty(0, dtype=np.int64)
    return ScanLog(
        name=path.name.split(".")[0],
        odometry=_noisy_odometry(np.array(stamps), X_WB, model, seed),
        scans=tuple(scans),
        model=model,
        truth=GroundTruth(np.array(stamps), X_WB, nothing, np.empty((0, 2))),
        notes=rows.notes,
    )


def _scan_line(path: Path, number: int, words: list[str]) -> tuple[float, ...]:
    """Ranges, pose and stamp of a FLASER line."""
    count = len(words) - 2 - _TAIL
    if count < 1 or words[1] != str(count):
        # Three digits more than any scanner has rays.
        told = int(words[1]) if len(words) > 1 and words[1].isdecimal() and len(words[1]) < 8 else count
        kind = ShortRowError if len(words) < 3 or count < told else DatasetError
        raise kind(f"{path}, line {number}: not a whole FLASER line; copy the file again")
    return tuple(parse_numbers(path, number, [*words[2 : 2 + count + 3], words[2 + count + 6]]))


def _noisy_odometry(stamps: FloatArray, X_WB: FloatArray, model: OdometryConfig, seed: int) -> tuple[Odometry, ...]:
    """What wheels and a gyro would have said at stamps (n,) and true poses (n, 3)."""
    rng = np.random.default_rng(seed)
    errors = odometry.run_errors(rng.standard_normal(3), model)
    state = odometry.initial_state(X_WB[0])
    state[odometry.TIME] = stamps[0]
    messages = [odometry.message(state)]
    for stamp, pose, before, dt in zip(stamps[1:], X_WB[1:], X_WB[:-1], np.diff(stamps), strict=True):
        speed = math.hypot(pose[0] - before[0], pose[1] - before[1]) / dt
        moving = np.array([*pose, speed, 0.0])
        state = odometry.integrate(state, float(stamp), moving, errors, rng.standard_normal(2), model)
        messages.append(odometry.message(state))
    return tuple(messages)
