"""Obstacle surfaces anchored to landmarks, so that they move with the map.

Three kinds of polylines (Sec. III of the paper knows only the first):
EDGE: between two landmarks; vertices in similarity coordinates of the two, (0, 0) the first and (1, 0) the second.
END: a wall end, anchored to one landmark; vertices as offsets from it along the axes of the view that saw it, m.
LOOSE: a surface without a landmark; vertices in the frame A of the view that saw it, m.
A surface was seen from the left of its polyline.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import minimum_filter1d

from tfg_drake.geometry.se2 import inverse, rotation, transform
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, message, replace
from tfg_drake.tfg.drift import DRIFT_SIGMAS, drift_from_robot
from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.polyline import (
    arc_length,
    covered,
    nearest,
    pack,
    sample,
    segments_of,
    sub_polyline,
    taken,
    uncovered_runs,
)
from tfg_drake.tfg.segmentation import Components

EDGE, END, LOOSE = 0, 1, 2

# A tag seen in this turn belongs to a surface this close, m; one known from earlier turns must lie closer, m.
SEEN_TAG_DISTANCE = 0.2
KNOWN_TAG_DISTANCE = 0.1
# A detour longer than this many times the distance of its tags is not an edge: similarity would magnify their errors.
LONGEST_DETOUR = 3.0
# Wall ends and loose surfaces are cut where an edge runs this close, m, new ones also where any older surface does, m.
EDGE_COVERS = 0.15
SURFACE_COVERS = 0.1
# Samples for that, m; shorter remains are dropped, m.
SPACING = 0.05
LEAST_LENGTH = 0.04
# What is left overlaps what covers the rest by this, m, so that no line of sight slips between them.
OVERLAP = 0.06
# A wall end or loose surface this far inside what a turn saw to be free was an error or is gone, m.
REFUTED_DEPTH = 0.15
# An edge falls only where that much of it was, m.
REFUTED_LENGTH = 0.15
# Of a loose surface that much of which was nothing is left: somebody stood there.
REFUTED_SHARE = 0.4
# Neighbouring bins that must agree to that.
REFUTED_BINS = 2
# Greatest angle between the line of sight and its normal, rad.
REFUTED_INCIDENCE = np.deg2rad(75.0)


@message
class Surfaces:
    """All surfaces, edges first.

    kind: (s,). ids: (s, 2) the landmarks it is anchored to, counter-clockwise seen from the view that saw it, -1 for
    none. view: (s,) index of that view. range: (s,) m, its farthest vertex from there. offsets: (s + 1,) and vertices:
    (v, 2), see the module.
    """

    kind: IntArray
    ids: IntArray
    view: IntArray
    range: FloatArray
    offsets: IntArray
    vertices: FloatArray


class _Surface(NamedTuple):
    """One surface that is new or has changed; the polyline (v, 2) is in the newest view's frame, m."""

    kind: int
    first: int
    second: int
    view: int
    range: float
    polyline: FloatArray


@dataclasses.dataclass(frozen=True)
class _Draft:
    """The surfaces while the graph is being updated, by row: the old ones, with vertices in the newest view's frame A,
    m, and behind them those made since. Most of the old ones stay as they are."""

    old: Surfaces
    made: list[_Surface]

    def add(self, surface: _Surface) -> int:
        """The row of a new surface."""
        self.made.append(surface)
        return len(self.old.kind) + len(self.made) - 1

    def __getitem__(self, row: int) -> _Surface:
        old, count = self.old, len(self.old.kind)
        if row >= count:
            return self.made[row - count]
        first, second = old.ids[row].tolist()
        polyline = old.vertices[old.offsets[row] : old.offsets[row + 1]]
        return _Surface(int(old.kind[row]), first, second, int(old.view[row]), float(old.range[row]), polyline)

    def packed(self, rows: Sequence[int]) -> tuple[IntArray, FloatArray]:
        """offsets (n + 1,) and vertices (v, 2) of the polylines of some rows (n,), in this order."""
        old = self.old
        offsets, vertices = pack([s.polyline for s in self.made])
        offsets = np.concatenate([old.offsets, old.offsets[-1] + offsets[1:]])
        return taken(np.array(rows, dtype=np.int64), offsets, np.concatenate([old.vertices, vertices]))

    def numbers(self, rows: Sequence[int]) -> IntArray:
        """kind, first, second and view (n, 4) of some rows (n,), in this order."""
        old = self.old
        made = np.array([(s.kind, s.first, s.second, s.view) for s in self.made], dtype=np.int64).reshape(-1, 4)
        return np.concatenate([np.column_stack([old.kind, old.ids, old.view]), made])[np.array(rows, dtype=np.int64)]

    def surfaces(self, rows: Sequence[int]) -> Surfaces:
        """Some of the surfaces, by kind and else in this order, with vertices in A."""
        numbers = self.numbers(rows)
        order = np.argsort(numbers[:, 0], kind="stable")
        numbers, rows = numbers[order], np.array(rows, dtype=np.int64)[order].tolist()
        ranges = np.concatenate([self.old.range, [s.range for s in self.made]])[rows]
        return Surfaces(numbers[:, 0], numbers[:, 1:3], numbers[:, 3], ranges, *self.packed(rows))


