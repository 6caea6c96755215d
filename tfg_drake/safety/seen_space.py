"""Space seen to be free round the robot: a short memory of its scans, carried along by odometry.

What is not seen is not free. A ray that met something at a range, or nothing within the scanner's reach, says that the
way up to there is free; a ray that says nothing (nan) says nothing of any place. The memory is a square window of cells
round the robot, at rest in the odometry frame O. So the robot may drive through what it saw a moment ago and cannot see
now: a depth camera's blind zone, what lies beside its field of view, rays that were lost.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.geometry.se2 import inverse, transform
from tfg_drake.messages import BoolArray, FloatArray, IntArray, LaserScan, message
from tfg_drake.safety.corridor import touch_distance
from tfg_drake.safety.edge_on import may_stand

# Side of a cell, m: a chair's leg covers half of one, and rays of 1 degree meet each cell within 2 m.
CELL = 0.04
# Half of the window, cells: 0.96 m, beyond the way in which a base of 0.7 m/s stops and beyond most blind zones.
HALF = 24
CELLS = 2 * HALF
# What was seen is kept for this time, s, twice that of a full turn.
MEMORY = 10.0
# The same behind a base that drives backwards, as an error of the gyro of a hundredth moves what lies behind.
_MEMORY_BEHIND = 4.0
# A cell that more rays passed than met is stamped this much before the scan, s: it counts as remembered.
_HARDLY_OLDER = 1e-6
# Distance by which an object may extend beyond its return, m.
_REACHES = 0.6 * CELL
# Step along a ray, in cells; neighbouring rays cover the corners that it cuts.
_STEP = 0.75
# Fewer neighbouring rays without a return than this are lost; more may be an object in the blind zone.
_GAP = 3
# Rays up to _BESIDE apart whose ranges differ by at most _SAME_SURFACE, m, are on one surface, and a line through them
# removes most of the noise: memory would keep the nearest returns of a wall, which then seems to narrow a passage.
_BESIDE, _SAME_SURFACE = 3, 0.1
# Greatest distance by which an oblique surface may end nearer than its last ray, m.
_MOST_NEARER = 0.1
# The last piece of a ray, m, says nothing of free space, as its range is not exact.
_BEFORE_RETURN = 0.5 * CELL


@message
class SeenSpace:
    """The memory. corner: (2,) the window's lowest cell, in cells of O's axes. seen: (CELLS, CELLS) when each cell was
    seen last, s, -inf never; the cell (i, j) of O is at [i % CELLS, j % CELLS]. met: (CELLS, CELLS) something was there
    then, else it was free. p_OM: (CELLS, CELLS, 2) where it was, m.
    """

    corner: IntArray
    seen: FloatArray
    met: BoolArray
    p_OM: FloatArray


def nothing_seen() -> SeenSpace:
    """The memory before the first scan."""
    shape = (CELLS, CELLS)
    return SeenSpace(
        np.zeros(2, dtype=np.int64), np.full(shape, -np.inf), np.zeros(shape, dtype=np.bool_), np.zeros((*shape, 2))
    )


def remembered(space: SeenSpace, scan: LaserScan, X_OB: FloatArray, radius: float) -> SeenSpace:
    """The memory with a scan taken at X_OB (3,) by a round robot of this radius (m), which stands on free ground."""
    angles, ranges = _all_round(scan)
    ranges = _without_noise(ranges)
    cells, stands = np.flatnonzero(space.met), np.zeros((CELLS, CELLS), dtype=np.bool_)
    age = scan.stamp - space.seen.take(cells)
    p_BM = transform(inverse(X_OB), space.p_OM.reshape(-1, 2).take(cells, axis=0))
    stands.put(cells, may_stand(p_BM, age, angles, ranges) & (age <= MEMORY))
    return SeenSpace(
        *_remembered(space.corner, space.seen, space.met, space.p_OM, stands, angles, ranges, scan.stamp, X_OB, radius)
    )


def _all_round(scan: LaserScan) -> tuple[FloatArray, FloatArray]:
    """Angles and ranges (n,) of a scan; where it closes a circle, those at its end are at its beginning, too."""
    angles, ranges, turn = scan.angles, scan.ranges, 2.0 * math.pi
    closed = len(angles) > 2 * _BESIDE and turn - angles[-1] + angles[0] < _GAP * turn / len(angles)
    begin, end = (_BESIDE, len(angles) - _BESIDE) if closed else (0, len(angles))
    angles = np.concatenate([angles[end:] - turn, angles, angles[:begin] + turn])
    return angles, np.concatenate([ranges[end:], ranges, ranges[:begin]])


@njit(cache=True)
def _remembered(
    corner: IntArray,
    seen: FloatArray,
    met: BoolArray,
    p_OM: FloatArray,
    stands: BoolArray,
    angles: FloatArray,
    ranges: FloatArray,
    stamp: float,
    X_OB: FloatArray,
    radius: float,
) -> tuple[IntArray, FloatArray, BoolArray, FloatArray]:
    """The memory's arrays after a scan. stands: (CELLS, CELLS) what was met there may stand there yet."""
    after, occupied, where = seen.copy(), met.copy(), p_OM.copy()
    i0, j0 = math.floor(X_OB[0] / CELL) - HALF, math.floor(X_OB[1] / CELL) - HALF
    # Where the robot is in the window, in cells; (u, v) count cells from its corner.
    u_B, v_B = X_OB[0] / CELL - i0, X_OB[1] / CELL - j0
    # Rays a cell: that went through it, ended in it, or would have come there if a gap of them had not been lost.
    passed = np.zeros(CELLS * CELLS, dtype=np.int64)
    ended, lost = np.zeros_like(passed), np.zeros_like(passed)
    total = np.empty((CELLS * CELLS, 2))
    reach = (HALF - 1) * CELL
    way = np.empty(int(reach / (_STEP * CELL)) + 1, dtype=np.int64)
    gap_begin = gap_end = 0
    # The outermost rays have no others on one side.
    for k in range(_BESIDE, len(ranges) - _BESIDE):
        says = ranges[k] >= 0.0
        if not says:
            if k >= gap_end:
                gap_begin = gap_end = k
                while gap_end < len(ranges) and not ranges[gap_end] >= 0.0:
                    gap_end += 1
            if gap_end - gap_begin < _GAP:
                continue
        free = min(reach, ranges[k] - _BEFORE_RETURN) if says else reach
        counted = passed if says else lost
        cosine, sine = math.cos(X_OB[2] + angles[k]), math.sin(X_OB[2] + angles[k])
        steps = int(free / (_STEP * CELL)) + 1 if free > 0.0 else 0
        for n in range(steps):
            way[n] = int(u_B + n * _STEP * cosine) * CELLS + int(v_B + n * _STEP * sine)
        last = -1
        for n in range(steps):
            if way[n] != last:
                last = way[n]
                counted[last] += 1
        if ranges[k] < reach:
            cell = int(u_B + ranges[k] / CELL * cosine) * CELLS + int(v_B + ranges[k] / CELL * sine)
            if ended[cell] == 0:
                total[cell, 0], total[cell, 1] = 0.0, 0.0
            ended[cell] += 1
            total[cell, 0] += X_OB[0] + ranges[k] * cosine
            total[cell, 1] += X_OB[1] + ranges[k] * sine
            if cell == last:
                passed[cell] -= 1
            for step in (-1, 1):
                beyond, end = _end(ranges, k, step)
                if end > 0.0:
                    bearing = X_OB[2] + angles[beyond]
                    x, y = X_OB[0] + end * math.cos(bearing), X_OB[1] + end * math.sin(bearing)
                    cell = (math.floor(x / CELL) - i0) * CELLS + math.floor(y / CELL) - j0
                    if ended[cell] == 0:
                        # No ray has met it: it counts as met before.
                        ended[cell], total[cell, 0], total[cell, 1] = 1, x, y
                        passed[cell] += 2
    beneath = radius / CELL - 1.0
    first_a, first_b = i0 % CELLS, j0 % CELLS
    for u in range(CELLS):
        a = first_a + u if first_a + u < CELLS else first_a + u - CELLS
        for v in range(CELLS):
            b = first_b + v if first_b + v < CELLS else first_b + v - CELLS
            if not (0 <= i0 + u - corner[0] < CELLS and 0 <= j0 + v - corner[1] < CELLS):
                # It has come into the window.
                after[a, b], occupied[a, b] = -np.inf, False
            cell = u * CELLS + v
            x, y = u + 0.5 - u_B, v + 0.5 - v_B
            if x * x + y * y < beneath * beneath:
                after[a, b], occupied[a, b] = stamp, False
            elif occupied[a, b] and _any_beside(lost, u, v):
                # Past the edge of what is too near to be seen rays pass, or end in what noise has moved away; odometry
                # errs by a cell there.
                continue
            elif ended[cell] > 0:
                # A few rays do not tell where a thing ends: what was met before counts, too.
                after[a, b] = stamp if ended[cell] >= passed[cell] else stamp - _HARDLY_OLDER
                for axis in range(2):
                    mean = total[cell, axis] / ended[cell]
                    where[a, b, axis] = 0.5 * (where[a, b, axis] + mean) if occupied[a, b] else mean
                occupied[a, b] = True
            elif passed[cell] > lost[cell] and not (occupied[a, b] and stands[a, b]):
                after[a, b], occupied[a, b] = stamp, False
            elif x * x + y * y < (radius / CELL) ** 2 and not occupied[a, b]:
                after[a, b] = stamp
    return np.array([i0, j0]), after, occupied, where


