"""Logs of the MinesRover, as CoreSLAM and BreezySLAM have them: wheel encoders and a Hokuyo URG-04LX, no truth.

B. Steux and O. El Hamzaoui, "tinySLAM: a SLAM algorithm in less than 200 lines C-language program", ICARCV 2010. One
scan a line: time (us), counts of the left and the right wheel in columns 2 and 3 (from 0), 682 ranges (mm) from column
24 on, 240 degrees counter-clockwise round straight ahead; 0 and the scanner's error codes below 20 stand for no range.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.recording import DatasetError, ScanLog
from tfg_drake.datasets.rows import Rows, ShortRowError
from tfg_drake.datasets.text import parse_numbers
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, LaserScan, Odometry

# The rover: metres a count, half the distance between the wheels, m, and the scanner's place ahead of the axle, m.
METRES_PER_COUNT = 2.0 * math.pi * 0.077 / 2000.0
HALF_AXLE = 0.165
SCANNER_AHEAD = 0.145
# The scanner: rays, the angle that they span, rad, its range, m, and its noise, m.
RAYS = 682
FIELD_OF_VIEW = math.radians(240.0)
RANGE_MAX = 5.6
LEAST_RANGE = 0.02
SIGMA = 0.03
# Rays at either end that see the rover itself.
_OWN = 70
_FIRST = 24


def odometry_model() -> OdometryConfig:
    """What fits wheels that skid as they turn, without a gyro: their heading is hardly worth more than a guess."""
    return OdometryConfig(distance_noise=0.05, distance_scale=0.03, gyro_noise=0.3, gyro_bias=0.02, gyro_scale=0.3)


def load_breezyslam(path: Path) -> ScanLog:
    """The run in a file, which may be gzipped. The body's origin is the scanner, its odometry the wheels' alone.

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
        scans.append(LaserScan(float(stamp), angles[valid], ranges[valid], RANGE_MAX, SIGMA))
    return ScanLog(
        name=path.name.split(".")[0],
        odometry=_odometry(stamps, METRES_PER_COUNT * table[:, 1:3]),
        scans=tuple(scans),
        model=odometry_model(),
        truth=None,
        notes=rows.notes,
    )


def _odometry(stamps: FloatArray, wheels: FloatArray) -> tuple[Odometry, ...]:
    """The scanner's pose by how far (n, 2), m, the left and the right wheel have come."""
    X_AS = np.array([SCANNER_AHEAD, 0.0, 0.0])  # From the axle to the scanner.
    X_OA = se2.inverse(X_AS)
    messages = [Odometry(0.0, np.zeros(3), np.zeros(2), at_rest=True)]
    steps = zip(stamps[1:], np.diff(stamps), np.diff(wheels, axis=0), strict=True)
    for stamp, dt, (left, right) in steps:
        ahead, turn = 0.5 * (left + right), 0.5 * (right - left) / HALF_AXLE
        chord = ahead * np.sinc(0.5 * turn / math.pi)
        step = np.array([chord * math.cos(0.5 * turn), chord * math.sin(0.5 * turn), turn])
        X_OA = se2.compose(X_OA, step)
        still = left == right == 0.0
        messages.append(Odometry(float(stamp), se2.compose(X_OA, X_AS), np.array([ahead, turn]) / dt, still))
    return tuple(messages)
