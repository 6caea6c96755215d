"""What of a world a robot can reach and see: the yardstick of every coverage figure.

Reachable cells are the cells of a 5 cm grid that a disc of robot radius + 5 cm can be moved to from the start. A tag is
reachable if some reachable cell has line of sight to it within range and incidence, a surface point if some reachable
cell sees it within scan range.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from tfg_drake.config import NODE_MARGIN
from tfg_drake.geometry.visibility import line_of_sight
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.world.world import World

# Side of a cell, m.
CELL = 0.05
# Two faces of a wall within this distance, m, are one.
FACE_GAP = 0.25
# Visibility is tried from every COARSE-th cell in x and y first, on which coverage is counted.
COARSE = 4
# Distance of a face's points in front of its wall, m, as nothing is visible from the wall itself.
_OFF_WALL = 2e-3


@dataclasses.dataclass(frozen=True)
class Grid:
    """A grid over the world: the centre of cell (row, column) is p_WG + CELL (column, row). shape: (rows, columns)."""

    p_WG: FloatArray
    shape: tuple[int, int]

    def cell(self, p_WP: FloatArray) -> tuple[IntArray, IntArray]:
        """Rows and columns (n,) of the cells holding the points p_WP (n, 2), clipped to the grid."""
        index = np.floor((p_WP - self.p_WG) / CELL + 0.5).astype(np.int64)
        return np.clip(index[:, 1], 0, self.shape[0] - 1), np.clip(index[:, 0], 0, self.shape[1] - 1)

    def centers(self, mask: BoolArray) -> FloatArray:
        """Centres (n, 2) in W of the cells where mask is true, row by row, m."""
        row, column = np.nonzero(mask)
        return self.p_WG + CELL * np.column_stack([column, row])


def make_grid(world: World) -> Grid:
    """The grid over the world's bounding box and 1 m more on every side, a cell's centre on the start."""
    points = np.concatenate([world.walls.reshape(-1, 2), world.p_WT, world.start[None, :2]])
    start = world.start[:2]
    first = np.floor((points.min(axis=0) - 1.0 - start) / CELL)
    last = np.ceil((points.max(axis=0) + 1.0 - start) / CELL)
    columns, rows = (last - first).astype(int) + 1
    return Grid(p_WG=start + CELL * first, shape=(int(rows), int(columns)))


def free_cells(grid: Grid, walls: FloatArray, clearance: float) -> BoolArray:
    """Cells (rows, columns) whose centre is at least `clearance` (m) from every wall (m, 4)."""
    free = np.ones(grid.shape, dtype=np.bool_)
    for wall in walls:
        (a, b), (dx, dy) = wall.reshape(2, 2), wall[2:] - wall[:2]
        first = np.floor((np.minimum(a, b) - clearance - grid.p_WG) / CELL).astype(int).clip(0)
        stop = np.ceil((np.maximum(a, b) + clearance - grid.p_WG) / CELL).astype(int).clip(-1) + 1
        near = free[first[1] : stop[1], first[0] : stop[0]]
        x = grid.p_WG[0] + CELL * (first[0] + np.arange(near.shape[1]))
        y = grid.p_WG[1] + CELL * (first[1] + np.arange(near.shape[0])[:, None])
        square = dx * dx + dy * dy
        t = np.clip(((x - a[0]) * dx + (y - a[1]) * dy) / (square if square > 0.0 else 1.0), 0.0, 1.0)
        near &= (a[0] + t * dx - x) ** 2 + (a[1] + t * dy - y) ** 2 >= clearance * clearance
    return free


def reachable_cells(grid: Grid, world: World, robot_radius: float, keep_out: FloatArray | None = None) -> BoolArray:
    """Cells (rows, columns) connected to the start for a disc of robot_radius + NODE_MARGIN, that keeps clear of
    keep_out (k, 4), m in W, as of walls.

    A robot that starts nearer to a wall than that counts from the nearest cell it can get to within its own radius;
    without one no cell is reachable.
    """
    obstacles = world.walls if keep_out is None else np.vstack([world.walls, keep_out])
    free = free_cells(grid, obstacles, robot_radius + NODE_MARGIN)
    start_row, start_column = grid.cell(world.start[None, :2])
    half = int(np.ceil(robot_radius / CELL)) + 1
    around = np.zeros(grid.shape, dtype=np.bool_)
    rows, columns = (slice(max(int(at[0]) - half, 0), int(at[0]) + half + 1) for at in (start_row, start_column))
    around[rows, columns] = free[rows, columns]
    row, column = np.nonzero(around)
    distance = np.hypot(*(grid.centers(around) - world.start[:2]).T)
    if not len(row) or distance.min() > robot_radius:
        return np.zeros(grid.shape, dtype=np.bool_)
    nearest = int(np.argmin(distance))
    labels, _ = ndimage.label(free)
    return np.asarray(labels == labels[row[nearest], column[nearest]])


def _seen(
    walls: FloatArray,
    points: FloatArray,
    normals: FloatArray,
    cells: FloatArray,
    range_max: float,
    max_incidence: float,
) -> BoolArray:
    """Which points (n, 2) on faces with normals (n, 2) some cell centre (c, 2) sees: nearest cells first."""
    seen = np.zeros(len(points), dtype=np.bool_)
    if not len(points) or not len(cells):
        return seen
    tree = cKDTree(cells)
    origins = points + _OFF_WALL * normals

    def look(some: IntArray, index: IntArray, near: BoolArray) -> None:
        """Tries the cells index (s, k) of some points (s,), as far as they are near (s, k)."""
        offset = cells[np.where(near, index, 0)] - origins[some, None]
        ahead = (offset * normals[some, None]).sum(axis=-1)
        facing = near & (ahead >= np.cos(max_incidence) * np.linalg.norm(offset, axis=-1))
        for row in np.flatnonzero(facing.any(axis=1)).tolist():
            i = some[row]
            seen[i] = np.count_nonzero(line_of_sight(walls, origins[i], cells[index[row, facing[row]]]))

    for count in (1, 8, 64):
        left = np.flatnonzero(~seen)
        distance, index = tree.query(points[left], k=np.arange(1, count + 1), distance_upper_bound=range_max)
        look(left, index, np.isfinite(distance))
    for i in np.flatnonzero(~seen).tolist():
        index = np.array([tree.query_ball_point(points[i], range_max)], dtype=np.int64)
        look(np.array([i]), index, np.ones(index.shape, dtype=np.bool_))
    return seen


def reachable_tags(world: World, grid: Grid, reachable: BoolArray, tag_range: float, max_incidence: float) -> BoolArray:
    """Which tags (n,) some reachable cell sees within tag_range (m) and max_incidence (rad)."""
    normals = np.column_stack([np.cos(world.tag_facing), np.sin(world.tag_facing)])
    seen = _seen(world.walls, world.p_WT, normals, coarse(grid, reachable), tag_range, max_incidence)
    rest = np.nonzero(~seen)[0]
    if len(rest):
        cells = grid.centers(reachable)
        seen[rest] = _seen(world.walls, world.p_WT[rest], normals[rest], cells, tag_range, max_incidence)
    return seen


def coarse(grid: Grid, mask: BoolArray) -> FloatArray:
    """Centres (n, 2) in W of every COARSE-th cell in x and y where a mask (rows, columns) is true, m."""
    thinned = np.zeros_like(mask)
    thinned[::COARSE, ::COARSE] = mask[::COARSE, ::COARSE]
    return grid.centers(thinned)


def reachable_faces(world: World, grid: Grid, reachable: BoolArray, scan_range: float) -> tuple[FloatArray, FloatArray]:
    """The faces of wall pieces, CELL long, that some reachable cell sees: centres (n, 2), m, and unit normals (n, 2),
    in W. A piece that is seen from both sides has two."""
    points, normals = cut_walls(world.walls)
    points, normals = np.repeat(points, 2, axis=0), np.repeat(normals, 2, axis=0)
    normals[1::2] *= -1.0
    faces = _beside(world.walls, grid, _connected_space(world, grid, reachable), points, normals)
    points, normals = points[faces], normals[faces]
    seen = _seen(world.walls, points, normals, coarse(grid, reachable), scan_range, 0.5 * np.pi)
    return points[seen], normals[seen]


def cut_walls(walls: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Centres (n, 2) of equal pieces of the walls (m, 4), at most CELL long, m, and their unit normals (n, 2)."""
    if not len(walls):
        return np.zeros((0, 2)), np.zeros((0, 2))
    d = walls[:, 2:] - walls[:, :2]
    length = np.linalg.norm(d, axis=1)
    count = np.maximum(np.ceil(length / CELL - 1e-9), 1.0).astype(np.int64)
    wall = np.repeat(np.arange(len(walls)), count)
    k = np.arange(len(wall)) - np.repeat(np.cumsum(count) - count, count)
    points = walls[wall, :2] + ((k + 0.5) / count[wall])[:, None] * d[wall]
    normal = np.column_stack([-d[:, 1], d[:, 0]]) / length[:, None]
    return points, normal[wall]


