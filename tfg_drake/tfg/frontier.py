"""Frontiers: where a turn's free space ends at the unknown, not at a surface.

They lie along the shadow edges and maximum-range arcs of every view's star polygon, a little inside the unknown, and
along surfaces that no turn has seen well enough to have found a tag there. All are kept in the frame A of the view
that saw them, so that they move with the map.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from tfg_drake.geometry.connected import component_labels, connect
from tfg_drake.geometry.distance import clearance, enter
from tfg_drake.geometry.segment_grid import rows_in_box, segment_grid
from tfg_drake.geometry.star import inside_any
from tfg_drake.geometry.turned import turned
from tfg_drake.messages import BoolArray, FloatArray, IntArray, message
from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.polyline import covered, joined, sample, segments_of
from tfg_drake.tfg.segmentation import Components

# How far beyond a shadow edge or maximum-range arc a frontier point lies, m, and their spacing, m.
PUSH = 0.35
SPACING = 0.4
# How far on the free side of the edge the line to a frontier point begins that no surface may cut, m.
ROOT = 0.2
# A frontier point this close to a surface is part of it, m.
SURFACE_DISTANCE = 0.1
# Past one end of a surface it must be seen by more than this, m: what lies between the last two rays may hide it.
GRAZE = 0.1
# Spacing of the points of uninspected surface, m, how far in front of it they must have been seen from, m, and how
# far in front of it their frontier points lie, m.
UNINSPECTED_SPACING = 0.1
UNINSPECTED_LIFT = 0.2
UNINSPECTED_STANDOFF = 0.3
# Where another surface lies opposite, nearer than this, m, the two are this share of that: a robot between the two
# would stand nearer to a surface than its frontier points, and could never look at them from in front.
NARROW = 1.0
NARROW_SHARE = 1.0 / 3.0
# Shorter stretches of uninspected surface are let be, m; points this close make one stretch, m.
UNINSPECTED_LENGTH = 0.25
UNINSPECTED_GAP = 0.16
# Points with normals whose cosine is more than this lie on one face.
SAME_NORMAL = 0.7
# Free space this close behind a surface means a thin wall, m.
THIN_WALL = 0.25
# A surface that ends farther than this from every other one goes on round a corner, m; how much of it is unseen, m.
END_GAP = 0.15
END_LENGTH = 0.4
# A point of two views' frontiers counts once within this distance, m.
SAME_FRONTIER = 0.35


@message
class FrontierPoints:
    """Points kept in views' frames, or all placed in one frame.

    view: (f,) whose frame A. p: (f, 2) m. normal: (f, 2) unit vectors from the unknown back to where it was seen from;
    for uninspected surface the surface's normal on its free side. length: (f,) m. on_surface: (f,) whether it stands
    for uninspected surface.
    """

    view: Annotated[IntArray, "f"]
    p: Annotated[FloatArray, "f", 2]
    normal: Annotated[FloatArray, "f", 2]
    length: Annotated[FloatArray, "f"]
    on_surface: Annotated[BoolArray, "f"]


def points_of(view: int, p: FloatArray, normal: FloatArray, length: FloatArray) -> FrontierPoints:
    """Points (f, 2), normals (f, 2) and lengths (f,) in the frame of one view."""
    return FrontierPoints(np.full(len(p), view, dtype=np.int64), p, normal, length, np.zeros(len(p), dtype=bool))


def place_points(points: FrontierPoints, X_MA: FloatArray) -> FrontierPoints:
    """The points in the map frame, with the views' poses X_MA (k, 3)."""
    pose = X_MA[points.view]
    p, normal = pose[:, :2] + turned(points.p, pose[:, 2]), turned(points.normal, pose[:, 2])
    return FrontierPoints(points.view, p, normal, points.length, points.on_surface)


