"""The landmarks and frontier points that a full turn at a point is expected to see (numba kernels)."""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tfg_drake.config import TagSensorConfig
from tfg_drake.geometry.distance import crossed
from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.geometry.segment_grid import SegmentGrid, rows_in_box, segment_grid
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, TfgMap, is_tag
from tfg_drake.slam.scan_lines import SLANT
from tfg_drake.slam.walls import FLOOR, ends_of
from tfg_drake.table import taken
from tfg_drake.tfg.frontier import GRAZE

# A landmark lies on a piece of surface within this distance, m, the map's own error.
SURFACE_TOLERANCE = 0.1
# A wall's target is this far from its end, m, or a quarter of the wall, so that the next wall does not hide it.
FROM_CORNER = 0.2
# The share of the sensor's range within which a frontier point is visible, as the point lies a little inside the
# unknown.
FRONTIER_RANGE_SHARE = 0.9
# Margin of a frontier's incidence below the sensor's limit, rad.
FRONTIER_INCIDENCE_MARGIN = math.radians(5.0)


@dataclasses.dataclass(frozen=True)
class Visibility:
    """The targets that each of c points sees: point i sees index[offsets[i]:offsets[i + 1]], ascending.

    offsets: (c + 1,). index: rows of the targets.
    """

    offsets: IntArray
    index: IntArray

    @property
    def count(self) -> IntArray:
        """The number of targets seen from each point, (c,)."""
        return self.offsets[1:] - self.offsets[:-1]

    def of(self, points: IntArray) -> Visibility:
        """Return the visibility from some of the points, rows (k,)."""
        return Visibility(*taken(points, self.offsets, self.index))

    def spread(self, points: IntArray, count: int) -> Visibility:
        """Return the visibility from `count` points, of which these are the rows (k,), ascending; the others see
        nothing."""
        counts = np.zeros(count, dtype=np.int64)
        counts[points] = self.count
        return Visibility(np.append(0, np.cumsum(counts)), self.index)

    def kept(self, keep: BoolArray) -> Visibility:
        """Return the visibility without some of its entries. keep: one truth value for each entry of index."""
        point = np.repeat(np.arange(len(self.count)), self.count)[keep]
        count = np.bincount(point, minlength=len(self.count))
        return Visibility(np.append(0, np.cumsum(count)), self.index[keep])

    def joined(self, others: Visibility, rows: int) -> Visibility:
        """Return the joint visibility of these targets, `rows` of them, and of others after them, from the same
        points."""
        point = np.concatenate([np.repeat(np.arange(len(of.count)), of.count) for of in (self, others)])
        index = np.append(self.index, others.index + rows)[np.argsort(point, kind="stable")]
        return Visibility(self.offsets + others.offsets, index)

    def thinned(self, most: int) -> Visibility:
        """Return the visibility with at most `most` targets per point, evenly taken."""
        count = np.minimum(self.count, most)
        offsets = np.append(0, np.cumsum(count))
        place = np.arange(offsets[-1]) - np.repeat(offsets[:-1], count)
        row = np.repeat(self.offsets[:-1], count) + place * np.repeat(self.count, count) // np.repeat(count, count)
        return Visibility(offsets, self.index[row])


@read_only_arguments
@njit(cache=True)
def visible_targets(
    points: FloatArray,
    targets: FloatArray,
    normals: FloatArray,
    segments: FloatArray,
    grid: SegmentGrid,
    range_max: float,
    max_incidence: float,
    tolerance: float,
    graze: float,
    close: float,
) -> tuple[IntArray, IntArray]:
    """Return the targets within range and incidence with a line of sight, as (offsets (c + 1,), index).

    points: (c, 2), targets: (n, 2) and segments: (m, 4) in one frame, m. normals: (n, 2) unit vectors, the side from
    which each target can be seen. grid: the segment_grid of the segments. tolerance: length, m, by which lines of sight
    are shortened at the target. graze: m, targets that would be hidden if displaced this far to one side, but not to
    the other, do not count. close: m, within which a target is seen from anywhere in front of it, however obliquely.
    """
    cos_max = math.cos(max_incidence)
    offsets = np.zeros(len(points) + 1, dtype=np.int64)
    index = np.empty(256, dtype=np.int64)
    count, before = 0, -1
    target_grid, asked = segment_grid(np.hstack((targets, targets))), np.empty(len(targets), dtype=np.int64)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        for k in range(rows_in_box(target_grid, x - range_max, x + range_max, y - range_max, y + range_max, asked)):
            t = asked[k]
            dx, dy = targets[t, 0] - x, targets[t, 1] - y
            r = math.sqrt(dx * dx + dy * dy)
            if r > range_max or r == 0.0:
                continue
            ahead = -(dx * normals[t, 0] + dy * normals[t, 1])
            if ahead < cos_max * r and (r > close or ahead <= 0.0):
                continue
            share = max(0.0, 1.0 - tolerance / r)
            ex, ey = x + share * dx, y + share * dy
            # The segment that hid one target often hides the next and is tried first.
            hidden_by = crossed(x, y, ex, ey, segments, grid, before)
            before = hidden_by if hidden_by >= 0 else before
            clear = hidden_by < 0
            if clear and graze > 0.0:
                gx, gy = -graze * dy / r, graze * dx / r
                one = crossed(x, y, ex + gx, ey + gy, segments, grid, before)
                other = crossed(x, y, ex - gx, ey - gy, segments, grid, before)
                clear = (one < 0) == (other < 0)
            if clear:
                if count == len(index):
                    grown = np.empty(2 * count, dtype=np.int64)
                    grown[:count] = index
                    index = grown
                index[count] = t
                count += 1
        index[offsets[i] : count].sort()
        offsets[i + 1] = count
    return offsets, index[:count].copy()


