"""A map as an occupancy grid of ROS map_server: an image, and the .yaml that says how to read it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry.polygon import outline
from tfg_drake.geometry.raster import draw_segments, fill_polygon
from tfg_drake.grid import frontier
from tfg_drake.grid.frontier import CellArray
from tfg_drake.mapfile.in_world import stars_of, tfg_in_world
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray, TfgMap

# Side of a cell, m.
CELL = 0.05
# Grey levels that map savers write, and their threshold, with which grey 205 is unknown.
OCCUPIED, UNKNOWN, FREE, FREE_THRESH = 0, 205, 254, 0.196


def rasterised(tfg: TfgMap, cell: float = CELL) -> tuple[CellArray, FloatArray]:
    """A TFG as classes (h, w) of `grid.frontier` in rows of cells, and their lowest corner (2,), m: free where a cell's
    centre is in a star polygon, occupied along surfaces. The corner is a multiple of a cell, so that cells keep their
    place as the map grows."""
    points = np.vstack([tfg.star_vertices, tfg.segments.reshape(-1, 2)])
    if not len(points):
        return np.zeros((0, 0), dtype=np.uint8), np.zeros(2)
    first = np.floor(points.min(axis=0) / cell) - 1.0
    low = cell * first
    width, height = (np.floor(points.max(axis=0) / cell) - first + 2.0).astype(int)
    cells = np.full((height, width), frontier.UNKNOWN, dtype=np.uint8)
    for star in stars_of(tfg):
        fill_polygon(cells, (star - low) / cell, frontier.FREE)
    draw_segments(cells, (tfg.segments - np.tile(low, 2)) / cell, frontier.OCCUPIED)
    return cells, low


def map_server_files(saved: SavedMap, image: str) -> tuple[str, bytes]:
    """The contents of the .yaml and of the image (.pgm), whose file name `image` is, see `rasterised`. Raises BadInput
    where the map has no free space."""
    cells, low = _cells(saved)
    level = np.full_like(cells, UNKNOWN)
    level[cells == frontier.FREE], level[cells == frontier.OCCUPIED] = FREE, OCCUPIED
    return _files(level, low, image)


def keep_out_files(saved: SavedMap, areas: Sequence[FloatArray], image: str) -> tuple[str, bytes]:
    """The same of Nav2's keep-out mask, on the grid of map_server_files.

    Cells with their centres in one of the areas, corners (n, 2), m in W, and those that its edges pass through are
    occupied, all others free.
    """
    cells, low = _cells(saved)
    level = np.full_like(cells, FREE)
    for corners in areas:
        placed = (corners - low) / CELL
        fill_polygon(level, placed, OCCUPIED)
        draw_segments(level, outline(placed), OCCUPIED)
    return _files(level, low, image)


def _cells(saved: SavedMap) -> tuple[CellArray, FloatArray]:
    tfg = tfg_in_world(saved)
    if not len(tfg.star_vertices):
        raise BadInput("the map has no free space, so there is no grid of it; export what it has, such as a .csv")
    return rasterised(tfg)


def _files(level: CellArray, low: FloatArray, image: str) -> tuple[str, bytes]:
    text = (
        f"image: {image}\nmode: trinary\nresolution: {CELL}\norigin: [{low[0]:.6f}, {low[1]:.6f}, 0.0]\n"
        f"negate: 0\noccupied_thresh: 0.65\nfree_thresh: {FREE_THRESH}\n"
    )
    rows, columns = level.shape
    return text, b"P5\n%d %d\n255\n" % (columns, rows) + level[::-1].tobytes()
