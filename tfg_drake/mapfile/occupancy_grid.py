"""A map as an occupancy grid of ROS map_server: an image, and the .yaml that says how to read it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry.polygon import outline
from tfg_drake.geometry.star import inside_any
from tfg_drake.mapfile.in_world import corners_of, tfg_in_world
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray, IntArray

# Side of a cell, m.
CELL = 0.05
# What map savers write, and their threshold, above which grey 205 is unknown.
OCCUPIED, UNKNOWN, FREE, FREE_THRESH = 0, 205, 254, 0.196
# Cells whose centres are placed at once.
_AT_ONCE = 1_000_000


def map_server_files(saved: SavedMap, image: str) -> tuple[str, bytes]:
    """The contents of the .yaml and of the image (.pgm), whose file name `image` is.

    Cells that surfaces pass through are occupied, others whose centres were seen to be free are free, all else is
    unknown. Raises BadInput where the map has no free space.
    """
    tfg, (low, columns, rows) = tfg_in_world(saved), _extent(saved)
    level = np.full((rows, columns), UNKNOWN, dtype=np.uint8)
    for some in np.array_split(np.arange(rows), math.ceil(rows * columns / _AT_ONCE)):
        free = inside_any(_centres(low, columns, some), tfg.star_offsets, tfg.star_vertices)
        level[some] = np.where(free, FREE, UNKNOWN).reshape(-1, columns)
    _draw(level, low, tfg.segments)
    return _files(level, low, image)


def keep_out_files(saved: SavedMap, areas: Sequence[FloatArray], image: str) -> tuple[str, bytes]:
    """The same of Nav2's keep-out mask, on the grid of map_server_files.

    Cells with their centres in one of the areas, corners (n, 2), m in W, and those that its edges pass through are
    occupied, all others free.
    """
    low, columns, rows = _extent(saved)
    level = np.full((rows, columns), FREE, dtype=np.uint8)
    for corners in areas:
        inside = Outline(corners).contains_points(_centres(low, columns, np.arange(rows)))
        level[inside.reshape(rows, columns)] = OCCUPIED
        _draw(level, low, outline(corners))
    return _files(level, low, image)


def _extent(saved: SavedMap) -> tuple[FloatArray, int, int]:
    """The grid's lowest corner (2,), m in W, its columns and rows. Raises BadInput where the map has no free space."""
    tfg = tfg_in_world(saved)
    if not len(tfg.star_vertices):
        raise BadInput("the map has no free space, so there is no grid of it; export what it has, such as a .csv")
    low, high = corners_of(np.zeros((0, 2)), tfg)
    low = CELL * (np.floor(low / CELL) - 1.0)
    columns, rows = (np.ceil((high - low) / CELL) + 1.0).astype(int).tolist()
    return low, columns, rows


def _centres(low: FloatArray, columns: int, rows: IntArray) -> FloatArray:
    """The centres (r * columns, 2) of the cells of some rows (r,), m in W."""
    x, y = low[0] + CELL * (np.arange(columns) + 0.5), low[1] + CELL * (rows + 0.5)
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def _draw(level: NDArray[np.uint8], low: FloatArray, segments: FloatArray) -> None:
    """Makes the cells of a grid occupied through which segments (m, 4), m in W, pass."""
    for piece in segments:
        count = math.ceil(4.0 * math.hypot(*(piece[2:] - piece[:2])) / CELL) + 1
        column, row = np.floor((np.linspace(piece[:2], piece[2:], count) - low) / CELL).astype(int).T
        there = (column >= 0) & (row >= 0) & (column < level.shape[1]) & (row < level.shape[0])
        level[row[there], column[there]] = OCCUPIED


def _files(level: NDArray[np.uint8], low: FloatArray, image: str) -> tuple[str, bytes]:
    text = (
        f"image: {image}\nmode: trinary\nresolution: {CELL}\norigin: [{low[0]:.6f}, {low[1]:.6f}, 0.0]\n"
        f"negate: 0\noccupied_thresh: 0.65\nfree_thresh: {FREE_THRESH}\n"
    )
    rows, columns = level.shape
    return text, b"P5\n%d %d\n255\n" % (columns, rows) + level[::-1].tobytes()
