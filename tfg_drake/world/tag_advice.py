"""Where to hang tags, so that a robot that maps the building knows best where it is.

The robot is taken to look round once at places all over the floor it can reach, and to drive to each from a place
nearer to its start, by odometry. A tag adds what it would tell in those turns, by the noise that the explorer's
information gain takes a turn to have (`tfg_drake.planning.information_gain`); its own position is unknown and is
eliminated. Tags are chosen one by one, each the one that takes most from the entropy of the robot's positions, summed
over the places. What a tag promises is computed anew only when it comes to be the best: an older promise is taken for
a bound, because tags mostly share what they tell.
"""

from __future__ import annotations

import dataclasses
import heapq
import math
from collections.abc import Callable

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial import cKDTree

from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.geometry.visibility import line_of_sight
from tfg_drake.grid.path import cheapest
from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.planning.exact_gain import whitened
from tfg_drake.planning.information_gain import sightings_of_turn, turn_noise
from tfg_drake.planning.odometry_drift import odometry_covariance
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.world.reachability import CELL, make_grid, reachable_cells
from tfg_drake.world.tag_placement import place_tags
from tfg_drake.world.world import World, WorldError

# Greatest number of robot places and of tag candidates, with which 40 tags take some seconds.
PLACES = 160
CANDIDATES = 500
# Least distance between places, and between tags, m; candidates are farther apart in a large building.
PLACE_SPACING = 0.5
TAG_SPACING = 0.3
# Deviation of a position, m per axis, that need not be improved.
WELL_KNOWN = 0.005


@dataclasses.dataclass(frozen=True)
class Advice:
    """Tags to hang, the most telling first.

    p_WT: (n, 2) m, in front of the walls, and facing: (n,) rad, the headings of their normals. places: (p, 2) in W, m,
    where the robot was taken to be. deviation: (n + 1, p) m, what the position is known to at each, both axes together,
    before the first tag and after each.
    """

    p_WT: FloatArray
    facing: FloatArray
    places: FloatArray
    deviation: FloatArray


def advise_tags(
    world: World,
    count: int,
    mapper: PlanningParameters,
    *,
    floor: Callable[[FloatArray], BoolArray] | None = None,
    on_tag: Callable[[int], object] | None = None,
) -> Advice:
    """Where to hang `count` tags in a world, beside those that it has.

    Args:
        world: walls, start and the tags that stay.
        count: of tags to hang; fewer are advised where the walls have no room for as many.
        mapper: who will map the building.
        floor: says which points (n, 2) in W are floor (n,); None: all that can be reached.
        on_tag: called with the number of tags chosen so far.

    Raises:
        WorldError: there is no wall, or no room for the robot at its start.
    """
    radius = mapper.robot.radius
    places, parent = _places(world, radius, floor)
    if not len(world.walls) or not len(places):
        raise WorldError("no wall can be reached from the start; start where the robot has room, between walls")
    p_WT, facing = _candidates(world, radius)
    turns = _Turns(world, places, parent, mapper)
    for p, heading in zip(world.p_WT.copy(), world.tag_facing, strict=True):
        turns.hang(turns.rows(p, heading))
    rows = [turns.rows(p, heading) for p, heading in zip(p_WT, facing, strict=True)]
    heap = [(-turns.promise(one), i) for i, one in enumerate(rows)]
    heapq.heapify(heap)
    chosen: list[int] = []
    deviation = [turns.deviation()]
    while len(chosen) < count and heap:
        _, i = heapq.heappop(heap)
        if any(np.hypot(*(p_WT[i] - p_WT[j])) < TAG_SPACING and facing[i] == facing[j] for j in chosen):
            continue
        promise = turns.promise(rows[i])
        if heap and promise < -heap[0][0]:
            heapq.heappush(heap, (-promise, i))
            continue
        turns.hang(rows[i])
        chosen.append(i)
        deviation.append(turns.deviation())
        if on_tag is not None:
            on_tag(len(chosen))
    return Advice(p_WT[chosen].reshape(-1, 2), facing[chosen], places, np.array(deviation))


