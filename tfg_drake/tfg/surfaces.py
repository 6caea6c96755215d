"""Obstacle surfaces anchored to walls and views, so that they move with the map.

A surface that lies on a wall of the map is a piece of its line, with vertices in m along the wall from its point
nearest to the anchor, and to the left of that. Any other is a polyline in the frame A of the view that saw it, m. The
landmarks that it joins determine its kind (Sec. III-A of the paper has only the first):
EDGE: a piece of a wall, or of another surface between two tags.
END: a surface with a tag at one end only.
LOOSE: a surface without a landmark.
A surface was seen from the left of its polyline.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np

from tfg_drake.geometry.se2 import inverse, rotation, transform
from tfg_drake.messages import WALLS_BELOW, BoolArray, FloatArray, IntArray, MapEstimate, is_tag, message, replace
from tfg_drake.slam.keyframe import along_walls
from tfg_drake.tfg.drift import DRIFT_SIGMAS, drift_from_robot
from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.polyline import (
    SAME_FACE,
    arc_length,
    covered,
    nearest,
    pack,
    sample,
    segments_of,
    sub_polyline,
    uncovered_runs,
)
from tfg_drake.tfg.segmentation import Components

EDGE, END, LOOSE = 0, 1, 2

# A tag belongs to a surface within SEEN_TAG_DISTANCE, m, if this turn has seen it; within ON_SURFACE, m, otherwise, as
# any other point of the map.
SEEN_TAG_DISTANCE = 0.2
ON_SURFACE = 0.1
# Surface within ON_WALL, m, of a wall's line is on the wall if it is LEAST_ON_WALL, m, long.
ON_WALL = 0.06
LEAST_ON_WALL = 0.15
# Greatest extension of a wall beyond its seen part, m.
GOES_ON = 20.0
# Other surfaces are cut within this distance of a wall, m, and new ones within this distance of any older surface: less
# than the thickness of a hollow wall, which is open at its end.
SURFACE_COVERS = 0.1
# Spacing of the samples for that, m; shorter remains are dropped, m.
SPACING = 0.05
LEAST_LENGTH = 0.04
# A remaining piece overlaps the one that covers the rest by this, m, so that no line of sight passes between them.
OVERLAP = 0.06
# A surface this deep inside the free space of a turn, m, was an error or is gone.
REFUTED_DEPTH = 0.15
# A loose surface is removed if this share of it is gone: somebody stood there.
REFUTED_SHARE = 0.4
# Number of bins on either side that must agree.
REFUTED_BINS = 2
# Greatest angle between the line of sight and its normal, rad.
REFUTED_INCIDENCE = np.deg2rad(75.0)


@message
class Surfaces:
    """The surfaces of a graph.

    ids: (s, 2) the landmarks that each joins: the wall that it lies on, twice, or the tags where it begins and
    ends, -1 for none. view: (s,) index of the view that saw it. range: (s,) m, its farthest vertex from there. offsets:
    (s + 1,) and vertices: (v, 2), see the module.
    """

    ids: Annotated[IntArray, "s", 2]
    view: Annotated[IntArray, "s"]
    range: Annotated[FloatArray, "s"]
    offsets: Annotated[IntArray, "s+1"]
    vertices: Annotated[FloatArray, "v", 2]

    @property
    def kind(self) -> IntArray:
        """The kind (s,) of each: EDGE, END or LOOSE."""
        return np.asarray(np.where(self.on_wall, EDGE, np.count_nonzero(self.ids < 0, axis=1)))

    @property
    def on_wall(self) -> BoolArray:
        """Mask of the surfaces (s,) that are pieces of walls."""
        return ~is_tag(self.ids[:, 0])


class _Surface(NamedTuple):
    """One surface while the graph is being updated; the polyline (v, 2) is in the newest view's frame A, m. The other
    fields: see Surfaces."""

    first: int
    second: int
    view: int
    range: float
    polyline: FloatArray

    @property
    def on_wall(self) -> bool:
        return self.first < WALLS_BELOW


def _pieces(surfaces: Surfaces, landmarks: MapEstimate, X_AM: FloatArray) -> list[_Surface]:
    """The surfaces one by one, in A."""
    vertices, offsets = transform(X_AM, place(surfaces, landmarks)), surfaces.offsets.tolist()
    polylines = [vertices[start:stop] for start, stop in itertools.pairwise(offsets)]
    each = zip(surfaces.ids.tolist(), surfaces.view.tolist(), surfaces.range.tolist(), polylines, strict=True)
    return [_Surface(first, second, view, reach, polyline) for (first, second), view, reach, polyline in each]


def _surfaces(pieces: Sequence[_Surface]) -> Surfaces:
    """The pieces as one message, with vertices in A."""
    ids = np.array([(s.first, s.second) for s in pieces], dtype=np.int64).reshape(-1, 2)
    view, reach = np.array([s.view for s in pieces], dtype=np.int64), np.array([s.range for s in pieces])
    return Surfaces(ids, view, reach, *pack([s.polyline for s in pieces]))


class _SeenTags(NamedTuple):
    """Tags on the newest panorama's components: ids, positions in A (m), component, arc length, normals in A."""

    ids: IntArray
    p_AL: FloatArray
    component: IntArray
    along: FloatArray
    normal: FloatArray