def find_frontiers(panorama: Panorama, links: BoolArray, least_gap: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frontier points of one panorama in A: p (f, 2), m, normal (f, 2) and length (f,), m.

    links: (b,) whether a bin and the next one saw the same surface. least_gap: shadow edges shorter than this (m) are
    let be: the robot does not fit through.
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
    length = np.hypot(*(stop - start).T)
    count = np.maximum(1, np.round(length / SPACING).astype(np.int64))
    edge = np.repeat(np.arange(len(count)), count)
    fraction = (np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count) + 0.5) / count[edge]
    p = start[edge] + fraction[:, None] * (stop - start)[edge] + PUSH * direction[edge]
    return p, -direction[edge], (length / count)[edge]


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


def find_uninspected(components: Components, max_range: float, max_incidence: float) -> tuple[FloatArray, FloatArray]:
    """Points (u, 2) and normals (u, 2) in A on surfaces seen too far off or too slantwise to find a tag there.

    max_range: m and max_incidence: rad, as far as the tag sensor sees.
    """
    points, normals, _, _, _ = sample(components.offsets, components.vertices, UNINSPECTED_SPACING)
    distance = np.hypot(points[:, 0], points[:, 1])
    facing = -np.sum(points * normals, axis=1)
    poor = (distance > max_range) | (facing < np.cos(max_incidence) * distance)
    return points[poor], normals[poor]


