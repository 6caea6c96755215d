"""Logs of robots with a laser scanner and no tags, as two collections keep them.

The Radish repository has logs of the CARMEN toolkit (`carmen_lines`). Some are raw: the wheels' own way. Others were
corrected by SLAM: their poses, which are the scanner's, serve as the truth, and odometry is made from them with errors
drawn by a seed.

CoreSLAM and BreezySLAM have logs of the MinesRover: wheel encoders and a Hokuyo URG-04LX, no truth.
B. Steux and O. El Hamzaoui, "tinySLAM: a SLAM algorithm in less than 200 lines C-language program", ICARCV 2010. One
scan a line: time (us), counts of the left and the right wheel in columns 2 and 3 (from 0), 682 ranges (mm) from column
24 on, 240 degrees counter-clockwise round straight ahead; 0 and the scanner's error codes below 20 stand for no range.
The scans are told later than the counts: their headings agree best with those of the wheels SCANS_LATE before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.config import OdometryConfig, ScanConfig
from tfg_drake.datasets.carmen_lines import CarmenLog, CarmenScan, read_carmen
from tfg_drake.datasets.recording import DatasetError, GroundTruth, Recording, odometry_along, said_of_scanner
from tfg_drake.datasets.rows import Rows, parse_numbers
from tfg_drake.geometry import se2
from tfg_drake.geometry.sweep import from_place, in_order
from tfg_drake.messages import FloatArray, IntArray, LaserScan, Odometry, replace
from tfg_drake.notes import Note
from tfg_drake.simulation import odometry
from tfg_drake.storage.trajectory import poses_at
from tfg_drake.table import empty

# Ranges from here on, m, are codes of the scanner for no return, whether of nothing or of glass.
NO_RETURN = 49.9
# The greatest range means no return if more than the share SAME_GREATEST of all rays and LEAST_SAME rays have it;
# QUANTUM, m, is the ranges' resolution.
SAME_GREATEST, LEAST_SAME, QUANTUM = 0.005, 100, 0.005
# Deviation of the ranges, m: their resolution of 1 cm and the error of corrected poses.
CARMEN_SIGMA = 0.02
# Greatest range used of any scanner but the rover's, m; rays with a longer one are free up to it.
OTHER_RANGE_MAX = 20.0
# In a log with corrected poses, which are the scanner's own.
EXACT_SCANNER = ScanConfig(yaw_deviation=0.0, mount_deviation=0.0, clock_deviation=0.0, sweep_deviation=0.0)
_SAY_SPAN = "say what it spans, rad, by --set hardware.scanner.field_of_view=RAD"
# Half circles, by their numbers of rays.
HALF_CIRCLES = (180, 181, 360, 361, 720, 721)
# In a raw log the scanner's pose on the body is constant, and odometry in scans equals that in odometry lines, within
# this, m and rad.
_TOGETHER = 0.01
# Deviations of a raw log's scanner, m and rad, if the log states its pose, and if that is 0.
WHEELED_SCANNER = ScanConfig(mount_deviation=0.02, yaw_deviation=0.02)
UNPLACED_SCANNER = ScanConfig(mount_deviation=0.2, yaw_deviation=0.05)
# Stamps are wrong if the robot is faster between two scans, m/s and rad/s, or these are nearer or farther apart in
# time, s; if more than the share OFTEN is wrong, no stamp is used.
FASTEST, FASTEST_TURN, LEAST_STEP, LONGEST_STEP, OFTEN = 5.0, 20.0, 1e-3, 3600.0, 0.02
# Time computed from the motion: the usual speed, m/s and rad/s, and the duration of a scan, s.
USUAL, USUAL_TURN, SCAN_TIME = 0.4, 0.6, 0.05

# The rover: metres per count, half the distance between the wheels, m, and the scanner's place ahead of the axle, m.
METRES_PER_COUNT = 2.0 * math.pi * 0.077 / 2000.0
HALF_AXLE = 0.165
SCANNER_AHEAD = 0.145
# The rover's scanner: number of rays, field of view, rad, greatest and least range, m, noise, m.
RAYS = 682
FIELD_OF_VIEW = math.radians(240.0)
RANGE_MAX = 5.6
LEAST_RANGE = 0.02
ROVER_SIGMA = 0.03
# Delay of its stamps, s; the deviations of its place, m, and of the delay, s.
SCANS_LATE = 0.17
ROVER_SCANNER = ScanConfig(mount_deviation=0.02, clock_deviation=0.05)
# The clock of another scanner in such a log is unknown.
OTHER_SCANNER = ScanConfig(mount_deviation=0.2, yaw_deviation=0.05, clock_deviation=0.1)
# Rays at either end that see the rover itself.
_OWN = 70
_FIRST = 24


def load_carmen(path: Path, model: OdometryConfig, seed: int, scanner: Mapping[str, Any] | None = None) -> Recording:
    """The run in a file, which may be packed (.gz, .bz2).

    model: errors of the odometry that is made from corrected poses. seed: of their draws. scanner: fields of
    `RobotScannerConfig` that somebody has said; they win over what the log says. Rays without a return are left out.

    Raises:
        DatasetError: the file cannot be read, a line is broken, there are fewer than two scans in it, or what they span
            is neither told nor a half circle.
    """
    said, rows = said_of_scanner(path, scanner), Rows(path)
    log = read_carmen(path, rows)
    raw, poses, X_BS = _way(path, log)
    told = np.array([one.stamp for one in log.scans])
    stamps, untrue = _in_time(told, poses, raw)
    logged = np.array([one.logged for one in log.scans])
    if untrue and not _in_time(logged, poses, raw)[1]:
        stamps = logged
        untrue = (replace(untrue[0], text=f"{untrue[0].text.partition(';')[0]}; the logger's stamps are used"),)
    scans, greatest = [], _no_return(log)
    rays: dict[tuple[int, float, float], tuple[FloatArray, IntArray]] = {}
    for stamp, one in zip(stamps - said.get("clock_offset", 0.0), log.scans, strict=True):
        kind = len(one.ranges), one.first, one.step
        if kind not in rays:
            rays[kind] = _seen(_angles(path, one, said), said, X_BS[2])
        angles, order = rays[kind]
        ranges = one.ranges[order]
        met = (ranges > 0.0) & (ranges < min(NO_RETURN, one.range_max))
        farthest = min(OTHER_RANGE_MAX, one.range_max, greatest)
        scans.append(_scan(stamp, angles[met], ranges[met], farthest, CARMEN_SIGMA))
    place = np.array([said.get("x", X_BS[0]), said.get("y", X_BS[1])]) if raw else np.zeros(2)
    believed = (WHEELED_SCANNER if place.any() else UNPLACED_SCANNER) if raw else EXACT_SCANNER
    model = odometry_model() if raw else model
    arrivals = logged if raw and not untrue and (np.diff(logged) >= 0.0).all() else np.empty(0)
    return Recording(
        name=path.name.split(".")[0],
        odometry=odometry_along(stamps, poses, tells_rest=True) if raw else _noisy_odometry(stamps, poses, model, seed),
        scans=tuple(from_place(one, place) for one in scans),
        model=model,
        truth=None if raw else empty(GroundTruth, stamps=stamps, X_WB=poses),
        notes=rows.notes + untrue,
        detections=(),
        scanner=believed,
        X_BS=np.append(place, 0.0),
        odometry_arrivals=arrivals,
        scan_arrivals=arrivals,
        told_stamps=np.column_stack([told, stamps]) if untrue else np.empty((0, 2)),
    )


def _way(path: Path, log: CarmenLog) -> tuple[bool, FloatArray, FloatArray]:
    """True if a log is raw; the poses (n, 3) at its scans, of a raw one the body's by its wheels, else the scanner's;
    the scanner's pose X_BS (3,) in what has these poses.

    Where SLAM corrected the poses of scans they leave those of the odometry's own lines, or there are none of these.
    """
    X_WS, X_OB, before = (np.array(poses) for poses in zip(*(one[6:9] for one in log.scans), strict=True))
    if not len(log.stamps):
        if np.isnan(X_WS).any():
            raise DatasetError(f"{path}: scans without poses and no ODOM lines; record odometry, too")
        return False, X_WS, np.zeros(3)
    order = np.argsort(log.stamps, kind="stable")
    at = np.array([one.stamp for one in log.scans])
    between = poses_at(at, log.stamps[order], log.X_OB[order])
    if np.isnan(X_OB).any():
        return True, between, np.zeros(3)
    off = np.min([_apart(X_OB, between), _apart(X_OB, np.where(np.isnan(before), between, before))], axis=0)
    X_BS = se2.between(X_OB, X_WS)
    together = _apart(X_BS, X_BS[:1]).max() < _TOGETHER
    moved = np.append(False, _apart(X_OB[1:], X_OB[:-1]) > _TOGETHER)
    raw = bool(together and (not moved.any() or np.median(off[moved]) < _TOGETHER))
    return (True, X_OB, X_BS[0]) if raw else (False, X_WS, np.zeros(3))


def _apart(some: FloatArray, others: FloatArray) -> FloatArray:
    """(n,) m or rad, the greatest difference between poses (n, 3)."""
    step = some - others
    step[:, 2] = se2.wrap_angle(step[:, 2])
    return np.asarray(np.abs(step).max(axis=1))


def _in_time(stamps: FloatArray, poses: FloatArray, raw: bool) -> tuple[FloatArray, tuple[Note, ...]]:
    """Stamps (n,), s, of scans at poses (n, 3) in the order of the log, those that cannot be true by motion, and a note
    on these. raw: poses are those of wheels; stamps that seldom cannot be true stay as they are."""
    step, dt = np.abs(np.diff(poses, axis=0)), np.diff(stamps)
    length, turn = np.hypot(step[:, 0], step[:, 1]), np.abs(se2.wrap_angle(step[:, 2]))
    least = np.maximum(np.maximum(length / FASTEST, turn / FASTEST_TURN), LEAST_STEP)
    usual = np.maximum(length / USUAL, turn / USUAL_TURN) + SCAN_TIME
    untrue = (dt < least) | (dt > LONGEST_STEP)
    often = bool(np.mean(untrue) > OFTEN)
    # Wheels themselves may jump, and a clock may be set: the intake tells.
    if not untrue.any() or (raw and not often):
        return stamps, ()
    if often:
        times = stamps[0] + np.append(0.0, np.cumsum(usual))
        what = "none is believed"
    else:
        times, later = stamps.copy(), 0.0
        for k in range(1, len(stamps)):
            later += dt[k - 1] - usual[k - 1] if dt[k - 1] > LONGEST_STEP else 0.0
            at = stamps[k] - later
            times[k] = at if at - times[k - 1] >= least[k - 1] else times[k - 1] + usual[k - 1]
        what = "the others are believed"
    count, first = int(np.count_nonzero(untrue)), float(times[np.argmax(untrue)])
    cannot = f"{count} of {len(stamps)} stamps cannot be true: they stand still, run back, or leave no time for the way"
    text = f"{cannot} or hours; {what}; time is by motion instead, {USUAL:g} m/s and {USUAL_TURN:g} rad/s"
    return times, (Note("stamps", first, text),)


def _angles(path: Path, scan: CarmenScan, said: Mapping[str, Any]) -> FloatArray:
    """The angles (m,) of a scan's rays as the scanner counts them, rad."""
    n = len(scan.ranges)
    if said.get("field_of_view", 0.0) > 0.0:
        return _spanning(n, said)
    if scan.step > 0.0:
        return np.asarray(scan.first + scan.step * np.arange(n))
    if n in HALF_CIRCLES:
        return np.asarray((np.arange(n) / (n - n % 2) - 0.5) * math.pi)
    half = ", ".join(map(str, HALF_CIRCLES))
    raise DatasetError(f"{path}: scans of {n} rays, and only {half} are half a circle; {_SAY_SPAN}")


