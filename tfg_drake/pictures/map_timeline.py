"""A saved map as the timeline of one moment, which the page of a mission shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tfg_drake.config import RobotConfig
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.pictures import scene, tables
from tfg_drake.storage.timeline import TimelineWriter


def write_map_timeline(saved: SavedMap, path: Path, title: str) -> None:
    """Write the timeline of a map. title: stands above it. Raises OSError where the file cannot be written."""
    with TimelineWriter(path) as writer:
        now, tfg, stars = saved.stamp, saved.tfg, scene.free_space(saved.tfg)
        writer.write("world", now, {}, title=title, radius=RobotConfig.radius, rule="", simulated=False)
        writer.write("frame", now, {"pose": saved.X_WM.astype(np.float32)})
        table, views = tables.landmarks(saved), len(saved.X_MA)
        writer.write_rows("map", now, table, stage=saved.stage, entropy=saved.entropy, views=views)
        writer.write_rows("wall_landmarks", now, tables.wall_landmarks(saved.graph))
        writer.write_rows("tfg", now, tables.surfaces(tfg))
        writer.write_rows("facing", now, tables.facing(tfg, saved.ids, saved.p_ML))
        writer.write_rows("frontiers", now, tables.frontiers(tfg))
        writer.write("free", now, scene.packed_stars(stars, np.arange(len(stars))))
