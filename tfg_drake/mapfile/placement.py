"""How a map lies to another one, to a survey or to a plan: by the walls that both have."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tfg_drake.geometry import se2
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray
from tfg_drake.slam.estimator_state import Placed
from tfg_drake.slam.place_search import (
    LOOSELY,
    UNTIED,
    Places,
    Seen,
    find_places,
    is_elsewhere,
    nothing_seen,
    seen_by_keyframes,
    seen_from,
)
from tfg_drake.slam.relocalizer import BY_WALLS
from tfg_drake.slam.surface_fit import Surfaces, points_along
from tfg_drake.slam.walls import directions

# Range within which walls are seen, m, and number of views, up to twice as many.
SIGHT, VIEWS = 10.0, 12


class Standing(NamedTuple):
    """Surfaces of a map or a plan: segments (m, 4), m, seen from their left. X_MV: (k, 3) the map's views."""

    segments: FloatArray
    X_MV: FloatArray


def standing_in(saved: SavedMap) -> Standing:
    """All that stands in a map."""
    return Standing(saved.tfg.segments, saved.X_MA)


def seen_in(saved: SavedMap) -> Seen:
    """The surfaces of a map as its views see them, in M; of a recording as its keyframes have seen them."""
    standing = standing_in(saved)
    return _all_of(standing) if len(standing.segments) else seen_by_keyframes(saved.graph)


def places_of(a: SavedMap, b: SavedMap) -> Places:
    """The places that B may have in A, by their surfaces."""
    return find_places(seen_in(a), seen_by_keyframes(b.graph))


def by_walls(in_A: Standing, in_B: Standing) -> Placed | None:
    """How B lies in A by the walls of both; None where they do not tell it, or more than one place looks like it.

    What is seen from the views of one is looked for in the other, either way: one may be a small part of the other.
    """
    of_A, of_B = _all_of(in_A), _all_of(in_B)
    B_in_A, A_in_B = find_places(of_A, _seen_in(in_B)).found(), find_places(of_B, _seen_in(in_A)).found()
    found = [X for X in (B_in_A, None if A_in_B is None else se2.inverse(A_in_B)) if X is not None]
    if not found or is_elsewhere(np.array(found), found[0]).any():
        return None
    X, _, _ = Surfaces(of_A.points).fitted(of_B.points, found[0], UNTIED, LOOSELY)
    return Placed(X, np.diag(BY_WALLS**2))


def _all_of(standing: Standing) -> Seen:
    """All that stands, as the views see it."""
    return seen_from(standing.X_MV[:, :2], points_along(standing.segments.reshape(-1, 2, 2)))


def _seen_in(of: Standing) -> Seen:
    """All that a robot at some of the views sees."""
    views = of.X_MV[:: max(len(of.X_MV) // VIEWS, 1)]
    seen = nothing_seen()
    for X in views:
        seen = seen.with_look(_seen_from(X, of), X)
    return seen


def _seen_from(X_BV: FloatArray, in_B: Standing) -> FloatArray:
    """Points with normals (p, 4) of what a robot at a pose (3,) sees, in its frame, as far as it sees."""
    pairs = se2.transform(se2.inverse(X_BV), in_B.segments.reshape(-1, 2)).reshape(-1, 2, 2)
    along, normal, length = directions(pairs)
    distance, nearest = np.sum(pairs[:, 0] * normal, axis=1), -np.sum(pairs[:, 0] * along, axis=1)
    half = np.sqrt(np.maximum(SIGHT**2 - distance**2, 0.0))
    reach = np.clip(np.column_stack([nearest - half, nearest + half]), 0.0, length[:, None])
    ends = pairs[:, :1] + reach[:, :, None] * along[:, None]
    return points_along(ends[(distance > 0.0) & (reach[:, 1] > reach[:, 0])])