def _places(
    world: World, robot_radius: float, floor: Callable[[FloatArray], BoolArray] | None
) -> tuple[FloatArray, IntArray]:
    """Places (p, 2) over the floor, m, the start first, and from which earlier one each is driven to (p,), -1 for
    none."""
    grid = make_grid(world)
    mask = reachable_cells(grid, world, robot_radius)
    if floor is not None and mask.any():
        mask[mask] = floor(grid.centers(mask))
    cells = grid.centers(mask)
    if not len(cells):
        return cells, np.zeros(0, dtype=np.int64)
    start = np.flatnonzero(mask)[[np.argmin(np.hypot(*(cells - world.start[:2]).T))]]
    cost, _, _ = cheapest(mask, np.ones(mask.shape), start, np.zeros(1), np.zeros(1))
    near = mask & np.isfinite(cost)
    cells = grid.centers(near)
    tree, order = cKDTree(cells), np.argsort(cost[near], kind="stable").tolist()
    spacing = max(PLACE_SPACING, 0.8 * math.sqrt(len(order) * CELL**2 / PLACES))
    while True:
        chosen, taken = [], np.zeros(len(cells), dtype=np.bool_)
        for i in order:
            if not taken[i]:
                chosen.append(i)
                taken[tree.query_ball_point(cells[i], spacing)] = True
        if len(chosen) <= PLACES:
            break
        spacing *= 1.1
    places, parent = cells[chosen], np.full(len(chosen), -1)
    for k in range(1, len(chosen)):
        distance = np.hypot(*(places[:k] - places[k]).T)
        free = line_of_sight(world.walls, places[k], np.ascontiguousarray(places[:k]))
        parent[k] = int(np.argmin(np.where(free, distance, 1e6 + distance)))
    return places, parent


def _candidates(world: World, robot_radius: float) -> tuple[FloatArray, FloatArray]:
    """Where a tag could hang: p_WT (c, 2), m, and facing (c,), rad."""
    spacing = TAG_SPACING
    while True:
        _, p_WT, facing = place_tags(world.walls, world.start, spacing, robot_radius)
        if len(p_WT) <= CANDIDATES:
            break
        spacing *= max(1.1, len(p_WT) / CANDIDATES)
    if not len(world.p_WT) or not len(p_WT):
        return p_WT, facing
    distance, nearest = cKDTree(world.p_WT).query(p_WT)
    crowded = (distance < TAG_SPACING) & (np.cos(facing - world.tag_facing[nearest]) > 0.5)
    return p_WT[~crowded], facing[~crowded]


