"""Occupancy grids of many particles, which share every tile that they have in common.

A cell holds four numbers: its log odds of being occupied (Moravec and Elfes 1985; Thrun, Burgard and Fox 2005, section
9.2) in steps of STEP nats, 0 where nothing was ever measured; how many rays have ended in it; and the mean of where in
it they did, x and y from its middle in FINE-ths of a cell. Without the mean a surface would be known to half a cell
only, and the heading would drift from room to room.

A particle's grid is a table of indices into one pool of square tiles. Particles that
descend from one another name the same tiles; a scan writes copies of those that it touches. So a new set of maps costs
what the scan touches, not what the maps hold, and the old set stays as it was.

Cell (i, j) has its centre at ((j + 0.5) r, (i + 0.5) r) in M, r the resolution: rows go along y.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tfg_drake.messages import FloatArray, IntArray, LaserScan

TileIndex = NDArray[np.int32]
Tiles = NDArray[np.int8]
Marks = NDArray[np.uint8]

# Cells along a tile's side.
TILE = 32
# One step of a cell's log odds, nats; the steps of a return and of a ray that passes through, and the bound of either
# sign, so that a door that has closed can change the cell.
STEP = 0.1
HIT, PASS, LIMIT = 9, -4, 60
# Resolution of a mean within a cell, in parts of the cell, and the greatest number of returns in it.
FINE = 250
MOST_ENDS = 100
# Neighbouring returns within this distance, m, are on one surface, whose cells between them are set, too. Otherwise far
# surfaces would be rows of dots, and scans would match at every multiple of the angle between rays.
SURFACE_GAP = 0.35
# Columns of a cell.
ODDS, ENDS, MEAN_X, MEAN_Y = 0, 1, 2, 3


class TileMaps(NamedTuple):
    """The grids of n particles; nobody changes them.

    resolution: side of a cell, m. corner: (2,) x and y, in tiles from M's origin, of the tile that table[:, 0, 0]
    names. table: (n, h, w) each particle's tiles, rows along y. tiles: (t, TILE, TILE, 4) the pool; tile 0 is the
    unknown.
    """

    resolution: float
    corner: IntArray
    table: TileIndex
    tiles: Tiles

    def locked(self) -> TileMaps:
        """Themselves, read-only. They are not copied, as a message's arrays are: the pool is large and nobody else
        holds it."""
        for array in (self.corner, self.table, self.tiles):
            array.flags.writeable = False
        return self


def empty_maps(particles: int, resolution: float) -> TileMaps:
    """Grids that know nothing yet. resolution: side of a cell, m."""
    table = np.zeros((particles, 0, 0), dtype=np.int32)
    tiles = np.zeros((1, TILE, TILE, 4), dtype=np.int8)
    return TileMaps(resolution, np.zeros(2, dtype=np.int64), table, tiles).locked()


def grown(maps: TileMaps, lower: FloatArray, upper: FloatArray) -> TileMaps:
    """The same grids, their tables wide enough for the points lower (2,) to upper (2,) in M, m."""
    side = TILE * maps.resolution
    first = np.floor(np.asarray(lower) / side).astype(np.int64)
    last = np.floor(np.asarray(upper) / side).astype(np.int64)
    n, h, w = maps.table.shape
    if h * w:
        first = np.minimum(first, maps.corner)
        last = np.maximum(last, maps.corner + np.array([w - 1, h - 1]))
        if np.array_equal(first, maps.corner) and np.array_equal(last, maps.corner + np.array([w - 1, h - 1])):
            return maps
    wide = np.zeros((n, int(last[1] - first[1]) + 1, int(last[0] - first[0]) + 1), dtype=np.int32)
    if h * w:
        x, y = maps.corner - first
        wide[:, y : y + h, x : x + w] = maps.table
    return maps._replace(corner=first, table=wide).locked()


def reach_of(scan: LaserScan) -> float:
    """How far from the robot a scan says anything, m; 0 if it says nothing."""
    told = scan.ranges[scan.ranges > 0.0]
    return float(np.minimum(told, scan.range_max).max(initial=0.0))


def insert_scan(maps: TileMaps, parents: IntArray, X_MB: FloatArray, scan: LaserScan) -> TileMaps:
    """The grids of n new particles: each its parent's grid with the scan put in at the parent's pose.

    parents: (n,) rows of maps. X_MB: (m, 3) poses of the m particles of maps. A range within range_max is a return in
    the cell where it ends; any longer one, inf too, leaves its ray free up to range_max; nan and what is not above 0
    say nothing. Neighbouring returns within SURFACE_GAP are joined. A cell changes once a scan: by HIT if any ray ends
    in it or a joined surface passes through it, else by PASS if any ray does.
    """
    alive, inverse = np.unique(parents, return_inverse=True)
    X = np.ascontiguousarray(X_MB[alive])
    reach = reach_of(scan)
    wide = grown(maps, X[:, :2].min(axis=0) - reach, X[:, :2].max(axis=0) + reach)
    table, tiles = np.ascontiguousarray(wide.table[alive]), wide.tiles
    fresh = _insert(table, tiles, wide.corner, X, scan.angles, scan.ranges, scan.range_max, reach, maps.resolution)
    # The tiles that nobody names any more are left out of the pool.
    used = np.zeros(len(tiles) + len(fresh), dtype=np.bool_)
    used[table.ravel()] = True
    used[0] = True
    kept = np.flatnonzero(used[: len(tiles)])
    pool = np.empty((len(kept) + len(fresh), TILE, TILE, 4), dtype=np.int8)
    np.take(tiles, kept, axis=0, out=pool[: len(kept)])
    pool[len(kept) :] = fresh
    renamed = np.cumsum(used, dtype=np.int32) - np.int32(1)
    return TileMaps(maps.resolution, wide.corner, renamed[table][inverse], pool).locked()


def log_odds(maps: TileMaps, particle: int) -> tuple[FloatArray, NDArray[np.int8]]:
    """One particle's grid: origin (2,), the corner of cell [0, 0] in M, m, and (h, w) log odds in steps."""
    origin = np.asarray(maps.corner * (TILE * maps.resolution), dtype=np.float64)
    h, w = maps.table.shape[1:]
    grid = maps.tiles[maps.table[particle], :, :, ODDS].swapaxes(1, 2).reshape(h * TILE, w * TILE)
    return origin, grid


