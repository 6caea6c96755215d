"""Drives through buildings that nobody chose, recorded as robots with wheels and a scanner record them.

    python benchmarks/recorded_drives.py 7 drive.db3
    python benchmarks/recorded_drives.py 7 drive.log

A seed draws the building (that of offices.py), the way, speeds, the errors of wheels and gyro, and the scanner with its
place. Written are ROS 2 bags (SQLite) and raw logs of CARMEN, whose scanner has 181 rays and sits amid the robot.
"""

from __future__ import annotations

import argparse
import math
import sqlite3
import struct
from pathlib import Path
from typing import NamedTuple

import missions
import numpy as np
import offices
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from tfg_drake.config import OdometryConfig, ScanConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray
from tfg_drake.simulation import laser_scanner, odometry
from tfg_drake.world.reachability import CELL, make_grid, reachable_cells
from tfg_drake.world.world import bare_world

# SECONDS: least duration of a drive, s. STEP: period of the odometry, s. RADIUS: distance kept from walls, m.
SECONDS, STEP, RADIUS = 75.0, 0.05, 0.4
# Least delay between a scan's measurement and its log entry, s.
LOGGED = 0.03
# Stamp of a drive's time 0, s.
EPOCH = 1_700_000_000.0


class Drive(NamedTuple):
    """A recording and the truth. Times are s from the first message on, stamps those of the headers.

    truth: (n, 4) time, x, y, yaw. odometry: (n, 7) time recorded, stamp, x, y, yaw, speed, turn rate. scan_times:
    (m, 2) time recorded and stamp. ranges: m arrays of ranges in the order in which the scanner counts. first, step:
    rad, bearing of the first ray and from ray to ray. range_max: m. X_BS: (3,) where the scanner sits. mount_told:
    whether the recording says so.
    """

    truth: FloatArray
    odometry: FloatArray
    scan_times: FloatArray
    ranges: list[FloatArray]
    first: float
    step: float
    range_max: float
    X_BS: FloatArray
    mount_told: bool = True


def drive(seed: int, carmen: bool = False, yaw: float = 0.0) -> Drive:
    """The drive of a seed, with the scanner of CARMEN's logs or another one, that looks aside by yaw more, rad."""
    rng = np.random.default_rng([seed, 91])
    walls, start = offices.plan(seed)
    speed, turn_rate = rng.uniform(0.25, 0.8), rng.uniform(0.5, 1.2)
    truth = _driven(_way(np.array(walls), np.array(start), rng), speed, turn_rate)
    model = OdometryConfig(gyro_noise=rng.uniform(0.002, 0.01))
    errors = odometry.run_errors(rng.standard_normal(3), model)
    state, rows = odometry.initial_state(truth[0, 1:4]), []
    for row in truth:
        state = odometry.integrate(state, row[0], row[1:], errors, rng.standard_normal(2), model)
        said = odometry.message(state)
        rows.append(
            [row[0] + 0.002 * rng.exponential(), row[0], *said.X_OB, *(said.V_B if row[0] > 0.0 else (0.0, 0.0))]
        )
    view = math.pi if carmen else float(rng.choice([math.pi, math.radians(240), math.radians(270), 2.0 * math.pi]))
    count = 181 if carmen else round(view / math.radians(rng.choice([0.5, 1.0])))
    step = view / (count - 1) if view < 6.0 else view / count
    scanner = ScanConfig(range=float(rng.choice([8.0, 12.0, 20.0])), noise=rng.uniform(0.005, 0.02))
    X_BS = (
        np.zeros(3) if carmen else np.array([rng.uniform(-0.1, 0.2), rng.uniform(-0.05, 0.05), rng.uniform(-0.3, 0.3)])
    )
    angles = -0.5 * view + step * np.arange(count)
    # A scan in a log of CARMEN has the pose of a message of odometry.
    times = truth[2:-6:2, 0] if carmen else np.arange(0.1, truth[-1, 0] - 0.3, 1.0 / rng.uniform(6.0, 12.0))
    ranges, heading = [], np.unwrap(truth[:, 3])
    for time in times:
        X_WB = np.array([np.interp(time, truth[:, 0], value) for value in (truth[:, 1], truth[:, 2], heading)])
        X_WS = se2.compose(se2.compose(X_WB, X_BS), np.array([0.0, 0.0, yaw]))
        seen = laser_scanner.scan(np.array(walls), X_WS, time, angles, rng.standard_normal(count), scanner)
        ranges.append(np.array(seen.ranges))
    scan_times = np.column_stack([times + LOGGED + 0.01 * rng.exponential(size=len(times)), times])
    return Drive(truth[:, :4], np.array(rows), scan_times, ranges, float(angles[0]), step, scanner.range, X_BS)


