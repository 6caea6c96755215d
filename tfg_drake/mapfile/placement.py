"""How a map lies to another one, to a survey or to a plan: by the tags or the walls that both have."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.geometry import se2
from tfg_drake.geometry.distance import clearance
from tfg_drake.geometry.star import inside_any
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, TagDetections, replace
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.slam.lost_robot import Expected, relocalize
from tfg_drake.slam.place_search import LOOSELY, SAME, UNTIED, find_place
from tfg_drake.slam.surface_fit import Surfaces, points_along
from tfg_drake.slam.walls import directions
from tfg_drake.tfg.polyline import sample

# A pose that says nothing of where to look.
ANYWHERE = Expected(np.array([1e6, 0.0, 0.0]), None, np.ones(3))
# Tags that must agree.
LEAST_TAGS = 3
# A robot sees walls up to this distance, m. It is looked for from so many views or up to twice as many, and from so
# many it must be found.
SIGHT, VIEWS, LEAST_VIEWS = 10.0, 12, 2
# Of what stands in each so large a share, both together, lies at most where the other is free: farther than this from
# what stands there, m. Spacing of samples, m.
MOST_AMID, OFF_WALLS, SPACING = 0.06, 0.3, 0.1
# Deviations of a pose by walls, m, m, rad.
BY_WALLS = np.array([0.05, 0.05, 0.005])


class Standing(NamedTuple):
    """What stands in a map or a plan: segments (m, 4), m, seen from their left. X_MV: (k, 3) the map's views. is_free:
    which of some points (n, 2) are known to be free."""

    segments: FloatArray
    X_MV: FloatArray
    is_free: Callable[[FloatArray], BoolArray]


class Placement(NamedTuple):
    """How B lies in A: X_AB (3,) and its covariance (3, 3). wrong: (d,) ids of the tags that stand elsewhere in B."""

    X_AB: FloatArray
    covariance: FloatArray
    wrong: IntArray


def standing_in(saved: SavedMap) -> Standing:
    """What stands in a map."""
    tfg = saved.tfg
    return Standing(tfg.segments, saved.X_MA, lambda p: inside_any(p, tfg.star_offsets, tfg.star_vertices))


def by_tags(of_A: SavedMap | MapEstimate, of_B: SavedMap) -> Placement | None:
    """How B lies in A by the tags of both, robustly; None where these are too few or do not tell it.

    Raises:
        BadInput: there are enough, and they stand differently.
    """
    common, in_A, in_B = np.intersect1d(of_A.ids, of_B.ids, return_indices=True)
    if len(common) < LEAST_TAGS:
        return None
    # Seen from amid them: far off a small error of heading is a large one of the place.
    middle = of_B.p_ML[in_B].mean(axis=0)
    x, y = (of_B.p_ML[in_B] - middle).T
    both = of_A.landmark_covariance[in_A], of_B.landmark_covariance[in_B]
    sigma, distance = np.sqrt(sum(np.linalg.eigvalsh(one)[:, -1] for one in both)), np.hypot(x, y)
    seen = TagDetections(0.0, common, distance, np.arctan2(y, x), sigma, sigma / np.maximum(distance, 0.1))
    known = replace(empty_map(), ids=of_A.ids, p_ML=of_A.p_ML, landmark_covariance=of_A.landmark_covariance)
    found = relocalize(known, seen, ANYWHERE)
    if found is None:
        raise BadInput(
            f"{len(common)} tags are in both, but fewer than three in five of them stand alike: are both of one place?"
        )
    if not found.is_known:
        return None
    X_AB, J = se2.compose(found.X_MB, np.append(-middle, 0.0)), np.eye(3)
    J[:2, 2] = (found.X_MB[:2] - X_AB[:2])[::-1] * [1.0, -1.0]
    return Placement(X_AB, J @ found.covariance @ J.T, common[~found.agreeing])


def by_walls(in_A: Standing, in_B: Standing) -> Placement | None:
    """How B lies in A by the walls of both; None where they do not tell it, or more than one place looks like it.

    A robot that stands at some view of one and sees the walls that are there is looked for in the other. Of the places
    of B that follow those are left at which nothing of either stands where the other is free.
    """
    X_AB, places = np.vstack([_found(in_A, in_B), se2.inverse(_found(in_B, in_A))]), []
    while len(X_AB):
        off = X_AB - X_AB[0]
        off[:, 2] = se2.wrap_angle(off[:, 2])
        alike = (np.hypot(off[:, 0], off[:, 1]) < SAME[0]) & (np.abs(off[:, 2]) < SAME[1])
        X = X_AB[0] + np.median(off[alike], axis=0)
        if _amid(in_B, X, in_A) + _amid(in_A, se2.inverse(X), in_B) < MOST_AMID:
            places.append((X, np.count_nonzero(alike)))
        X_AB = X_AB[~alike]
    if len(places) != 1 or places[0][1] < LEAST_VIEWS:
        return None
    seen = points_along(in_B.segments.reshape(-1, 2, 2))
    X, _, _ = Surfaces(points_along(in_A.segments.reshape(-1, 2, 2))).fitted(seen, places[0][0], UNTIED, LOOSELY)
    return Placement(X, np.diag(BY_WALLS**2), np.empty(0, dtype=np.int64))


def _found(in_A: Standing, in_B: Standing) -> FloatArray:
    """Poses X_AB (q, 3) at which a robot that stands at some view of B has found itself in A by its walls."""
    before = points_along(in_A.segments.reshape(-1, 2, 2))
    views = in_B.X_MV[:: max(len(in_B.X_MV) // VIEWS, 1)]
    found = [(find_place(before, _seen_from(X, in_B), np.zeros(3), anywhere=True)[0], X) for X in views]
    return np.array([se2.compose(X_AV, se2.inverse(X)) for X_AV, X in found if X_AV is not None]).reshape(-1, 3)


def _seen_from(X_BV: FloatArray, in_B: Standing) -> FloatArray:
    """Points with normals (p, 4) of what a robot at a pose (3,) sees, in its frame, as far as it sees."""
    pairs = se2.transform(se2.inverse(X_BV), in_B.segments.reshape(-1, 2)).reshape(-1, 2, 2)
    along, normal, length = directions(pairs)
    distance, nearest = np.sum(pairs[:, 0] * normal, axis=1), -np.sum(pairs[:, 0] * along, axis=1)
    half = np.sqrt(np.maximum(SIGHT**2 - distance**2, 0.0))
    reach = np.clip(np.column_stack([nearest - half, nearest + half]), 0.0, length[:, None])
    ends = pairs[:, :1] + reach[:, :, None] * along[:, None]
    return points_along(ends[(distance > 0.0) & (reach[:, 1] > reach[:, 0])])


def _amid(of: Standing, X: FloatArray, other: Standing) -> float:
    """The share of what stands in a map that lies where the other one, in which it lies at X (3,), is free."""
    points = sample(2 * np.arange(len(of.segments) + 1), of.segments.reshape(-1, 2), SPACING)[0]
    p = se2.transform(X, points)
    far = clearance(np.hstack([p, p]), other.segments, OFF_WALLS) >= OFF_WALLS
    return float(np.mean(far & other.is_free(p)))