def find_unseen_backs(
    offsets: IntArray, vertices: FloatArray, stars: tuple[IntArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Points (u, 2) and normals (u, 2) of the faces of thin walls that no turn has seen, only the other face.

    Free space begins right behind such a wall, but no surface faces it. offsets, vertices: all surfaces, packed, m.
    stars: as in `tfg_drake.geometry.star.inside_any`, in the same frame.
    """
    points, normals, _, _, _ = sample(offsets, vertices, UNINSPECTED_SPACING)
    segments, _ = segments_of(offsets, vertices)
    faced = covered(points, -normals, segments, np.full(len(points), THIN_WALL))
    points, normals = points[~faced], -normals[~faced]
    free = inside_any(points + THIN_WALL * normals, *stars)
    return points[free], normals[free]


def find_open_ends(
    offsets: IntArray, vertices: FloatArray, stars: tuple[IntArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Points (u, 2) in front of faces that no turn has seen, only the corner where they begin, and normals (u, 2).

    There a surface ends in the open: no other one goes on, but what lies behind it is free. offsets, vertices: all
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
    at, along, is_last = at[is_open], along[is_open], is_last[is_open]
    # Behind the surface is on its right, which is on the left of the way back to its start.
    behind = np.where(is_last, 1.0, -1.0)[:, None] * np.stack([along[:, 1], -along[:, 0]], axis=1)
    points = at + UNINSPECTED_STANDOFF * along + END_GAP * behind
    is_open = inside_any(points, *stars)
    # The other face of a thin wall is not round the corner but behind: see find_unseen_backs.
    is_open[is_open] = ~inside_any((at - END_GAP * along + THIN_WALL * behind)[is_open], *stars)
    points, along, at = points[is_open], along[is_open], at[is_open]
    cut_off = clearance(np.hstack([at + 1e-3 * along, points]), segments, 1e-6) == 0.0
    is_open = ~cut_off & _off_surface(points, segments)
    return points[is_open], along[is_open]


def in_front(p: FloatArray, normal: FloatArray, segments: FloatArray, distance: float) -> FloatArray:
    """Points (n, 2) a distance (m) in front of surface points p (n, 2) with unit normals (n, 2), nearer in a narrow
    place. segments: (m, 4) all surfaces, their fronts on the left, in the same frame, m."""
    # Their own surface may have been mapped again a little nearer: its front is not opposite.
    narrow = enter(np.hstack([p + NARROW_SHARE * distance * normal, p + NARROW * normal]), segments)
    return np.asarray(p + np.where(narrow, NARROW_SHARE, 1.0)[:, None] * distance * normal)


def uninspected_frontiers(points: FrontierPoints) -> FrontierPoints:
    """Points on the longer stretches of uninspected surface, all in the frame of the points."""
    first, p, normal, length = _stretches(np.array(points.p), np.array(points.normal))
    return FrontierPoints(points.view[first], p, normal, length, np.ones(len(first), dtype=np.bool_))


@njit(cache=True)
def _stretches(p: FloatArray, normal: FloatArray) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Points p (n, 2) with unit normals (n, 2) that hang together on one face, every stretch but the short ones cut
    into parts of about SPACING: of each part its first point's row (k,), the means (k, 2), (k, 2), its length (k,), m.
    """
    n = len(p)
    face, grid, near = np.arange(n), segment_grid(np.hstack((p, p))), np.empty(n, dtype=np.int64)
    for i in range(n):
        x, y, gap = p[i, 0], p[i, 1], UNINSPECTED_GAP
        for k in range(rows_in_box(grid, x - gap, x + gap, y - gap, y + gap, near)):
            j = near[k]
            same_face = normal[i, 0] * normal[j, 0] + normal[i, 1] * normal[j, 1] > SAME_NORMAL
            if j < i and same_face and (p[j, 0] - x) ** 2 + (p[j, 1] - y) ** 2 <= gap * gap:
                connect(face, i, j)
    component_labels(face)
    row, mean_p, mean_normal = np.empty(n, dtype=np.int64), np.zeros((n, 2)), np.zeros((n, 2))
    lengths = np.empty(n)
    count = 0
    for start in range(n):
        if face[start] != start:
            continue
        members = np.flatnonzero(face == start)
        mx, my = normal[members, 0].sum() / len(members), normal[members, 1].sum() / len(members)
        size = max(math.hypot(mx, my), 1e-9)
        along = np.dot(p[members], np.array([-my / size, mx / size]))
        # By extent, not by count: two views may have placed the same stretch a little differently.
        length = along.max() - along.min() + UNINSPECTED_SPACING
        if length < UNINSPECTED_LENGTH:
            continue
        parts = max(1, round(length / SPACING))
        part = np.minimum((parts * (along - along.min()) / length).astype(np.int64), parts - 1)
        for k in range(parts):
            of_part = members[part == k]
            if len(of_part) == 0:
                continue
            for i in of_part:
                mean_p[count] += p[i]
                mean_normal[count] += normal[i]
            mean_p[count] /= len(of_part)
            mean_normal[count] /= len(of_part)
            mean_normal[count] /= max(math.hypot(mean_normal[count, 0], mean_normal[count, 1]), 1e-9)
            row[count], lengths[count] = of_part[0], length / parts
            count += 1
    return row[:count], mean_p[:count], mean_normal[:count], lengths[:count]


def open_frontiers(points: FrontierPoints, segments: FloatArray) -> BoolArray:
    """Which frontier points no surface explains, (f,): none runs through them, none cuts them off from the free side.

    points and segments (m, 4) in one frame.
    """
    # Where little is seen through a gap, the line begins behind the surface on the other side of it: that one does not
    # cut it off.
    lines = np.hstack([points.p + (PUSH + ROOT) * points.normal, points.p])
    return np.asarray(~enter(lines, segments) & _off_surface(points.p, segments))


def _off_surface(p: FloatArray, segments: FloatArray) -> BoolArray:
    """Which points p (f, 2) no surface (m, 4) runs through, (f,)."""
    return np.asarray(clearance(np.hstack([p, p]), segments, SURFACE_DISTANCE) >= SURFACE_DISTANCE)


def far_from(p: FloatArray, others: FloatArray, distance: float) -> BoolArray:
    """Which points (n, d) have none of the others (m, d) within distance, (n,)."""
    return np.asarray(cKDTree(others).query(p)[0] > distance)


def most_within(points: FloatArray, others: FloatArray, number: IntArray, distance: float) -> IntArray:
    """The largest number (n,) that any of the others (m, d), each with a number (m,), has within distance of each of
    the points (n, d); 0 where there is none."""
    most, tree = np.zeros(len(points), dtype=np.int64), cKDTree(points)
    for i in np.argsort(number):
        most[tree.query_ball_point(others[i], distance)] = number[i]
    return most
