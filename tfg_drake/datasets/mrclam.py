"""UTIAS MR.CLAM: five robots among barcoded cylinders (Leung, Halpern, Barfoot and Liu, IJRR 30(8), 2011).

A folder holds Barcodes.dat, Landmark_Groundtruth.dat and, for each robot N, RobotN_Odometry.dat, RobotN_Measurement.dat
and perhaps RobotN_Groundtruth.dat, plain or gzipped. The odometry rows are velocity commands, and a measurement names
a barcode, not a subject.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tfg_drake.config import OdometryConfig
from tfg_drake.datasets.recording import DatasetError, GroundTruth, Recording, make_frames
from tfg_drake.datasets.rows import find_file, found_file, read_table
from tfg_drake.geometry import se2
from tfg_drake.io.clock_unit import UNITS, clock_unit
from tfg_drake.messages import FloatArray, Odometry, replace
from tfg_drake.notes import Note
from tfg_drake.table import empty

# Subjects 1 to 5 are robots, 6 to 20 landmarks.
ROBOTS = range(1, 6)
LANDMARKS = range(6, 21)
# Measured against the truth of Dataset6: 0.07-0.18 m and 0.006-0.018 rad.
SIGMA_RANGE = 0.2
SIGMA_BEARING = 0.014
# Ratio of the commands to the true speed and turn rate, on which the smoothed runs of Dataset6 agree within a few %.
SPEED_SCALE = 1.05
TURN_SCALE = 1.09
# Delay from a command's stamp to its effect, s: all five smoothed runs fit best at 0.20 to 0.25 s.
COMMAND_LATENCY = 0.2
# Longest time between two odometry messages, s, if the file has enough rows.
LONGEST_MESSAGE = 0.25

# A command is followed by another within this time, s. Otherwise rows are missing, and the robot is assumed to have
# driven straight ahead, as its turns are short.
LONGEST_HELD = 2.0


def odometry_model() -> OdometryConfig:
    """Noise of the odometry of every run, the commands' mean scale taken out."""
    return OdometryConfig(distance_noise=0.02, distance_scale=0.04, gyro_noise=0.02, gyro_bias=0.005, gyro_scale=0.04)


def load_mrclam(folder: Path, robot: int) -> Recording:
    """One robot's run; the other robots it saw are left out.

    Raises:
        DatasetError: a file is missing or broken, or there is no such robot.
    """
    table, mended = read_table(find_file(folder, "Barcodes.dat"), ("subject", "barcode"), timed=False)
    notes, barcodes = [*mended], table.astype(np.int64)
    if robot not in ROBOTS:
        raise DatasetError(f"--robot {robot}: MR.CLAM has robots 1 to 5")
    odometry_file = find_file(folder, f"Robot{robot}_Odometry.dat")
    odometry, mended = read_table(odometry_file, ("time", "forward speed", "turn rate"))
    if not len(odometry):
        raise DatasetError(f"{odometry_file}: no odometry in it; copy it again")
    unit = clock_unit(odometry[:, 0])
    if unit != "s":
        notes.append(Note("stamps", None, f"{odometry_file.name}: stamps of all files read as {unit}"))
    odometry[:, 0] *= UNITS[unit]
    odometry, missing = _without_long_turns(odometry)
    if missing:
        notes.append(Note("silence", None, f"{odometry_file.name}: {missing}"))
    notes += mended
    at_first = (odometry[0, 0], 0.0, 0.0)
    commands = odometry / (1.0, SPEED_SCALE, TURN_SCALE) + (COMMAND_LATENCY, 0.0, 0.0)
    messages = integrate_commands(np.vstack([at_first, commands]))

    file = find_file(folder, f"Robot{robot}_Measurement.dat")
    sightings, mended = read_table(file, ("time", "barcode", "range", "bearing"))
    notes += mended
    subjects = dict(zip(barcodes[:, 1].tolist(), barcodes[:, 0].tolist(), strict=True))
    subject = np.array([subjects.get(int(code), 0) for code in sightings[:, 1]], dtype=np.int64)
    unknown = int(np.count_nonzero(subject == 0))
    if unknown:
        left_out = f"{unknown} measurements of barcodes that Barcodes.dat does not list were left out"
        notes.append(Note("messages", None, left_out))
    stamps = sightings[:, 0] * UNITS[unit]
    kept = np.isin(subject, LANDMARKS) & (stamps >= messages[0].stamp) & (stamps <= messages[-1].stamp)
    kept &= sightings[:, 2] > 0.0
    distance, bearing = sightings[kept, 2:].T
    sigma_range, sigma_bearing = (np.full(len(distance), sigma) for sigma in (SIGMA_RANGE, SIGMA_BEARING))
    frames = make_frames(stamps[kept], subject[kept], distance, bearing, sigma_range, sigma_bearing)
    truth, told = _truth(folder, robot, UNITS[unit])
    notes += told
    return Recording(
        name=f"{folder.resolve().name}-robot{robot}",
        odometry=messages,
        detections=frames,
        model=odometry_model(),
        truth=truth,
        notes=tuple(notes),
    )