class _Walls(NamedTuple):
    """Walls in A: their ids (w,), a point on each (w, 2), m, unit vectors (w, 2) along them, and how far they have been
    seen from the point (w, 2), m."""

    ids: IntArray
    origin: FloatArray
    along: FloatArray
    reach: FloatArray

    def on(self, row: int, at: FloatArray) -> FloatArray:
        """Points (k, 2), m in A, of a wall at distances (k,), m, from its origin."""
        return np.asarray(self.origin[row] + at[:, None] * self.along[row])

    def at(self, row: int, points: FloatArray) -> FloatArray:
        """Return the distance (k,), m, of points (k, 2), m in A, along a wall from its origin."""
        return np.asarray((points - self.origin[row]) @ self.along[row])


def place(surfaces: Surfaces, landmarks: MapEstimate) -> FloatArray:
    """Return the vertices (v, 2) of all surfaces in the map frame, m, with the estimate's walls and views."""
    origin, x, y = _frames(surfaces, landmarks)
    u, v = surfaces.vertices.T
    return np.asarray(origin + np.stack([x * u - y * v, y * u + x * v], axis=1))


def _frames(surfaces: Surfaces, landmarks: MapEstimate) -> tuple[FloatArray, FloatArray, FloatArray]:
    """For each vertex the origin (v, 2), m in M, of its coordinates, and the direction (v,), (v,) of their first axis:
    along a wall from its anchor on, or that of the view."""
    pose, axis = landmarks.X_MA[surfaces.view], np.empty((len(surfaces.view), 2))
    origin, axis[:, 0], axis[:, 1] = pose[:, :2].copy(), np.cos(pose[:, 2]), np.sin(pose[:, 2])
    walls = np.flatnonzero(surfaces.on_wall)
    if len(walls):
        row = np.searchsorted(landmarks.ids, surfaces.ids[walls, 0])
        origin[walls], axis[walls] = landmarks.places[row], along_walls(landmarks.p_ML[row])
    count = np.diff(surfaces.offsets)
    return np.repeat(origin, count, axis=0), *np.repeat(axis, count, axis=0).T


def add_observation(
    surfaces: Surfaces,
    landmarks: MapEstimate,
    components: Components,
    panorama: Panorama,
    known_ids: IntArray,
    known_facing: FloatArray,
) -> tuple[Surfaces, IntArray, FloatArray]:
    """Return the surfaces with those of the newest view added.

    landmarks: the map with that view, of tags and walls. components, panorama: seen from it. known_ids: (n,) ascending,
    tags seen before, known_facing: (n, 2) unit vectors in M of the side they face. Returns also the ids (t,) of this
    turn's tags that lie on a surface, and its normals there in A (t, 2).
    """
    view, estimate = landmarks.stage - 1, landmarks.of_tags
    X_MA = landmarks.X_MA[view]
    X_AM = inverse(X_MA)
    tags = _find_tags(estimate, X_AM, components, panorama.range_max, known_ids, known_facing)
    walls = _walls_in(landmarks, X_AM)
    seen, others = _from_components(components, tags, walls, view)

    pieces = _pieces(surfaces, landmarks, X_AM)
    old = _trim(pieces, np.zeros((0, 4)), 0.0, panorama, landmarks)
    on_walls = _joined([*(piece for piece in old if piece.on_wall), *seen], walls)
    wall_segments = _segments(on_walls)
    kept = _trim([piece for piece in old if not piece.on_wall], wall_segments, SURFACE_COVERS)
    new = _trim(others, wall_segments, SURFACE_COVERS)
    kept = _split(_farther_left(kept, new), tags, ~np.isin(tags.ids, known_ids))
    new = _trim(new, _segments(kept), SURFACE_COVERS)
    merged = _surfaces(on_walls + kept + new)
    observed = np.isin(tags.ids, estimate.observation.ids)
    return _packed(merged, landmarks), tags.ids[observed], tags.normal[observed]


