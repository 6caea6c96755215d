"""How far a trajectory is from relations between its poses that were checked by hand.

R. Kuemmerle et al., "On measuring the accuracy of SLAM algorithms", Autonomous Robots 27(4), 2009. A file has a
relation a line: t1 t2 x y z roll pitch yaw, the scanner at t2 as seen from where it was at t1, s, m and rad, and all
times are those of scans. The error of one is its difference to what the trajectory has there: no alignment, and no
error grows with the way before.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.datasets.recording import DatasetError
from tfg_drake.datasets.rows import Rows, parse_numbers
from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, IntArray, message
from tfg_drake.storage.trajectory import poses_at

_COLUMNS = ("t1", "t2", "x", "y", "z", "roll", "pitch", "yaw")


@message
class Relations:
    """path: the file. times: (k, 2) s, as it has them. X_12: (k, 3) the pose at the second as seen from the first."""

    path: Path
    times: FloatArray
    X_12: FloatArray


def read_relations(path: Path) -> Relations:
    """The relations in a file, plain or packed (.gz, .bz2).

    Raises:
        DatasetError: it cannot be read, a line is broken, or there is none.
    """

    def parse(number: int, words: list[str]) -> list[float]:
        if len(words) != len(_COLUMNS):
            found = f"{len(_COLUMNS)} numbers expected ({', '.join(_COLUMNS)}), {len(words)} found"
            raise DatasetError(f"{path}, line {number}: {found}; mend the line")
        return parse_numbers(path, number, words)

    table = np.array(Rows(path).read(parse))
    if not len(table):
        raise DatasetError(f"{path}: no relation in it; a line has {' '.join(_COLUMNS)}")
    return Relations(path, table[:, :2], table[:, [2, 3, 7]])


def relation_errors(
    stamps: FloatArray, X_W: FloatArray, relations: Relations, told_stamps: FloatArray | None = None
) -> dict[str, Any]:
    """How many relations there are, and the mean and standard deviation of their errors, m and degrees.

    stamps: (n,) s, increasing, X_W: (n, 3) the scanner's poses in any frame W, at all scans of the log. told_stamps:
    those of `Recording`, by which times in the file are looked up where stamps could not be true. Between two poses the
    way is straight.

    Raises:
        DatasetError: a relation's time is farther from all poses than half of their usual distance in time.
    """
    _, error = off_relations(stamps, X_W, relations, told_stamps)
    return {
        "count": len(error),
        "translation_m": _figures(np.hypot(error[:, 0], error[:, 1])),
        "rotation_deg": _figures(np.degrees(np.abs(error[:, 2]))),
    }


def off_relations(
    stamps: FloatArray, X_W: FloatArray, relations: Relations, told_stamps: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """The relations' times (k, 2), s, by the stamps, and where each has its second pose, as seen from where the
    trajectory has it, (k, 3). Arguments and what is raised as of `relation_errors`."""
    times = relations.times
    if told_stamps is not None and len(told_stamps):
        told, here = told_stamps[np.argsort(told_stamps[:, 0], kind="stable")].T
        times = here[_nearest(told, times, relations)]
    else:
        _nearest(stamps, times, relations)
    X_W1, X_W2 = (poses_at(at, stamps, X_W) for at in times.T)
    return times, se2.between(se2.between(X_W1, X_W2), relations.X_12)


def _nearest(stamps: FloatArray, times: FloatArray, relations: Relations) -> IntArray:
    """Rows of the stamps (n,), in order, nearest to times (k, 2). Raises DatasetError where none is near."""
    after = np.clip(np.searchsorted(stamps, times), 1, len(stamps) - 1)
    nearest = after - (times - stamps[after - 1] < stamps[after] - times)
    off = np.abs(times - stamps[nearest])
    far = np.argwhere(off > 0.5 * np.median(np.diff(stamps)))
    if len(far):
        row, column = far[0].tolist()
        raise DatasetError(
            f"{relations.path}, relation {row + 1}: no pose near {times[row, column]:.6f} s, the nearest is "
            f"{off[row, column]:.3f} s away; are these the relations of this log?"
        )
    return np.asarray(nearest)


def _figures(errors: FloatArray) -> dict[str, float]:
    return {"mean": float(errors.mean()), "std": float(errors.std())}