@njit(cache=True)
def _end(ranges: FloatArray, k: int, step: int) -> tuple[int, float]:
    """The next ray to one side of the k-th, step -1 or 1, if it passes the surface that the k-th met, and the range (m)
    there up to which that surface may reach; 0 where that is no nearer."""
    before, beyond = k - step, k + step
    while 0 < beyond < len(ranges) - 1 and not ranges[beyond] >= 0.0:
        beyond += step
    while 0 < before < len(ranges) - 1 and not ranges[before] >= 0.0:
        before -= step
    if abs(beyond - k) > _BESIDE or abs(before - k) > _BESIDE or not ranges[beyond] > ranges[k] + _SAME_SURFACE:
        return beyond, 0.0
    nearer = (ranges[before] - ranges[k]) * (k - beyond) / (before - k)
    return beyond, ranges[k] - min(nearer, _MOST_NEARER) if nearer > 0.0 else 0.0


@njit(cache=True)
def _any_beside(counts: IntArray, u: int, v: int) -> bool:
    """Whether there is any in a cell or one beside it."""
    for i in range(max(u - 1, 0), min(u + 2, CELLS)):
        for j in range(max(v - 1, 0), min(v + 2, CELLS)):
            if counts[i * CELLS + j] > 0:
                return True
    return False


