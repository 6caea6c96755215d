"""Ways through an occupancy grid: where a robot can be, the cheapest ways there, a path to follow and its checks."""

from __future__ import annotations

import dataclasses
import heapq

import numpy as np
from numba import njit
from scipy import ndimage

from tfg_drake.config import NODE_MARGIN, RobotConfig
from tfg_drake.geometry.distance import clearance, point_distance
from tfg_drake.geometry.se2 import transform
from tfg_drake.grid.frontier import FREE, OCCUPIED, CellArray, cell_at, center_of, classify
from tfg_drake.messages import BoolArray, FloatArray, GridMap, IntArray, LaserScan, replace
from tfg_drake.planning.parameters import COMFORT, cost_of_edge
from tfg_drake.planning.path import PATH_STEP, SHORTCUT_CLEARANCE, lines_between, path_is_free, resample, round_corners

# A robot without room may drive straight to a cell with room within this distance, m.
WAY_OUT = 0.6
# Shortcuts end at every SHORTCUT_STRIDE-th cell of a way and span at most SHORTCUT_SPAN cells.
SHORTCUT_STRIDE = 8
SHORTCUT_SPAN = 240
# Returns of a scan within this distance, m, are checked against the path ahead.
RETURN_REACH = 3.0


@dataclasses.dataclass(frozen=True)
class Ways:
    """The cheapest ways from the robot to all cells of a grid; all (h, w).

    cells: what each cell is (see frontier.classify). room: m from a cell's centre to the nearest side of an occupied
    one. cost: m weighted by clearance, inf where there is no way. length: m. before: flat index of the cell before on
    the way, -1 at its first cell and where there is none.
    """

    cells: CellArray
    room: FloatArray
    cost: FloatArray
    length: FloatArray
    before: IntArray

    @property
    def reachable(self) -> BoolArray:
        """The cells (h, w) to which there is a way."""
        return np.isfinite(self.cost)


def room_round(cells: CellArray, resolution: float) -> FloatArray:
    """Distance (h, w), m, from the centre of each cell to the nearest side of an occupied one, inf without any.

    Half a cell less than to its centre: within the cell the surface may be anywhere.
    """
    occupied = cells == OCCUPIED
    if not occupied.any():
        return np.full(cells.shape, np.inf)
    return np.asarray(resolution * (ndimage.distance_transform_edt(~occupied) - 0.5))


def room_needed(robot: RobotConfig) -> float:
    """Room (m) that a cell must have for the robot's centre to be there."""
    return robot.radius + NODE_MARGIN