def without_doubles(surfaces: Surfaces, first: int, landmarks: MapEstimate) -> Surfaces:
    """Return the surfaces (s,) of two joined maps, the first map's before the second's, without duplicates: touching
    pieces of one wall are merged, and surface that the first map shows is cut off the second's."""
    X_AM = inverse(landmarks.X_MA[-1])
    pieces, known = _pieces(surfaces, landmarks, X_AM), set(surfaces.ids[:first, 0].tolist())
    on_walls = _joined([piece for piece in pieces if piece.on_wall], _walls_in(landmarks, X_AM))
    kept = [piece for piece in on_walls if piece.first in known]
    kept += _trim([piece for piece in on_walls if piece.first not in known], _segments(kept), SURFACE_COVERS)
    for others in (pieces[:first], pieces[first:]):
        kept += _trim([piece for piece in others if not piece.on_wall], _segments(kept), SURFACE_COVERS)
    return _packed(_surfaces(kept), landmarks)


def _find_tags(
    estimate: MapEstimate,
    X_AM: FloatArray,
    components: Components,
    range_max: float,
    known_ids: IntArray,
    known_facing: FloatArray,
) -> _SeenTags:
    """The landmarks that lie on the newest components, whether this turn saw them or earlier ones."""
    p_AL = transform(X_AM, estimate.p_ML)
    near = np.flatnonzero(np.hypot(p_AL[:, 0], p_AL[:, 1]) <= range_max + 2.0 * SEEN_TAG_DISTANCE)
    ids, p_AL = estimate.ids[near], p_AL[near]
    component, along, distance, normal = nearest(p_AL, components.offsets, components.vertices)
    observed = np.isin(ids, estimate.observation.ids)
    facing = np.zeros((len(estimate.ids), 2))
    row = np.searchsorted(estimate.ids, known_ids)
    facing[row] = transform(np.array([0.0, 0.0, X_AM[2]]), known_facing)
    same_side = np.sum(facing[near] * normal, axis=1) > 0.5
    on = np.where(observed, distance <= SEEN_TAG_DISTANCE, (distance <= ON_SURFACE) & same_side)
    on &= component >= 0
    return _SeenTags(ids[on], p_AL[on], component[on], along[on], normal[on])


def _walls_in(landmarks: MapEstimate, X_AM: FloatArray) -> _Walls:
    """The walls of a map in A."""
    walls = ~is_tag(landmarks.ids)
    along = along_walls(landmarks.p_ML[walls]) @ rotation(float(X_AM[2])).T
    return _Walls(landmarks.ids[walls], transform(X_AM, landmarks.places[walls]), along, landmarks.reach[walls])


def _from_components(
    components: Components, tags: _SeenTags, walls: _Walls, view: int
) -> tuple[list[_Surface], list[_Surface]]:
    """The pieces of the components that lie on walls, and all others, cut at the tags on them."""
    samples = sample(components.offsets, components.vertices, SPACING)
    wall, (_, _, component, start, stop) = _wall_of(samples, walls), samples
    on_walls: list[_Surface] = []
    others: list[_Surface] = []
    for i, j in zip(*_runs(component, wall), strict=True):
        c, begin, end = int(component[i]), float(start[i]), float(stop[j])
        whole = components.vertices[components.offsets[c] : components.offsets[c + 1]]
        polyline = sub_polyline(whole, begin, end)
        if wall[i] >= 0:
            row, first = int(wall[i]), int(walls.ids[wall[i]])
            polyline = walls.on(row, walls.at(row, polyline[[0, -1]]))
            on_walls.append(_Surface(first, first, view, _farthest(polyline), polyline))
            continue
        mine = np.flatnonzero((tags.component == c) & (tags.along >= begin) & (tags.along <= end))
        mine = mine[np.argsort(tags.along[mine], kind="stable")]
        piece = _Surface(-1, -1, view, _farthest(polyline), polyline)
        if components.closed and len(mine) and begin == 0.0 and end >= arc_length(whole)[-1]:
            piece = piece._replace(first=int(tags.ids[mine[-1]]), second=int(tags.ids[mine[0]]))
        others += _cut(piece, tags.ids[mine], tags.along[mine] - begin)
    return on_walls, others