def expected_tags(
    points: FloatArray, estimate: MapEstimate, tfg: TfgMap, sensor: TagSensorConfig, grid: SegmentGrid | None = None
) -> Visibility:
    """Return the known tags that a full turn at each point (c, 2), m in M, should see; index: rows of
    estimate.of_tags.ids.

    A tag is visible from the side that it was seen from, so those on the far face of a thin wall do not count.
    grid: the segment_grid of tfg.segments, if it is there.
    """
    surfaces, p_ML = (tfg.segments, grid or segment_grid(tfg.segments)), estimate.p_ML[is_tag(estimate.ids)]
    within = sensor.range, sensor.max_incidence, SURFACE_TOLERANCE
    return Visibility(*visible_targets(points, p_ML, tfg.facing, *surfaces, *within, 0.0, 0.0))


class Targets(NamedTuple):
    """The t points that represent a map's landmarks: a point near each end of a wall, then the tags.

    p_MT: (t, 2) m. facing: (t, 2) the side it was seen from. entry: (t,) index of its landmark among those jointly
    known, -1 for the others. by_landmark: (t, 2, 2) derivative of p_MT on the landmark. normal: (t, 2) of the wall,
    divided by the deviation of the distance along it that all looks of a turn share, 1/m in M; zero for a tag.
    """

    p_MT: FloatArray
    facing: FloatArray
    entry: IntArray
    by_landmark: FloatArray
    normal: FloatArray

    @property
    def of_walls(self) -> int:
        """The number of points of walls, which come first."""
        return int(np.count_nonzero(self.normal.any(axis=1)))

    def known_jointly(self, seen: Visibility) -> Visibility:
        """Return a visibility of targets without those whose landmarks are not jointly known."""
        return seen.kept(self.entry[seen.index] >= 0)


def targets(landmarks: MapEstimate, tfg: TfgMap) -> Targets:
    """Return the points that represent the landmarks of a map; tfg.facing is that of its tags."""
    walls = int(np.count_nonzero(~is_tag(landmarks.ids)))
    wall, reach = landmarks.p_ML[:walls], landmarks.reach[:walls]
    half = 0.5 * (reach[:, 1] - reach[:, 0])
    inwards = np.minimum(FROM_CORNER, 0.5 * half)
    reach = reach + inwards[:, None] * [1.0, -1.0]
    normal = np.column_stack([np.cos(wall[:, 0]), np.sin(wall[:, 0])])
    of_wall = normal[:, None, :, None] * np.stack([-reach, np.ones_like(reach)], axis=2)[:, :, None]
    deviation = np.hypot((half - inwards) * FLOOR[0], FLOOR[1])
    whitened, tags = normal / deviation[:, None], len(landmarks.ids) - walls
    entry = landmarks.local_entry
    return Targets(
        np.vstack([ends_of(wall, landmarks.anchor[:walls], reach).reshape(-1, 2), landmarks.p_ML[walls:]]),
        np.vstack([np.repeat(-normal, 2, axis=0), tfg.facing]),
        np.append(np.repeat(entry[:walls], 2), entry[walls:]),
        np.concatenate([of_wall.reshape(-1, 2, 2), np.tile(np.eye(2), (tags, 1, 1))]),
        np.vstack([np.repeat(whitened, 2, axis=0), np.zeros((tags, 2))]),
    )


def expected_walls(points: FloatArray, of: Targets, tfg: TfgMap, scan_range: float, grid: SegmentGrid) -> Visibility:
    """Return the wall points that the scans of a full turn at each point (c, 2), m in M, should see; index: rows of
    `of`.

    scan_range: m. grid: the segment_grid of tfg.segments.
    """
    p, facing = of.p_MT[: of.of_walls], of.facing[: of.of_walls]
    within = scan_range, math.acos(SLANT), SURFACE_TOLERANCE, 0.0, 0.0
    return Visibility(*visible_targets(points, p, facing, tfg.segments, grid, *within))


def expected_frontiers(
    points: FloatArray, tfg: TfgMap, sensor: TagSensorConfig, least_range: float = 0.0
) -> Visibility:
    """Return the frontier points that a full turn at each point (c, 2), m in M, looks through; index: rows of
    tfg.frontiers.

    The line of sight must pass the end of a surface by more than GRAZE (see
    `tfg_drake.geometry.visibility.surely_visible`). least_range: m, of the scanner.
    """
    surfaces = tfg.segments, segment_grid(tfg.segments)
    within = FRONTIER_RANGE_SHARE * sensor.range, sensor.max_incidence - FRONTIER_INCIDENCE_MARGIN, 0.0
    visible = Visibility(*visible_targets(points, tfg.frontiers, tfg.frontier_normal, *surfaces, *within, GRAZE, 0.0))
    if least_range == 0.0:
        return visible
    ways = tfg.frontiers[visible.index] - np.repeat(points, visible.count, axis=0)
    return visible.kept(np.hypot(ways[:, 0], ways[:, 1]) >= least_range)
