"""Recordings that are wrong in a way that users have reported, each run by `tfg-drake slam`: whether it is right, told,
refused or silently wrong.

    python benchmarks/recording_mutations.py --seeds 200
    python benchmarks/recording_mutations.py --good --seeds 200

A seed draws a drive (recorded_drives.py; every third is a log of CARMEN, the others are bags) and one of the mutations
below; --good leaves it as it is. Classes: right: RMSE of the trajectory after alignment at most .1 m; told: more than
that, and a note of the mutation's kind within 5 s of it; refused: in one line; wrong: none of these. A row a seed is
kept in --rows as soon as it is there, and no row that is there is run again. The table has for each mutation how many
are of each class; of good drives, how many were told something, or refused.
"""

from __future__ import annotations

import argparse
import collections
import json
import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import recorded_drives
from recorded_drives import Drive

from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams.missions.slam import run_slam
from tfg_drake.geometry.alignment import align
from tfg_drake.geometry.se2 import transform
from tfg_drake.messages import FloatArray

# A result is right up to an RMSE of RIGHT, m; a mutation is told by a note at most NEAR, s, from it.
RIGHT, NEAR = 0.1, 5.0
CLASSES = ("right", "told", "refused", "wrong", "error")


class Mutated(NamedTuple):
    """A drive, the kinds of notes that say what is wrong with it, and when that is, s; nan: all along."""

    drive: Drive
    kinds: tuple[str, ...]
    time: float = math.nan


def _amid(drive: Drive, rng: np.random.Generator) -> float:
    """A time while the robot drives, s."""
    moving = np.flatnonzero(np.hypot(*np.diff(drive.truth[:, 1:3], axis=0).T) > 0.005)
    end = drive.truth[-1, 0]
    inside = moving[(drive.truth[moving, 0] > 0.2 * end) & (drive.truth[moving, 0] < 0.8 * end)]
    return float(drive.truth[rng.choice(inside), 0])


def _in_frame(rows: FloatArray, x: float, y: float, turn: float) -> None:
    """Odometry told in another frame, whose origin is at x, y, turned."""
    c, s = math.cos(turn), math.sin(turn)
    p = rows[:, 2:4] - (x, y)
    rows[:, 2], rows[:, 3] = c * p[:, 0] + s * p[:, 1], -s * p[:, 0] + c * p[:, 1]
    rows[:, 4] = np.remainder(rows[:, 4] - turn + math.pi, 2.0 * math.pi) - math.pi


def reset(drive: Drive, rng: np.random.Generator) -> Mutated:
    """The odometry begins at 0 once more."""
    at, rows = _amid(drive, rng), drive.odometry.copy()
    after = rows[:, 1] >= at
    _in_frame(rows[after], *rows[after][0, 2:5])
    new = rows[after]
    _in_frame(new, *new[0, 2:5])
    rows[after] = new
    return Mutated(drive._replace(odometry=rows), ("jump", "slip"), at)


def jump(drive: Drive, rng: np.random.Generator) -> Mutated:
    """The odometry jumps by .2 to 5 m and up to half a turn."""
    at, rows = _amid(drive, rng), drive.odometry.copy()
    new = rows[rows[:, 1] >= at]
    bearing, far = rng.uniform(-math.pi, math.pi), 0.2 * 25.0 ** rng.uniform()
    _in_frame(new, far * math.cos(bearing), far * math.sin(bearing), 0.0)
    about = new[0, 2:5].copy()
    _in_frame(new, about[0], about[1], rng.choice([0.0, rng.uniform(-math.pi, math.pi)]))
    new[:, 2:4] += about[:2]
    rows[rows[:, 1] >= at] = new
    return Mutated(drive._replace(odometry=rows), ("jump", "slip"), at)


def scale(drive: Drive, rng: np.random.Generator) -> Mutated:
    """Wheels whose size is wrong: the way is .2 to 5 times as long."""
    rows, factor = drive.odometry.copy(), 5.0 ** rng.uniform(-1.0, 1.0)
    rows[:, 2:4] *= factor
    rows[:, 5] *= factor
    return Mutated(drive._replace(odometry=rows), ("travel_scale", "turn_scale"))


def sign(drive: Drive, rng: np.random.Generator) -> Mutated:
    """The odometry turns the wrong way."""
    rows = drive.odometry * (1.0, 1.0, 1.0, -1.0, -1.0, 1.0, -1.0)
    return Mutated(drive._replace(odometry=rows), ())