class _SeenTags(NamedTuple):
    """Tags on the newest panorama's components: ids, positions in A (m), component, arc length, normals in A."""

    ids: IntArray
    p_AL: FloatArray
    component: IntArray
    along: FloatArray
    normal: FloatArray


def no_surfaces() -> Surfaces:
    """The surfaces of an empty map."""
    none = np.zeros(0, dtype=np.int64)
    offsets = np.zeros(1, dtype=np.int64)
    return Surfaces(none, np.zeros((0, 2), dtype=np.int64), none, np.zeros(0), offsets, np.zeros((0, 2)))


def place(surfaces: Surfaces, estimate: MapEstimate) -> FloatArray:
    """The vertices (v, 2) of all surfaces in the map frame, m, with the estimate's landmarks and views."""
    count = np.diff(surfaces.offsets)
    kind = np.repeat(surfaces.kind, count)
    theta = np.repeat(estimate.X_MA[surfaces.view, 2], count)
    origin = np.repeat(_anchors(surfaces, estimate), count, axis=0)
    # Edges are scaled and turned by the vector between their landmarks, the others turned by their view's heading.
    span = np.repeat(_positions(surfaces.ids[:, 1], estimate), count, axis=0) - origin
    x = np.where(kind == EDGE, span[:, 0], np.cos(theta))
    y = np.where(kind == EDGE, span[:, 1], np.sin(theta))
    u, v = surfaces.vertices[:, 0], surfaces.vertices[:, 1]
    return origin + np.stack([x * u - y * v, y * u + x * v], axis=1)


def _positions(ids: IntArray, estimate: MapEstimate) -> FloatArray:
    """p_ML (n, 2) of landmarks (n,); anything for the id -1."""
    if not len(estimate.ids):
        return np.zeros((len(ids), 2))
    return estimate.p_ML[np.minimum(np.searchsorted(estimate.ids, ids), len(estimate.ids) - 1)]


def _anchors(surfaces: Surfaces, estimate: MapEstimate) -> FloatArray:
    on_view = (surfaces.kind == LOOSE)[:, None]
    return np.where(on_view, estimate.X_MA[surfaces.view, :2], _positions(surfaces.ids[:, 0], estimate))


def add_observation(
    surfaces: Surfaces,
    estimate: MapEstimate,
    components: Components,
    panorama: Panorama,
    known_ids: IntArray,
    known_facing: FloatArray,
) -> tuple[Surfaces, IntArray, FloatArray]:
    """The surfaces with those of the newest view added.

    estimate: the map with that view. components, panorama: seen from it. known_ids: (n,) ascending, landmarks seen
    before, known_facing: (n, 2) unit vectors in M of the side they face.
    Returns the surfaces, and which tags of this turn lie on one, ids (t,), and its normals there in A (t, 2).
    """
    view = estimate.stage - 1
    X_MA = estimate.X_MA[view]
    X_AM = inverse(X_MA)
    tags = _find_tags(estimate, X_AM, components, panorama.range_max, known_ids, known_facing)
    edges, pieces = _from_components(components, tags, view)

    draft = _Draft(replace(surfaces, vertices=transform(X_AM, place(surfaces, estimate))), [])
    all_edges, ends = _break_refuted(draft, panorama, estimate)
    _split_edges(all_edges, draft, tags, ~np.isin(tags.ids, known_ids))
    for key, edge in edges.items():
        if key not in all_edges or edge.range <= draft[all_edges[key]].range:
            all_edges[key] = draft.add(edge)
    kept_edges = list(all_edges.values())
    edge_segments = _segments(draft, kept_edges)

    others = np.flatnonzero(surfaces.kind != EDGE).tolist()
    kept = _trim(draft, ends + others, edge_segments, EDGE_COVERS, panorama, estimate)
    new = _trim(draft, [draft.add(piece) for piece in pieces], edge_segments, EDGE_COVERS)
    kept = _farther_left(draft, kept, new)
    new = _trim(draft, new, _segments(draft, kept), SURFACE_COVERS)
    merged = draft.surfaces(kept_edges + kept + new)
    observed = np.isin(tags.ids, estimate.observation.ids)
    return _packed(merged, estimate, X_MA), tags.ids[observed], tags.normal[observed]


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
    on = np.where(observed, distance <= SEEN_TAG_DISTANCE, (distance <= KNOWN_TAG_DISTANCE) & same_side)
    on &= component >= 0
    return _SeenTags(ids[on], p_AL[on], component[on], along[on], normal[on])


