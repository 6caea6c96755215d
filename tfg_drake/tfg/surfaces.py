"""Obstacle surfaces anchored to landmarks, so that they move with the map.

Three kinds of polylines (Sec. III of the paper knows only the first):
EDGE: between two landmarks; vertices in similarity coordinates of the two, (0, 0) the first and (1, 0) the second.
END: a wall end, anchored to one landmark; vertices as offsets from it along the axes of the goal that saw it, m.
LOOSE: a surface without a landmark; vertices in the frame A of the goal that saw it, m.
A surface was seen from the left of its polyline.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tfg_drake.geometry.se2 import inverse, rotation, transform
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, message
from tfg_drake.tfg.drift import DRIFT_SIGMAS, drift_from_robot
from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.polyline import arc_length, covered, cut, nearest, pack, sample, segments_of, uncovered_runs
from tfg_drake.tfg.segmentation import Component

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
# Neighbouring bins that must agree to that.
REFUTED_BINS = 2
# Greatest angle between the line of sight and its normal, rad.
REFUTED_INCIDENCE = np.deg2rad(75.0)


@message
class Surfaces:
    """All surfaces, edges first.

    kind: (s,). ids: (s, 2) the landmarks it is anchored to, counter-clockwise seen from the goal that saw it, -1 for
    none. goal: (s,) index of that goal. range: (s,) m, its farthest vertex from there. offsets: (s + 1,) and vertices:
    (v, 2), see the module.
    """

    kind: IntArray
    ids: IntArray
    goal: IntArray
    range: FloatArray
    offsets: IntArray
    vertices: FloatArray


class _Surface(NamedTuple):
    """One surface while the graph is being updated; the polyline (v, 2) is in the newest goal's frame, m."""

    kind: int
    first: int
    second: int
    goal: int
    range: float
    polyline: FloatArray


class _View(NamedTuple):
    """What refutes surfaces: the newest panorama. ids: (n,) ascending, drift: (n, 2, 2) of `drift_from_robot`, R_MA:
    (2, 2)."""

    panorama: Panorama
    ids: IntArray
    drift: FloatArray
    R_MA: FloatArray


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
    """The vertices (v, 2) of all surfaces in the map frame, m, with the estimate's landmarks and goals."""
    count = np.diff(surfaces.offsets)
    kind = np.repeat(surfaces.kind, count)
    theta = np.repeat(estimate.X_MA[surfaces.goal, 2], count)
    origin = np.repeat(_anchors(surfaces, estimate), count, axis=0)
    # Edges are scaled and turned by the vector between their landmarks, the others turned by their goal's heading.
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
    on_goal = (surfaces.kind == LOOSE)[:, None]
    return np.where(on_goal, estimate.X_MA[surfaces.goal, :2], _positions(surfaces.ids[:, 0], estimate))


def add_observation(
    surfaces: Surfaces,
    estimate: MapEstimate,
    components: Sequence[Component],
    panorama: Panorama,
    known_ids: IntArray,
    known_facing: FloatArray,
) -> tuple[Surfaces, IntArray, FloatArray]:
    """The surfaces with those of the newest goal added.

    estimate: the map with that goal. components, panorama: seen from it. known_ids: (n,) ascending, landmarks seen
    before, known_facing: (n, 2) unit vectors in M of the side they face.
    Returns the surfaces, and which tags of this turn lie on one, ids (t,), and its normals there in A (t, 2).
    """
    goal = estimate.stage - 1
    X_MA = estimate.X_MA[goal]
    X_AM = inverse(X_MA)
    tags = _find_tags(estimate, X_AM, components, known_ids, known_facing)
    edges, pieces = _from_components(components, tags, goal)

    old = _unpack(surfaces, transform(X_AM, place(surfaces, estimate)))
    view = _View(panorama, estimate.ids, drift_from_robot(estimate), rotation(float(X_MA[2])))
    old = _break_refuted(old, view)
    all_edges = {(min(s.first, s.second), max(s.first, s.second)): s for s in old if s.kind == EDGE}
    new_tag = ~np.isin(tags.ids, known_ids)
    _split_edges(all_edges, tags, new_tag)
    for key, edge in edges.items():
        if key not in all_edges or edge.range <= all_edges[key].range:
            all_edges[key] = edge
    kept_edges = list(all_edges.values())
    edge_segments = _segments(kept_edges)

    kept = _trim([s for s in old if s.kind != EDGE], edge_segments, EDGE_COVERS, view)
    pieces = _trim(pieces, edge_segments, EDGE_COVERS, None)
    pieces = _trim(pieces, _segments(kept), SURFACE_COVERS, None)
    merged = kept_edges + sorted(kept + pieces, key=lambda s: s.kind)
    observed = np.isin(tags.ids, estimate.observation.ids)
    return _pack(merged, estimate, X_MA), tags.ids[observed], tags.normal[observed]