def lag(drive: Drive, rng: np.random.Generator) -> Mutated:
    """Scans are stamped up to 1 s too early or too late."""
    times = drive.scan_times + np.array([0.0, rng.uniform(-1.0, 1.0)])
    return Mutated(drive._replace(scan_times=times), ("lag", "clock"))


def mirrored(drive: Drive, rng: np.random.Generator) -> Mutated:
    """The scanner hangs upside down, and nothing says so."""
    whole = drive.step * len(drive.ranges[0]) > 6.2
    ranges = [np.roll(one[::-1], 1) if whole else one[::-1].copy() for one in drive.ranges]
    return Mutated(drive._replace(ranges=ranges), ())


def gap(drive: Drive, rng: np.random.Generator) -> Mutated:
    """3 to 10 s of odometry are missing."""
    at, long, stamps = _amid(drive, rng), rng.uniform(3.0, 10.0), drive.odometry[:, 1]
    kept = (stamps < at) | (stamps > at + long)
    return Mutated(drive._replace(odometry=drive.odometry[kept]), ("silence", "jump", "slip"), at + long)


def clock(drive: Drive, rng: np.random.Generator) -> Mutated:
    """All stamps jump by 1 to 100 s back, or by hours ahead."""
    at, by = _amid(drive, rng), rng.choice([-(100.0 ** rng.uniform()), rng.uniform(1e3, 1e5)], p=[0.75, 0.25])
    odometry, times = drive.odometry.copy(), drive.scan_times.copy()
    for rows in (odometry, times):
        rows[rows[:, 1] >= at, 1] += by
    return Mutated(drive._replace(odometry=odometry, scan_times=times), ("clock", "stamps"), at)


def cut_stamps(drive: Drive, rng: np.random.Generator) -> Mutated:
    """Stamps are whole seconds."""
    odometry, times = drive.odometry.copy(), drive.scan_times.copy()
    for rows in (odometry, times):
        rows[:, 1] = np.floor(rows[:, 1])
    return Mutated(drive._replace(odometry=odometry, scan_times=times), ("clock", "stamps"))


def rays_lost(drive: Drive, rng: np.random.Generator) -> Mutated:
    """A fifth to three fifths of the rays come back with nothing."""
    share = rng.uniform(0.2, 0.6)
    ranges = [np.where(rng.uniform(size=len(one)) < share, np.inf, one) for one in drive.ranges]
    return Mutated(drive._replace(ranges=ranges), ("rays", "walls"))


def max_range(drive: Drive, rng: np.random.Generator) -> Mutated:
    """A ray that meets nothing, and some others, are told as the scanner's range."""
    ranges = [
        np.where((rng.uniform(size=len(one)) < 0.1) | np.isinf(one), drive.range_max, one) for one in drive.ranges
    ]
    return Mutated(drive._replace(ranges=ranges), ("rays", "walls"))


def ray_count(drive: Drive, rng: np.random.Generator) -> Mutated:
    """From some time on a scan has fewer rays than its header says."""
    at, share = _amid(drive, rng), rng.uniform(0.3, 0.9)
    late = drive.scan_times[:, 1] >= at
    ranges = [one[: int(share * len(one))] if cut else one for one, cut in zip(drive.ranges, late, strict=True)]
    return Mutated(drive._replace(ranges=ranges), ("rays", "scans", "scan"), at)


def frozen(drive: Drive, rng: np.random.Generator) -> Mutated:
    """For 3 to 10 s the scanner says the same."""
    at, long = _amid(drive, rng), rng.uniform(3.0, 10.0)
    times, ranges = drive.scan_times[:, 1], list(drive.ranges)
    for k in np.flatnonzero((times > at) & (times < at + long)):
        ranges[k] = ranges[k - 1]
    return Mutated(drive._replace(ranges=ranges), ("frozen",), at)


MUTATIONS: dict[str, Callable[[Drive, np.random.Generator], Mutated]] = {
    one.__name__: one
    for one in (
        reset,
        jump,
        gap,
        cut_stamps,
        clock,
        scale,
        sign,
        lag,
        mirrored,
        rays_lost,
        max_range,
        ray_count,
        frozen,
    )
}
# The mutation that is drawn with the drive.
MOUNT_YAW = "mount_yaw"


