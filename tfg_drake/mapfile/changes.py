"""Changes in a building since an older map of it was made."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from tfg_drake.geometry.distance import point_distance
from tfg_drake.geometry.se2 import transform
from tfg_drake.geometry.star import lines_in_one_star
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.keyframe import rows_of

# A tag was moved if it is at least MOVED, m, and DEVIATIONS standard deviations of both from its old place.
MOVED, DEVIATIONS = 0.15, 4.0
# A piece of surface of at most this length, m, is new, or gone, if all of it is farther than this from the other map's
# surfaces, and one view of that map saw free space from half of this in front of it to half of this behind.
APART = 0.2
# Pieces whose middles are within this distance, m, are reported as one.
TOGETHER = 0.5


def map_changes(before: SavedMap, after: SavedMap) -> dict[str, Any]:
    """The changes between two maps in one frame M: ids of tags that were moved, are gone or are new, and the pieces of
    surface (x0, y0, x1, y1) in W, m, that are new or gone."""
    old, new = _places(before), _places(after)
    row, both = rows_of(old[0], new[0])
    shift = new[1][row[both]] - old[1][both]
    covariance = new[2][row[both]] + old[2][both]
    squared = np.einsum("ni,nij,nj->n", shift, np.linalg.inv(covariance), shift)
    moved = (np.hypot(*shift.T) > MOVED) & (squared > DEVIATIONS**2)
    return {
        "tags_moved": old[0][both][moved].tolist(),
        "tags_gone": old[0][~both].tolist(),
        "tags_new": np.setdiff1d(new[0], old[0]).tolist(),
        "surfaces_new": _only_in(after, before),
        "surfaces_gone": _only_in(before, after),
    }


def told(changes: dict[str, Any]) -> str:
    """The changes in words."""
    parts = []
    for name in ("moved", "gone", "new"):
        if ids := changes[f"tags_{name}"]:
            parts.append(f"tags {name}: {', '.join(map(str, ids))}")
    for name in ("new", "gone"):
        pieces = np.array(changes[f"surfaces_{name}"]).reshape(-1, 4)
        if len(pieces):
            length = np.hypot(*(pieces[:, 2:] - pieces[:, :2]).T)
            middle = 0.5 * (pieces[:, :2] + pieces[:, 2:])
            _, thing = connected_components(cdist(middle, middle) < TOGETHER)
            total, (x, y) = np.bincount(thing, length), (np.bincount(thing, at) / np.bincount(thing) for at in middle.T)
            places = [f"{total[k]:.1f} m about ({x[k]:.1f}, {y[k]:.1f})" for k in np.argsort(-total, kind="stable")]
            parts.append(f"surface {name}: {', '.join(places)}")
    return "; ".join(parts) or "nothing"


def _places(saved: SavedMap) -> tuple[IntArray, FloatArray, FloatArray]:
    """Ids (n,), places (n, 2) and covariances (n, 2, 2) of the tags that are not doubtful."""
    sure = ~saved.is_doubtful
    return saved.ids[sure], saved.p_ML[sure], saved.landmark_covariance[sure]


def _only_in(one: SavedMap, other: SavedMap) -> list[list[float]]:
    """The pieces of one map's surfaces that stand where the other has free space."""
    pieces = np.concatenate([np.zeros((0, 4)), *(_cut(segment) for segment in one.tfg.segments)])
    middle, along = 0.5 * (pieces[:, :2] + pieces[:, 2:]), pieces[:, 2:] - pieces[:, :2]
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    apart = np.ones(len(pieces), dtype=bool)
    for point in (pieces[:, :2], middle, pieces[:, 2:]):
        apart &= point_distance(point, other.tfg.segments) > APART
    across = np.hstack([middle - 0.5 * APART * normal, middle + 0.5 * APART * normal])
    apart &= lines_in_one_star(across, other.tfg.star_offsets, other.tfg.star_vertices)
    ends = transform(one.X_WM, pieces[apart].reshape(-1, 2)).reshape(-1, 4)
    return [[round(value, 3) for value in piece] for piece in ends.tolist()]


def _cut(segment: FloatArray) -> FloatArray:
    """A segment (4,) in pieces (k, 4)."""
    n = max(1, round(float(np.hypot(*(segment[2:] - segment[:2]))) / APART))
    ends = segment[:2] + np.linspace(0.0, 1.0, n + 1)[:, None] * (segment[2:] - segment[:2])
    return np.hstack([ends[:-1], ends[1:]])