def integrate_commands(rows: FloatArray) -> tuple[Odometry, ...]:
    """Dead reckoning from commands (n, 3) of time, forward speed and turn rate, each valid until the next.

    Exact on arcs. Rows that repeat a command are one arc and make one message.
    """
    dt = np.diff(rows[:, 0])
    X_OB = se2.poses_of(se2.arcs(rows[:-1, 1] * dt, rows[:-1, 2] * dt))
    repeats = np.append(False, np.all(rows[1:, 1:] == rows[:-1, 1:], axis=1)).tolist()
    stamps = rows[:, 0].tolist()
    messages = [Odometry(stamp=stamps[0], X_OB=X_OB[0], V_B=rows[0, 1:])]
    for i in range(1, len(rows)):
        if i < len(rows) - 1:
            if stamps[i + 1] <= stamps[i]:
                continue  # the last of several rows at one time counts
            if repeats[i] and stamps[i + 1] - messages[-1].stamp <= LONGEST_MESSAGE:
                continue
        if stamps[i] > messages[-1].stamp:
            at_rest = not messages[-1].V_B.any()
            messages.append(Odometry(stamp=stamps[i], X_OB=X_OB[i], V_B=rows[i, 1:], at_rest=at_rest))
    return tuple(messages)


def _without_long_turns(rows: FloatArray) -> tuple[FloatArray, str]:
    """The commands (n, 3), none of which turns for longer than LONGEST_HELD, and what is said of the holes."""
    dt = np.diff(rows[:, 0])
    holes = np.flatnonzero(dt > LONGEST_HELD)
    if not len(holes):
        return rows, ""
    straight = rows[holes] * (1.0, 1.0, 0.0) + (LONGEST_HELD, 0.0, 0.0)
    at = ", ".join(f"{dt[i]:.1f} s after {rows[i, 0]:.1f}" for i in holes[:5].tolist())
    more = f" and {len(holes) - 5} times more" if len(holes) > 5 else ""
    return np.insert(rows, holes + 1, straight, axis=0), f"no rows for {at}{more}; the motion then is a guess"


def _truth(folder: Path, robot: int, unit: float) -> tuple[GroundTruth | None, list[Note]]:
    """Ground truth, if any, and notes on mended lines. unit: of its stamps, s."""
    notes: list[Note] = []
    truth = empty(GroundTruth)
    if file := found_file(folder, f"Robot{robot}_Groundtruth.dat"):
        poses, mended = read_table(file, ("time", "x", "y", "heading"))
        notes += mended
        truth = replace(truth, stamps=unit * poses[:, 0], X_WB=poses[:, 1:])
    if file := found_file(folder, "Landmark_Groundtruth.dat"):
        landmarks, mended = read_table(file, ("subject", "x", "y", "sigma x", "sigma y"), timed=False)
        notes += mended
        landmarks = landmarks[np.argsort(landmarks[:, 0])]
        truth = replace(truth, ids=landmarks[:, 0].astype(np.int64), p_WL=landmarks[:, 1:3])
    return (truth if len(truth.stamps) or len(truth.ids) else None), notes