@njit(cache=True)
def _without_noise(ranges: FloatArray) -> FloatArray:
    """Ranges (n,) as straight pieces of the surfaces that they met have them; one alone is as it was."""
    result = ranges.copy()
    for k in range(len(ranges)):
        # The line through those beside it, and its value at the ray: at a surface's end, too, it leans to no side.
        count, sum_i, sum_ii, sum_r, sum_ir = 0, 0, 0, 0.0, 0.0
        for j in range(max(k - _BESIDE, 0), min(k + _BESIDE + 1, len(ranges))):
            off = ranges[j] - ranges[k]
            if abs(off) < _SAME_SURFACE:
                i = j - k
                count, sum_i, sum_ii = count + 1, sum_i + i, sum_ii + i * i
                sum_r, sum_ir = sum_r + off, sum_ir + i * off
        if count > 2:
            result[k] += (sum_ii * sum_r - sum_i * sum_ir) / (count * sum_ii - sum_i * sum_i)
    return result


def open_distance(
    space: SeenSpace,
    X_OB: FloatArray,
    curvature: float,
    radius: float,
    reach: float,
    newest: float,
    backwards: bool = False,
) -> float:
    """How far (m) a round base may drive along an arc until its outline meets what is not known to be free.

    X_OB: (3,) its pose. curvature: of the arc, 1/m. radius: of the base, m. reach: farther than this (m) makes no
    difference. newest: stamp of the newest scan in the memory, s: what that one met is left to who has its exact place.
    inf if nothing within reach is in doubt. Cells that were never seen, or not for MEMORY, count if they lie one cell
    within the outline's way: beside it a wall may stand that no ray passes. What was met may reach farther than where
    it was. The base stops a cell's side earlier: odometry errs by about as much where it cannot see. backwards: where
    no scanner may look, the way has to be wider by a cell on either side, and free a moment ago.
    """
    distance: float = open_distance_among(
        space.corner, space.seen, space.met, space.p_OM, X_OB, curvature, radius, reach, newest, backwards
    )
    return distance


@njit(cache=True)
def open_distance_among(
    corner: IntArray,
    seen: FloatArray,
    met: BoolArray,
    p_OM: FloatArray,
    X_OB: FloatArray,
    curvature: float,
    radius: float,
    reach: float,
    newest: float,
    backwards: bool,
) -> float:
    """As open_distance, of a memory's arrays."""
    wider, memory = (CELL, _MEMORY_BEHIND) if backwards else (0.0, MEMORY)
    span = radius + reach + 2.0 * CELL
    cosine, sine = math.cos(X_OB[2]), math.sin(X_OB[2])
    least = np.inf
    first_j = math.floor((X_OB[1] - span) / CELL)
    for i in range(math.floor((X_OB[0] - span) / CELL), math.floor((X_OB[0] + span) / CELL) + 1):
        a, b = i % CELLS, (first_j - 1) % CELLS
        for j in range(first_j, math.floor((X_OB[1] + span) / CELL) + 1):
            b = b + 1 if b + 1 < CELLS else 0
            dx, dy = (i + 0.5) * CELL - X_OB[0], (j + 0.5) * CELL - X_OB[1]
            outline, corridor = radius, radius - CELL + wider
            if 0 <= i - corner[0] < CELLS and 0 <= j - corner[1] < CELLS:
                if seen[a, b] == newest or (seen[a, b] >= newest - memory and not met[a, b]):
                    continue
                if met[a, b]:
                    dx, dy = p_OM[a, b, 0] - X_OB[0], p_OM[a, b, 1] - X_OB[1]
                    outline, corridor = radius + _REACHES, radius + _REACHES + wider
            # Space beneath the base is free.
            if radius * radius < dx * dx + dy * dy < span * span:
                x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
                distance = touch_distance(x, y, curvature, outline, corridor)
                if distance < 0.0 and outline > radius:
                    # It is as near already to what was met, and may go where its outline does not touch it.
                    distance = touch_distance(x, y, curvature, radius, radius)
                least = min(least, distance - CELL)
    return least
