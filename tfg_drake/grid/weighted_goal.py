"""The goal of most information about grid and pose, weighted: the rule of Bourgault et al. (IROS 2002), eq. 1 of the
paper.

A candidate is worth weight_map * I_OG + weight_pose * I_SLAM, per expected second. I_OG is the entropy of the grid
that a turn there would remove, I_SLAM how much better the pose would be known after the way there, by odometry, and
matching the turn's scans with the known grid, than after another turn where the robot stands.

The published rule takes the largest sum, whatever the way: the robot would cross the map for the best view. And the
drop of entropy from arrival to after the match is no measure of a place, as the way there brings about most of it:
about 10 nats wherever there are walls, so that by it the robot visits every known place before the last frontiers.
Stachniss et al. (RSS 2005) pay for the way by a cost with a weight of its own; a rate needs none.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from scipy import ndimage
from scipy.spatial import cKDTree

from tfg_drake.config import ExplorerConfig, GridConfig, OdometryConfig, RobotConfig, ScanConfig
from tfg_drake.grid.frontier import FREE, OCCUPIED, UNKNOWN, CellArray, center_of
from tfg_drake.grid.frontier_goal import AT_HAND, Access, TriedPlaces, find_access, goal_among, no_goal
from tfg_drake.grid.gmapping import POSE_FLOOR
from tfg_drake.grid.path import Ways, find_ways, in_cells
from tfg_drake.messages import FloatArray, GoalChoice, GridMap, IntArray, PoseEstimate
from tfg_drake.planning.candidates import OVERHEAD
from tfg_drake.planning.odometry_drift import odometry_covariance

# Spacing of the candidates at known places, m.
KNOWN_SPREAD = 2.0
# Number of rays cast around a candidate.
RAYS = 180
# Surfaces' directions are those of the grid's slope, smoothed by this many cells.
SMOOTHING = 2.0
# Least cosine of the incidence of a ray that counts.
LEAST_COSINE = 0.2


@njit(cache=True)
def _look_round(
    cells: CellArray, slope: FloatArray, points: FloatArray, reach: float, rays: int
) -> tuple[FloatArray, FloatArray]:
    """Area of unknown cells in view of each point (c, 2), and what the surfaces in view say of a pose there.

    All lengths in cells, points as (row, column). slope: (2, h, w) along rows and columns, of any scale. reach: of
    the rays. Unknown cells hide nothing; surfaces count that are seen through free cells only. Second: (c, 3, 3) the
    sum over the rays of J^T J, J the derivatives of a range by (column, row, heading); Censi, ICRA 2007.
    """
    height, width = cells.shape
    area, information = np.zeros(len(points)), np.zeros((len(points), 3, 3))
    J = np.empty(3)
    for k in range(len(points)):
        for ray in range(rays):
            angle = 2.0 * math.pi * ray / rays
            c, s = math.cos(angle), math.sin(angle)
            i0, j0, known = int(points[k, 0]), int(points[k, 1]), True
            r = 0.5
            while r < reach:
                i, j = math.floor(points[k, 0] + r * s), math.floor(points[k, 1] + r * c)
                if not (0 <= i < height and 0 <= j < width):
                    break
                if cells[i, j] == OCCUPIED:
                    # On the surface itself, one cell thick, the slope is that of nothing: take it just before.
                    nx, ny = slope[1, i0, j0], slope[0, i0, j0]
                    size = math.sqrt(nx * nx + ny * ny)
                    cosine = (nx * c + ny * s) / size if size > 0.0 else 0.0
                    if known and cosine > LEAST_COSINE:
                        J[0], J[1] = -nx / (size * cosine), -ny / (size * cosine)
                        J[2] = r * (nx * s - ny * c) / (size * cosine)
                        for a in range(3):
                            for b in range(3):
                                information[k, a, b] += J[a] * J[b]
                    break
                if cells[i, j] == UNKNOWN:
                    known = False
                    # The sector's share of this step stands for all cells between the rays.
                    area[k] += 2.0 * math.pi / rays * r
                i0, j0 = i, j
                r += 1.0
    return area, information


def grid_gain(unknown: FloatArray) -> FloatArray:
    """I_OG (c,), nats: the entropy of so many unknown cells (c,), of even odds, known afterwards."""
    return math.log(2.0) * unknown


def log_variance(covariance: FloatArray, information: FloatArray) -> FloatArray:
    """Log-determinants (c,) of covariances (c, 3, 3) of a pose after information (c, 3, 3) was added."""
    prior = covariance + np.diag(POSE_FLOOR**2)
    return np.asarray(np.linalg.slogdet(prior)[1] - np.linalg.slogdet(np.eye(3) + prior @ information)[1])


def pose_gain(here: FloatArray, there: FloatArray) -> FloatArray:
    """I_SLAM (c,), nats, from the log_variance (1,) after a turn here and those (c,) after one there, 0 if larger."""
    return np.maximum(0.0, 0.5 * (here - there))


def predicted_covariance(
    pose: PoseEstimate, points: FloatArray, length: FloatArray, speed: float, odometry: OdometryConfig
) -> FloatArray:
    """Covariance (c, 3, 3) of the pose X_MB on arrival at each of the points (c, 2), m in M, by odometry alone.

    length: (c,) m of the ways there, speed: m/s on them.
    """
    J = np.broadcast_to(np.eye(3), (len(points), 3, 3)).copy()
    J[:, 0, 2], J[:, 1, 2] = pose.X_MB[1] - points[:, 1], points[:, 0] - pose.X_MB[0]
    grown = odometry_covariance(pose.X_MB, points, length, length / speed, odometry)
    return np.asarray(J @ pose.covariance @ J.transpose(0, 2, 1) + grown)


def _expected(
    grid: GridMap,
    ways: Ways,
    stand: IntArray,
    pose: PoseEstimate,
    odometry: OdometryConfig,
    scan: ScanConfig,
    robot: RobotConfig,
) -> tuple[FloatArray, FloatArray]:
    """I_OG and I_SLAM (c,), nats, of a turn at each of the cells (c, 2)."""
    res = grid.resolution
    solid = (ways.cells != FREE).astype(np.float64)
    slope = np.stack([ndimage.gaussian_filter(solid, SMOOTHING, order=order) for order in ((1, 0), (0, 1))])
    points = np.vstack([center_of(grid, stand), pose.X_MB[None, :2]])
    area, summed = _look_round(ways.cells, slope, in_cells(grid, points), scan.range / res, RAYS)
    # A range is matched with a surface that is known to half a cell; each ray cast stands for several of the turn's.
    weight = 2.0 * math.pi / RAYS / scan.resolution / (scan.noise**2 + (0.5 * res) ** 2)
    scale = np.array([1.0, 1.0, res])
    information = weight * summed * np.outer(scale, scale)
    predicted = predicted_covariance(pose, points[:-1], ways.length[tuple(stand.T)], robot.max_speed, odometry)
    here, there = log_variance(pose.covariance[None], information[-1:]), log_variance(predicted, information[:-1])
    return grid_gain(area[:-1]), pose_gain(here, there)


def _one_a_square(points: FloatArray, cost: FloatArray, side: float) -> IntArray:
    """Rows of the points (n, 2) that are the cheapest (n,) of their square of this side (m), ascending."""
    order = np.argsort(cost, kind="stable")
    _, first = np.unique(np.floor(points[order] / side), axis=0, return_index=True)
    return np.sort(order[first])


def _candidates(
    grid: GridMap, ways: Ways, access: Access, pose: PoseEstimate, tried: TriedPlaces
) -> tuple[IntArray, FloatArray, int]:
    """Cells (c, 2) to turn at, what for (c, 2), m in M, and how many of them, the first, are for a frontier.

    The others are known places where the robot was not sent yet: each is visited for the pose once, or the robot
    would come back to them for ever.
    """
    rows = np.flatnonzero(access.worth)
    # From one place the robot looks at what is at hand.
    rows = rows[_one_a_square(access.p_MF[rows], access.cost[rows], AT_HAND)]
    stride = max(1, round(KNOWN_SPREAD / grid.resolution))
    places = stride * np.argwhere(ways.reachable[::stride, ::stride])
    centers = center_of(grid, places)
    been = cKDTree(np.vstack([tried.p_MF, pose.X_MB[None, :2]]))
    new = been.query(centers)[0] >= 0.5 * KNOWN_SPREAD
    return np.vstack([access.stand[rows], places[new]]), np.vstack([access.p_MF[rows], centers[new]]), len(rows)


def choose(
    grid: GridMap,
    pose: PoseEstimate,
    tried: TriedPlaces,
    odometry: OdometryConfig,
    scan: ScanConfig,
    robot: RobotConfig,
    explorer: ExplorerConfig,
    weights: GridConfig,
) -> tuple[GoalChoice, TriedPlaces]:
    """The candidate of most weighted information, per expected second where weights.per_time says so, or how the
    mission ends, and the tries with it.

    The robot has just looked round at pose.X_MB. Ends by the rule of `frontier_goal`: while a frontier is worth a goal,
    known places compete with it. GoalChoice.exploration is weight_map * I_OG, exploitation weight_pose * I_SLAM.
    GoalChoice.node and candidates are flat indices of grid cells.
    """
    p_MB = pose.X_MB[:2]
    ways = find_ways(grid, p_MB, robot)
    access = find_access(grid, ways, p_MB, tried, robot, explorer.frontier_attempts)
    if not access.worth.any():
        return no_goal(grid, access, ways, p_MB, robot), tried
    stand, p_MF, frontiers = _candidates(grid, ways, access, pose, tried)
    map_gain, certainty = _expected(grid, ways, stand, pose, odometry, scan, robot)
    exploration, exploitation = weights.weight_map * map_gain, weights.weight_pose * certainty
    gain = exploration + exploitation
    time = ways.length[tuple(stand.T)] / robot.max_speed + 2.0 * math.pi / explorer.turn_rate + OVERHEAD
    value = gain / time if weights.per_time else gain
    best = int(np.argmax(value))
    what = "a frontier" if best < frontiers else "a known place"
    reason = f"{map_gain[best]:.0f} nats of the grid and {certainty[best]:.1f} of the pose are expected at {what}."
    choice = goal_among(grid, stand, best, value, reason, exploration, exploitation)
    return choice, TriedPlaces(np.vstack([tried.p_MF, p_MF[best : best + 1]]), best < frontiers)
