"""A map as an occupancy grid of ROS map_server: an image, and the .yaml that says how to read it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry.polygon import outline
from tfg_drake.geometry.raster import draw_segments, fill_polygon
from tfg_drake.mapfile.in_world import corners_of, stars_of, tfg_in_world
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray

# Side of a cell, m.
CELL = 0.05
# What map savers write, and their threshold, above which grey 205 is unknown.
OCCUPIED, UNKNOWN, FREE, FREE_THRESH = 0, 205, 254, 0.196


def map_server_files(saved: SavedMap, image: str) -> tuple[str, bytes]:
    """The contents of the .yaml and of the image (.pgm), whose file name `image` is.

    Cells that surfaces pass through are occupied, others whose centres were seen to be free are free, all else is
    unknown. Raises BadInput where the map has no free space.
    """
    tfg, (low, columns, rows) = tfg_in_world(saved), _extent(saved)
    level = np.full((rows, columns), UNKNOWN, dtype=np.uint8)
    for star in stars_of(tfg):
        fill_polygon(level, (star - low) / CELL, FREE)
    draw_segments(level, (tfg.segments - np.tile(low, 2)) / CELL, OCCUPIED)
    return _files(level, low, image)


def keep_out_files(saved: SavedMap, areas: Sequence[FloatArray], image: str) -> tuple[str, bytes]:
    """The same of Nav2's keep-out mask, on the grid of map_server_files.

    Cells with their centres in one of the areas, corners (n, 2), m in W, and those that its edges pass through are
    occupied, all others free.
    """
    low, columns, rows = _extent(saved)
    level = np.full((rows, columns), FREE, dtype=np.uint8)
    for corners in areas:
        placed = (corners - low) / CELL
        fill_polygon(level, placed, OCCUPIED)
        draw_segments(level, outline(placed), OCCUPIED)
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


def _files(level: NDArray[np.uint8], low: FloatArray, image: str) -> tuple[str, bytes]:
    text = (
        f"image: {image}\nmode: trinary\nresolution: {CELL}\norigin: [{low[0]:.6f}, {low[1]:.6f}, 0.0]\n"
        f"negate: 0\noccupied_thresh: 0.65\nfree_thresh: {FREE_THRESH}\n"
    )
    rows, columns = level.shape
    return text, b"P5\n%d %d\n255\n" % (columns, rows) + level[::-1].tobytes()
