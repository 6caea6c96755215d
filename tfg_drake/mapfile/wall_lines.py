"""The walls of a map as few straight lines, as a draughtsman draws them."""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import FloatArray

# Pieces of surface are one wall if all are within OFF, m, of its line, and no gap between them is wider than GAP, m.
OFF, GAP = 0.03, 0.1


def wall_lines(segments: FloatArray) -> FloatArray:
    """Segments (m, 4), m, none without length, as lines (n, 4) that cover them all, the longest pieces first."""
    length = np.hypot(*(segments[:, 2:] - segments[:, :2]).T)
    left, lines = segments[np.argsort(-length, kind="stable")].reshape(-1, 2, 2), []
    while len(left):
        line, left, grows = left[0], left[1:], True
        while grows:
            way = line[1] - line[0]
            reach = float(np.hypot(*way))
            place = (left - line[0]) @ way / reach
            off = np.abs((left - line[0]) @ np.array([-way[1], way[0]])) / reach
            joins = (off.max(axis=1) < OFF) & (place.max(axis=1) > -GAP) & (place.min(axis=1) < reach + GAP)
            ends = np.vstack([line, left[joins].reshape(-1, 2)])
            order = np.argsort(ends @ way, kind="stable")
            line, left, grows = ends[order[[0, -1]]], left[~joins], bool(joins.any())
        lines.append(line.ravel())
    return np.array(lines).reshape(-1, 4)