def _no_return(log: CarmenLog) -> float:
    """Less than the greatest range in a log, m, where so many rays have just this that it says that nothing was met;
    else inf."""
    ranges = np.concatenate([one.ranges for one in log.scans])
    ranges = ranges[(ranges > 0.0) & (ranges < NO_RETURN)]
    same = np.count_nonzero(ranges == ranges.max(initial=0.0))
    often = same > max(LEAST_SAME, SAME_GREATEST * len(ranges))
    return float(ranges.max()) - QUANTUM if often else math.inf


def _spanning(n: int, said: Mapping[str, Any]) -> FloatArray:
    return np.linspace(-0.5, 0.5, n) * float(said["field_of_view"])


def _scan(stamp: float, angles: FloatArray, ranges: FloatArray, range_max: float, sigma: float) -> LaserScan:
    return LaserScan(float(stamp), angles, np.where(ranges <= range_max, ranges, math.inf), range_max, sigma)


def _seen(angles: FloatArray, said: Mapping[str, Any], yaw: float) -> tuple[FloatArray, IntArray]:
    """The angles (m,) of rays from the body's x axis, increasing in (-pi, pi], and which of (n,) these are that the
    scanner counts as `angles`, rad. yaw: where it looks, rad, unless somebody has said that."""
    angles = -angles if said.get("flip", False) != said.get("clockwise", False) else angles
    angles = angles + said.get("yaw", yaw)
    if angles.min() <= -math.pi or angles.max() > math.pi:
        angles = se2.wrap_angle(angles)
    order = in_order(angles)
    return angles[order], order