def _connected_space(world: World, grid: Grid, reachable: BoolArray) -> BoolArray:
    """Cells of the space open to the reachable ones, through gaps however narrow: what lies outside is never seen."""
    labels, _ = ndimage.label(free_cells(grid, world.walls, 0.55 * CELL))
    inside = np.unique(labels[reachable])
    return np.asarray(np.isin(labels, inside[inside > 0]))


def _beside(walls: FloatArray, grid: Grid, connected: BoolArray, points: FloatArray, normals: FloatArray) -> BoolArray:
    """Which face points (n, 2) have a cell of the connected space right in front of them, in line of sight."""
    origins = points + _OFF_WALL * normals
    row, column = grid.cell(points + 1.5 * CELL * normals)
    # The nine cells round it.
    around = np.stack(np.meshgrid((-1, 0, 1), (-1, 0, 1), indexing="ij"), axis=-1).reshape(-1, 2)
    r = np.clip(row[:, None] + around[:, 0], 0, grid.shape[0] - 1)
    c = np.clip(column[:, None] + around[:, 1], 0, grid.shape[1] - 1)
    centers = grid.p_WG + CELL * np.stack([c, r], axis=-1)
    front = connected[r, c] & (((centers - origins[:, None]) * normals[:, None]).sum(axis=-1) > 0.0)
    result = np.zeros(len(points), dtype=np.bool_)
    for i in np.flatnonzero(front.any(axis=1)).tolist():
        result[i] = np.count_nonzero(line_of_sight(walls, origins[i], centers[i, front[i]]))
    return result


def second_faces(points: FloatArray, normals: FloatArray) -> BoolArray:
    """Marks (n,) every face that lies straight behind an earlier parallel one, nearer than FACE_GAP."""
    second = np.zeros(len(points), dtype=np.bool_)
    if not len(points):
        return second
    pairs = cKDTree(points).query_pairs(FACE_GAP, output_type="ndarray")
    offset = points[pairs[:, 1]] - points[pairs[:, 0]]
    n = normals[pairs[:, 0]]
    along = np.abs(offset[:, 0] * n[:, 1] - offset[:, 1] * n[:, 0])
    parallel = np.abs(np.sum(n * normals[pairs[:, 1]], axis=1)) > 0.9
    pairs = pairs[parallel & (along < 0.5 * CELL)]
    for i, j in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]:
        if not second[i]:
            second[j] = True
    return second