def _find_tags(
    estimate: MapEstimate,
    X_AM: FloatArray,
    components: Sequence[Component],
    known_ids: IntArray,
    known_facing: FloatArray,
) -> _SeenTags:
    """The landmarks that lie on the newest components, whether this turn saw them or earlier ones."""
    p_AL = transform(X_AM, estimate.p_ML)
    component, along, distance, normal = nearest(p_AL, *pack([c.polyline for c in components]))
    observed = np.isin(estimate.ids, estimate.observation.ids)
    facing = np.zeros((len(estimate.ids), 2))
    row = np.searchsorted(estimate.ids, known_ids)
    facing[row] = transform(np.array([0.0, 0.0, X_AM[2]]), known_facing)
    same_side = np.sum(facing * normal, axis=1) > 0.5
    on = np.where(observed, distance <= SEEN_TAG_DISTANCE, (distance <= KNOWN_TAG_DISTANCE) & same_side)
    on &= component >= 0
    return _SeenTags(estimate.ids[on], p_AL[on], component[on], along[on], normal[on])


def _from_components(
    components: Sequence[Component], tags: _SeenTags, goal: int
) -> tuple[dict[tuple[int, int], _Surface], list[_Surface]]:
    """Edges between neighbouring tags of each component by their sorted ids, then wall ends and loose surfaces."""
    edges: dict[tuple[int, int], _Surface] = {}
    ends: list[_Surface] = []
    loose: list[_Surface] = []
    for c, component in enumerate(components):
        mine = np.flatnonzero(tags.component == c)
        mine = mine[np.argsort(tags.along[mine], kind="stable")]
        polyline, along = component.polyline, tags.along[mine]
        total = float(arc_length(polyline)[-1])
        farthest = float(np.hypot(polyline[:, 0], polyline[:, 1]).max())
        if not len(mine):
            loose.append(_Surface(LOOSE, -1, -1, goal, farthest, polyline))
            continue
        if component.closed:
            # Begin and end at the first tag, so that the last edge leads back to it.
            first = along[0]
            if 0.0 < first < total:
                polyline = np.concatenate([cut(polyline, first, total), cut(polyline, 0.0, first)[1:]])
            mine = np.append(mine, mine[0])
            along = np.append(along - first, total)
        else:
            ends += _end(tags, int(mine[0]), cut(polyline, 0.0, along[0]) if along[0] > 0.0 else polyline[:1], -1, goal)
            ends += _end(
                tags, int(mine[-1]), cut(polyline, along[-1], total) if along[-1] < total else polyline[-1:], 0, goal
            )
        for i, j, start, stop in zip(mine[:-1], mine[1:], along[:-1], along[1:], strict=True):
            if stop <= start:
                continue
            part = cut(polyline, start, stop)
            edge = _edge(tags, int(i), int(j), part, goal)
            key = (min(edge.first, edge.second), max(edge.first, edge.second))
            if _detour(edge.polyline) <= LONGEST_DETOUR and (key not in edges or edge.range < edges[key].range):
                edges[key] = edge
            else:
                middle = 0.5 * (stop - start)
                ends += _end(tags, int(i), cut(part, 0.0, middle), 0, goal)
                ends += _end(tags, int(j), cut(part, middle, stop - start), -1, goal)
    return edges, ends + loose


def _edge(tags: _SeenTags, i: int, j: int, part: FloatArray, goal: int) -> _Surface:
    polyline = part.copy()
    polyline[0], polyline[-1] = tags.p_AL[i], tags.p_AL[j]
    farthest = float(np.hypot(polyline[:, 0], polyline[:, 1]).max())
    return _Surface(EDGE, int(tags.ids[i]), int(tags.ids[j]), goal, farthest, polyline)


