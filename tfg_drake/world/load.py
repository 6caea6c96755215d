"""From a map's file to a world: walls by the file's format, then tags and a start."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from scipy import ndimage

from tfg_drake.config import NODE_MARGIN
from tfg_drake.messages import BoolArray, FloatArray, IntArray, replace
from tfg_drake.world.map_server import load_map_server
from tfg_drake.world.reachability import CELL, cut_walls, free_cells, make_grid
from tfg_drake.world.tag_placement import place_tags
from tfg_drake.world.vectormap import FENCE_DISTANCE, load_vectormap
from tfg_drake.world.world import World, WorldError, bare_world, check_extent, check_world

_log = logging.getLogger(__name__)


def load_map(
    path: Path, robot_radius: float, tag_spacing: float | None, start: Sequence[float] | None, seed: int
) -> World:
    """The world in a ROS map_server file (.yaml) or a vector map (*.vectormap.txt).

    robot_radius: m. tag_spacing: m, None for a world without tags. start: X_WS (x, y, yaw), None to draw it from the
    seed. Raises WorldError.
    """
    if not path.is_file():
        raise WorldError(f"{path}: no such file")
    is_free = p_WY = None
    if path.name.endswith(".vectormap.txt"):
        walls, dropped = load_vectormap(path)
        p_WY = walls[-4, :2] + 0.5 * FENCE_DISTANCE
        if dropped:
            _log.warning("%s: dropped %d walls of zero length", path, dropped)
    elif path.suffix in (".yaml", ".yml"):
        occupancy = load_map_server(path)
        walls, is_free = occupancy.walls, occupancy.is_free
        for note in occupancy.notes:
            _log.warning("%s: %s", path, note)
    else:
        raise WorldError(f"{path}: unknown kind of map; give a scenario or map_server .yaml or a *.vectormap.txt")
    try:
        check_extent(walls)
        X_WS = draw_start(walls, robot_radius, seed, is_free, p_WY) if start is None else np.array(start, dtype=float)
        furnished = furnish(bare_world(walls, X_WS), robot_radius, tag_spacing, None)
        if is_free is not None and not is_free(X_WS[None, :2])[0]:
            raise WorldError(
                f"world.start: ({X_WS[0]:g}, {X_WS[1]:g}) is not in a free cell of the map; start elsewhere"
            )
        return furnished
    except WorldError as error:
        raise WorldError(f"{path}: {error}") from None


def furnish(
    world: World, robot_radius: float, tag_spacing: float | None, start: Sequence[float] | FloatArray | None
) -> World:
    """The world with another start X_WS (x, y, yaw) and with tags every tag_spacing (m, inf: none), each where it is
    not None.

    Raises WorldError as check_world does, before and after tags are placed.
    """
    X_WS = world.start if start is None else np.array(start, dtype=float)
    if X_WS.shape != (3,):
        raise WorldError(f"world.start: expected x, y, yaw, found {X_WS.size} numbers")
    moved = replace(world, start=X_WS) if tag_spacing is None else bare_world(world.walls, X_WS)
    check_world(moved, robot_radius)
    if tag_spacing is None or math.isinf(tag_spacing):
        return moved
    ids, p_WT, facing = place_tags(world.walls, X_WS, tag_spacing, robot_radius)
    return replace(moved, tag_ids=ids, p_WT=p_WT, tag_facing=facing)


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
    wall do not count, so that a closed building is begun inside. Regions are those of a disc of robot_radius +
    NODE_MARGIN on the 5 cm grid; a region's wall length is that of the wall right beside it. A world without walls
    begins at the origin. Raises WorldError if the robot fits nowhere inside the walls.
    """
    if not len(walls):
        return np.zeros(3)
    corner = np.array([walls[:, [0, 2]].min(), walls[:, [1, 3]].min(), 0.0])
    grid = make_grid(bare_world(walls, corner))
    labels, count = ndimage.label(free_cells(grid, walls, robot_radius + NODE_MARGIN))
    outside = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    labels[np.isin(labels, outside)] = 0
    if is_free is not None:
        labels[labels > 0] *= is_free(grid.centers(labels > 0))
    pieces, normals = cut_walls(walls)
    beside = robot_radius + NODE_MARGIN + CELL
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
