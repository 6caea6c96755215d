"""Converts a way through the roadmap to a path that the robot can follow, and checks whether a path is open."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from tfg_drake.config import NODE_MARGIN, RobotConfig
from tfg_drake.geometry.distance import clearance, point_distance, point_segment_distance, room_beside
from tfg_drake.geometry.read_only import read_only_arguments
from tfg_drake.geometry.se2 import compose, inverse, transform
from tfg_drake.geometry.segment_grid import SegmentGrid, segment_grid
from tfg_drake.geometry.star import line_in_stars, star_index
from tfg_drake.messages import BoolArray, FloatArray, IntArray, LaserScan, MapEstimate, TfgMap
from tfg_drake.planning.chance_constraint import TRACKING_DEVIATION, deviation_along, required_clearance
from tfg_drake.planning.parameters import COMFORT, PlanningParameters
from tfg_drake.planning.roadmap import RETURN_OFF, RoadmapState, in_free_space
from tfg_drake.planning.routes import Routes, node_path, nodes_to, routes

# A shortcut with this clearance, m, may replace a way with more.
SHORTCUT_CLEARANCE = 0.35
# Shortcuts begin and end at multiples of SHORTCUT_STEP, m, and span at most SHORTCUT_REACH of them.
SHORTCUT_STEP = 0.4
SHORTCUT_REACH = 24
# A corner is rounded over at most this length before and behind it, m.
ROUNDING = 0.6
# Number of points of a rounded corner.
ARC_POINTS = 8
# Time until a new path is followed, s.
REACTION = 1 / 16
# Spacing of a path's points, m.
PATH_STEP = 0.1
# A collision probability that is taken as zero.
NO_RISK = 1e-4
# Length of the path ahead that must be free, m.
LOOK_AHEAD = 2.0
# Unmapped obstacles block a path within this distance of the robot, m; a person farther ahead will have passed.
UNMAPPED_AHEAD = 1.25
# Greatest deviation of the follower from its path at full speed, m (99 % of its commands, benchmarks/tracking.py).
STRAYS = 0.01
# Assumed depth of an unmapped obstacle, m, whose far side is not visible.
BODY = 0.3


def resample(points: FloatArray, step: float) -> FloatArray:
    """Return points (k, 2) at equal intervals of at most step (m) along a polyline (n, 2), both ends included."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    count = max(1, int(np.ceil(along[-1] / step - 1e-9)))
    s = np.linspace(0.0, along[-1], count + 1)
    return np.stack([np.interp(s, along, points[:, 0]), np.interp(s, along, points[:, 1])], axis=1)