def probability(steps: NDArray[np.int8]) -> NDArray[np.float32]:
    """The probability of being occupied, for log odds in steps."""
    table = 1.0 / (1.0 + np.exp(-STEP * np.arange(-128, 128)))
    return np.asarray(table.astype(np.float32)[steps.astype(np.int64) + 128])


@njit(cache=True)
def surface_points(angles: FloatArray, ranges: FloatArray, range_max: float, spacing: float) -> FloatArray:
    """p_BP (k, 2), m: the returns and, between neighbours within SURFACE_GAP, points at a spacing (m)."""
    most = int(SURFACE_GAP / spacing) + 1
    points = np.empty((most * len(angles), 2))
    count = 0
    x, y = math.inf, math.inf
    for k in range(len(angles)):
        if not 0.0 < ranges[k] <= range_max:
            # A ray without a return between two others parts them.
            x, y = math.inf, math.inf
            continue
        u, v = ranges[k] * math.cos(angles[k]), ranges[k] * math.sin(angles[k])
        gap = math.hypot(u - x, v - y)
        pieces = math.ceil(gap / spacing) if gap <= SURFACE_GAP else 1
        for piece in range(1, max(1, pieces)):
            points[count, 0] = x + piece / pieces * (u - x)
            points[count, 1] = y + piece / pieces * (v - y)
            count += 1
        points[count, 0], points[count, 1] = u, v
        count += 1
        x, y = u, v
    return points[:count]


