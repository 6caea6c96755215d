"""What stands where the map lies over itself.

Two faces of a wall share no landmark. Until a loop closes, what was mapped from one side may lie in free space that was
seen from the other: a room's walls in the passage outside. One of the two is in the way only by mistake: the one whose
place relative to the robot is known less well, as the way to it along what ties the map together is longer. And where a
room was mapped another way round, so that nobody can tell where it lies seen from the passage, it says nothing of what
the passage is like, drifted into it or not.
"""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from tfg_drake.geometry.star import looked_through
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate
from tfg_drake.tfg.drift import MOST_DRIFT, drift_from_robot
from tfg_drake.tfg.surfaces import Surfaces

# A surface this deep in the free space of a view this near, m, that did not look at its front has drifted into it.
DEPTH = 0.2
REACH = 5.0
# What was mapped on the robot's own way is known within MOST_DRIFT, seen from it, and this a metre, as its heading is.
# Little of it: a room must not be taken apart because its far end is asked for less.
SWING = 0.01


def standing(
    surfaces: Surfaces,
    vertices: FloatArray,
    tag_ids: IntArray,
    tag_view: IntArray,
    stars: tuple[IntArray, FloatArray, FloatArray],
    star_view: IntArray,
    estimate: MapEstimate,
) -> BoolArray:
    """Which surfaces (s,) stand: no view that is tied more closely to the newest than theirs has looked through them.

    vertices: (v, 2) of the surfaces in the map frame, m. tag_ids, tag_view: (n,) landmarks and a view that saw each.
    stars: as in `tfg_drake.geometry.star.inside_any`, in the map frame, star_view: (k,) the views they are of.
    """
    count, none = len(surfaces.view), np.zeros(len(star_view))

    def through(surface_rank: FloatArray, star_rank: FloatArray) -> BoolArray:
        return looked_through(surfaces.offsets, vertices, surface_rank, *stars, star_rank, DEPTH, REACH)

    # As a rule there is nothing of the kind, and how the views are tied does not matter.
    if not through(np.ones(count), none).any():
        return np.ones(count, dtype=np.bool_)
    rank = distance_along_map(*_saw(surfaces, tag_ids, tag_view), star_view, estimate)
    return np.asarray(~through(rank[surfaces.view], rank[star_view]))


@dataclasses.dataclass(frozen=True)
class WeaklyTied:
    """What was mapped another way round than the robot came: seen from it, nobody can tell where that lies.

    landmarks: (n,) of the map, views: (k,) of the map, surfaces: (s,).
    """

    landmarks: BoolArray
    views: BoolArray
    surfaces: BoolArray


def weakly_tied(surfaces: Surfaces, tag_ids: IntArray, tag_view: IntArray, estimate: MapEstimate) -> WeaklyTied:
    """What cannot be told from where the robot is: landmarks, those views that saw no others of the landmarks known
    jointly, and the surfaces of either.

    tag_ids, tag_view: (n,) landmarks and a view that saw each.
    """
    landmarks = _known_badly(estimate)
    if not landmarks.any():
        return nothing_weakly_tied(surfaces, estimate)
    known = estimate.is_local
    view, ids = _saw(surfaces, tag_ids, tag_view)
    row = np.searchsorted(estimate.ids, ids)
    these, others = (
        np.bincount(view[which[row]], minlength=len(estimate.X_MA)) for which in (landmarks, known & ~landmarks)
    )
    views = (these > 0) & (others == 0)
    carried = np.isin(surfaces.ids, estimate.ids[landmarks]).any(axis=1)
    return WeaklyTied(landmarks, views, views[surfaces.view] | carried)


def nothing_weakly_tied(surfaces: Surfaces, estimate: MapEstimate) -> WeaklyTied:
    """Everything was mapped as the robot came."""
    return WeaklyTied(*(np.zeros(len(of), dtype=np.bool_) for of in (estimate.ids, estimate.X_MA, surfaces.view)))


@functools.lru_cache(maxsize=1)
def _known_badly(estimate: MapEstimate) -> BoolArray:
    """Landmarks (n,) whose place, seen from the robot, is known worse than its own way can have made it: none of those
    that the newest view saw. What all of them are known worse by is the robot's own."""
    badly = np.zeros(len(estimate.ids), dtype=np.bool_)
    known = estimate.is_local
    if known.any():
        (xx, xy), (_, yy) = drift_from_robot(estimate, np.flatnonzero(known)).transpose(1, 2, 0)
        largest = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
        distance = np.hypot(*(estimate.local_p_ML - estimate.X_MD[:2]).T)
        badly[known] = largest - largest.min() > (MOST_DRIFT + SWING * distance) ** 2
        badly &= ~np.isin(estimate.ids, estimate.observation.ids)
    return badly


def _saw(surfaces: Surfaces, tag_ids: IntArray, tag_view: IntArray) -> tuple[IntArray, IntArray]:
    """Views and landmarks (p,) that they saw, as far as surfaces tell and these landmarks with a view each, (n,)."""
    view = np.concatenate([np.repeat(surfaces.view, 2), tag_view])
    ids = np.concatenate([surfaces.ids.ravel(), tag_ids])
    return view[ids >= 0], ids[ids >= 0]


def distance_along_map(view: IntArray, ids: IntArray, views: IntArray, estimate: MapEstimate) -> FloatArray:
    """How far (k,), m, each of the map's views is from the last of `views` along what ties them; inf where none does.

    What ties: a view and a landmark that it saw, view and ids (p,), and two of `views` (g,), ascending, in succession.
    """
    k, n = len(estimate.X_MA), len(estimate.ids)
    # Each pair once: a sparse matrix adds up what it is given twice.
    pair = np.unique(view * n + np.searchsorted(estimate.ids, ids))
    saw, row = pair // n, pair % n
    before = views[:-1][np.diff(views) == 1]
    to_landmark = np.hypot(*(estimate.p_ML[row] - estimate.X_MA[saw, :2]).T)
    to_next = np.hypot(*(estimate.X_MA[before + 1, :2] - estimate.X_MA[before, :2]).T)
    length = np.append(to_landmark, to_next)
    ties = csr_matrix((length, (np.append(saw, before), np.append(k + row, before + 1))), shape=(k + n, k + n))
    return np.asarray(dijkstra(ties, directed=False, indices=views[-1])[:k])
