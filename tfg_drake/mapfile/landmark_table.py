"""A map's landmarks as a .csv file."""

from __future__ import annotations

import math

from tfg_drake.mapfile.in_world import landmarks_in_world, tfg_in_world
from tfg_drake.mapfile.saved_map import SavedMap

HEADER = "id,x_m,y_m,cov_xx_m2,cov_xy_m2,cov_yy_m2,facing_rad"


def landmark_csv(saved: SavedMap) -> str:
    """The file's contents: a line a landmark, in the world frame W; facing is empty where it is not known."""
    p_WL, covariance = landmarks_in_world(saved)
    facing = tfg_in_world(saved).facing
    lines = [HEADER]
    for tag, p, P, f in zip(saved.ids.tolist(), p_WL.tolist(), covariance.tolist(), facing.tolist(), strict=True):
        side = repr(math.atan2(f[1], f[0])) if any(f) else ""
        lines.append(f"{tag},{p[0]!r},{p[1]!r},{P[0][0]!r},{P[0][1]!r},{P[1][1]!r},{side}")
    return "\n".join(lines) + "\n"
