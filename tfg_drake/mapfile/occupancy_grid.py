"""A map as an occupancy grid of ROS map_server: an image, and the .yaml that says how to read it."""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry.star import inside_any
from tfg_drake.mapfile.in_world import corners_of, tfg_in_world
from tfg_drake.mapfile.saved_map import SavedMap

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
    tfg = tfg_in_world(saved)
    if not len(tfg.star_vertices):
        raise BadInput("the map has no free space, so there is no grid of it; export what it has, such as a .csv")
    low, high = corners_of(np.zeros((0, 2)), tfg)
    low = CELL * (np.floor(low / CELL) - 1.0)
    columns, rows = (np.ceil((high - low) / CELL) + 1.0).astype(int).tolist()
    x, level = low[0] + CELL * (np.arange(columns) + 0.5), np.full((rows, columns), UNKNOWN, dtype=np.uint8)
    for some in np.array_split(np.arange(rows), math.ceil(rows * columns / _AT_ONCE)):
        centres = np.stack(np.meshgrid(x, low[1] + CELL * (some + 0.5)), axis=-1).reshape(-1, 2)
        free = inside_any(centres, tfg.star_offsets, tfg.star_vertices)
        level[some] = np.where(free, FREE, UNKNOWN).reshape(-1, columns)
    for piece in tfg.segments:
        count = math.ceil(4.0 * math.hypot(*(piece[2:] - piece[:2])) / CELL) + 1
        column, row = np.floor((np.linspace(piece[:2], piece[2:], count) - low) / CELL).astype(int).T
        level[row, column] = OCCUPIED
    text = (
        f"image: {image}\nmode: trinary\nresolution: {CELL}\norigin: [{low[0]:.6f}, {low[1]:.6f}, 0.0]\n"
        f"negate: 0\noccupied_thresh: 0.65\nfree_thresh: {FREE_THRESH}\n"
    )
    return text, b"P5\n%d %d\n255\n" % (columns, rows) + level[::-1].tobytes()
