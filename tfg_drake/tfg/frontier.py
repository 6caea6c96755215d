"""Frontiers: places where free space ends at the unknown, not at a surface.

They lie along the shadow edges and maximum-range arcs of every view's star polygon, a little inside the unknown, and
along faces of surfaces that no turn has seen, or none well enough to find a tag there. All are stored in the frame A of
a view, so that they move with the map.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.config import TagSensorConfig
from tfg_drake.geometry.distance import clearance, enter
from tfg_drake.geometry.star import inside_any, inspected
from tfg_drake.geometry.turned import turned
from tfg_drake.messages import BoolArray, FloatArray, IntArray, message, replace
from tfg_drake.table import concat
from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.polyline import covered, joined, sample, segments_of, uncovered_runs
from tfg_drake.tfg.stars import Stars
from tfg_drake.tfg.surfaces import ON_SURFACE

# Frontier points lie PUSH, m, beyond a shadow edge or maximum-range arc, SPACING, m, apart. Points of two views within
# PUSH of each other are one.
PUSH = 0.35
SPACING = 0.4
# A frontier point needs a line to it, uncut by surfaces, from ROOT, m, on the free side of its edge; a face must have
# been seen from ROOT in front of it.
ROOT = 0.2
# A frontier point must be visible past the end of a surface by more than this, m, as a gap between two rays may hide
# it.
GRAZE = 0.1
# Spacing of the samples of faces, m, and distance of a face's frontier points in front of it, m.
FACE_SPACING = 0.1
STANDOFF = 0.3
# If another surface is opposite within NARROW, m, frontier points lie at the share NARROW_SHARE of their distance:
# otherwise a robot between the two surfaces could never see them from in front.
NARROW = 1.0
NARROW_SHARE = 1.0 / 3.0
# Shorter pieces of a face are ignored, m.
LEAST_FACE = 0.25
# A surface with free space within this distance behind it, m, is a thin wall.
THIN_WALL = 0.25
# A surface that ends farther than this from all others, m, continues around a corner; its frontier point stands for
# this length.
END_GAP = 0.15
# Kinds of frontier points: the unknown beyond free space; a face that no view has seen; a face that no view has seen
# well enough to detect a tag.
FREE, UNSEEN, POORLY_SEEN = range(3)


@message
class FrontierPoints:
    """Frontier points in views' frames, or all in one frame.

    view: (f,) the view of the frame A. p: (f, 2) m. normal: (f, 2) unit vectors from the unknown back to the view; for
    a face its normal. length: (f,) m. kind: (f,) FREE, UNSEEN or POORLY_SEEN. tries: (f,) number of views that have
    tried it in vain.
    """

    view: Annotated[IntArray, "f"]
    p: Annotated[FloatArray, "f", 2]
    normal: Annotated[FloatArray, "f", 2]
    length: Annotated[FloatArray, "f"]
    kind: Annotated[IntArray, "f"]
    tries: Annotated[IntArray, "f"]

    @property
    def on_face(self) -> BoolArray:
        """Mask of the points (f,) that stand for a face."""
        return np.asarray(self.kind != FREE)


def points_of(
    view: int | IntArray, p: FloatArray, normal: FloatArray, length: FloatArray, kind: int = FREE
) -> FrontierPoints:
    """Points (f, 2), normals (f, 2) and lengths (f,) of one kind in the frame of one view, or of each its own (f,)."""
    n = len(p)
    return FrontierPoints(np.full(n, view), p, normal, length, np.full(n, kind), np.zeros(n, dtype=np.int64))


def place_points(points: FrontierPoints, X_MA: FloatArray) -> FrontierPoints:
    """Return the points in the map frame, with the views' poses X_MA (k, 3)."""
    pose = X_MA[points.view]
    p, normal = pose[:, :2] + turned(points.p, pose[:, 2]), turned(points.normal, pose[:, 2])
    return replace(points, p=p, normal=normal)