class _Turns:
    """The joint Gaussian of the poses at the first look and at all places, with the tags that hang so far."""

    def __init__(self, world: World, places: FloatArray, parent: IntArray, mapper: PlanningParameters) -> None:
        sensor, explorer = mapper.sensor, mapper.explorer
        self._walls, self._sensor = world.walls, sensor
        # The first look fixes the map: its pose is known, and it sees what is ahead of it alone.
        self._p = np.vstack([world.start[None, :2], places])
        self._ahead = world.start[2]
        looked = max(1.0, sensor.detection_probability * sensor.rate * explorer.first_look)
        self._noise = turn_noise(sensor, sightings_of_turn(sensor, explorer.turn_rate))
        self._first_noise = turn_noise(sensor, looked)
        self._covariance = self._driven(np.append(-1, parent + 1), mapper)

    def _driven(self, parent: IntArray, mapper: PlanningParameters) -> FloatArray:
        """The covariance (3n, 3n) of the poses by odometry alone, each reached from its parent."""
        n = len(self._p)
        S = np.zeros((n, 3, n, 3))
        look_round = 2.0 * math.pi / mapper.explorer.turn_rate
        for i in range(1, n):
            k = max(int(parent[i]), 0)
            d = self._p[i] - self._p[k]
            distance = np.array([np.hypot(*d)])
            X = np.append(self._p[k], 0.0)
            time = distance / mapper.robot.max_speed + look_round
            Q = odometry_covariance(X, self._p[i][None], distance, time, mapper.odometry)[0]
            F = np.eye(3)
            F[:2, 2] = -d[1], d[0]
            S[i, :, :i] = np.einsum("ab,bjc->ajc", F, S[k, :, :i])
            S[:i, :, i] = S[i, :, :i].transpose(1, 2, 0)
            S[i, :, i] = F @ S[k, :, k] @ F.T + Q
        return S.reshape(3 * n, 3 * n)

    def rows(self, p_WT: FloatArray, facing: float) -> tuple[IntArray, FloatArray]:
        """What the turns that see a tag tell of the poses, the tag's place eliminated: columns (c,) of the covariance
        and whitened rows (m, c), of unit noise."""
        sensor = self._sensor
        d = p_WT - self._p
        distance = np.hypot(*d.T)
        incidence = np.abs(wrap_angle(np.arctan2(-d[:, 1], -d[:, 0]) - facing))
        seen = (distance <= sensor.range) & (incidence <= sensor.max_incidence)
        seen[0] &= bool(abs(wrap_angle(math.atan2(d[0, 1], d[0, 0]) - self._ahead)) <= 0.5 * sensor.field_of_view)
        view = np.flatnonzero(seen)
        view = view[line_of_sight(self._walls, p_WT, np.ascontiguousarray(self._p[view]))]
        k = len(view)
        if k < 2:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 0))
        tag = whitened(d[view], self._noise)
        first = view == 0
        tag[first] = whitened(d[view[first]], self._first_noise)
        pose = np.zeros((k, 2, k, 3))
        each = np.arange(k)
        pose[each, :, each, :2] = -tag
        pose[each, 1, each, 2] = -1.0 / np.where(first, self._first_noise[3], self._noise[3])
        rest = np.linalg.qr(tag.reshape(2 * k, 2), mode="complete")[0][:, 2:]
        return (3 * view[:, None] + np.arange(3)).ravel(), rest.T @ pose.reshape(2 * k, 3 * k)

    def _taken(self, rows: tuple[IntArray, FloatArray]) -> FloatArray:
        """W (m, 3n): a tag takes W^T W off the covariance."""
        columns, A = rows
        cross = A @ self._covariance[columns]
        innovation = np.eye(len(A)) + cross[:, columns] @ A.T
        return np.asarray(solve_triangular(cholesky(innovation, lower=True), cross, lower=True, check_finite=False))

    def promise(self, rows: tuple[IntArray, FloatArray]) -> float:
        """How much a tag would take from the entropy of the positions, nats, summed over the places."""
        if not len(rows[1]):
            return 0.0
        W = self._taken(rows).reshape(-1, len(self._p), 3)[:, 1:, :2]
        return self._entropy(self._positions()) - self._entropy(self._positions() - np.einsum("mpa,mpb->pab", W, W))

    def hang(self, rows: tuple[IntArray, FloatArray]) -> None:
        """Adds a tag."""
        if len(rows[1]):
            W = self._taken(rows)
            self._covariance = self._covariance - W.T @ W

    def deviation(self) -> FloatArray:
        """What the position is known to at each place (p,), m."""
        return np.asarray(np.sqrt(np.trace(self._positions(), axis1=1, axis2=2)))

    def _positions(self) -> FloatArray:
        """Covariances (p, 2, 2) of the positions at the places, m^2."""
        n = len(self._p)
        each = np.arange(1, n)
        return np.asarray(self._covariance.reshape(n, 3, n, 3)[each, :2, each, :2])

    @staticmethod
    def _entropy(S: FloatArray) -> float:
        """Entropy of positions (p, 2, 2), nats, summed, less a constant; what is well known is not worth more."""
        determinant = (S[:, 0, 0] + WELL_KNOWN**2) * (S[:, 1, 1] + WELL_KNOWN**2) - S[:, 0, 1] ** 2
        return 0.5 * float(np.log(determinant).sum())