def _from_components(
    components: Components, tags: _SeenTags, view: int
) -> tuple[dict[tuple[int, int], _Surface], list[_Surface]]:
    """Edges between neighbouring tags of each component by their sorted ids, then wall ends and loose surfaces."""
    edges: dict[tuple[int, int], _Surface] = {}
    ends: list[_Surface] = []
    loose: list[_Surface] = []
    for c, (begin, end) in enumerate(itertools.pairwise(components.offsets.tolist())):
        mine = np.flatnonzero(tags.component == c)
        mine = mine[np.argsort(tags.along[mine], kind="stable")]
        polyline, along = components.vertices[begin:end], tags.along[mine]
        if not len(mine):
            loose.append(_Surface(LOOSE, -1, -1, view, _farthest(polyline), polyline))
            continue
        total = float(arc_length(polyline)[-1])
        if components.closed:
            # Begin and end at the first tag, so that the last edge leads back to it.
            first = along[0]
            if 0.0 < first < total:
                polyline = np.concatenate(
                    [sub_polyline(polyline, first, total), sub_polyline(polyline, 0.0, first)[1:]]
                )
            mine = np.append(mine, mine[0])
            along = np.append(along - first, total)
        else:
            ends += _end(
                tags, int(mine[0]), sub_polyline(polyline, 0.0, along[0]) if along[0] > 0.0 else polyline[:1], -1, view
            )
            ends += _end(
                tags,
                int(mine[-1]),
                sub_polyline(polyline, along[-1], total) if along[-1] < total else polyline[-1:],
                0,
                view,
            )
        for i, j, start, stop in zip(mine[:-1], mine[1:], along[:-1], along[1:], strict=True):
            if stop <= start:
                continue
            part = sub_polyline(polyline, start, stop)
            edge = _edge(tags, int(i), int(j), part, view)
            key = (min(edge.first, edge.second), max(edge.first, edge.second))
            if _detour(edge.polyline) <= LONGEST_DETOUR and (key not in edges or edge.range < edges[key].range):
                edges[key] = edge
            else:
                middle = 0.5 * (stop - start)
                ends += _end(tags, int(i), sub_polyline(part, 0.0, middle), 0, view)
                ends += _end(tags, int(j), sub_polyline(part, middle, stop - start), -1, view)
    return edges, ends + loose


def _edge(tags: _SeenTags, i: int, j: int, part: FloatArray, view: int) -> _Surface:
    polyline = part.copy()
    polyline[0], polyline[-1] = tags.p_AL[i], tags.p_AL[j]
    return _Surface(EDGE, int(tags.ids[i]), int(tags.ids[j]), view, _farthest(polyline), polyline)


def _end(tags: _SeenTags, i: int, polyline: FloatArray, at: int, view: int) -> list[_Surface]:
    """The wall end from tag i, at the polyline's start (at = 0) or end (at = -1); none where it has no length."""
    if len(polyline) < 2:
        return []
    polyline = polyline.copy()
    polyline[at] = tags.p_AL[i]
    return [_Surface(END, int(tags.ids[i]), -1, view, _farthest(polyline), polyline)]


def _farthest(polyline: FloatArray) -> float:
    """How far a polyline's farthest vertex is from the origin, m."""
    return float(np.hypot(polyline[:, 0], polyline[:, 1]).max())


def _detour(polyline: FloatArray) -> float:
    """How far a polyline strays from its first point, in units of the distance between its ends."""
    span = np.hypot(*(polyline[-1] - polyline[0]))
    return float(np.hypot(*(polyline - polyline[0]).T).max() / span) if span > 1e-6 else np.inf