def _wall_of(samples: tuple[FloatArray, FloatArray, IntArray, FloatArray, FloatArray], walls: _Walls) -> IntArray:
    """The row (n,) of the wall that each of the samples (n,) of components lies on, -1 for none: see `sample`."""
    points, normals, component, start, stop = samples
    ends = walls.reach + np.array([-GOES_ON, GOES_ON])
    lines = walls.origin[:, None] + ends[:, :, None] * walls.along[:, None]
    wall, _, distance, normal = nearest(points, 2 * np.arange(len(lines) + 1), lines.reshape(-1, 2))
    wall[(distance > ON_WALL) | (np.sum(normal * normals, axis=1) < SAME_FACE)] = -1
    for i, j in zip(*_runs(component, wall), strict=True):
        if stop[j] - start[i] < LEAST_ON_WALL:
            wall[i : j + 1] = -1
    return wall


def _runs(component: IntArray, wall: IntArray) -> tuple[list[int], list[int]]:
    """First and last of the samples (n,) that follow each other on one component and one wall."""
    changes = np.flatnonzero((np.diff(component) != 0) | (np.diff(wall) != 0)) + 1
    bounds = np.concatenate([[0], changes, [len(wall)]]) if len(wall) else np.zeros(1, dtype=np.int64)
    return bounds[:-1].tolist(), (bounds[1:] - 1).tolist()


def _cut(piece: _Surface, ids: IntArray, along: FloatArray) -> list[_Surface]:
    """The parts of a piece between its ends and the tags (t,) on it, at arc lengths (t,), m, ascending."""
    at = [0.0, *along.tolist(), float(arc_length(piece.polyline)[-1])]
    parts = []
    for (a, b), (begin, end) in zip(
        itertools.pairwise([piece.first, *ids.tolist(), piece.second]), itertools.pairwise(at), strict=True
    ):
        if end - begin > 1e-6:
            polyline = sub_polyline(piece.polyline, begin, end)
            parts.append(_Surface(a, b, piece.view, _farthest(polyline), polyline))
    return parts


def _split(pieces: list[_Surface], tags: _SeenTags, new_tag: BoolArray) -> list[_Surface]:
    """The pieces, each that newly mapped tags lie on cut at these. new_tag: (t,) of the tags seen."""
    new = np.flatnonzero(new_tag)
    owner, along, distance, normal = nearest(tags.p_AL[new], *pack([piece.polyline for piece in pieces]))
    lies_on = (distance <= ON_SURFACE) & (np.sum(normal * tags.normal[new], axis=1) > 0.5)
    split: list[_Surface] = []
    for i, piece in enumerate(pieces):
        on = np.flatnonzero(lies_on & (owner == i))
        on = on[np.argsort(along[on], kind="stable")]
        split += (_cut(piece, tags.ids[new[on]], along[on]) if len(on) else []) or [piece]
    return split


def _joined(pieces: list[_Surface], walls: _Walls) -> list[_Surface]:
    """Pieces of walls, those of one wall that touch as one."""
    joined: list[_Surface] = []
    for first in np.unique([piece.first for piece in pieces]).tolist():
        row = int(np.searchsorted(walls.ids, first))
        mine = [piece for piece in pieces if piece.first == first]
        reach = np.array([walls.at(row, piece.polyline[[0, -1]]) for piece in mine])
        order = np.argsort(reach[:, 0], kind="stable")
        farthest = np.maximum.accumulate(reach[order, 1])
        apart = np.flatnonzero(reach[order[1:], 0] > farthest[:-1] + SPACING) + 1
        for rows in np.split(order, apart):
            polyline = walls.on(row, np.array([reach[rows, 0].min(), reach[rows, 1].max()]))
            view, distance = max(mine[k].view for k in rows), min(mine[k].range for k in rows)
            joined.append(_Surface(first, first, view, distance, polyline))
    return joined


def _farthest(polyline: FloatArray) -> float:
    """Return the distance of a polyline's farthest vertex from the origin, m."""
    return float(np.hypot(polyline[:, 0], polyline[:, 1]).max())


