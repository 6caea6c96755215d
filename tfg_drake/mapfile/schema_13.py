"""Maps of schema 13, in which a wall was two landmarks, points held along it: read as maps of today."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from tfg_drake.mapfile.message_arrays import ArraysError, from_arrays
from tfg_drake.messages import WALLS_BELOW, FloatArray, IntArray, replace
from tfg_drake.slam.keyframe import Keyframe
from tfg_drake.slam.shared import SHARED
from tfg_drake.slam.walls import directions
from tfg_drake.table import take

if TYPE_CHECKING:
    from tfg_drake.mapfile.saved_map import SavedMap

# Columns that a graph and its keyframes lacked, and columns of the same shape.
_NEW = {f"graph.keyframes.{name}": "graph.keyframes.y_AL" for name in ("anchor", "reach", "pull")}
_NEW |= {"graph.anchor": "graph.p_ML", "graph.reach": "graph.p_ML"}

Arrays = dict[str, NDArray[Any]]


def read_map(kind: type[SavedMap], arrays: Mapping[str, NDArray[Any]]) -> SavedMap:
    """The map that arrays of this schema hold. Raises ArraysError."""
    try:
        known, first, reach = padded(dict(arrays))
        return with_walls(from_arrays(kind, known), first, reach)
    except (KeyError, IndexError, ValueError) as error:
        raise ArraysError(str(error)) from None


def padded(arrays: Arrays) -> tuple[Arrays, IntArray, FloatArray]:
    """The arrays of a map with columns that it had not as zeros, and the ids (w,) of its walls' first points and how
    far (w, 2) m from these they have been seen. Raises KeyError where there are none of these."""
    first, reach = arrays.pop("walls.first"), arrays.pop("walls.reach")
    arrays["graph.unevenness"] = arrays.pop("walls.unevenness")
    for name, like in _NEW.items():
        arrays[name] = np.zeros_like(arrays[like])
        if f"{like}@shape" in arrays:
            arrays[f"{name}@shape"] = arrays[f"{like}@shape"]
    counts = arrays["graph.keyframes.ids@shape"]
    arrays["graph.keyframes.points"], arrays["graph.keyframes.points@shape"] = np.zeros(0), 0 * counts + [0, 4]
    _put_errors(arrays)
    return arrays, first, reach


def _put_errors(arrays: Arrays) -> None:
    """The constant errors of tags, which had derivatives of their own, as parameters of the keyframes."""
    of, counts = "graph.keyframes.", arrays["graph.keyframes.ids@shape"][:, 0]
    shapes, sizes = arrays.pop(f"{of}errors@shape"), arrays[f"{of}information@shape"].copy()
    each = np.split(arrays.pop(f"{of}errors"), np.cumsum(shapes.prod(axis=1))[:-1])
    information = np.split(arrays[f"{of}information"], np.cumsum(sizes.prod(axis=1))[:-1])
    pull = np.split(arrays[f"{of}pull"], np.cumsum(2 * counts)[:-1])
    for j in np.flatnonzero(shapes[:, 0]):
        m = 2 * counts[j] + 3 + SHARED
        by_error, W = each[j].reshape(shapes[j]), information[j].reshape(m, m)
        information[j] = np.block([[W, by_error[:m, :-1]], [by_error[:m, :-1].T, by_error[m:, :-1]]])
        pull[j], sizes[j] = by_error[m:, -1], len(information[j])
    arrays[f"{of}information"] = np.concatenate([one.ravel() for one in information])
    arrays[f"{of}information@shape"], arrays[f"{of}pull"] = sizes, np.concatenate(pull)


def with_walls(saved: SavedMap, first: IntArray, reach: FloatArray) -> SavedMap:
    """A map that was read from padded arrays with walls of two numbers."""
    graph, surfaces = saved.graph, saved.tfg_graph.surfaces
    w = int(np.searchsorted(graph.ids, WALLS_BELOW)) // 2
    pairs = graph.p_ML[: 2 * w].reshape(w, 2, 2)
    along, normal, length = directions(pairs)
    reach = reach[np.argsort(first)]
    middle = reach.mean(axis=1)
    walls = np.column_stack([np.arctan2(normal[:, 1], normal[:, 0]), np.zeros(w)])
    covariance = graph.landmark_covariance[: 2 * w].reshape(w, 2, 2, 2)
    variance = np.einsum("wi,wkij,wj->w", normal, covariance, normal)
    of_walls = np.zeros((w, 2, 2))
    of_walls[:, 0, 0], of_walls[:, 1, 1] = variance / length**2, variance / 4.0
    none = np.zeros((len(graph.ids) - 2 * w, 2))
    rows = np.append(2 * np.arange(w), np.arange(2 * w, len(graph.ids)))
    graph = replace(
        take(graph, n=rows),
        keyframes=tuple(map(_with_walls, graph.keyframes)),
        ids=_named(graph.ids[rows]),
        p_ML=np.vstack([walls, graph.p_ML[2 * w :]]),
        anchor=np.vstack([pairs[:, 0] + middle[:, None] * along, none]),
        reach=np.vstack([reach - middle[:, None], none]),
        landmark_covariance=np.concatenate([of_walls, graph.landmark_covariance[2 * w :]]),
    )
    ids, vertices = _named(surfaces.ids), surfaces.vertices.copy()
    on = np.repeat(surfaces.on_wall, np.diff(surfaces.offsets))
    wall = np.repeat(np.searchsorted(graph.ids, ids[:, 0]), np.diff(surfaces.offsets))[on]
    vertices[on] = vertices[on] * length[wall, None] - np.column_stack([middle[wall], np.zeros(len(wall))])
    return replace(
        saved,
        graph=graph,
        tfg_graph=replace(saved.tfg_graph, surfaces=replace(surfaces, ids=ids, vertices=vertices)),
        tfg=replace(saved.tfg, segment_ids=_named(saved.tfg.segment_ids)),
    )


def _named(ids: IntArray) -> IntArray:
    """Landmarks with the ids of walls in place of those of their points."""
    return np.where(ids < WALLS_BELOW, (ids + WALLS_BELOW) // 2, ids)


def _with_walls(one: Keyframe) -> Keyframe:
    """A keyframe with its walls by angle and distance from the middle of their points."""
    w = one.walls // 2
    pairs = one.y_AL[: 2 * w].reshape(w, 2, 2)
    _, normal, length = directions(pairs)
    rows = np.append(2 * np.arange(w), np.arange(2 * w, len(one.ids)))
    # A point moves along the normal by the distance, and by the angle the farther it is from the middle.
    by_walls = [np.kron([[0.5 * d, 1.0], [-0.5 * d, 1.0]], n[:, None]) for n, d in zip(normal, length, strict=True)]
    kept = np.eye(2 * len(one.ids))[:, (2 * rows[:, None] + [0, 1]).ravel()]
    errors = [kept] if len(one.information) > 2 * len(one.ids) + 3 + SHARED else []
    T = scipy.linalg.block_diag(*by_walls, np.eye(2 * len(one.ids) + 3 + SHARED - 4 * w), *errors)
    walls = np.column_stack([np.arctan2(normal[:, 1], normal[:, 0]), np.zeros(w)])
    none = np.zeros((len(one.ids) - 2 * w, 2))
    return replace(
        take(one, n=rows),
        ids=_named(one.ids[rows]),
        y_AL=np.vstack([walls, one.y_AL[2 * w :]]),
        anchor=np.vstack([pairs.mean(axis=1), none]),
        reach=np.vstack([0.5 * length[:, None] * [-1.0, 1.0], none]),
        information=T.T @ one.information @ T,
    )
