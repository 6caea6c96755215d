"""Logs of robots with a laser scanner and no tags, as two collections keep them.

The Radish repository has logs of the CARMEN toolkit, corrected by SLAM. One message a line: FLASER n r1..rn x y theta
and seven fields more, the fourth a time stamp, ranges in metres over the half plane ahead. The poses are the scanner's,
corrected: they serve as the truth, and odometry is made from them with errors drawn by a seed.

CoreSLAM and BreezySLAM have logs of the MinesRover: wheel encoders and a Hokuyo URG-04LX, no truth.
B. Steux and O. El Hamzaoui, "tinySLAM: a SLAM algorithm in less than 200 lines C-language program", ICARCV 2010. One
scan a line: time (us), counts of the left and the right wheel in columns 2 and 3 (from 0), 682 ranges (mm) from column
24 on, 240 degrees counter-clockwise round straight ahead; 0 and the scanner's error codes below 20 stand for no range.
The scans are told later than the counts: their headings agree best with those of the wheels SCANS_LATE before.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tfg_drake.config import OdometryConfig, ScanConfig
from tfg_drake.datasets.recording import DatasetError, GroundTruth, Recording
from tfg_drake.datasets.rows import Rows, ShortRowError
from tfg_drake.datasets.text import parse_numbers
from tfg_drake.geometry import se2
from tfg_drake.geometry.sweep import Sweep, scan_of
from tfg_drake.messages import FloatArray, LaserScan, Odometry
from tfg_drake.simulation import odometry

# A range from here on is one of the scanner's codes for no return, m; whether there was nothing or glass, none tells.
NO_RETURN = 49.9
# Of the scanners' ranges, m: their resolution of 1 cm and what the corrected poses have wrong.
CARMEN_SIGMA = 0.02
# The poses are the scanner's own.
EXACT_SCANNER = ScanConfig(yaw_deviation=0.0, mount_deviation=0.0, clock_deviation=0.0, sweep_deviation=0.0)
# Stamps that stand still or run backwards are moved on by this, s: the order of the lines is right.
LEAST_STEP = 1e-3
# x y theta, the odometry's x y theta, its stamp, host, the logger's stamp.
_TAIL = 9

# The rover: metres a count, half the distance between the wheels, m, and the scanner's place ahead of the axle, m.
METRES_PER_COUNT = 2.0 * math.pi * 0.077 / 2000.0
HALF_AXLE = 0.165
SCANNER_AHEAD = 0.145
# The scanner: rays, the angle that they span, rad, its range, m, and its noise, m.
RAYS = 682
FIELD_OF_VIEW = math.radians(240.0)
RANGE_MAX = 5.6
LEAST_RANGE = 0.02
ROVER_SIGMA = 0.03
# What its stamps are late, s, and the deviations of the scanner's place, m, and of this.
SCANS_LATE = 0.17
ROVER_SCANNER = ScanConfig(mount_deviation=0.02, clock_deviation=0.05)
# Rays at either end that see the rover itself.
_OWN = 70
_FIRST = 24


def load_carmen(path: Path, model: OdometryConfig, seed: int, range_max: float = 20.0) -> Recording:
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
        scans.append(LaserScan(stamps[-1], angles[met], within, range_max, CARMEN_SIGMA))
    if len(scans) < 2:
        raise DatasetError(f"{path}: fewer than two FLASER lines in it; is it a CARMEN log?")
    X_WB = np.array(poses)
    nothing = np.empty(0, dtype=np.int64)
    return Recording(
        name=path.name.split(".")[0],
        odometry=_noisy_odometry(np.array(stamps), X_WB, model, seed),
        scans=tuple(scans),
        model=model,
        truth=GroundTruth(np.array(stamps), X_WB, nothing, np.empty((0, 2))),
        notes=rows.notes,
        detections=(),
        scanner=EXACT_SCANNER,
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


def odometry_model() -> OdometryConfig:
    """The noise of odometry by wheels alone, which skid a little as they turn."""
    return OdometryConfig(distance_noise=0.05, distance_scale=0.03, gyro_noise=0.05, gyro_bias=0.005, gyro_scale=0.05)


def load_breezyslam(path: Path) -> Recording:
    """The run in a file, which may be gzipped. The body's origin is amid the wheels, its odometry theirs alone.

    Raises:
        DatasetError: the file cannot be read, a line is broken, two scans are at one time, or there is but one.
    """
    rows = Rows(path)

    def parse(number: int, words: list[str]) -> tuple[float, ...]:
        if len(words) < _FIRST + RAYS:
            complaint = f"{_FIRST + RAYS} columns expected, {len(words)} found; mend it"
            raise ShortRowError(f"{path}, line {number}: {complaint}")
        return tuple(parse_numbers(path, number, [words[0], *words[2:4], *words[_FIRST : _FIRST + RAYS]]))

    read = rows.once(rows.read(parse))
    if len(read) < 2:
        raise DatasetError(f"{path}: fewer than two scans in it; copy it again")
    table = np.array(read)
    table = table[rows.in_order(table[:, 0])]
    same = np.flatnonzero(np.diff(table[:, 0]) <= 0.0)
    if len(same):
        raise DatasetError(f"{path}: two different scans at {table[same[0], 0]:.0f} us; leave one of them out")
    stamps = 1e-6 * (table[:, 0] - table[0, 0])
    seen = slice(_OWN, RAYS - _OWN)
    angles = ((np.arange(RAYS) + 0.5) / RAYS - 0.5)[seen] * FIELD_OF_VIEW
    scans = []
    for stamp, row in zip(stamps, table, strict=True):
        ranges = 1e-3 * row[3:][seen]
        valid = ranges >= LEAST_RANGE
        if stamp >= SCANS_LATE:
            at = float(stamp - SCANS_LATE), angles[valid], ranges[valid], np.zeros(np.count_nonzero(valid))
            scans.append(scan_of(Sweep(*at, SCANNER_AHEAD, 0.0, RANGE_MAX, ROVER_SIGMA), np.zeros(2)))
    return Recording(
        name=path.name.split(".")[0],
        odometry=_wheel_odometry(stamps, METRES_PER_COUNT * table[:, 1:3]),
        scans=tuple(scans),
        model=odometry_model(),
        truth=None,
        notes=rows.notes,
        detections=(),
        scanner=ROVER_SCANNER,
    )


def _wheel_odometry(stamps: FloatArray, wheels: FloatArray) -> tuple[Odometry, ...]:
    """The pose by how far (n, 2), m, the left and the right wheel have come."""
    X_OB = np.zeros(3)
    messages = [Odometry(0.0, np.zeros(3), np.zeros(2), at_rest=True)]
    steps = zip(stamps[1:], np.diff(stamps), np.diff(wheels, axis=0), strict=True)
    for stamp, dt, (left, right) in steps:
        ahead, turn = 0.5 * (left + right), 0.5 * (right - left) / HALF_AXLE
        chord = ahead * np.sinc(0.5 * turn / math.pi)
        step = np.array([chord * math.cos(0.5 * turn), chord * math.sin(0.5 * turn), turn])
        X_OB = se2.compose(X_OB, step)
        still = left == right == 0.0
        messages.append(Odometry(float(stamp), X_OB, np.array([ahead, turn]) / dt, still))
    return tuple(messages)
