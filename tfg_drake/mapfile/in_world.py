"""A map in the world frame W, as other programs take it."""

from __future__ import annotations

from typing import Any

import numpy as np

from tfg_drake.geometry.se2 import rotation, transform
from tfg_drake.mapfile.saved_map import PLACES, SavedMap
from tfg_drake.messages import FloatArray, TfgMap, replace
from tfg_drake.table import take

# Kinds of surface (TfgMap.segment_kind) by number.
KINDS = ("edge", "wall_end", "bare_surface")


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


def corners_of(p_WL: FloatArray, tfg: TfgMap) -> tuple[FloatArray, FloatArray]:
    """The least and the greatest x and y (2,) of landmarks and TFG, m; of nothing the origin, twice."""
    shown = np.vstack([p_WL, tfg.segments.reshape(-1, 2), tfg.frontiers, tfg.star_vertices])
    shown = shown if len(shown) else np.zeros((1, 2))
    return shown.min(axis=0), shown.max(axis=0)