def _end(tags: _SeenTags, i: int, polyline: FloatArray, at: int, goal: int) -> list[_Surface]:
    """The wall end from tag i, at the polyline's start (at = 0) or end (at = -1); none where it has no length."""
    if len(polyline) < 2:
        return []
    polyline = polyline.copy()
    polyline[at] = tags.p_AL[i]
    farthest = float(np.hypot(polyline[:, 0], polyline[:, 1]).max())
    return [_Surface(END, int(tags.ids[i]), -1, goal, farthest, polyline)]


def _detour(polyline: FloatArray) -> float:
    """How far a polyline strays from its first point, in units of the distance between its ends."""
    span = np.hypot(*(polyline[-1] - polyline[0]))
    return float(np.hypot(*(polyline - polyline[0]).T).max() / span) if span > 1e-6 else np.inf


def _split_edges(edges: dict[tuple[int, int], _Surface], tags: _SeenTags, new_tag: BoolArray) -> None:
    """Replaces each edge that a newly mapped tag lies on by the two to that tag, unless those exist already."""
    new = np.flatnonzero(new_tag)
    if not len(new) or not edges:
        return
    keys = list(edges)
    owner, along, distance, normal = nearest(tags.p_AL[new], *pack([edges[key].polyline for key in keys]))
    same_side = np.sum(normal * tags.normal[new], axis=1) > 0.5
    lies_on = (distance <= KNOWN_TAG_DISTANCE) & same_side
    for k in np.unique(owner[lies_on]):
        old = edges.pop(keys[k])
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
            polyline = cut(old.polyline, s[i], s[i + 1])
            polyline[0], polyline[-1] = places[i], places[i + 1]
            if _detour(polyline) <= LONGEST_DETOUR:
                edges[key] = old._replace(first=ids[i], second=ids[i + 1], polyline=polyline)


def _break_refuted(surfaces: Sequence[_Surface], view: _View) -> list[_Surface]:
    """The surfaces, edges that the newest view saw past cut down to the wall ends that remain."""
    edges = [s for s in surfaces if s.kind == EDGE]
    points, normals, owner, start, stop = sample(*pack([s.polyline for s in edges]), SPACING)
    refuted = _refuted(points, normals, _slack(edges, owner, normals, view), view.panorama)
    length = np.bincount(owner[refuted], (stop - start)[refuted], minlength=len(edges))
    kept = [s for s, gone in zip(edges, length, strict=True) if gone < REFUTED_LENGTH]
    for i in np.flatnonzero(length >= REFUTED_LENGTH):
        edge, own = edges[i], owner == i
        middle = 0.5 * float(stop[own][-1])
        for a, b in uncovered_runs(refuted[own], start[own], stop[own], LEAST_LENGTH):
            anchor = edge.first if a + b <= 2.0 * middle else edge.second
            kept.append(edge._replace(kind=END, first=anchor, second=-1, polyline=cut(edge.polyline, a, b)))
    return kept + [s for s in surfaces if s.kind != EDGE]


def _trim(
    pieces: Sequence[_Surface], segments: FloatArray, distance: float, refuted_by: _View | None
) -> list[_Surface]:
    """The pieces without what segments (m, 4) cover, and without what a view saw to be free."""
    offsets, vertices = pack([s.polyline for s in pieces])
    points, normals, owner, start, stop = sample(offsets, vertices, SPACING)
    drop = covered(points, normals, segments, np.full(len(points), distance))
    if refuted_by is not None:
        slack = _slack(pieces, owner, normals, refuted_by)
        drop |= _refuted(points, normals, slack, refuted_by.panorama)
    first = np.searchsorted(owner, np.arange(len(pieces) + 1))
    trimmed = []
    for i, piece in enumerate(pieces):
        own = slice(first[i], first[i + 1])
        if not drop[own].any():
            trimmed.append(piece)
            continue
        for a, b in uncovered_runs(drop[own], start[own], stop[own], LEAST_LENGTH):
            a, b = max(a - OVERLAP, 0.0), min(b + OVERLAP, float(stop[own][-1]))
            trimmed.append(piece._replace(polyline=cut(piece.polyline, a, b)))
    return trimmed