def lines_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return segments (n, 4) from points (n, 2) to others (n, 2); either may be a single point (2,)."""
    return np.hstack(np.broadcast_arrays(np.atleast_2d(a), np.atleast_2d(b)))


def _insert(points: FloatArray, step: float) -> FloatArray:
    """Return a polyline (n, 2) with extra points on its pieces, at intervals of at most step, m."""
    pieces = [resample(points[i : i + 2], step)[:-1] for i in range(len(points) - 1)]
    return np.vstack([*pieces, points[-1:]])


def shortcut(points: FloatArray, tfg: TfgMap, segments: FloatArray, enough: float, least: float) -> FloatArray:
    """Return a polyline (n, 2) without detours, where the straight line is as safe as the part that it replaces.

    segments: (m, 4) all obstacles, m in M. The line keeps the clearance of the part it replaces or `enough` (m),
    whichever is less, but at least `least` (m), and lies in known free space.
    """
    points = _insert(points, SHORTCUT_STEP)
    return points[_shortest(points, segments, enough, least, tfg.star_offsets, tfg.star_vertices)]


@njit(cache=True)
def _shortest(
    points: FloatArray,
    segments: FloatArray,
    enough: float,
    least: float,
    star_offsets: IntArray,
    star_vertices: FloatArray,
) -> IntArray:
    """Return the points (k,) of a polyline (n, 2) that remain without its detours, see shortcut."""
    grid, stars = segment_grid(segments), star_index(star_offsets, star_vertices)
    near, room = np.empty(len(stars[1][4]), dtype=np.int64), np.empty(len(points))
    for i in range(len(points) - 1):
        a, b = points[i], points[i + 1]
        room[i] = room_beside(a[0], a[1], b[0], b[1], segments, grid, enough)
    kept, count, i = np.zeros(len(points), dtype=np.int64), 1, 0
    replaced = np.empty(SHORTCUT_REACH)
    while i < len(points) - 1:
        last = min(i + SHORTCUT_REACH, len(points) - 1)
        replaced[0] = room[i]
        for j in range(i + 1, last):
            replaced[j - i] = min(replaced[j - i - 1], room[j])
        following = i + 1
        for j in range(last, i + 1, -1):
            ax, ay, bx, by = points[i, 0], points[i, 1], points[j, 0], points[j, 1]
            needed = max(least, replaced[j - i - 1]) - 1e-9
            if room_beside(ax, ay, bx, by, segments, grid, enough) < needed:
                continue
            if line_in_stars(ax, ay, bx, by, star_offsets, star_vertices, stars, near):
                following = j
                break
        i = following
        kept[count] = i
        count += 1
    return kept[:count]


@njit(cache=True)
def _room(a: FloatArray, b: FloatArray, segments: FloatArray, grid: SegmentGrid, enough: float) -> float:
    """As `room_beside`, of the edge between two points (2,)."""
    return float(room_beside(a[0], a[1], b[0], b[1], segments, grid, enough))


@read_only_arguments
@njit(cache=True)
def round_corners(points: FloatArray, segments: FloatArray, enough: float, least: float) -> FloatArray:
    """Return a polyline (n, 2) with its corners replaced by parabolas, as large as the clearance (see shortcut)
    allows."""
    grid, arc = segment_grid(segments), np.empty((ARC_POINTS, 2))
    smooth, count = np.empty((ARC_POINTS * len(points), 2)), 1
    smooth[0] = points[0]
    for i in range(1, len(points) - 1):
        corner, back, on = points[i], points[i - 1] - points[i], points[i + 1] - points[i]
        to_back, to_on = math.hypot(back[0], back[1]), math.hypot(on[0], on[1])
        sharp = _room(corner, points[i - 1], segments, grid, enough)
        sharp = max(least, min(sharp, _room(corner, points[i + 1], segments, grid, enough)))
        cut, rounded = min(ROUNDING, 0.5 * min(to_back, to_on)), False
        while cut > 0.05 and not rounded:
            a, b = corner + back / to_back * cut, corner + on / to_on * cut
            rounded = True
            for k in range(ARC_POINTS):
                t = k * (1.0 / (ARC_POINTS - 1))
                arc[k] = (1 - t) ** 2 * a + 2 * t * (1 - t) * corner + t**2 * b
                if k > 0 and _room(arc[k - 1], arc[k], segments, grid, enough) < sharp - 1e-9:
                    rounded = False
                    break
            cut *= 0.6
        smooth[count] = corner
        if rounded:
            smooth[count : count + ARC_POINTS] = arc
        count += ARC_POINTS if rounded else 1
    smooth[count] = points[-1]
    return smooth[: count + 1]


def plan_path(
    state: RoadmapState,
    estimate: MapEstimate,
    tfg: TfgMap,
    X_MB: FloatArray,
    node: int,
    parameters: PlanningParameters,
    obstacles: FloatArray | None = None,
    speed: float = 0.0,
) -> FloatArray:
    """Return a path (k, 2), m in M, at intervals of 0.1 m from the robot's pose X_MB (3,) to a node; empty without one.

    The roadmap's edges keep the chance constraint by the deviation at their ends. The path is smoothed where it keeps
    the constraint at each of its points, TRACKING_DEVIATION allowed, and otherwise follows the edges. obstacles: (b, 4)
    segments met at this stage that the map does not hold, m in M. speed: m/s, of the moving robot, whose path begins
    straight ahead with its stopping distance if there is room.
    """
    robot = parameters.robot
    obstacles = np.zeros((0, 4)) if obstacles is None else obstacles
    segments = np.vstack([tfg.obstacles, obstacles])
    X_MS = _where_it_stops(X_MB, speed, tfg, segments, robot)
    if node < len(state.points) and np.hypot(*(state.points[node] - X_MB[:2])) < 2.0 * np.hypot(*(X_MS - X_MB)[:2]):
        X_MS = X_MB
    before = X_MB[None, :2] if X_MS is not X_MB else np.zeros((0, 2))
    ways = routes(state, tfg, X_MS, parameters, obstacles)
    way = node_path(state, ways, X_MS, node)
    if len(way) < 2 or np.hypot(*np.ptp(way, axis=0)) < 1e-6:
        return np.zeros((0, 2))
    room, enough = robot.radius + NODE_MARGIN, max(SHORTCUT_CLEARANCE, _required(state, ways, node, parameters))
    straight = np.vstack([before, shortcut(way, tfg, segments, enough, room)])
    smooth = resample(round_corners(straight, segments, enough, room), PATH_STEP)
    if too_narrow(smooth, estimate, tfg, parameters).any():
        return resample(np.vstack([before, way]), PATH_STEP)
    return smooth


def too_narrow(path: FloatArray, estimate: MapEstimate, tfg: TfgMap, parameters: PlanningParameters) -> BoolArray:
    """Return a mask of the points (k,) of a path (k, 2), m in M, that lack more than TRACKING_DEVIATION of the
    clearance that the chance constraint requires."""
    sigma = deviation_along(path, estimate, tfg, parameters)
    need = (
        required_clearance(parameters.robot.radius, sigma, parameters.planner.collision_probability)
        - TRACKING_DEVIATION
    )
    return np.asarray(clearance(lines_between(path, path), tfg.obstacles, float(need.max())) < need)


def _where_it_stops(
    X_MB: FloatArray, speed: float, tfg: TfgMap, segments: FloatArray, robot: RobotConfig
) -> FloatArray:
    """Return the pose (3,) where a robot at X_MB (3,) with a speed (m/s) can stop at the earliest, if it has room among
    the segments (m, 4), m in M, on the way; otherwise X_MB."""
    if speed <= 0.0:
        return X_MB
    X_MS = compose(X_MB, np.array([speed * (REACTION + 0.5 * speed / robot.max_acceleration), 0.0, 0.0]))
    ahead = lines_between(X_MB[:2], X_MS[:2])
    room = clearance(ahead, segments, COMFORT)[0] >= robot.radius + NODE_MARGIN
    return X_MS if room and in_free_space(ahead, tfg)[0] else X_MB


def _required(state: RoadmapState, ways: Routes, node: int, parameters: PlanningParameters) -> float:
    """Return the largest clearance, m, that the chance constraint requires on the way to a node."""
    nodes, planner = nodes_to(ways, node), parameters.planner
    if planner.risk == "path":
        # Where a shortcut passes, it should add nothing to the risk of the whole.
        probability = np.minimum(planner.collision_probability, NO_RISK)
        return float(required_clearance(parameters.robot.radius, state.sigma[nodes].max(initial=0.0), probability))
    return float(state.edges.required[edges_on(state, nodes)].max(initial=0.0))


def edges_on(state: RoadmapState, nodes: list[int]) -> BoolArray:
    """Return a mask of the usable edges (e,) between these nodes."""
    on = np.zeros(len(state.points), dtype=np.bool_)
    on[nodes] = True
    return np.asarray(on[state.edges.nodes[:, 0]] & on[state.edges.nodes[:, 1]] & state.edges.usable)


@njit(cache=True)
def _beside(
    points: FloatArray, ranges: FloatArray, angles: FloatArray, X_MB: FloatArray, reach: float
) -> tuple[FloatArray, FloatArray]:
    """The returns (h, 2), m in M, of a scan (b,), (b,) taken at pose X_MB (3,), and how far (h,), m, each is from the
    next LOOK_AHEAD metres of a path (k, 2) from the point nearest to the robot, reach (m) where that is farther."""
    hits, distance = np.empty((len(ranges), 2)), np.full(len(ranges), reach)
    first, nearest = 0, np.inf
    for k in range(len(points)):
        square = (points[k, 0] - X_MB[0]) ** 2 + (points[k, 1] - X_MB[1]) ** 2
        if square < nearest:
            first, nearest = k, square
    ahead = points[first : first + 1 + round(LOOK_AHEAD / PATH_STEP)]
    left, right, low, high = np.inf, -np.inf, np.inf, -np.inf
    for k in range(len(ahead)):
        left, right = min(left, ahead[k, 0] - reach), max(right, ahead[k, 0] + reach)
        low, high = min(low, ahead[k, 1] - reach), max(high, ahead[k, 1] + reach)
    c, s = math.cos(X_MB[2]), math.sin(X_MB[2])
    count = 0
    for i in range(len(ranges)):
        if not math.isfinite(ranges[i]):
            continue
        ahead_of, beside = ranges[i] * math.cos(angles[i]), ranges[i] * math.sin(angles[i])
        x, y = X_MB[0] + c * ahead_of - s * beside, X_MB[1] + s * ahead_of + c * beside
        hits[count, 0], hits[count, 1] = x, y
        if left < x < right and low < y < high:
            for k in range(len(ahead)):
                j = max(k - 1, 0)
                apart = point_segment_distance(x, y, ahead[j, 0], ahead[j, 1], ahead[k, 0], ahead[k, 1])
                distance[count] = min(distance[count], apart)
        count += 1
    return hits[:count], distance[:count]


def path_is_free(
    points: FloatArray, scan: LaserScan, X_MB: FloatArray, radius: float, segments: FloatArray, *, bold: bool = False
) -> bool:
    """Return whether the next two metres of a path (k, 2), m in M, are open to a disc of a radius (m) at X_MB (3,).

    The path is blocked by two returns of the scan that no mapped surface (segments (m, 4)) explains, within the radius
    plus 2 cm of the path and within UNMAPPED_AHEAD of the robot; also by returns of mapped surfaces that the disc may
    touch, as a surface may extend a little beyond its end in the map. bold: only overlaps of 2 cm block it.
    """
    near = radius + 0.02
    hits, distance = _beside(points, scan.ranges, scan.angles, X_MB, near)
    close = np.flatnonzero(distance < near)
    if len(close) < 2:
        return True
    unmapped = point_distance(hits[close], segments) > RETURN_OFF
    here = ~unmapped | (np.hypot(*(hits[close] - X_MB[:2]).T) < UNMAPPED_AHEAD)
    close, unmapped = close[here], unmapped[here]
    if np.count_nonzero(distance[close] < radius + (-0.02 if bold else STRAYS)) >= 2:
        return False
    return bold or int(np.count_nonzero(unmapped)) < 2


def unmapped_obstacles(
    points: FloatArray, scan: LaserScan, X_MB: FloatArray, radius: float, segments: FloatArray
) -> FloatArray:
    """Return obstacles on a path (see path_is_free), as short segments (b, 4), m in M, for the next path to avoid.

    They consist of the returns within COMFORT of the robot's outline on the path ahead that no mapped surface explains,
    or that it may touch. Neighbours too close for the robot to pass between them are joined; an assumed body is added
    behind unexplained ones.
    """
    reach = radius + COMFORT
    hits, distance = _beside(points, scan.ranges, scan.angles, X_MB, reach)
    unmapped = point_distance(hits, segments) > RETURN_OFF
    hits = hits[(distance < reach) & (unmapped | (distance < radius + STRAYS))]
    if len(hits) == 0:
        return np.zeros((0, 4))
    following = np.vstack([hits[1:], hits[-1:]])
    joined = np.hypot(*(following - hits).T) < 2.0 * radius
    fronts = lines_between(hits, np.where(joined[:, None], following, hits))
    front = hits[point_distance(hits, segments) > RETURN_OFF]
    away = front - X_MB[:2]
    behind = front + BODY * away / np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-9)[:, None]
    return np.vstack([fronts, lines_between(front, behind)])


def seen_past(obstacles: FloatArray, scan: LaserScan, X_MB: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return masks of the obstacles met on the way (b, 4), m in M, that a scan at X_MB (3,) sees past, by the ray to
    the middle of each and its neighbours, and of those in its view."""
    middle = transform(inverse(X_MB), 0.5 * (obstacles[:, :2] + obstacles[:, 2:]))
    bearing, distance = np.arctan2(middle[:, 1], middle[:, 0]), np.hypot(middle[:, 0], middle[:, 1])
    ray = np.searchsorted(scan.angles, bearing)
    in_view = (ray > 1) & (ray < len(scan.angles) - 1)
    least = scan.ranges[np.where(in_view, ray, 2)[:, None] + np.arange(-2, 2)].min(axis=1)
    return in_view & (least > distance + RETURN_OFF), in_view
