"""From a map's file to a world: walls by the file's format, then tags and a start."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tfg_drake.messages import FloatArray, replace
from tfg_drake.world.map_server import load_map_server
from tfg_drake.world.start import draw_start
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