def _slack(surfaces: Sequence[_Surface], owner: IntArray, normals: FloatArray, view: _View) -> FloatArray:
    """How far (n,), m along the normals, points on surfaces owner (n,), with normals (n, 2) in A, may have been mapped
    from where they would be seen now; none for surfaces without a landmark."""
    sigma = np.zeros(len(owner))
    normal = normals @ view.R_MA.T
    for side in ("first", "second"):
        ids = np.array([getattr(s, side) for s in surfaces], dtype=np.int64)[owner]
        anchored = ids >= 0
        C = view.drift[np.searchsorted(view.ids, ids[anchored])]
        variance = np.einsum("ni,nij,nj->n", normal[anchored], C, normal[anchored])
        sigma[anchored] = np.maximum(sigma[anchored], np.sqrt(np.maximum(variance, 0.0)))
    return np.asarray(DRIFT_SIGMAS * sigma)


def _refuted(points: FloatArray, normals: FloatArray, slack: FloatArray, panorama: Panorama) -> BoolArray:
    """Which points (n, 2) with unit normals (n, 2) in A the panorama saw past, in their bin and its neighbours, (n,).

    slack: (n,) m along the normals, by how much more than REFUTED_DEPTH. Surfaces nearly edge-on are let be: a thin
    wall shows nothing of itself there.
    """
    bins = len(panorama.ranges)
    reach = np.where(np.isinf(panorama.ranges), panorama.range_max, np.nan_to_num(panorama.ranges, posinf=0.0))
    least = np.min([np.roll(reach, k) for k in range(-REFUTED_BINS, REFUTED_BINS + 1)], axis=0)
    bearing = np.arctan2(points[:, 1], points[:, 0]) % (2.0 * np.pi)
    index = np.minimum((bearing * bins / (2.0 * np.pi)).astype(np.int64), bins - 1)
    distance = np.hypot(points[:, 0], points[:, 1])
    cosine = np.abs(np.sum(points * normals, axis=1)) / np.maximum(distance, 1e-9)
    broadside = cosine >= np.cos(REFUTED_INCIDENCE)
    return np.asarray(broadside & (cosine * (least[index] - REFUTED_DEPTH - distance) > slack))


def _segments(surfaces: Sequence[_Surface]) -> FloatArray:
    return segments_of(*pack([s.polyline for s in surfaces]))[0]


def _unpack(surfaces: Surfaces, vertices: FloatArray) -> list[_Surface]:
    offsets = surfaces.offsets.tolist()
    rows = zip(
        surfaces.kind.tolist(), surfaces.ids.tolist(), surfaces.goal.tolist(), surfaces.range.tolist(), strict=True
    )
    return [
        _Surface(kind, first, second, goal, farthest, vertices[offsets[i] : offsets[i + 1]])
        for i, (kind, (first, second), goal, farthest) in enumerate(rows)
    ]


def _pack(surfaces: Sequence[_Surface], estimate: MapEstimate, X_MA: FloatArray) -> Surfaces:
    """Back from the newest goal's frame to the coordinates of each kind: the inverse of place."""
    offsets, vertices = pack([s.polyline for s in surfaces])
    anchors = [(s.kind, s.goal) for s in surfaces]
    kind, goal = np.array(anchors, dtype=np.int64).reshape(-1, 2).T
    ids = np.array([(s.first, s.second) for s in surfaces], dtype=np.int64).reshape(-1, 2)
    packed = Surfaces(kind, ids, goal, np.array([s.range for s in surfaces]), offsets, vertices)
    count = np.diff(offsets)
    kinds = np.repeat(kind, count)
    theta = np.repeat(estimate.X_MA[goal, 2], count)
    origin = np.repeat(_anchors(packed, estimate), count, axis=0)
    span = np.repeat(_positions(ids[:, 1], estimate), count, axis=0) - origin
    x = np.where(kinds == EDGE, span[:, 0], np.cos(theta))
    y = np.where(kinds == EDGE, span[:, 1], np.sin(theta))
    offset = transform(X_MA, vertices) - origin
    square = x * x + y * y
    local = np.stack([x * offset[:, 0] + y * offset[:, 1], x * offset[:, 1] - y * offset[:, 0]], axis=1)
    return Surfaces(kind, ids, goal, packed.range, offsets, local / square[:, None])