@njit(cache=True)
def mark_scan(
    cells: Marks,
    x: float,
    y: float,
    theta: float,
    angles: FloatArray,
    ranges: FloatArray,
    range_max: float,
    resolution: float,
) -> None:
    """Marks the cells that rays meet with 1.

    cells: (h, w), the marks so far; every ray must stay inside. x, y, theta: the robot's pose in the frame of the
    corner of cell [0, 0], m and rad. angles (m,), ranges (m,), range_max: as in LaserScan. A ray visits every cell
    that its segment meets (Amanatides and Woo 1987).
    """
    for k in range(len(angles)):
        r = ranges[k]
        if not r > 0.0:
            continue
        r = min(r, range_max)
        x0, y0 = x / resolution, y / resolution
        dx = r / resolution * math.cos(theta + angles[k])
        dy = r / resolution * math.sin(theta + angles[k])
        j, i = math.floor(x0), math.floor(y0)
        j_end, i_end = math.floor(x0 + dx), math.floor(y0 + dy)
        step_j, step_i = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
        # The share of the ray at which it crosses into the next column and row, and what a cell takes of it.
        next_j = ((j + 1 if dx > 0.0 else j) - x0) / dx if dx != 0.0 else math.inf
        next_i = ((i + 1 if dy > 0.0 else i) - y0) / dy if dy != 0.0 else math.inf
        each_j = abs(1.0 / dx) if dx != 0.0 else math.inf
        each_i = abs(1.0 / dy) if dy != 0.0 else math.inf
        # Counted, so that rounding can lead no ray past its end.
        left_j, left_i = abs(j_end - j), abs(i_end - i)
        while True:
            cells[i, j] = 1
            if left_j == 0 and left_i == 0:
                break
            if left_i == 0 or (left_j > 0 and next_j < next_i):
                j, left_j, next_j = j + step_j, left_j - 1, next_j + each_j
            else:
                i, left_i, next_i = i + step_i, left_i - 1, next_i + each_i


@njit(cache=True)
def _insert(
    table: TileIndex,
    tiles: Tiles,
    corner: IntArray,
    X_MB: FloatArray,
    angles: FloatArray,
    ranges: FloatArray,
    range_max: float,
    reach: float,
    resolution: float,
) -> Tiles:
    """Puts the scan into every particle's grid: into `table` go the numbers of new tiles, which are returned."""
    count, side = 0, TILE * resolution
    p_BP = surface_points(angles, ranges, range_max, 0.5 * resolution)
    window = int(2.0 * reach / side) + 2
    fresh = np.empty((len(table) * window * window, TILE, TILE, 4), dtype=np.int8)
    cells = np.zeros((window * TILE, window * TILE), dtype=np.uint8)
    for p in range(len(table)):
        tile_x, tile_y = math.floor((X_MB[p, 0] - reach) / side), math.floor((X_MB[p, 1] - reach) / side)
        x, y = X_MB[p, 0] - tile_x * side, X_MB[p, 1] - tile_y * side
        mark_scan(cells, x, y, X_MB[p, 2], angles, ranges, range_max, resolution)
        c, s = math.cos(X_MB[p, 2]) / resolution, math.sin(X_MB[p, 2]) / resolution
        for k in range(len(p_BP)):
            u = x / resolution + c * p_BP[k, 0] - s * p_BP[k, 1]
            v = y / resolution + s * p_BP[k, 0] + c * p_BP[k, 1]
            cells[math.floor(v), math.floor(u)] = 2
        for a in range(window):
            for b in range(window):
                marks = cells[a * TILE : (a + 1) * TILE, b * TILE : (b + 1) * TILE]
                touched = False
                for i in range(TILE):
                    for j in range(TILE):
                        touched |= marks[i, j] != 0
                if not touched:
                    continue
                row, column = tile_y + a - corner[1], tile_x + b - corner[0]
                new = fresh[count]
                new[:] = tiles[table[p, row, column]]
                for i in range(TILE):
                    for j in range(TILE):
                        value = int(new[i, j, ODDS])
                        if marks[i, j] == 2:
                            value = min(value + HIT, LIMIT)
                            # 0 is kept for what was never measured.
                            value = 1 if value == 0 else value
                        elif marks[i, j] == 1:
                            value = max(value + PASS, -LIMIT)
                            value = -1 if value == 0 else value
                        new[i, j, ODDS] = value
                        marks[i, j] = 0
                table[p, row, column] = len(tiles) + count
                count += 1
        for k in range(len(p_BP)):
            u = x / resolution + c * p_BP[k, 0] - s * p_BP[k, 1]
            v = y / resolution + s * p_BP[k, 0] + c * p_BP[k, 1]
            j, i = math.floor(u), math.floor(v)
            name = table[p, tile_y + i // TILE - corner[1], tile_x + j // TILE - corner[0]]
            cell = fresh[name - len(tiles), i % TILE, j % TILE]
            if cell[ENDS] < MOST_ENDS:
                cell[ENDS] += 1
                cell[MEAN_X] += round((FINE * (u - j - 0.5) - cell[MEAN_X]) / cell[ENDS])
                cell[MEAN_Y] += round((FINE * (v - i - 0.5) - cell[MEAN_Y]) / cell[ENDS])
    return fresh[:count]