def _trim(
    pieces: Sequence[_Surface],
    segments: FloatArray,
    distance: float,
    refuted_by: Panorama | None = None,
    landmarks: MapEstimate | None = None,
) -> list[_Surface]:
    """Return the pieces without the parts that segments (m, 4) cover, and without those that a panorama, with its map,
    saw to be free."""
    of = _surfaces(pieces)
    points, normals, owner, start, stop = sample(of.offsets, of.vertices, SPACING)
    drop = covered(points, normals, segments, np.full(len(points), distance))
    if refuted_by is not None and landmarks is not None:
        refuted = _refuted(points, normals, of.ids[owner], refuted_by, landmarks)
        gone = np.bincount(owner[refuted], minlength=len(pieces)) >= REFUTED_SHARE * np.bincount(owner)
        drop |= refuted | (gone & (of.kind == LOOSE))[owner]
    is_cut = np.bincount(owner[drop], minlength=len(pieces)) > 0
    length = np.zeros(len(pieces))
    length[owner] = stop
    left, begin, end = uncovered_runs(owner, drop, start, stop, LEAST_LENGTH)
    begin, end = np.maximum(begin - OVERLAP, 0.0), np.minimum(end + OVERLAP, length[left])
    runs = np.searchsorted(left, np.arange(len(pieces) + 1)).tolist()
    trimmed = []
    for i, piece in enumerate(pieces):
        if not is_cut[i]:
            trimmed.append(piece)
            continue
        for r in range(runs[i], runs[i + 1]):
            part = piece._replace(polyline=sub_polyline(piece.polyline, begin[r], end[r]))
            if not part.on_wall:
                part = part._replace(
                    first=piece.first if begin[r] == 0.0 else -1,
                    second=piece.second if end[r] == length[i] else -1,
                )
            trimmed.append(part)
    return trimmed


def _farther_left(pieces: list[_Surface], new: list[_Surface]) -> list[_Surface]:
    """The pieces without what new ones show that were seen from nearer: a wall seen from far may lie some centimetres
    off, and close a passage."""
    points, normals, owner, _, _ = sample(*pack([piece.polyline for piece in pieces]), SPACING)
    again = set(owner[covered(points, normals, _segments(new), np.full(len(points), SURFACE_COVERS))].tolist())
    left = []
    for i, piece in enumerate(pieces):
        nearer = [one for one in new if one.range < piece.range] if i in again else []
        left += _trim([piece], _segments(nearer), SURFACE_COVERS) if nearer else [piece]
    return left


def _refuted(
    points: FloatArray, normals: FloatArray, ids: IntArray, panorama: Panorama, landmarks: MapEstimate
) -> BoolArray:
    """Which points (n, 2) with unit normals (n, 2) in A the panorama saw past, in their bin and its neighbours, (n,).

    ids: (n, 2) the landmarks that they join, -1 for none: so far as these may have drifted, seen from the robot, they
    may be seen past.
    """
    depth = _seen_past(points, normals, panorama)
    refuted = depth > 0.0
    asked = np.flatnonzero(refuted)
    if not len(asked):
        return np.asarray(refuted)
    sigma, normal = np.zeros(len(asked)), normals[asked] @ rotation(float(landmarks.X_MA[-1, 2])).T
    for side in ids[asked].T:
        anchored = side != -1
        C = drift_from_robot(landmarks, np.searchsorted(landmarks.ids, side[anchored]))
        variance = np.einsum("ni,nij,nj->n", normal[anchored], C, normal[anchored])
        sigma[anchored] = np.maximum(sigma[anchored], np.sqrt(np.maximum(variance, 0.0)))
    refuted[asked] = depth[asked] > DRIFT_SIGMAS * sigma
    return np.asarray(refuted)


def _seen_past(points: FloatArray, normals: FloatArray, panorama: Panorama) -> FloatArray:
    """Return how much farther (n,), m along the normal, than REFUTED_DEPTH behind points (n, 2) with unit normals (n,
    2) in A a panorama saw at least, in the point's bin and its neighbours; 0 if it did not.

    Surfaces nearly edge-on are skipped, as a thin wall is invisible there.
    """
    distance = np.hypot(points[:, 0], points[:, 1])
    cosine = np.abs(np.sum(points * normals, axis=1)) / np.maximum(distance, 1e-9)
    judged = (distance < panorama.range_max) & (cosine >= math.cos(REFUTED_INCIDENCE))
    beyond = panorama.least_range(points, REFUTED_BINS) - REFUTED_DEPTH - distance
    return np.where(judged, np.maximum(0.0, cosine * beyond), 0.0)


def _segments(pieces: list[_Surface]) -> FloatArray:
    return segments_of(*pack([piece.polyline for piece in pieces]))[0]


def _packed(surfaces: Surfaces, landmarks: MapEstimate) -> Surfaces:
    """The surfaces, from the newest view's frame back in the coordinates of each: the inverse of place."""
    origin, x, y = _frames(surfaces, landmarks)
    u, v = (transform(landmarks.X_MA[-1], surfaces.vertices) - origin).T
    return replace(surfaces, vertices=np.stack([x * u + y * v, x * v - y * u], axis=1))