@njit(cache=True)
def cheapest(
    traversable: BoolArray, weight: FloatArray, sources: IntArray, source_cost: FloatArray, source_length: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Dijkstra's algorithm over sides and corners of traversable cells (h, w), in cells: cost, length, cell before.

    A step costs its length times the mean weight (h, w) of its two cells. sources: (s,) flat indices of cells where
    ways begin. No step goes over a corner unless both cells beside it are traversable.
    """
    height, width = traversable.shape
    cost, length = np.full((height, width), np.inf), np.full((height, width), np.inf)
    before = np.full((height, width), -1)
    done = np.zeros((height, width), dtype=np.bool_)
    heap = [(0.0, 0)]
    heap.pop()
    for k in range(len(sources)):
        i, j = sources[k] // width, sources[k] % width
        cost[i, j], length[i, j] = source_cost[k], source_length[k]
        heapq.heappush(heap, (source_cost[k], sources[k]))
    while len(heap) > 0:
        _, cell = heapq.heappop(heap)
        i, j = cell // width, cell % width
        if done[i, j]:
            continue
        done[i, j] = True
        for di in range(-1, 2):
            for dj in range(-1, 2):
                a, b = i + di, j + dj
                if not (0 <= a < height and 0 <= b < width) or done[a, b] or not traversable[a, b]:
                    continue
                step = 1.0
                if di != 0 and dj != 0:
                    if not (traversable[a, j] and traversable[i, b]):
                        continue
                    step = np.sqrt(2.0)
                new = cost[i, j] + 0.5 * step * (weight[i, j] + weight[a, b])
                if new < cost[a, b]:
                    cost[a, b], length[a, b], before[a, b] = new, length[i, j] + step, cell
                    heapq.heappush(heap, (new, a * width + b))
    return cost, length, before


@njit(cache=True)
def sees(blocked: BoolArray, a: FloatArray, b: FloatArray) -> BoolArray:
    """Which of the straight lines (n,) between points a (n, 2) and b (n, 2) meet no blocked cell (h, w).

    Points are (row, column) in cells, the centre of cell [0, 0] at (0.5, 0.5).
    """
    height, width = blocked.shape
    clear = np.ones(len(a), dtype=np.bool_)
    for k in range(len(a)):
        di, dj = b[k, 0] - a[k, 0], b[k, 1] - a[k, 1]
        steps = int(2.0 * max(abs(di), abs(dj))) + 1
        for s in range(steps + 1):
            i, j = int(np.floor(a[k, 0] + di * s / steps)), int(np.floor(a[k, 1] + dj * s / steps))
            if 0 <= i < height and 0 <= j < width and blocked[i, j]:
                clear[k] = False
                break
    return clear


def in_cells(grid: GridMap, points: FloatArray) -> FloatArray:
    """Points (n, 2), m in M, as (row, column) in cells, as `sees` takes them."""
    return np.ascontiguousarray(((points - grid.origin) / grid.resolution)[:, ::-1])


def occupied_near(grid: GridMap, cells: CellArray, points: FloatArray, reach: float) -> FloatArray:
    """The centres of the occupied cells within the box of points (n, 2) and `reach` (m) more, as segments (m, 4) of no
    length, m in M."""
    low, high = cell_at(grid, points.min(axis=0) - reach), cell_at(grid, points.max(axis=0) + reach)
    box = cells[low[0] : high[0] + 1, low[1] : high[1] + 1]
    centers = center_of(grid, np.argwhere(box == OCCUPIED) + low)
    return np.hstack([centers, centers])


def find_ways(grid: GridMap, p_MB: FloatArray, robot: RobotConfig) -> Ways:
    """The cheapest ways from p_MB (2,), m in M, to all cells, over free cells with room for the robot.

    A step costs length * (1 + 2 max(0, 1 - d)^2) with d the room in metres, as an edge of the roadmap does. A robot
    that has no room itself begins with a straight line to any cell within WAY_OUT that has, no nearer to what is
    occupied than where it stands, if possible.
    """
    cells = classify(grid)
    room = room_round(cells, grid.resolution)
    traversable = (cells == FREE) & (room >= room_needed(robot))
    weight = cost_of_edge(np.ones_like(room), np.maximum(room, 0.0))
    sources = cell_at(grid, p_MB)[None]
    away = np.zeros(1)
    if not traversable[tuple(sources[0])]:
        sources, away = _ways_out(grid, cells, traversable, p_MB)
    flat = sources[:, 0] * traversable.shape[1] + sources[:, 1]
    begin = away / grid.resolution
    cost, length, before = cheapest(traversable, weight, flat, cost_of_edge(begin, np.zeros_like(begin)), begin)
    return Ways(cells, room, grid.resolution * cost, grid.resolution * length, before)


def _ways_out(grid: GridMap, cells: CellArray, traversable: BoolArray, p_MB: FloatArray) -> tuple[IntArray, FloatArray]:
    """Traversable cells (s, 2) to which a robot without room can drive straight, and how far they are (s,), m."""
    low, high = cell_at(grid, p_MB - WAY_OUT), cell_at(grid, p_MB + WAY_OUT)
    found = np.argwhere(traversable[low[0] : high[0] + 1, low[1] : high[1] + 1]) + low
    centers = center_of(grid, found)
    away = np.hypot(*(centers - p_MB).T)
    near = away <= WAY_OUT
    found, centers, away = found[near], centers[near], away[near]
    if len(found) == 0:
        return found, away
    blocks = occupied_near(grid, cells, p_MB[None], WAY_OUT + COMFORT)
    own = float(point_distance(p_MB[None], blocks)[0])
    no_nearer = clearance(lines_between(p_MB, centers), blocks, COMFORT) >= min(own, COMFORT) - 1e-9
    # Hemmed in: straight over whatever the map shows there to the nearest cell.
    chosen = no_nearer if no_nearer.any() else away == away.min()
    return found[chosen], away[chosen]


def plan_path(grid: GridMap, ways: Ways, p_MB: FloatArray, p_MG: FloatArray) -> FloatArray:
    """A path (k, 2), m in M, at intervals of 0.1 m along the cheapest way from p_MB (2,) to the cell of p_MG (2,).

    Shortened and rounded where that comes no nearer to what is occupied than the way itself, or than
    SHORTCUT_CLEARANCE, and stays on free cells. Empty where there is no way.
    """
    cell = tuple(cell_at(grid, p_MG))
    if not np.isfinite(ways.cost[cell]):
        return np.zeros((0, 2))
    flat, reverse = cell[0] * ways.cost.shape[1] + cell[1], []
    while flat >= 0:
        reverse.append(flat)
        flat = int(ways.before.flat[flat])
    points = center_of(grid, np.stack(np.unravel_index(reverse[::-1], ways.cost.shape), axis=1))
    start = p_MB[None]
    if ways.length[tuple(cell_at(grid, points[0]))] == 0.0:
        # The robot is in the way's first cell: no way out to be kept as it is.
        points, start = np.vstack([start, points[1:]]), start[:0]
    if len(points) + len(start) < 2:
        return np.zeros((0, 2))
    blocks = occupied_near(grid, ways.cells, points, SHORTCUT_CLEARANCE + grid.resolution)
    points = round_corners(_shorten(grid, ways.cells, points, blocks), blocks, SHORTCUT_CLEARANCE, 0.0)
    return resample(np.vstack([start, points]), PATH_STEP)


def _shorten(grid: GridMap, cells: CellArray, points: FloatArray, blocks: FloatArray) -> FloatArray:
    """A way (n, 2) from cell to cell with detours cut out, see plan_path; blocks: (m, 4) occupied cells."""
    if len(points) < 3:
        return points
    closed = cells != FREE
    pieces = clearance(lines_between(points[:-1], points[1:]), blocks, SHORTCUT_CLEARANCE)
    last = len(points) - 1
    kept, i = [0], 0
    while i < last:
        ends = np.arange(i + SHORTCUT_STRIDE, min(i + SHORTCUT_SPAN, last + 1), SHORTCUT_STRIDE)
        if last <= i + SHORTCUT_SPAN:
            ends = np.union1d(ends, [last])
        lines = lines_between(points[i], points[ends])
        replaced = np.minimum.accumulate(pieces[i : ends[-1]])[ends - i - 1]
        good = clearance(lines, blocks, SHORTCUT_CLEARANCE) >= replaced - 1e-9
        good &= sees(closed, in_cells(grid, lines[:, :2]), in_cells(grid, lines[:, 2:]))
        i = int(ends[good][-1]) if good.any() else i + 1
        kept.append(i)
    return points[kept]


def _rest(points: FloatArray, p_MB: FloatArray) -> FloatArray:
    """The part of a path (k, 2) from its point nearest to the robot on."""
    return points[int(np.argmin(np.hypot(*(points - p_MB).T))) :]


def path_in_grid_is_free(points: FloatArray, grid: GridMap, p_MB: FloatArray, robot: RobotConfig) -> bool:
    """Whether the rest of a path (k, 2), m in M, is open to the robot at p_MB (2,) in a newer grid.

    Nothing occupied may be nearer to it than the robot's radius; where the robot itself is nearer to something, than
    that.
    """
    if len(points) == 0:
        return True
    rest = np.vstack([_rest(points, p_MB), points[-1:]])
    need = robot.radius + 0.5 * grid.resolution
    blocks = occupied_near(grid, classify(grid), np.vstack([rest, p_MB]), need)
    own = float(point_distance(p_MB[None], blocks)[0])
    return bool(clearance(lines_between(rest[:-1], rest[1:]), blocks, need).min() >= min(need, 0.95 * own))


def path_in_scan_is_free(
    points: FloatArray, grid: GridMap, scan: LaserScan, X_MB: FloatArray, robot: RobotConfig
) -> bool:
    """Whether a scan taken at X_MB (3,) leaves the next two metres of a path (k, 2), m in M, open.

    Returns that the grid explains count only where the robot would touch what they are of (see path_is_free).
    """
    mapped = occupied_near(grid, classify(grid), X_MB[None, :2], RETURN_REACH)
    return path_is_free(points, scan, X_MB, robot.radius, mapped)


def with_returns(grid: GridMap, scan: LaserScan, X_MB: FloatArray) -> GridMap:
    """The grid with what a scan taken at X_MB (3,) met within RETURN_REACH marked as occupied.

    For a path round what the grid does not hold yet: it takes up a scan only now and then.
    """
    hit = scan.ranges < RETURN_REACH
    r, angle = scan.ranges[hit], scan.angles[hit]
    return with_points(grid, transform(X_MB, np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)))


def with_segments(grid: GridMap, segments: FloatArray) -> GridMap:
    """The grid with the cells on segments (m, 4), m in M, marked as occupied."""
    if not len(segments):
        return grid
    pieces = [resample(segment.reshape(2, 2), 0.5 * grid.resolution) for segment in segments]
    return with_points(grid, np.vstack(pieces))


def with_points(grid: GridMap, p_MP: FloatArray) -> GridMap:
    """The grid with the cells that hold points (n, 2), m in M, marked as occupied."""
    inside = ((p_MP >= grid.origin) & (p_MP < grid.origin + grid.resolution * np.array(grid.probability.T.shape))).all(
        1
    )
    probability = grid.probability.copy()
    probability[tuple(cell_at(grid, p_MP[inside]).T)] = 1.0
    return replace(grid, probability=probability)
