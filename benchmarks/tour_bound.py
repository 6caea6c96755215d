"""A bound of the best tour from below, by relaxation: some things are far apart, and each must be seen from somewhere.

Of the floor a tour may leave a share unseen. So a thing is a tag, or a patch of one cell more than may be left unseen:
no tour is spared to see some of it. A tour comes, in some order, to places that see each of the things; from one to the
next it drives at least as far as it is between the two regions from which they are seen, past all walls and at full
speed, never turning. The shortest of all orders, found exactly, is the bound.

It is true to the walls, not to a lattice. A region's outline is taken at points ROUGH apart at most, and they count as
so much nearer to each other; the robot may pass walls by as much nearer than its radius, and round corners by the
chords of its circle.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from tfg_drake.comparison.best_tour import ToSee
from tfg_drake.comparison.known_ways import RING, way_graph
from tfg_drake.config import RobotConfig
from tfg_drake.geometry.distance import point_distance, room_beside
from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.geometry.segment_grid import segment_grid
from tfg_drake.geometry.visibility import cast_rays, line_of_sight
from tfg_drake.messages import BoolArray, FloatArray, IntArray

# Points of an outline are sampled every half SQUARE and rounded to a grid of SQUARE, m: then every point of the outline
# has one within ROUGH, m.
SQUARE = 0.1
ROUGH = SQUARE
# A tag's point of view lies OFF_WALL, m, in front of its wall.
OFF_WALL = 2e-3
# Number of rays of an outline, besides those to the ends of walls.
RAYS = 360
# Greatest number of things that are tried, and of those that enter the bound.
TRIED, THINGS = 24, 11
# Approximate number of a region's points by which it is found to lie within another one.
INSIDE = 20


def tour_bound(walls: FloatArray, start: FloatArray, see: ToSee, robot: RobotConfig) -> tuple[float, float]:
    """Time, s, and length, m, that no tour from start (2,) stays below; what of see can be seen at all must be."""
    walls = np.ascontiguousarray(walls)
    regions = [start[None]]
    # What a region is seen from, how far, and points of it.
    eyes, reach, inside = [start[None]], [0.0], [start[None]]
    for thing in _things(see, start, walls):
        region = _region(thing, see, walls, robot.radius - ROUGH)
        if len(region):
            regions.append(region)
            # From behind its wall nobody sees a tag.
            eyes.append(see.points[thing] + OFF_WALL * see.normals[thing])
            reach.append(float(see.limits[thing[0], 0]))
            some = region if see.is_tag[thing[0]] else see.points[thing]
            inside.append(some[:: max(1, len(some) // INSIDE)])
    apart = _apart(walls, regions, robot.radius - ROUGH)
    for i in range(len(regions)):
        for j in range(len(regions)):
            if any(_sees(walls, p, reach[j], inside[i]) for p in eyes[j]):  # the outlines of nested regions are apart
                apart[i, j] = apart[j, i] = 0.0
    length = _shortest_visit(apart)
    run_up = min(length, 0.5 * robot.max_speed**2 / robot.max_acceleration)
    time = math.sqrt(2.0 * run_up / robot.max_acceleration) + (length - run_up) / robot.max_speed
    return time, length


def _sees(walls: FloatArray, p: FloatArray, reach: float, points: FloatArray) -> bool:
    """Whether any of points (n, 2) is in sight of a point p (2,) within reach, m."""
    near = points[np.hypot(*(points - p).T) <= reach]
    return len(near) > 0 and bool(line_of_sight(walls, p, near).any())


def _things(see: ToSee, start: FloatArray, walls: FloatArray) -> list[IntArray]:
    """Rows of what is to be seen, a thing each: far from each other and the start."""
    cells, tags = np.flatnonzero(~see.is_tag), np.flatnonzero(see.is_tag)
    count = math.floor((1.0 - see.share) * len(cells) + 1e-9) + 1
    things = [tags[i : i + 1] for i in range(len(tags))]
    if len(cells):
        # Patches round cells that are spread evenly: those of its neighbours that the middle sees.
        tree = cKDTree(see.points[cells])
        for i in _spread(see.points[cells], start, 4 * TRIED):
            _, near = tree.query(see.points[cells[i]], k=min(4 * count, len(cells)))
            near = np.atleast_1d(near)
            near = near[line_of_sight(walls, see.points[cells[i]], see.points[cells[near]])][:count]
            if len(near) == count:
                things.append(cells[near])
    middles = np.array([see.points[thing].mean(axis=0) for thing in things]).reshape(-1, 2)
    return [things[i] for i in _spread(middles, start, TRIED)]


def _spread(points: FloatArray, start: FloatArray, count: int) -> list[int]:
    """Rows of so many of points (n, 2) at most, one after the other the farthest from those before it and the start."""
    chosen: list[int] = []
    if len(points):
        off = np.hypot(*(points - start).T)
        while len(chosen) < min(count, len(points)):
            chosen.append(int(np.argmax(off)))
            off = np.minimum(off, np.hypot(*(points - points[chosen[-1]]).T))
    return chosen


def _region(rows: IntArray, see: ToSee, walls: FloatArray, room: float) -> FloatArray:
    """Points (n, 2), m, near the outline of the region from which some of these rows are seen, where a robot has room,
    m."""
    from_points, reach = see.points[rows] + OFF_WALL * see.normals[rows], float(see.limits[rows[0], 0])
    outlines = []
    for p in from_points:
        corners = _outline(p, reach, walls)
        d = np.roll(corners, -1, axis=0) - corners
        count = 1 + (np.hypot(*d.T) / (0.5 * SQUARE)).astype(np.int64)
        edge = np.repeat(np.arange(len(d)), count)
        share = (np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)) / count[edge]
        outlines.append(corners[edge] + share[:, None] * d[edge])
    squares = np.unique(np.round(np.concatenate(outlines) / SQUARE).astype(np.int64), axis=0)
    points = SQUARE * squares.astype(np.float64)
    points = points[point_distance(points, walls) >= room]
    return np.asarray(points[~_deep(points, from_points, reach, walls)])


@read_only_arguments
@njit(cache=True)
def _deep(points: FloatArray, from_points: FloatArray, reach: float, walls: FloatArray) -> BoolArray:
    """Which points (n, 2) are so deep in sight of one of from_points (m, 2), within reach (m) past walls (w, 4), that
    no outline of the region is near, (n,)."""
    grid, room, deep = segment_grid(walls), 1.5 * SQUARE, np.zeros(len(points), dtype=np.bool_)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        for j in range(len(from_points)):
            a, b = from_points[j, 0], from_points[j, 1]
            if math.hypot(a - x, b - y) < reach - room and room_beside(a, b, x, y, walls, grid, room) >= room:
                deep[i] = True
                break
    return deep


def _outline(p: FloatArray, reach: float, walls: FloatArray) -> FloatArray:
    """Corners (k, 2), m, of all that is in sight of a point p (2,) within reach (m), or a little more."""
    d = walls.reshape(-1, 2) - p
    ends = np.arctan2(d[:, 1], d[:, 0])
    a, along = walls[:, :2] - p, walls[:, 2:] - walls[:, :2]
    # Where walls leave the circle, beside where they end.
    square, half = (along**2).sum(axis=1), (a * along).sum(axis=1)
    inside = half**2 - square * ((a**2).sum(axis=1) - reach**2)
    root = np.sqrt(np.maximum(inside, 0.0))
    cuts = [a + ((sign * root - half) / square)[:, None] * along for sign in (-1.0, 1.0)]
    cut = np.concatenate([c[inside > 0.0] for c in cuts])
    all_round = np.linspace(-math.pi, math.pi, RAYS, endpoint=False)
    angles = np.concatenate([all_round, ends, np.arctan2(cut[:, 1], cut[:, 0])])
    angles = np.unique(np.concatenate([angles, angles - 1e-7, angles + 1e-7]))
    hit = cast_rays(walls, p, angles, reach)
    hit = np.where(np.isfinite(hit), hit, reach / math.cos(math.pi / RAYS))
    return np.asarray(p + hit[:, None] * np.column_stack([np.cos(angles), np.sin(angles)]))


def _apart(walls: FloatArray, regions: list[FloatArray], radius: float) -> FloatArray:
    """How far it is at least from region to region, (r, r) m, for a robot of a radius, m."""
    room = radius * math.cos(math.pi / RING)
    nodes, graph = way_graph(walls, np.zeros((0, 2)), radius, room)
    n, count = len(nodes), len(regions)
    to_nodes = np.array([_least(region, nodes, np.full(len(nodes), np.inf), walls, room) for region in regions])
    from_nodes = dijkstra(graph, indices=np.arange(n)) if n else np.zeros((0, 0))
    apart = np.zeros((count, count))
    for i in range(count):
        reached = (to_nodes[i][:, None] + from_nodes).min(axis=0, initial=np.inf)
        for j in range(i):
            apart[i, j] = np.min(reached + to_nodes[j], initial=np.inf)
            apart[i, j] = _least(regions[j], regions[i], np.full(len(regions[i]), apart[i, j]), walls, room).min()
            apart[j, i] = apart[i, j] = max(0.0, apart[i, j] - 2.0 * ROUGH)
    return apart


@read_only_arguments
@njit(cache=True)
def _least(
    from_points: FloatArray, to_points: FloatArray, than: FloatArray, walls: FloatArray, room: float
) -> FloatArray:
    """How far it is straight from the nearest of from_points (n, 2) to each of to_points (m, 2) with room (m) to walls
    (w, 4), (m,) m, where that is less than `than` (m,)."""
    grid, least = segment_grid(walls), than.copy()
    for j in range(len(to_points)):
        x, y = to_points[j, 0], to_points[j, 1]
        for i in range(len(from_points)):
            a, b = from_points[i, 0], from_points[i, 1]
            d = math.hypot(a - x, b - y)
            if d < least[j] and room_beside(a, b, x, y, walls, grid, room) >= room - 1e-6:
                least[j] = d
    return least


def _shortest_visit(apart: FloatArray) -> float:
    """The most that the shortest chain from row 0 through some of the other rows of (r, r) is, m: rows are added one
    after the other, the one first by which it becomes longest."""
    chosen, best = [0], 0.0
    rest = [i for i in range(1, len(apart)) if np.isfinite(apart[0, i])]
    while rest and len(chosen) <= THINGS:
        longer = [shortest_chain(np.ascontiguousarray(apart[np.ix_([*chosen, i], [*chosen, i])])) for i in rest]
        k = int(np.argmax(longer))
        if longer[k] <= best + 1e-9:
            break
        best = longer[k]
        chosen.append(rest.pop(k))
    return best


@read_only_arguments
@njit(cache=True)
def shortest_chain(apart: FloatArray) -> float:
    """Length of the shortest chain from row 0 through all other rows of distances (r, r), ending anywhere (Held and
    Karp 1962). No row is reached sooner than straight from row 0: regions do not keep the triangle's inequality."""
    n = len(apart) - 1
    cost = np.full((1 << n, n), np.inf)
    for j in range(n):
        cost[1 << j, j] = apart[0, j + 1]
    for visited in range(1, 1 << n):
        for j in range(n):
            if cost[visited, j] < np.inf:
                for k in range(n):
                    if not visited >> k & 1:
                        more = max(cost[visited, j] + apart[j + 1, k + 1], apart[0, k + 1])
                        cost[visited | 1 << k, k] = min(cost[visited | 1 << k, k], more)
    return float(cost[(1 << n) - 1].min()) if n else 0.0