def _way(walls: FloatArray, start: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Corners (k, 2), m, of a way to some places that can be reached from the start."""
    world = bare_world(walls, start)
    grid = make_grid(world)
    # Every fourth cell each way is a place.
    cells = np.argwhere(reachable_cells(grid, world, RADIUS)[::4, ::4])[:, ::-1]
    places = grid.p_WG + 4.0 * CELL * cells
    number = {tuple(cell): k for k, cell in enumerate(cells.tolist())}
    links = [
        (k, number[i + di, j + dj], math.hypot(di, dj))
        for (i, j), k in number.items()
        for di, dj in ((1, 0), (0, 1), (1, 1), (1, -1), (-1, 0), (0, -1), (-1, -1), (-1, 1))
        if (i + di, j + dj) in number
    ]
    rows, columns, lengths = (np.array(one) for one in zip(*links, strict=True))
    graph = coo_array((lengths, (rows, columns)), shape=(len(places), len(places))).tocsr()
    at, way = int(np.argmin(np.hypot(*(places - start[:2]).T))), []
    for _ in range(20):
        reach, before = dijkstra(graph, indices=at, return_predecessors=True)
        goal = int(rng.choice(np.flatnonzero(np.isfinite(reach))))
        path = [goal]
        while path[-1] != at:
            path.append(int(before[path[-1]]))
        way += [places[k] for k in path[::-1]]
        at = goal
    return np.array(way)


def _driven(way: FloatArray, speed: float, turn_rate: float) -> FloatArray:
    """Time, pose, speed and turn rate (n, 6) of who drives along corners (k, 2): two s at rest, then turns on the spot
    and straight ways."""
    kept = [way[0]]
    for k, corner in enumerate(way[1:-1], start=1):
        into, out = corner - kept[-1], way[k + 1] - corner
        if np.hypot(*into) > 1e-6 and (abs(into[0] * out[1] - into[1] * out[0]) > 1e-6 or into @ out < 0.0):
            kept.append(corner)
    pose = np.array([*kept[0], math.atan2(*(kept[1] - kept[0])[::-1])])
    rows = [[STEP * k, *pose, 0.0, 0.0] for k in range(41)]
    for corner in kept[1:]:
        ahead = corner - pose[:2]
        turn = float(se2.wrap_angle(math.atan2(ahead[1], ahead[0]) - pose[2]))
        way_left = float(np.hypot(*ahead))
        for length, most, axis in ((turn, turn_rate, 2), (way_left, speed, 0)):
            steps = math.ceil(abs(length) / most / STEP)
            for _ in range(steps):
                step = np.zeros(3)
                step[axis] = length / steps
                pose = se2.compose(pose, step)
                rate = length / steps / STEP
                rows.append([rows[-1][0] + STEP, *pose, rate * (axis == 0), rate * (axis == 2)])
        if rows[-1][0] > SECONDS:
            break
    return np.array(rows)


def write(drive: Drive, path: Path) -> None:
    """A bag where the name ends in .db3, else a log of CARMEN, which has no place for where the scanner sits."""
    events = [(row[0], 0, k) for k, row in enumerate(drive.odometry)]
    events += [(row[0], 1, k) for k, row in enumerate(drive.scan_times)]
    events.sort()
    path.unlink(missing_ok=True)
    if path.suffix == ".db3":
        _write_bag(drive, events, path)
    else:
        _write_carmen(drive, events, path)


def _write_carmen(drive: Drive, events: list[tuple[float, int, int]], path: Path) -> None:
    """Scans with the pose of the message of odometry that was logged nearest to when they were taken."""
    lines = []
    for at, is_scan, k in events:
        if is_scan:
            row = drive.odometry[int(np.argmin(np.abs(drive.odometry[:, 0] - drive.scan_times[k, 0] + LOGGED)))]
            ranges = np.where(np.isfinite(drive.ranges[k]), drive.ranges[k], 81.83)
            seen, pose = " ".join(f"{value:.2f}" for value in ranges), " ".join(f"{value:.6f}" for value in row[2:5])
            lines.append(
                f"FLASER {len(ranges)} {seen} {pose} {pose} {EPOCH + drive.scan_times[k, 1]:.6f} robot {at:.6f}"
            )
        else:
            x, y, yaw, speed, rate = drive.odometry[k, 2:]
            stamp = EPOCH + drive.odometry[k, 1]
            lines.append(f"ODOM {x:.6f} {y:.6f} {yaw:.6f} {speed:.6f} {rate:.6f} 0.0 {stamp:.6f} robot {at:.6f}")
    path.write_text("\n".join(lines) + "\n")


def _write_bag(drive: Drive, events: list[tuple[float, int, int]], path: Path) -> None:
    with sqlite3.connect(path) as file:
        file.execute(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
            "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)"
        )
        file.execute(
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, "
            "data BLOB NOT NULL)"
        )
        topics = [("/odom", "nav_msgs/msg/Odometry"), ("/scan", "sensor_msgs/msg/LaserScan")]
        topics += [("/tf_static", "tf2_msgs/msg/TFMessage")]
        for number, (name, kind) in enumerate(topics, start=1):
            file.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '')", (number, name, kind))
        x, y, yaw = drive.X_BS
        mount = _Cdr().number("I", 1).header(EPOCH, "base_link").text("laser").numbers("d", [x, y, 0.2, *_about_z(yaw)])
        rows = [(3, EPOCH, bytes(mount.data))] if drive.mount_told else []
        for at, is_scan, k in events:
            rows.append((1 + is_scan, EPOCH + at, _scan(drive, k) if is_scan else _odometry(drive.odometry[k])))
        rows_ns = [(number, round(1e9 * time), data) for number, time, data in rows]
        file.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", rows_ns)


class _Cdr:
    """A message of ROS 2 as bytes, little-endian, each number at a multiple of its size."""

    def __init__(self) -> None:
        self.data = bytearray(b"\x00\x01\x00\x00")

    def numbers(self, kind: str, values: FloatArray | list[float]) -> _Cdr:
        self.data += bytes(-(len(self.data) - 4) % struct.calcsize(kind)) if len(values) else b""
        self.data += struct.pack(f"<{len(values)}{kind}", *values)
        return self

    def number(self, kind: str, value: float) -> _Cdr:
        return self.numbers(kind, [value])

    def text(self, text: str) -> _Cdr:
        self.number("I", len(text) + 1).data.extend(text.encode() + b"\0")
        return self

    def header(self, stamp: float, frame: str) -> _Cdr:
        seconds = math.floor(stamp)
        nanoseconds = min(round(1e9 * (stamp - seconds)), 10**9 - 1)
        return self.number("i", seconds).number("I", nanoseconds).text(frame)


def _about_z(yaw: float) -> list[float]:
    return [0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)]


def _odometry(row: FloatArray) -> bytes:
    _, stamp, x, y, yaw, speed, rate = row
    out = _Cdr().header(EPOCH + stamp, "odom").text("base_link")
    out.numbers("d", [x, y, 0.0, *_about_z(yaw), *[0.0] * 36, speed, 0.0, 0.0, 0.0, 0.0, rate, *[0.0] * 36])
    return bytes(out.data)


def _scan(drive: Drive, k: int) -> bytes:
    ranges, last = drive.ranges[k], drive.first + drive.step * (len(drive.ranges[0]) - 1)
    out = _Cdr().header(EPOCH + drive.scan_times[k, 1], "laser")
    out.numbers("f", [drive.first, last, drive.step, 0.0, 0.1, 0.05, drive.range_max])
    out.number("I", len(ranges)).numbers("f", ranges).number("I", 0)
    return bytes(out.data)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seed", type=missions.seed)
    parser.add_argument("file", type=Path)
    asked = parser.parse_args()
    write(drive(asked.seed, asked.file.suffix == ".log"), asked.file)
