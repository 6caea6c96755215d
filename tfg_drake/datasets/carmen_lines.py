"""The lines of a CARMEN log that tell of scans and of odometry, one message a line.

FLASER n r1..rn and x y theta of scanner and of body; ODOM x y theta tv rv accel; both then t host t_logger.
ROBOTLASER1 and RAWLASER1: type, first angle, field of view, angle between rays, greatest range, accuracy, mode of
remissions, n r1..rn, m remissions; the former then x y theta of scanner and of body and five numbers of its safety;
both t host t_logger. Metres, radians, seconds; rays counter-clockwise from the scanner's right.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tfg_drake.datasets.recording import DatasetError
from tfg_drake.datasets.rows import Rows, ShortRowError, parse_numbers
from tfg_drake.messages import FloatArray

# By the kind of a line that tells of a scan: words before the number of rays, and words after ranges and remissions.
_SCANS = {"FLASER": (1, 9), "ROBOTLASER1": (8, 14), "RAWLASER1": (8, 3)}
_ODOMETRY, _ODOMETRY_WORDS = "ODOM", 10
# The words at the end of a line: t host t_logger.
_STAMPED = 3
_UNKNOWN = (math.nan, math.nan, math.nan)


class CarmenScan(NamedTuple):
    """A scan. stamp, logged: s, when it was taken and when the logger wrote it. ranges: (n,) m. first, step: rad, the
    angles of its rays, nan where they are not told. range_max: m, likewise inf. X_WS, X_OB: (3,) the scanner and the
    body, nan where they are not told. before: (3,) the body by the odometry's line before it, likewise."""

    stamp: float
    logged: float
    ranges: FloatArray
    first: float
    step: float
    range_max: float
    X_WS: tuple[float, ...]
    X_OB: tuple[float, ...]
    before: tuple[float, ...]


class CarmenLog(NamedTuple):
    """scans: in the order of their lines, of one kind of line. stamps, X_OB: (k,) s and (k, 3), of the odometry's own
    lines."""

    scans: list[CarmenScan]
    stamps: FloatArray
    X_OB: FloatArray


def read_carmen(path: Path, rows: Rows) -> CarmenLog:
    """Reads the rows of a file: odometry, and scans of the kind that has most lines.

    Raises:
        DatasetError: a line is broken, or there are fewer than two scans.
    """
    scans: dict[str, list[CarmenScan]] = {kind: [] for kind in _SCANS}
    odometry: list[tuple[float, ...]] = []

    def parse(number: int, words: list[str]) -> tuple[str, CarmenScan] | None:
        if words[0] in _SCANS:
            before = odometry[-1][1:] if odometry else _UNKNOWN
            return words[0], _scan(path, number, words, before)
        if words[0] == _ODOMETRY and len(words) == _ODOMETRY_WORDS:
            x, y, theta, stamp = parse_numbers(path, number, [*words[1:4], words[-_STAMPED]])
            odometry.append((stamp, x, y, theta))
        return None

    read = rows.read(parse)
    for kind, scan in rows.once(read, key=lambda row: (*row[1][:2], *row[1][6:8], row[1].ranges.tobytes())):
        scans[kind].append(scan)
    best = max(scans.values(), key=len)
    if len(best) < 2:
        kinds = ", ".join(_SCANS)
        raise DatasetError(f"{path}: fewer than two scans in it ({kinds}); is it a CARMEN log?")
    table = np.reshape(odometry, (-1, 4))
    return CarmenLog(best, table[:, 0], table[:, 1:])


def _scan(path: Path, number: int, words: list[str], before: tuple[float, ...]) -> CarmenScan:
    """The scan of a line."""
    at, after = _SCANS[words[0]]
    broken = f"{path}, line {number}: not a whole {words[0]} line; copy the file again"
    end = at
    for _ in range(1 if words[0] == "FLASER" else 2):
        if end >= len(words):
            raise ShortRowError(broken)
        # Three digits more than any scanner has rays.
        if not (words[end].isdecimal() and len(words[end]) < 8):
            raise DatasetError(broken)
        end += int(words[end]) + 1
    if len(words) != end + after:
        raise (ShortRowError if len(words) < end + after else DatasetError)(broken)
    ranges = np.array(parse_numbers(path, number, words[at + 1 : at + 1 + int(words[at])]))
    stamp, logged = parse_numbers(path, number, [words[-_STAMPED], words[-1]])
    X_WS: tuple[float, ...] = _UNKNOWN
    X_OB: tuple[float, ...] = _UNKNOWN
    if words[0] != "RAWLASER1":
        poses = parse_numbers(path, number, words[end : end + 6])
        X_WS, X_OB = tuple(poses[:3]), tuple(poses[3:])
    if words[0] == "FLASER":
        return CarmenScan(stamp, logged, ranges, math.nan, math.nan, math.inf, X_WS, X_OB, before)
    first, _, step, range_max = parse_numbers(path, number, words[2:6])
    return CarmenScan(stamp, logged, ranges, first, step, range_max or math.inf, X_WS, X_OB, before)