def _split_edges(edges: dict[tuple[int, int], int], draft: _Draft, tags: _SeenTags, new_tag: BoolArray) -> None:
    """Replaces each edge that a newly mapped tag lies on by the two to that tag, unless those exist already.

    edges: the rows of all edges in the draft by their sorted ids. new_tag: (t,) of the tags seen.
    """
    new = np.flatnonzero(new_tag)
    if not len(new) or not edges:
        return
    keys = list(edges)
    owner, along, distance, normal = nearest(tags.p_AL[new], *draft.packed(list(edges.values())))
    same_side = np.sum(normal * tags.normal[new], axis=1) > 0.5
    lies_on = (distance <= KNOWN_TAG_DISTANCE) & same_side
    for k in np.unique(owner[lies_on]):
        old = draft[edges.pop(keys[k])]
        on = np.flatnonzero(lies_on & (owner == k))
        on = on[np.argsort(along[on], kind="stable")]
        total = float(arc_length(old.polyline)[-1])
        s = [0.0, *along[on].tolist(), total]
        ids = [old.first, *tags.ids[new[on]].tolist(), old.second]
        places = [old.polyline[0], *tags.p_AL[new[on]], old.polyline[-1]]
        for i in range(len(ids) - 1):
            key = (min(ids[i], ids[i + 1]), max(ids[i], ids[i + 1]))
            if s[i + 1] - s[i] <= 1e-6 or key in edges:
                continue
            polyline = sub_polyline(old.polyline, s[i], s[i + 1])
            polyline[0], polyline[-1] = places[i], places[i + 1]
            if _detour(polyline) <= LONGEST_DETOUR:
                edges[key] = draft.add(old._replace(first=ids[i], second=ids[i + 1], polyline=polyline))


def _break_refuted(
    draft: _Draft, panorama: Panorama, estimate: MapEstimate
) -> tuple[dict[tuple[int, int], int], list[int]]:
    """The rows of the draft's edges by their sorted ids, those left out that the newest panorama saw past, and the rows
    of the wall ends that remain of these."""
    old, count = draft.old, int(np.count_nonzero(draft.old.kind == EDGE))
    points, normals, owner, start, stop = sample(old.offsets[: count + 1], old.vertices, SPACING)
    refuted = _refuted(points, normals, old.ids[owner], panorama, estimate)
    length = np.bincount(owner[refuted], (stop - start)[refuted], minlength=count)
    keys = zip(old.ids[:count].min(axis=1).tolist(), old.ids[:count].max(axis=1).tolist(), strict=True)
    edges, ends = dict(zip(keys, range(count), strict=True)), []
    for i in np.flatnonzero(length >= REFUTED_LENGTH).tolist():
        edge, own = draft[i], owner == i
        del edges[min(edge.first, edge.second), max(edge.first, edge.second)]
        middle = 0.5 * float(stop[own][-1])
        _, begin, end_at = uncovered_runs(owner[own], refuted[own], start[own], stop[own], LEAST_LENGTH)
        for a, b in zip(begin.tolist(), end_at.tolist(), strict=True):
            anchor = edge.first if a + b <= 2.0 * middle else edge.second
            end = edge._replace(kind=END, first=anchor, second=-1, polyline=sub_polyline(edge.polyline, a, b))
            ends.append(draft.add(end))
    return edges, ends


def _trim(
    draft: _Draft,
    rows: list[int],
    segments: FloatArray,
    distance: float,
    refuted_by: Panorama | None = None,
    estimate: MapEstimate | None = None,
) -> list[int]:
    """The rows of these pieces without what segments (m, 4) cover, and without what a panorama, with the map of then,
    saw to be free."""
    if not rows:
        return []
    points, normals, owner, start, stop = sample(*draft.packed(rows), SPACING)
    drop = covered(points, normals, segments, np.full(len(points), distance))
    if refuted_by is not None and estimate is not None:
        numbers = draft.numbers(rows)
        refuted = _refuted(points, normals, numbers[owner, 1:3], refuted_by, estimate)
        gone = np.bincount(owner[refuted], minlength=len(rows)) >= REFUTED_SHARE * np.bincount(owner)
        drop |= refuted | (gone & (numbers[:, 0] == LOOSE))[owner]
    less = np.bincount(owner[drop], minlength=len(rows)).tolist()
    length = np.zeros(len(rows))
    length[owner] = stop
    left, begin, end = uncovered_runs(owner, drop, start, stop, LEAST_LENGTH)
    begin, end = np.maximum(begin - OVERLAP, 0.0), np.minimum(end + OVERLAP, length[left])
    runs = np.searchsorted(left, np.arange(len(rows) + 1)).tolist()
    trimmed = []
    for i, row in enumerate(rows):
        if not less[i]:
            trimmed.append(row)
            continue
        piece = draft[row]
        for r in range(runs[i], runs[i + 1]):
            trimmed.append(draft.add(piece._replace(polyline=sub_polyline(piece.polyline, begin[r], end[r]))))
    return trimmed