def _noisy_odometry(stamps: FloatArray, X_WB: FloatArray, model: OdometryConfig, seed: int) -> tuple[Odometry, ...]:
    """Simulated odometry of wheels and a gyro at stamps (n,), true poses (n, 3)."""
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


def load_breezyslam(path: Path, scanner: Mapping[str, Any] | None = None) -> Recording:
    """The run in a file, which may be packed (.gz, .bz2). The body's origin is amid the wheels, its odometry theirs
    alone.

    scanner: fields of `RobotScannerConfig` that somebody has said. With field_of_view it is another scanner than the
    rover's, of any number of rays, whose place is not known unless that is said, too.

    Raises:
        DatasetError: the file cannot be read, a line is broken, two scans are at one time, there is but one, or the
            scanner is another and nobody said what it spans.
    """
    said, rows = said_of_scanner(path, scanner), Rows(path)
    other = said.get("field_of_view", 0.0) > 0.0
    columns = len(rows.first()[1]) if other else _FIRST + RAYS

    def parse(number: int, words: list[str]) -> tuple[float, ...]:
        # The rover's own logs may have one column more, of zeros.
        if other or len(words) != columns + 1:
            expected = f"{columns} columns expected, {_FIRST} and {columns - _FIRST} rays"
            mend = "mend it" if other else f"mend it, or of another scanner {_SAY_SPAN}"
            rows.expect(number, words, columns, expected, mend)
        return tuple(parse_numbers(path, number, [words[0], *words[2:4], *words[_FIRST:columns]]))

    read = rows.once(rows.read(parse))
    if len(read) < 2:
        raise DatasetError(f"{path}: fewer than two scans in it; copy it again")
    table = np.array(read)
    table = table[rows.in_order(table[:, 0])]
    same = np.flatnonzero(np.diff(table[:, 0]) <= 0.0)
    if len(same):
        raise DatasetError(f"{path}: two different scans at {table[same[0], 0]:.0f} us; leave one of them out")
    stamps = 1e-6 * (table[:, 0] - table[0, 0])
    if other:
        counted, own, late, range_max = _spanning(columns - _FIRST, said), 0, 0.0, OTHER_RANGE_MAX
        place, believed = (said.get("x", 0.0), said.get("y", 0.0)), OTHER_SCANNER
    else:
        counted, own = ((np.arange(RAYS) + 0.5) / RAYS - 0.5) * FIELD_OF_VIEW, _OWN
        late, range_max = SCANS_LATE, RANGE_MAX
        place, believed = (said.get("x", SCANNER_AHEAD), said.get("y", 0.0)), ROVER_SCANNER
    angles, order = _seen(counted[own : len(counted) - own], said, 0.0)
    scans = []
    for stamp, row in zip(stamps - said.get("clock_offset", late), table, strict=True):
        ranges = 1e-3 * row[3 + own :][order]
        valid = ranges >= LEAST_RANGE
        if stamp >= 0.0:
            seen = _scan(stamp, angles[valid], ranges[valid], range_max, ROVER_SIGMA)
            scans.append(from_place(seen, np.array(place)))
    return Recording(
        name=path.name.split(".")[0],
        odometry=_wheel_odometry(stamps, METRES_PER_COUNT * table[:, 1:3]),
        scans=tuple(scans),
        model=odometry_model(),
        truth=None,
        notes=rows.notes,
        detections=(),
        scanner=believed,
        X_BS=np.array([*place, 0.0]),
        mount_known=not other or "yaw" in said,
    )


def _wheel_odometry(stamps: FloatArray, wheels: FloatArray) -> tuple[Odometry, ...]:
    """The pose by how far (n, 2), m, the left and the right wheel have come."""
    left, right = np.diff(wheels, axis=0).T
    X_OB = se2.poses_of(se2.arcs(0.5 * (left + right), 0.5 * (right - left) / HALF_AXLE))
    return odometry_along(stamps, X_OB, tells_rest=True)
