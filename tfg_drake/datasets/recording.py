"""A data set once it is loaded: odometry, tag detections, a model of the odometry, and the truth if known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.config import OdometryConfig, ScanConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, LaserScan, Odometry, TagDetections, message
from tfg_drake.notes import Note

# Keys that can be set of a recording's scanner, `--set hardware.scanner.KEY=VALUE`.
SAID_OF_SCANNER = ("x", "y", "yaw", "flip", "clockwise", "field_of_view", "clock_offset")
# Called with the share of the work done, 0 to 1.
OnProgress = Callable[[float], None]


class DatasetError(BadInput):
    """A data set that cannot be used; the message is one line: what, where and how to mend it."""


@message
class GroundTruth:
    """The truth as far as it is known; any part may be empty.

    stamps: (n,) s, X_WB: (n, 3) the body's poses. ids: (m,) ascending, p_WL: (m, 2) landmarks, m.
    """

    stamps: Annotated[FloatArray, "n"]
    X_WB: Annotated[FloatArray, "n", 3]
    ids: Annotated[IntArray, "m"]
    p_WL: Annotated[FloatArray, "m", 2]


@message
class Recording:
    """One robot's run.

    name. odometry, detections: each in the order of their stamps, all detections within the odometry's span. model:
    what the estimator believes of the odometry. truth: None where nothing is known. notes: what a user should know
    of the data. piece_time: s, after which a piece of the way is mapped, however short it is by the odometry: for one
    that does not tell. scans: a recording with scans has no detections, and as it is read both scans and odometry are
    in the order in which they were recorded, whatever their stamps; poses are the body's, and scans are as seen from
    there. scanner: what is believed of it, X_BS (3,): where it sits. odometry_arrivals, scan_arrivals: (n,), (m,) s,
    when each message was recorded, both by one clock, the recorder's; empty where that is unknown.
    mount_known: whether where the scanner sits and looks was told, not guessed. told_stamps: (k, 2) s, of all scans as
    the data set has them and as they are here, where some could not be true; else empty.
    """

    name: str
    odometry: tuple[Odometry, ...]
    detections: tuple[TagDetections, ...]
    model: OdometryConfig
    truth: GroundTruth | None
    notes: tuple[Note, ...] = ()
    piece_time: float = math.inf
    scans: tuple[LaserScan, ...] = ()
    scanner: ScanConfig = dataclasses.field(default_factory=ScanConfig)
    X_BS: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(3))
    odometry_arrivals: FloatArray = dataclasses.field(default_factory=lambda: np.empty(0))
    scan_arrivals: FloatArray = dataclasses.field(default_factory=lambda: np.empty(0))
    mount_known: bool = True
    told_stamps: FloatArray = dataclasses.field(default_factory=lambda: np.empty((0, 2)))


def as_told(stamps: FloatArray, told_stamps: FloatArray) -> FloatArray:
    """Stamps (n,), s, of scans as their data set has them, by `Recording.told_stamps`; the same where it has none, or
    where its own run back."""
    told, here = told_stamps.T
    known = len(told) > 0 and bool(np.all(np.diff(told) > 0.0) and np.all(np.diff(here) > 0.0))
    return np.interp(stamps, here, told) if known else stamps


def said_of_scanner(path: Path, said: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """Settings that the user gives for a recording's scanner, by fields of `RobotScannerConfig`.

    Raises:
        DatasetError: one of them is of robots alone.
    """
    for key in said or {}:
        if key not in SAID_OF_SCANNER:
            known = ", ".join(SAID_OF_SCANNER)
            raise DatasetError(f"--set hardware.scanner.{key}: {path} is a recording, of its scanner say {known}")
    return said or {}


def odometry_along(stamps: FloatArray, X_OB: FloatArray, tells_rest: bool = False) -> tuple[Odometry, ...]:
    """Odometry of which only the poses (n, 3) at stamps (n,), s, are known. tells_rest: a pose that stays tells that no
    wheel has turned."""
    steps = np.vstack([np.zeros((1, 3)), se2.between(X_OB[:-1], X_OB[1:])])
    steps[:, 2] = se2.wrap_angle(steps[:, 2])
    dt = np.append(1.0, np.diff(stamps))
    V_B = steps[:, [0, 2]] / np.where(dt > 0.0, dt, 1.0)[:, None]
    told = zip(stamps, X_OB, V_B, tells_rest & (steps == 0.0).all(axis=1), strict=True)
    return tuple(Odometry(float(stamp), X, V, bool(still)) for stamp, X, V, still in told)


def make_frames(
    stamps: FloatArray,
    ids: IntArray,
    ranges: FloatArray,
    bearings: FloatArray,
    sigma_range: FloatArray,
    sigma_bearing: FloatArray,
) -> tuple[TagDetections, ...]:
    """One message for every distinct stamp, in order; all arguments (n,), one row a sighting.

    A landmark seen more than once at a stamp becomes one sighting, the mean weighted by information.
    """
    order = np.lexsort((ids, stamps))
    stamps, ids = stamps[order], ids[order]
    same = np.append(False, (stamps[1:] == stamps[:-1]) & (ids[1:] == ids[:-1]))
    group = np.cumsum(~same) - 1
    first = np.flatnonzero(~same)

    def merge(value: FloatArray, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
        weight = 1.0 / sigma[order] ** 2
        total = np.bincount(group, weight, minlength=len(first))
        return np.bincount(group, weight * value[order], minlength=len(first)) / total, 1.0 / np.sqrt(total)

    if not len(stamps):
        return ()
    distance, sigma_r = merge(ranges, sigma_range)
    # Sightings of one landmark at one instant lie on one side of the seam at pi, or differ by more than noise.
    bearing, sigma_b = merge(bearings, sigma_bearing)
    stamps, ids = stamps[first], ids[first]
    starts = np.flatnonzero(np.append(True, stamps[1:] != stamps[:-1]))
    ends = np.append(starts[1:], len(stamps))
    return tuple(
        TagDetections(float(stamps[a]), ids[a:b], distance[a:b], bearing[a:b], sigma_r[a:b], sigma_b[a:b])
        for a, b in zip(starts, ends, strict=True)
    )