def made(seed: int, good: bool) -> tuple[str, Mutated, str]:
    """The name of the seed's mutation, the mutated drive, and the ending of its file."""
    rng, carmen = np.random.default_rng([seed, 17]), seed % 3 == 2
    names = [*MUTATIONS, MOUNT_YAW]
    name = "good" if good else names[seed % len(names)]
    if name == MOUNT_YAW:
        yaw = float(rng.choice([math.pi, 0.5 * math.pi, -0.5 * math.pi, rng.uniform(-math.pi, math.pi)]))
        drive = recorded_drives.drive(seed, carmen, yaw)._replace(mount_told=False)
        return name, Mutated(drive, ("mount_yaw",)), ".log" if carmen else ".db3"
    drive = recorded_drives.drive(seed, carmen)
    return name, MUTATIONS[name](drive, rng) if name in MUTATIONS else Mutated(drive, ()), ".log" if carmen else ".db3"


def error(stamps: FloatArray, X: FloatArray, truth: FloatArray) -> float:
    """RMSE, m, of poses (n, 3) at stamps (n,) after alignment to the truth (m, 4), whatever their clock's offset."""

    def off(late: float) -> float:
        p = np.column_stack([np.interp(stamps - late, truth[:, 0], value) for value in truth[:, 1:3].T])
        return float(np.sqrt(np.mean(np.sum((transform(align(p, X[:, :2]), X[:, :2]) - p) ** 2, axis=1))))

    return min(off(late) for late in np.arange(-1.3, 1.31, 0.05))


def row(seed: int, good: bool) -> dict:
    """Runs a seed's drive, and judges what became of it: a row."""
    name, mutated, suffix = made(seed, good)
    begin, rmse, said, notes = time.process_time(), math.nan, "", []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"drive{suffix}"
        recorded_drives.write(mutated.drive, path)
        try:
            notes = run_slam(path, Path(folder) / "run").summary["notes"]
            table = np.loadtxt(Path(folder) / "run" / "trajectory.tum")
            X = np.column_stack([table[:, 1:3], 2.0 * np.arctan2(table[:, 6], table[:, 7])])
            rmse = error(_since_epoch(table[:, 0]), X, mutated.drive.truth)
            near = [one for one in notes if one["kind"] in mutated.kinds and _is_near(one["time_s"], mutated.time)]
            result = "right" if rmse <= RIGHT else "told" if near else "wrong"
        except BadInput as refusal:
            result, said = "refused", str(refusal).replace(folder, "")
        except Exception as fault:
            result, said = "error", f"{type(fault).__name__}: {fault}"
    return {
        "seed": seed,
        "mutation": name,
        "suffix": suffix,
        "class": result,
        "rmse_m": round(rmse, 4),
        "time_s": mutated.time,
        "notes": notes,
        "said": said,
        "cpu_s": round(time.process_time() - begin, 1),
    }


def _is_near(time_s: float | None, at: float) -> bool:
    return math.isnan(at) or time_s is None or abs(float(_since_epoch(time_s)) - at) <= NEAR


def _since_epoch(stamps: FloatArray | float) -> FloatArray:
    """Seconds since the drive began, of stamps with or without the epoch, s."""
    half = 0.5 * recorded_drives.EPOCH
    return np.asarray((stamps + half) % recorded_drives.EPOCH - half)


def main() -> None:
    """Runs what is not there, and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--good", action="store_true", help="drives that are right")
    parser.add_argument("--rows", type=Path, help="the file of rows; runs/recording_mutations.jsonl, or _good.jsonl")
    options = parser.parse_args()
    path = options.rows or Path(f"runs/recording_mutations{'_good' if options.good else ''}.jsonl")
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    there = {one["seed"] for one in rows}
    seeds = range(options.first, options.first + options.seeds)
    for seed in seeds:
        if seed not in there:
            rows.append(row(seed, options.good))
            with path.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    rows = [one for one in rows if one["seed"] in seeds]
    counts = collections.Counter((one["mutation"], one["class"]) for one in rows)
    print(f"{'':12}" + "".join(f"{name:>9}" for name in CLASSES))
    for name in dict.fromkeys(one["mutation"] for one in rows):
        print(f"{name:12}" + "".join(f"{counts[name, one]:9}" for one in CLASSES))
    all_of = collections.Counter(one["class"] for one in rows)
    told = f"; {sum(bool(one['notes']) for one in rows)} told something" if options.good else ""
    print(f"\nof {len(rows)} drives: " + ", ".join(f"{all_of[one]} {one}" for one in CLASSES) + told)


if __name__ == "__main__":
    main()
