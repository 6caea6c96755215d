"""Where a robot begins in a world that does not say."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import ndimage

from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.world.reachability import CELL, MARGIN, cut_walls, free_cells, make_grid
from tfg_drake.world.world import WorldError, bare_world


def draw_start(
    walls: FloatArray,
    robot_radius: float,
    seed: int,
    is_free: Callable[[FloatArray], BoolArray] | None = None,
    p_WY: FloatArray | None = None,
) -> FloatArray:
    """A start pose X_WS (3,) drawn from the seed in the connected free region with the most wall length.

    walls: (m, 4), m. robot_radius: m. is_free: tells of points (n, 2) in W whether the map calls them free (the walls
    of a grid enclose its solid blocks as well as its rooms); without it all space inside the walls is. p_WY: (2,) a
    place in the yard between a building and its fence, the last four walls: of the region there the fence and as much
    wall do not count, so that a closed building is begun inside. Regions are
    those of a disc of robot_radius + MARGIN on the 5 cm grid; a region's wall length is that of the wall right beside
    it. A world without walls begins at the origin. Raises WorldError if the robot fits nowhere inside the walls.
    """
    if not len(walls):
        return np.zeros(3)
    corner = np.array([walls[:, [0, 2]].min(), walls[:, [1, 3]].min(), 0.0])
    grid = make_grid(bare_world(walls, corner))
    labels, count = ndimage.label(free_cells(grid, walls, robot_radius + MARGIN))
    outside = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    labels[np.isin(labels, outside)] = 0
    if is_free is not None:
        labels[labels > 0] *= is_free(grid.centers(labels > 0))
    pieces, normals = cut_walls(walls)
    beside = robot_radius + MARGIN + CELL
    length: IntArray = np.zeros(count + 1, dtype=np.int64)
    for side in (beside, -beside):
        row, column = grid.cell(pieces + side * normals)
        length += np.bincount(labels[row, column], minlength=count + 1)
    if p_WY is not None:
        yard = labels[grid.cell(p_WY[None])]
        length[yard] = np.maximum(length[yard] - 2 * len(cut_walls(walls[-4:])[0]), 1)
    length[0] = 0
    if not length.any():
        raise WorldError(f"no free space inside the walls for a robot of radius {robot_radius:g} m; check the scale")
    cells = grid.centers(labels == np.argmax(length))
    random = np.random.default_rng(seed)
    position = cells[random.integers(len(cells))]
    return np.array([position[0], position[1], random.uniform(-np.pi, np.pi)])
