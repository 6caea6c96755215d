"""The openings of the known free space: its edges without a surface, and the reason why each was left."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from tfg_drake.config import NODE_MARGIN, RobotConfig, TagSensorConfig
from tfg_drake.geometry.distance import clearance
from tfg_drake.geometry.star import inside_any
from tfg_drake.messages import BoolArray, FloatArray, IntArray, Roadmap, TfgMap, message, replace
from tfg_drake.planning.mission_end import SHUT, hindrances

# Side of a grid cell, m, larger if the grid would have more than MOST_CELLS.
CELL, MOST_CELLS = 0.025, 1_000_000
# Edges within BESIDE_SURFACE, m, of a surface belong to it; edges shorter than LEAST_EDGE, m, lie between two rays.
BESIDE_SURFACE, LEAST_EDGE = 0.08, 0.05
# Resolution of a way's room, m; it is computed up to MOST_MARGIN, m, above the robot's radius.
ROOM_STEP, MOST_MARGIN = 0.01, 0.15
# The unknown behind an opening is measured up to REACH, m, away, on cells with side COARSE, m.
REACH, COARSE = 4.0, 0.05
# A frontier point within this distance of an opening's end, m, is part of it.
SAME_OPENING = 0.8
# Why an opening is left, the rows of Openings.why.
WHY = (
    "not worth the way",
    "tried in vain",
    "where the robot must not enter",
    "behind a door that shut",
    "too narrow for the uncertainty of the map",
    "too narrow for the robot",
)
NOT_WORTH, IN_VAIN, KEPT_OUT, BEHIND_DOOR, TOO_UNCERTAIN, TOO_NARROW = range(len(WHY))


@message
class Openings:
    """Edges of the known free space without a surface.

    p: (o, 2) the middle of each, m in M. width: (o,) m from end to end. room: (o,) m to either side on the widest way
    there through known free space. need: (o,) m, the room that the robot needs by its deviation there. unknown: (o,)
    m^2, the largest unknown region behind it, within REACH, with room for the robot. why: (o,) row of WHY.
    """

    p: Annotated[FloatArray, "o", 2]
    width: Annotated[FloatArray, "o"]
    room: Annotated[FloatArray, "o"]
    need: Annotated[FloatArray, "o"]
    unknown: Annotated[FloatArray, "o"]
    why: Annotated[IntArray, "o"]

    @property
    def missing(self) -> FloatArray:
        """The missing room (o,), m to either side, on the way to each; 0 if it suffices."""
        return np.where(self.why >= TOO_UNCERTAIN, np.maximum(self.need - self.room, ROOM_STEP), 0.0)


def find_openings(
    tfg: TfgMap, roadmap: Roadmap, p_MB: FloatArray, robot: RobotConfig, sensor: TagSensorConfig
) -> Openings:
    """Return the openings of a map with its roadmap. p_MB: (2,) place of the robot, m in M."""
    low, high = (of(tfg.star_vertices, axis=0) for of in (np.min, np.max))
    cell = max(CELL, float(np.sqrt(np.prod(high - low + 2.0 * REACH) / MOST_CELLS)))
    x, y = (np.arange(low[i] - REACH, high[i] + REACH, cell) for i in range(2))
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    free = inside_any(points, tfg.star_offsets, tfg.star_vertices).reshape(len(y), len(x))
    points, most = np.hstack([points, points]), robot.radius + MOST_MARGIN
    beside_surfaces = clearance(points, tfg.segments, most).reshape(free.shape)
    start = int((p_MB[1] - y[0]) / cell), int((p_MB[0] - x[0]) / cell)
    anywhere = widest = _widest(free, beside_surfaces, start)
    if len(tfg.keep_out):
        beside_areas = clearance(points, tfg.keep_out, most).reshape(free.shape)
        widest = _widest(free, np.minimum(beside_surfaces, beside_areas), start)
    step = max(1, round(COARSE / cell))
    enterable = ndimage.distance_transform_edt(~free[::step, ::step]) * step * cell >= robot.radius
    enterable &= beside_surfaces[::step, ::step] >= robot.radius
    rows = []
    for r, c in _edges(free, beside_surfaces >= BESIDE_SURFACE):
        length = float(np.hypot(np.ptp(r), np.ptp(c))) * cell
        if length >= LEAST_EDGE:
            middle = int(np.argmin(np.hypot(r - r.mean(), c - c.mean())))
            behind = _behind(enterable, r // step, c // step, robot.radius, step * cell)
            room = widest[r, c].max(), anywhere[r, c].max()
            rows.append([x[c[middle]], y[r[middle]], length + 2.0 * BESIDE_SURFACE, *room, behind])
    found = np.array(rows).reshape(-1, 6)
    p, width, room, room_anywhere, behind = found[:, :2], *found[:, 2:].T
    need = np.full(len(p), robot.radius + NODE_MARGIN)
    if len(roadmap.need) and len(p):
        need = np.minimum(roadmap.need[cKDTree(roadmap.points).query(p)[1]], most)
    has_shut = hindrances(tfg, roadmap, sensor, robot.radius) == SHUT
    why = np.where(room >= robot.radius + NODE_MARGIN - ROOM_STEP, TOO_UNCERTAIN, TOO_NARROW)
    why[_at(p, width, tfg.frontiers[has_shut])] = BEHIND_DOOR
    why[room_anywhere >= need - ROOM_STEP] = KEPT_OUT
    open_to = room >= need - ROOM_STEP
    why[open_to] = np.where(_at(p, width, tfg.given_up), IN_VAIN, NOT_WORTH)[open_to]
    return Openings(p, width, room, need, behind, why)


def with_seen_before(tfg: TfgMap, before: TfgMap) -> TfgMap:
    """Return a TFG with the free space of an earlier session in the same frame M, and with the surfaces of that session
    that do not lie in the newer free space."""
    middle = 0.5 * (before.segments[:, :2] + before.segments[:, 2:])
    stays = ~inside_any(middle, tfg.star_offsets, tfg.star_vertices)
    return replace(
        tfg,
        segments=np.vstack([tfg.segments, before.segments[stays]]),
        segment_kind=np.append(tfg.segment_kind, before.segment_kind[stays]),
        segment_ids=np.vstack([tfg.segment_ids, before.segment_ids[stays]]),
        star_offsets=np.append(tfg.star_offsets, tfg.star_offsets[-1] + before.star_offsets[1:]),
        star_vertices=np.vstack([tfg.star_vertices, before.star_vertices]),
        star_centers=np.vstack([tfg.star_centers, before.star_centers]),
    )


def _edges(free: BoolArray, off_surface: BoolArray) -> list[tuple[IntArray, IntArray]]:
    """Return rows and columns of the cells of each edge of the free cells (h, w) that is off all surfaces (h, w) on
    either side."""
    border = free & off_surface & ndimage.binary_dilation(~free & off_surface)
    # Two parts with one cell between them are one edge.
    label, _ = ndimage.label(ndimage.binary_dilation(border, np.ones((3, 3))), np.ones((3, 3)))
    row, column = np.nonzero(border)
    order, ends = np.argsort(label[row, column], kind="stable"), np.cumsum(np.bincount(label[row, column]))
    return [(row[some], column[some]) for some in np.split(order, ends[:-1]) if len(some)]


def _widest(free: BoolArray, room: FloatArray, start: tuple[int, int]) -> FloatArray:
    """Return the room (h, w), m, on the widest way from a cell to each other, in steps of ROOM_STEP; 0 without a
    way."""
    widest, near = np.zeros(free.shape), tuple(slice(max(0, at - 3), at + 4) for at in start)
    for level in np.arange(ROOM_STEP, room.max(), ROOM_STEP):
        label, _ = ndimage.label(free & (room >= level), np.ones((3, 3)))
        here = label[near].ravel()
        if not here.any():
            break
        widest[label == here[here > 0][0]] = level
    return widest


def _behind(enterable: BoolArray, row: IntArray, column: IntArray, radius: float, cell: float) -> float:
    """Return the area, m^2, of the largest region within REACH that a disc of a radius, m, sweeps with its centre in
    enterable (h, w) cells and that touches some of the cells (k,)."""
    reach, r, c = round(REACH / cell), int(row.mean()), int(column.mean())
    top, left = max(0, r - reach), max(0, c - reach)
    label, _ = ndimage.label(enterable[top : r + reach + 1, left : c + reach + 1])
    row, column = row - top, column - left
    inside = (row >= 0) & (row < label.shape[0]) & (column >= 0) & (column < label.shape[1])
    elsewhere = np.ones(label.shape, dtype=np.bool_)
    elsewhere[row[inside], column[inside]] = False
    touched = np.unique(label[ndimage.distance_transform_edt(elsewhere) * cell <= radius + 1.5 * cell])
    swept = [np.count_nonzero(ndimage.distance_transform_edt(label != one) * cell <= radius) for one in touched if one]
    return max(swept, default=0) * cell**2


def _at(p: FloatArray, width: FloatArray, points: FloatArray) -> BoolArray:
    """Return a mask of the openings (o,), with middle (o, 2) and width (o,), m, that contain some of the points (k, 2),
    m."""
    if not len(points):
        return np.zeros(len(p), dtype=np.bool_)
    return np.asarray(cKDTree(points).query(p)[0] <= 0.5 * width + SAME_OPENING)