def find_frontiers(panorama: Panorama, links: BoolArray, least_gap: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the frontier points of one panorama in A: p (f, 2), m, normal (f, 2) and length (f,), m.

    links: (b,) mask of bins that saw the same surface as the next one. least_gap: shorter shadow edges (m) are ignored,
    as the robot does not fit through.
    """
    angles, ranges = panorama.angles, panorama.ranges
    free = np.isinf(ranges)
    reach = np.where(free, panorama.range_max, ranges)
    ends = reach[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    following = np.roll(ends, -1, axis=0)
    span = following - ends
    length = np.hypot(span[:, 0], span[:, 1])
    both_free = free & np.roll(free, -1)
    known = ~np.isnan(ranges) & ~np.isnan(np.roll(ranges, -1))

    shadow = known & ~links & ~both_free & (length >= least_gap)
    # Behind the nearer surface, whichever end it is at: to the right of the edge, which runs counter-clockwise.
    right = np.stack([span[:, 1], -span[:, 0]], axis=1) / np.maximum(length, 1e-9)[:, None]
    p, normal, length = _along(ends[shadow], following[shadow], right[shadow])

    starts, stops = _runs(both_free & known)
    arc_p, arc_normal, arc_length = [p], [normal], [length]
    for a, b in zip(starts, stops, strict=True):
        first = angles[a % len(angles)]
        sweep = (b - a) * 2.0 * np.pi / len(angles)
        count = max(1, round(sweep * panorama.range_max / SPACING))
        theta = first + (np.arange(count) + 0.5) / count * sweep
        outwards = np.stack([np.cos(theta), np.sin(theta)], axis=1)
        arc_p.append((panorama.range_max + PUSH) * outwards)
        arc_normal.append(-outwards)
        arc_length.append(np.full(count, sweep * panorama.range_max / count))
    # On the border of what was never looked at, on that side of it: what is free there may go on.
    seen = ~np.isnan(ranges)
    for sign in (1, -1):
        last = np.flatnonzero(seen & np.roll(~seen, -sign))
        beyond = sign * np.stack([-ends[last, 1], ends[last, 0]], axis=1) / np.maximum(reach[last], 1e-9)[:, None]
        p, normal, length = _along(np.zeros_like(ends[last]), ends[last], beyond)
        arc_p.append(p)
        arc_normal.append(normal)
        arc_length.append(length)
    return np.concatenate(arc_p), np.concatenate(arc_normal), np.concatenate(arc_length)


def _along(start: FloatArray, stop: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points (n, 2) every SPACING along edges from start to stop (e, 2), m, pushed by PUSH in each edge's direction
    (e, 2); normals (n, 2) against that, and the length (n,), m, that each stands for."""
    whole = np.hypot(*(stop - start).T)
    edge, place, length = _divided(whole)
    fraction = place * length / np.maximum(whole, 1e-9)[edge]
    p = start[edge] + fraction[:, None] * (stop - start)[edge] + PUSH * direction[edge]
    return p, -direction[edge], length


def _divided(length: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Lengths (n,), m, in parts of about SPACING: the length (k,) that each is part of, the middle (k,) of the part, in
    parts from its beginning, and how long it is (k,), m."""
    count = np.maximum(1, np.round(length / SPACING).astype(np.int64))
    of = np.repeat(np.arange(len(count)), count)
    place = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count) + 0.5
    return of, place, (length / count)[of]


def _runs(flags: BoolArray) -> tuple[IntArray, IntArray]:
    """Circular runs of true flags (n,): where each starts, and where it stops, beyond n where it wraps round."""
    n = len(flags)
    if flags.all():
        return np.array([0]), np.array([n])
    if not flags.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    starts = np.flatnonzero(flags & ~np.roll(flags, 1))
    stops = np.flatnonzero(flags & ~np.roll(flags, -1)) + 1
    if stops[0] <= starts[0]:
        stops = np.append(stops[1:], stops[0] + n)
    return starts, stops


def find_faces(
    view: IntArray, offsets: IntArray, vertices: FloatArray, stars: Stars, tags: TagSensorConfig
) -> FrontierPoints:
    """Return frontier points in front of faces of surfaces that no view has seen, or none well enough to find a tag.

    A view sees a face well if its star contains the space in front of it, near enough and not too oblique for the tag
    sensor. Free space right behind a surface means a thin wall; if no surface faces that space, the far face has not
    been seen. offsets, vertices: all surfaces, packed, m in M like the stars and the points; view: (s,) that saw each,
    also used for its points.
    """
    points, normals, owner, start, stop = sample(offsets, vertices, FACE_SPACING)
    segments, _ = segments_of(offsets, vertices)
    front = in_front(points, normals, segments, ROOT)
    poorly = ~inspected(front, normals, *stars, tags.range, tags.max_incidence)
    unseen = inside_any(points - THIN_WALL * normals, *stars.polygons)
    unseen &= ~covered(points, -normals, segments, np.full(len(points), THIN_WALL))
    faces = []
    for which, outwards, kind in ((poorly, normals, POORLY_SEEN), (unseen, -normals, UNSEEN)):
        rows, length = _parts(owner, start, stop, which)
        p = in_front(points[rows], outwards[rows], segments, STANDOFF)
        faces.append(points_of(view[owner[rows]], p, outwards[rows], length, kind))
    ends, normal, of = find_open_ends(offsets, vertices, stars.polygons)
    return concat(*faces, points_of(view[of], ends, normal, np.full(len(ends), SPACING), UNSEEN))


def _parts(owner: IntArray, start: FloatArray, stop: FloatArray, which: BoolArray) -> tuple[IntArray, FloatArray]:
    """The stretches that some (n,) of the samples of polylines make, see `sample`, but for short ones, in parts of
    about SPACING: the sample in the middle of each (k,), and its length (k,), m."""
    run, begin, end = uncovered_runs(owner, ~which, start, stop, LEAST_FACE)
    of, place, length = _divided(end - begin)
    most = stop.max(initial=1.0)
    middle = np.searchsorted(owner + start / most, run[of] + (begin[of] + place * length) / most, side="right") - 1
    return middle, length


def find_open_ends(
    offsets: IntArray, vertices: FloatArray, stars: tuple[IntArray, FloatArray]
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return points (u, 2) in front of faces of which only the corner has been seen, normals (u, 2), and the surface
    (u,) of each.

    There a surface ends in the open: no other one continues it, but the space behind it is free. offsets, vertices: all
    surfaces, packed, m. stars: as in `tfg_drake.geometry.star.inside_any`, in the same frame.
    """
    at = np.concatenate([vertices[offsets[:-1]], vertices[offsets[1:] - 1]])
    before = np.concatenate([vertices[offsets[:-1] + 1], vertices[offsets[1:] - 2]])
    owner = np.tile(np.arange(len(offsets) - 1), 2)
    is_last = np.repeat([False, True], len(offsets) - 1)
    along = at - before
    along /= np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)[:, None]
    segments, segment_owner = segments_of(offsets, vertices)
    is_open = ~joined(at, along, is_last, owner, segments, segment_owner, END_GAP)
    at, along, is_last, owner = at[is_open], along[is_open], is_last[is_open], owner[is_open]
    # Behind the surface is on its right, which is on the left of the way back to its start.
    behind = np.where(is_last, 1.0, -1.0)[:, None] * np.stack([along[:, 1], -along[:, 0]], axis=1)
    points = at + STANDOFF * along + END_GAP * behind
    is_open = inside_any(points, *stars)
    # The other face of a thin wall is not round the corner but behind: see find_faces.
    is_open[is_open] = ~inside_any((at - END_GAP * along + THIN_WALL * behind)[is_open], *stars)
    points, along, at, owner = points[is_open], along[is_open], at[is_open], owner[is_open]
    cut_off = clearance(np.hstack([at + 1e-3 * along, points]), segments, 1e-6) == 0.0
    is_open = ~cut_off & _off_surface(points, segments)
    return points[is_open], along[is_open], owner[is_open]


def in_front(p: FloatArray, normal: FloatArray, segments: FloatArray, distance: float) -> FloatArray:
    """Return points (n, 2) at a distance (m) in front of surface points p (n, 2) with unit normals (n, 2), nearer in
    narrow places. segments: (m, 4) all surfaces, their fronts on the left, in the same frame, m."""
    # Their own surface may have been mapped again a little nearer: its front is not opposite.
    narrow = enter(np.hstack([p + NARROW_SHARE * distance * normal, p + NARROW * normal]), segments)
    return np.asarray(p + np.where(narrow, NARROW_SHARE, 1.0)[:, None] * distance * normal)


def open_frontiers(points: FrontierPoints, segments: FloatArray) -> BoolArray:
    """Return a mask (f,) of the frontier points that no surface runs through or separates from the free side.

    points and segments (m, 4) in one frame.
    """
    # Where little is seen through a gap, the line begins behind the surface on the other side of it: that one does not
    # cut it off.
    lines = np.hstack([points.p + (PUSH + ROOT) * points.normal, points.p])
    return np.asarray(~enter(lines, segments) & _off_surface(points.p, segments))


def _off_surface(p: FloatArray, segments: FloatArray) -> BoolArray:
    """Return a mask (f,) of the points p (f, 2) that no surface (m, 4) runs through."""
    return np.asarray(clearance(np.hstack([p, p]), segments, ON_SURFACE) >= ON_SURFACE)


def far_from(p: FloatArray, others: FloatArray, distance: float) -> BoolArray:
    """Return a mask (n,) of the points (n, d) with none of the others (m, d) within a distance."""
    return np.asarray(cKDTree(others).query(p)[0] > distance)


def tried_like(points: FrontierPoints, before: FrontierPoints, distance: float) -> FrontierPoints:
    """Return the points with the tries of the nearest earlier point, in the same frame, within a distance."""
    _, nearest = cKDTree(before.p).query(points.p, distance_upper_bound=distance)
    return replace(points, tries=np.append(before.tries, 0)[nearest])
