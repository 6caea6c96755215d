"""A map in the world frame W, as other programs take it."""

from __future__ import annotations

from typing import Any

import numpy as np

from tfg_drake.geometry.se2 import rotation, transform
from tfg_drake.mapfile.saved_map import PLACES, SavedMap
from tfg_drake.messages import FloatArray, TfgMap, replace
from tfg_drake.table import take


def landmarks_in_world(saved: SavedMap) -> tuple[FloatArray, FloatArray]:
    """Positions of the landmarks in W (n, 2), m, and their covariances (n, 2, 2), m^2."""
    R_WM = rotation(float(saved.X_WM[2]))
    return transform(saved.X_WM, saved.p_ML), np.asarray(R_WM @ saved.landmark_covariance @ R_WM.T)


def tfg_in_world(saved: SavedMap) -> TfgMap:
    """The TFG with W for its map frame, the facing of `SavedMap` and no pieces of no length."""
    tfg, R_WM = saved.tfg, rotation(float(saved.X_WM[2]))
    moved: dict[str, Any] = {name: transform(saved.X_WM, getattr(tfg, name).reshape(-1, 2)) for name in PLACES}
    segments = moved.pop("segments").reshape(-1, 4)
    in_W = replace(
        tfg,
        **moved,
        segments=segments,
        facing=saved.facing @ R_WM.T,
        frontier_normal=tfg.frontier_normal @ R_WM.T,
        given_up_normal=tfg.given_up_normal @ R_WM.T,
    )
    return take(in_W, m=np.hypot(*(segments[:, 2:] - segments[:, :2]).T) > 0.0)


def stars_of(tfg: TfgMap) -> list[FloatArray]:
    """The free polygons, (v, 2) each, anticlockwise."""
    return [star for star in np.split(tfg.star_vertices, tfg.star_offsets[1:-1]) if len(star) > 2]