def _farther_left(draft: _Draft, rows: list[int], new: list[int]) -> list[int]:
    """The rows of these pieces without what new ones show that were seen from nearer: a wall seen from far may lie some
    centimetres off, and close a passage."""
    if not rows or not new:
        return rows
    points, normals, owner, _, _ = sample(*draft.packed(rows), SPACING)
    again = covered(points, normals, _segments(draft, new), np.full(len(points), SURFACE_COVERS))
    seen_again = set(owner[again].tolist())
    left = []
    for i, row in enumerate(rows):
        nearer = [n for n in new if draft[n].range < draft[row].range] if i in seen_again else []
        left += _trim(draft, [row], _segments(draft, nearer), SURFACE_COVERS) if nearer else [row]
    return left


def _refuted(
    points: FloatArray, normals: FloatArray, ids: IntArray, panorama: Panorama, estimate: MapEstimate
) -> BoolArray:
    """Which points (n, 2) with unit normals (n, 2) in A the panorama saw past, in their bin and its neighbours, (n,).

    ids: (n, 2) the landmarks that they are anchored to, -1 for none: so far as these may have drifted, seen from the
    robot, they may be seen past.
    """
    depth = _seen_past(points, normals, panorama.ranges, panorama.range_max)
    refuted = depth > 0.0
    asked = np.flatnonzero(refuted)
    if not len(asked):
        return np.asarray(refuted)
    sigma, normal = np.zeros(len(asked)), normals[asked] @ rotation(float(estimate.X_MA[-1, 2])).T
    for side in ids[asked].T:
        anchored = side >= 0
        C = drift_from_robot(estimate, np.searchsorted(estimate.ids, side[anchored]))
        variance = np.einsum("ni,nij,nj->n", normal[anchored], C, normal[anchored])
        sigma[anchored] = np.maximum(sigma[anchored], np.sqrt(np.maximum(variance, 0.0)))
    refuted[asked] = depth[asked] > DRIFT_SIGMAS * sigma
    return np.asarray(refuted)


def _seen_past(points: FloatArray, normals: FloatArray, ranges: FloatArray, range_max: float) -> FloatArray:
    """How much farther (n,), m along the normal, than REFUTED_DEPTH behind points (n, 2) with unit normals (n, 2) in A
    a panorama of ranges (b,), m, saw at least, in the point's bin and its neighbours; 0 where it did not.

    Surfaces nearly edge-on are let be: a thin wall shows nothing of itself there.
    """
    bins, (x, y) = len(ranges), points.T
    reach = np.nan_to_num(ranges, nan=0.0, posinf=range_max)
    distance = np.hypot(x, y)
    cosine = np.abs(x * normals[:, 0] + y * normals[:, 1]) / np.maximum(distance, 1e-9)
    b = np.minimum((np.arctan2(y, x) % (2.0 * np.pi) * bins / (2.0 * np.pi)).astype(np.int64), bins - 1)
    least = minimum_filter1d(reach, 2 * REFUTED_BINS + 1, mode="wrap")[b]
    judged = (distance < range_max) & (cosine >= math.cos(REFUTED_INCIDENCE))
    return np.where(judged, np.maximum(0.0, cosine * (least - REFUTED_DEPTH - distance)), 0.0)


def _segments(draft: _Draft, rows: list[int]) -> FloatArray:
    return segments_of(*draft.packed(rows))[0]


def _packed(surfaces: Surfaces, estimate: MapEstimate, X_MA: FloatArray) -> Surfaces:
    """The surfaces, from the newest view's frame back in the coordinates of each kind: the inverse of place."""
    count = np.diff(surfaces.offsets)
    kinds = np.repeat(surfaces.kind, count)
    theta = np.repeat(estimate.X_MA[surfaces.view, 2], count)
    origin = np.repeat(_anchors(surfaces, estimate), count, axis=0)
    span = np.repeat(_positions(surfaces.ids[:, 1], estimate), count, axis=0) - origin
    x = np.where(kinds == EDGE, span[:, 0], np.cos(theta))
    y = np.where(kinds == EDGE, span[:, 1], np.sin(theta))
    offset = transform(X_MA, surfaces.vertices) - origin
    square = x * x + y * y
    local = np.stack([x * offset[:, 0] + y * offset[:, 1], x * offset[:, 1] - y * offset[:, 0]], axis=1)
    return replace(surfaces, vertices=local / square[:, None])
