"""A grid in a file: an npz archive of resolution, origin and probability, as GridMap names them."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from tfg_drake.io.files import read_arrays, reading, write_atomic
from tfg_drake.messages import GridMap


def save_grid(path: Path, grid: GridMap, *, final: bool = True) -> None:
    """Write a grid, atomically; one that is not final neither compressed nor durable. Raises OSError where it cannot
    be written."""
    buffer = io.BytesIO()
    (np.savez_compressed if final else np.savez)(buffer, **vars(grid))
    write_atomic(path, buffer.getvalue(), durable=final)


def load_grid(path: Path) -> GridMap:
    """The grid of a file that `save_grid` wrote. Raises FileError."""
    with reading(path):
        arrays = read_arrays(path)
        _height, _width = arrays["probability"].shape
        stage, stamp, resolution = (arrays[name].item() for name in ("stage", "stamp", "resolution"))
        return GridMap(stage, stamp, resolution, arrays["origin"].reshape(2), arrays["probability"])
