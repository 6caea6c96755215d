"""A map on disk: one .npz of plain arrays, no pickle, with a schema number.

| array | shape | meaning |
|---|---|---|
| schema | () | this layout's number |
| X_WM | (3,) | pose of the map frame in the world, m and rad |
| stage, stamp, entropy | () | goals in the map, time of the last (s), entropy of the landmarks (nats) |
| ids, p_ML, facing | (n,), (n, 2), (n, 2) | landmarks: id, position in M (m), side seen from (unit vector) |
| X_MD, covariance | (3,), (2n + 3, 2n + 3) | last departure pose; joint covariance of (p_ML row by row, X_MD) |
| X_MA | (k, 3) | arrival poses of the goals |
| segments, segment_kind, segment_ids | (m, 4), (m,), (m, 2) | obstacle surfaces, see `TfgMap` |
| frontiers, frontier_length, frontier_normal | (f, 2), (f,), (f, 2) | what is still open, see `TfgMap` |
| star_offsets, star_vertices, star_centers | (s + 1,), (v, 2), (s, 2) | free space seen from each goal, see `TfgMap` |
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.files import write_atomic
from tfg_drake.messages import FloatArray, IntArray, MapEstimate, TfgMap, message

SCHEMA = 1

# Array name -> shape; letters are lengths that must agree throughout the file.
_LAYOUT: dict[str, tuple[str | int, ...]] = {
    "X_WM": (3,),
    "stage": (),
    "stamp": (),
    "entropy": (),
    "ids": ("n",),
    "p_ML": ("n", 2),
    "facing": ("n", 2),
    "X_MD": (3,),
    "covariance": ("2n+3", "2n+3"),
    "X_MA": ("k", 3),
    "segments": ("m", 4),
    "segment_kind": ("m",),
    "segment_ids": ("m", 2),
    "frontiers": ("f", 2),
    "frontier_length": ("f",),
    "frontier_normal": ("f", 2),
    "star_offsets": ("s+1",),
    "star_vertices": ("v", 2),
    "star_centers": ("s", 2),
}
_INTEGERS = {"stage", "ids", "segment_kind", "segment_ids", "star_offsets"}


class MapFileError(Exception):
    """The file is not a map, or not a whole one."""


@message
class SavedMap:
    """A map as it is kept on disk; the fields are the file's arrays, see the module."""

    X_WM: FloatArray
    stage: int
    stamp: float
    entropy: float
    ids: IntArray
    p_ML: FloatArray
    facing: FloatArray
    X_MD: FloatArray
    covariance: FloatArray
    X_MA: FloatArray
    segments: FloatArray
    segment_kind: IntArray
    segment_ids: IntArray
    frontiers: FloatArray
    frontier_length: FloatArray
    frontier_normal: FloatArray
    star_offsets: IntArray
    star_vertices: FloatArray
    star_centers: FloatArray


def saved_map(X_WM: FloatArray, estimate: MapEstimate, tfg: TfgMap) -> SavedMap:
    """What is kept of an estimate and its TFG; `facing` is zero for landmarks the TFG does not know yet."""
    facing = np.zeros_like(estimate.p_ML)
    known = min(len(facing), len(tfg.facing)) if tfg.stage == estimate.stage else 0
    facing[:known] = tfg.facing[:known]
    return SavedMap(
        X_WM=np.array(X_WM, dtype=float),
        stage=estimate.stage,
        stamp=estimate.stamp,
        entropy=estimate.entropy,
        ids=estimate.ids,
        p_ML=estimate.p_ML,
        facing=facing,
        X_MD=estimate.X_MD,
        covariance=estimate.covariance,
        X_MA=estimate.X_MA,
        segments=tfg.segments,
        segment_kind=tfg.segment_kind,
        segment_ids=tfg.segment_ids,
        frontiers=tfg.frontiers,
        frontier_length=tfg.frontier_length,
        frontier_normal=tfg.frontier_normal,
        star_offsets=tfg.star_offsets,
        star_vertices=tfg.star_vertices,
        star_centers=tfg.star_centers,
    )


def save_map(path: Path, saved: SavedMap) -> None:
    """Write a map, atomically.

    Raises:
        OSError: the file cannot be written.
    """
    buffer = io.BytesIO()
    arrays = {name: np.asarray(getattr(saved, name)) for name in _LAYOUT}
    np.savez_compressed(buffer, schema=np.int64(SCHEMA), **arrays)  # type: ignore[arg-type]
    write_atomic(path, buffer.getvalue())


def load_map(path: Path) -> SavedMap:
    """Read a map.

    Raises:
        MapFileError: no such file, not a map, cut short, of another schema, or at odds with itself; one line.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            if "schema" not in file:
                raise MapFileError(f"{path} is not a map of tfg-drake")
            schema = int(file["schema"])
            if schema != SCHEMA:
                raise MapFileError(f"{path} has map schema {schema}; this version reads schema {SCHEMA}")
            missing = [name for name in _LAYOUT if name not in file]
            if missing:
                raise MapFileError(f"{path} is not a whole map: {missing[0]} is missing")
            arrays = {name: file[name] for name in _LAYOUT}
    except FileNotFoundError:
        raise MapFileError(f"no such map: {path}") from None
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise MapFileError(f"{path} is damaged or not a map of tfg-drake") from error
    _check(path, arrays)
    values: dict[str, Any] = {name: array.item() if array.ndim == 0 else array for name, array in arrays.items()}
    return SavedMap(**values)


def _check(path: Path, arrays: dict[str, FloatArray]) -> None:
    lengths: dict[str, int] = {}
    for name, shape in _LAYOUT.items():
        array = arrays[name]
        if len(array.shape) != len(shape):
            raise MapFileError(f"{path} is not a whole map: {name} has the wrong shape")
        for size, wanted in zip(array.shape, shape, strict=True):
            expected = _expected(wanted, lengths, size)
            if size != expected:
                raise MapFileError(f"{path} is not a whole map: {name} has the wrong shape")
        if name in _INTEGERS and array.dtype.kind != "i":
            raise MapFileError(f"{path} is not a whole map: {name} holds no integers")
        if name not in _INTEGERS and array.dtype.kind != "f":
            raise MapFileError(f"{path} is not a whole map: {name} holds no numbers")
    for name, array in arrays.items():
        if not np.all(np.isfinite(array)):
            raise MapFileError(f"{path} is not a whole map: {name} is not finite")
    offsets = arrays["star_offsets"]
    if len(offsets) < 1 or offsets[0] != 0 or offsets[-1] != lengths["v"] or np.any(np.diff(offsets) < 0):
        raise MapFileError(f"{path} is not a whole map: star_offsets does not fit star_vertices")


def _expected(wanted: str | int, lengths: dict[str, int], size: int) -> int:
    """The length an axis must have; the first axis of each letter settles it."""
    if isinstance(wanted, int):
        return wanted
    if wanted == "2n+3":
        return 2 * lengths["n"] + 3
    if wanted == "s+1":
        lengths["s"] = size - 1
        return size
    return lengths.setdefault(wanted, size)
