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
    save = np.savez_compressed if final else np.savez
    save(
        buffer,
        stage=grid.stage,
        stamp=grid.stamp,
        resolution=grid.resolution,
        origin=grid.origin,
        probability=grid.probability,
    )
    write_atomic(path, buffer.getvalue(), durable=final)


def load_grid(path: Path) -> GridMap:
    """The grid of a file that `save_grid` wrote. Raises FileError."""
    with reading(path):
        arrays = read_arrays(path)
        _height, _width = arrays["probability"].shape
        return GridMap(
            stage=int(arrays["stage"]),
            stamp=float(arrays["stamp"]),
            resolution=float(arrays["resolution"]),
            origin=arrays["origin"].reshape(2),
            probability=arrays["probability"],
        )
