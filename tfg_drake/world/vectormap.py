"""Vector maps: text files of wall segments, one `x0,y0,x1,y1` in metres a line (amrl_maps); # begins a comment."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tfg_drake.messages import FloatArray
from tfg_drake.world.world import WorldError, check_extent

# Distance of the fence around an open map from its bounding box, m.
FENCE_DISTANCE = 1.0


def load_vectormap(path: Path) -> tuple[FloatArray, int]:
    """Walls (m, 4) in m, the fence's four last, and the number of zero-length walls dropped; raises WorldError."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise WorldError(f"{path}: cannot be read: {reason}") from None
    rows = []
    for number, line in enumerate(lines, start=1):
        line = line.partition("#")[0].strip()
        if not line:
            continue
        try:
            row = [float(value) for value in line.split(",")]
        except ValueError:
            row = []
        if len(row) != 4 or not np.isfinite(row).all():
            raise WorldError(f"{path}: line {number}: expected x0,y0,x1,y1 in metres, found {line[:40]!r}")
        rows.append(row)
    if not rows:
        raise WorldError(f"{path}: no walls in it; expected lines of x0,y0,x1,y1 in metres")
    walls = np.array(rows)
    try:
        check_extent(walls)  # before the fence: it would be the farthest
    except WorldError as error:
        raise WorldError(f"{path}: {error}") from None
    zero = (walls[:, :2] == walls[:, 2:]).all(axis=1)
    return np.concatenate([walls[~zero], fence(walls)]), int(zero.sum())


def fence(walls: FloatArray) -> FloatArray:
    """Four walls (4, 4) FENCE_DISTANCE outside the bounding box of walls (m, 4), counter-clockwise, m."""
    points = walls.reshape(-1, 2)
    x0, y0 = points.min(axis=0) - FENCE_DISTANCE
    x1, y1 = points.max(axis=0) + FENCE_DISTANCE
    return np.array([[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]])
