"""Trajectories as text, in the TUM format that trajectory tools (evo and others) read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.io.files import FileError, read_text, reading, write_atomic
from tfg_drake.messages import FloatArray


def write_tum(path: Path, stamps: FloatArray, X_WB: FloatArray) -> None:
    """Write a trajectory, one pose a line: `timestamp tx ty tz qx qy qz qw`.

    Args:
        path: the file, written atomically.
        stamps: (n,) s.
        X_WB: (n, 3) planar poses, m and rad; z is 0 and the rotation about the z axis.

    Raises:
        OSError: the file cannot be written.
    """
    half = 0.5 * X_WB[:, 2]
    zero = np.zeros(len(stamps))
    table = np.column_stack([stamps, X_WB[:, 0], X_WB[:, 1], zero, zero, zero, np.sin(half), np.cos(half)])
    write_atomic(path, "".join(("%.6f" + 7 * " %.9f" + "\n") % tuple(row) for row in table))


def read_tum(path: Path) -> tuple[FloatArray, FloatArray]:
    """Read a planar trajectory: stamps (n,) s and X_WB (n, 3), m and rad.

    Raises:
        FileError: the file cannot be read, or a line is not eight numbers.
    """
    with reading(path):
        lines = [line for line in read_text(path).splitlines() if line.strip() and not line.startswith("#")]
    try:
        table = np.array([[float(word) for word in line.split()] for line in lines]).reshape(len(lines), 8)
    except ValueError:
        raise FileError(f"{path}: every line of a TUM trajectory has eight numbers") from None
    heading = wrap_angle(2.0 * np.arctan2(table[:, 6], table[:, 7]))
    return table[:, 0], np.column_stack([table[:, 1:3], heading])


def poses_at(stamps: FloatArray, log_stamps: FloatArray, poses: FloatArray) -> FloatArray:
    """The logged poses (m, 3) at other stamps (n,), interpolated: (n, 3), nan without a log."""
    if not len(log_stamps):
        return np.full((len(stamps), 3), np.nan)
    heading = np.unwrap(poses[:, 2])
    columns = [np.interp(stamps, log_stamps, column) for column in (poses[:, 0], poses[:, 1], heading)]
    return np.stack(columns, axis=1)
