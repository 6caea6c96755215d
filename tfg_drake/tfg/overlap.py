"""Resolves overlaps of the map with itself before a loop closes.

The two faces of a wall share no landmark. Until a loop closes, surfaces mapped from one side may therefore lie in free
space seen from the other side, such as the walls of a room in the corridor outside. Then the view that is closer to the
newest view along the ties of the map decides, as its place relative to the robot is known better.

A room that was reached along another arm of the loop is tied to the robot so weakly that its place relative to the
corridor is unknown; so is everything mapped before a kidnapping. The findings of such views and of the newest view do
not affect each other, or frontiers would be lost where the two overlap.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra

from tfg_drake.geometry.star import looked_through
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate
from tfg_drake.tfg.drift import MOST_DRIFT, drift_from_robot
from tfg_drake.tfg.passing import DEPTH
from tfg_drake.tfg.stars import Stars
from tfg_drake.tfg.surfaces import Surfaces

# A surface has drifted if it lies as deep as a passer-by in the free space of a view within this distance, m, that did
# not see its front.
REACH = 5.0
# Landmarks mapped on the robot's own way are known relative to it within MOST_DRIFT plus this per metre of distance,
# for the error of the heading. It is small, so that both ends of a room are treated alike.
SWING = 0.01


def standing(
    surfaces: Surfaces,
    vertices: FloatArray,
    tag_ids: IntArray,
    tag_view: IntArray,
    stars: Stars,
    star_view: IntArray,
    estimate: MapEstimate,
) -> BoolArray:
    """Return a mask of the surfaces (s,) that stand where they are mapped.

    A surface does not stand if a view has looked through it that is closer to the newest view, along the ties of the
    map, than the surface's own view (see `distance_along_map`).

    vertices: (v, 2) of the surfaces in the map frame, m. tag_ids, tag_view: (n,) landmarks and a view that saw each.
    stars: in the map frame, star_view: (k,) the view of each.
    """
    count, none = len(surfaces.view), np.zeros(len(star_view))

    def through(surface_rank: FloatArray, star_rank: FloatArray) -> BoolArray:
        return looked_through(surfaces.offsets, vertices, surface_rank, *stars, star_rank, DEPTH, REACH)

    # As a rule no view has looked through any surface; then the distances are not needed.
    if not through(np.ones(count), none).any():
        return np.ones(count, dtype=np.bool_)
    rank = distance_along_map(*_saw(surfaces, tag_ids, tag_view), star_view, estimate)
    return np.asarray(~through(rank[surfaces.view], rank[star_view]))


@dataclasses.dataclass(frozen=True)
class WeaklyTied:
    """The parts of the map with an unknown place relative to the robot, as they were mapped along another arm of an
    open loop.

    views: (k,) of the map, surfaces: (s,) of the graph.
    """

    views: BoolArray
    surfaces: BoolArray


def known_badly(estimate: MapEstimate) -> BoolArray:
    """Return a mask of the landmarks (n,) whose variance relative to the robot exceeds the drift on its own way.

    The least variance of all is the robot's own and is subtracted. Landmarks seen by the newest view are never badly
    known."""
    badly = np.zeros(len(estimate.ids), dtype=np.bool_)
    known = estimate.is_local
    if known.any():
        (xx, xy), (_, yy) = drift_from_robot(estimate, np.flatnonzero(known)).transpose(1, 2, 0)
        largest = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
        distance = np.hypot(*(estimate.places[estimate.local] - estimate.X_MD[:2]).T)
        badly[known] = largest - largest.min() > (MOST_DRIFT + SWING * distance) ** 2
        badly &= ~np.isin(estimate.ids, estimate.observation.ids)
    return badly


def weakly_tied(
    surfaces: Surfaces, tag_ids: IntArray, tag_view: IntArray, estimate: MapEstimate, landmarks: BoolArray
) -> WeaklyTied:
    """Return the weakly tied parts of a large map: views that saw, of the jointly known landmarks, only ones of unknown
    place relative to the robot, and the surfaces of these views or landmarks.

    tag_ids, tag_view: (m,) landmarks and a view that saw each. landmarks: (n,) those, see `known_badly`.
    """
    known = estimate.is_local
    view, ids = _saw(surfaces, tag_ids, tag_view)
    row = np.searchsorted(estimate.ids, ids)
    these, others = (
        np.bincount(view[which[row]], minlength=len(estimate.X_MA)) for which in (landmarks, known & ~landmarks)
    )
    views = (these > 0) & (others == 0)
    anchored = np.isin(surfaces.ids, estimate.ids[landmarks]).any(axis=1)
    return WeaklyTied(views, views[surfaces.view] | anchored)


def _saw(surfaces: Surfaces, tag_ids: IntArray, tag_view: IntArray) -> tuple[IntArray, IntArray]:
    """Pairs (p,) of a view and a landmark that it saw, from the surfaces and from tag_ids and tag_view (n,)."""
    view = np.concatenate([np.repeat(surfaces.view, 2), tag_view])
    ids = np.concatenate([surfaces.ids.ravel(), tag_ids])
    return view[ids != -1], ids[ids != -1]


def distance_along_map(view: IntArray, ids: IntArray, views: IntArray, estimate: MapEstimate) -> FloatArray:
    """Return the length (k,), m, of the shortest way along the map's ties from the last of `views` to each; inf
    without.

    A tie joins a view with a landmark that it saw, view and ids (p,), or two successive ones of `views` (g,).
    views: ascending.
    """
    k, n = len(estimate.X_MA), len(estimate.ids)
    # Each pair once: a sparse matrix adds up what it is given twice.
    pair = np.unique(view * n + np.searchsorted(estimate.ids, ids))
    saw, row = pair // n, pair % n
    before = views[:-1][np.diff(views) == 1]
    to_landmark = np.hypot(*(estimate.places[row] - estimate.X_MA[saw, :2]).T)
    to_next = np.hypot(*(estimate.X_MA[before + 1, :2] - estimate.X_MA[before, :2]).T)
    length = np.append(to_landmark, to_next)
    ties = csr_matrix((length, (np.append(saw, before), np.append(k + row, before + 1))), shape=(k + n, k + n))
    return np.asarray(dijkstra(ties, directed=False, indices=views[-1])[:k])
