"""People who walk about in the simulated building: discs that keep off walls and, mostly, out of the robot's way.

A person walks to a random place by a short way along free ground, sometimes stands there for a while, and walks on to
another. Whose way the robot bars waits for a moment and walks elsewhere, round it if there is room; some stop in front
of it out of curiosity. Nobody walks into a robot that moves; one that stands may be overlooked. People walk through
each other.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy import ndimage

from tfg_drake.geometry.distance import clearance, point_distance
from tfg_drake.grid.path import cheapest
from tfg_drake.messages import BoolArray, FloatArray, IntArray, message, replace
from tfg_drake.world.reachability import CELL, Grid, free_cells, make_grid, reachable_cells
from tfg_drake.world.world import World, WorldError

# Radius of a person, m.
RADIUS = 0.25
# Random numbers in [0, 1) per person and step: place, speed, whether it stands and how long, its reaction to the robot.
NUMBERS = 5
# Slowest and fastest walk, m/s.
SPEED = (0.6, 1.2)
# Share of the places at which a person stands, and the longest time, there or in front of the robot, s.
STANDING_SHARE = 0.5
LONGEST_STAND = 10.0
# Distance of a person's way from walls, m, on cells; SLACK, m, nearer on the straight lines between them.
MARGIN = 0.06
SLACK = 0.02
# Least distance of a person from the outline of a moving robot, and of a standing one, m. A person who would come
# nearer waits for PATIENCE, s, and walks elsewhere.
COMFORT = 0.4
PASSING = 0.15
PATIENCE = 1.0
# Distance, m, at which the robot is noticed, and beyond which people appear. The share ODD_SHARE stops and looks at it,
# and as many overlook it if it stands.
NOTICED = 1.2
ODD_SHARE = 0.12
# People avoid where the robot is and where it will be in this time, s, which it takes to stop.
FORESIGHT = 0.6
# Speed below which the robot stands, m/s.
ROBOT_STANDS = 0.01
# Depth at which a person bumps into the robot, m.
BUMP = 0.002


@message
class People:
    """Where people are, and what they are about.

    stamp: s, when p_WP (n, 2), m, holds; v_WP: (n, 2) m/s, at which they walk on. speed: (n,) m/s of their walk.
    standing: (n,) s for which they will stand. waited: (n,) s for which the robot has been in the way. noticed,
    heedless: (n,) whether they have taken note of the robot, and overlook it if it stands. ways: for each the places
    (k, 2), m in W, that its way leads through.
    """

    stamp: float
    p_WP: FloatArray
    v_WP: FloatArray
    speed: FloatArray
    standing: FloatArray
    waited: FloatArray
    noticed: BoolArray
    heedless: BoolArray
    ways: tuple[FloatArray, ...]


@dataclasses.dataclass(frozen=True)
class Ground:
    """Where people may walk. grid: cells, free: (rows, columns) which of them, all connected. places: (k,) their flat
    indices. walls: (m, 4), m in W."""

    grid: Grid
    free: BoolArray
    places: IntArray
    walls: FloatArray


def ground(world: World, robot_radius: float) -> Ground:
    """The largest connected part of the ground that people can walk on and the robot (radius in m) can get to.

    Raises WorldError where there is none.
    """
    grid = make_grid(world)
    free = free_cells(grid, world.walls, RADIUS + MARGIN) & reachable_cells(grid, world, robot_radius)
    if not free.any():
        raise WorldError("reality.people: nowhere in this world is there room for people; set it to 0")
    labels, _ = ndimage.label(free)
    connected = labels == np.argmax(np.bincount(labels[free]))
    return Ground(grid, connected, np.flatnonzero(connected), world.walls)


def nobody() -> People:
    """Before the first step."""
    none, pairs, nothing = np.zeros(0), np.zeros((0, 2)), np.zeros(0, dtype=np.bool_)
    return People(0.0, pairs, pairs, none, none, none, nothing, nothing, ())


def astray(people: People) -> People:
    """People whose ways may lead into walls that have come: they look for others."""
    return replace(people, ways=(np.zeros((0, 2)),) * len(people.ways))


def places_at(people: People, time: float) -> FloatArray:
    """Where people are (n, 2), m in W, at a time, s, until the next step."""
    return np.asarray(people.p_WP + (time - people.stamp) * people.v_WP)


def discs_at(people: People, time: float) -> FloatArray:
    """People as discs (n, 3): centre, m in W, and radius, m, at a time, s, until the next step."""
    return np.column_stack([places_at(people, time), np.full(len(people.p_WP), RADIUS)])


def first_met(time: float, robot: FloatArray, uniform: FloatArray, ground: Ground) -> People:
    """People at random places, as many as uniform (n, NUMBERS) has rows of numbers between 0 and 1.

    time: s. robot: (5,) x, y, theta of X_WB, speed and turn rate.
    """
    n = len(uniform)
    p_WG = _centre(ground.grid, ground.places)
    apart = np.hypot(*(p_WG - robot[:2]).T)
    far = np.flatnonzero(apart >= min(NOTICED, apart.max()))
    p_WP = p_WG[far[(uniform[:, 0] * len(far)).astype(np.int64)]]
    speed = SPEED[0] + (SPEED[1] - SPEED[0]) * uniform[:, 1]
    none, zero = np.zeros(n, dtype=np.bool_), np.zeros(n)
    return People(time, p_WP, np.zeros((n, 2)), speed, zero, zero, none, none, (np.zeros((0, 2)),) * n)


def step(
    people: People,
    time: float,
    period: float,
    robot: FloatArray,
    robot_radius: float,
    uniform: FloatArray,
    ground: Ground,
) -> People:
    """People at a time (s), and how they walk on until one period (s) later.

    robot: as in first_met, robot_radius: m. uniform: (n, NUMBERS) numbers between 0 and 1, fresh every time.
    """
    p_WP, v_WP = places_at(people, time), np.zeros_like(people.v_WP)
    standing, waited = np.maximum(people.standing - period, 0.0), people.waited.copy()
    noticed, heedless, ways = people.noticed.copy(), people.heedless.copy(), list(people.ways)
    touching = RADIUS + robot_radius
    stands_still = abs(robot[3]) < ROBOT_STANDS
    soon = robot[:2] + FORESIGHT * max(robot[3], 0.0) * np.array([math.cos(robot[2]), math.sin(robot[2])])

    def gap_at(p: FloatArray) -> float:
        return float(point_distance(p[None], np.concatenate([robot[:2], soon[:2]])[None])[0]) - touching

    for i, (place, _speed, stands, how_long, mind) in enumerate(uniform):
        gap = gap_at(p_WP[i])
        if gap > NOTICED:
            noticed[i] = heedless[i] = False
        elif not noticed[i]:
            noticed[i], heedless[i] = True, mind < ODD_SHARE
            if 1.0 - mind < ODD_SHARE:
                standing[i] = LONGEST_STAND * how_long
        if standing[i] > 0.0:
            continue
        length = people.speed[i] * period
        if gap < PASSING and not heedless[i]:
            back = _step_back(p_WP[i], robot[:2], min(length, PASSING + SLACK - gap), ground.walls)
            if back is not None:
                ways[i], v_WP[i] = ways[i][:0], (back - p_WP[i]) / period
                continue
        if not len(ways[i]):
            ways[i] = way_between(ground, p_WP[i], place, robot[:2], touching + PASSING)
            if stands < STANDING_SHARE:
                standing[i] = LONGEST_STAND * how_long
            if standing[i] > 0.0 or not len(ways[i]):
                continue
        towards = ways[i][0] - p_WP[i]
        left = math.hypot(*towards)
        move = towards * min(1.0, length / max(left, 1e-9))
        after = gap_at(p_WP[i] + move)
        if after < min(gap, PASSING if stands_still else COMFORT) and not (heedless[i] and stands_still):
            waited[i] += period
            if waited[i] >= PATIENCE:
                ways[i], waited[i] = way_between(ground, p_WP[i], place, robot[:2], touching + PASSING), 0.0
            continue
        waited[i] = 0.0
        if after < min(gap, 0.0):
            # As far as it goes: no farther than the robot's outline, which is not pushed away.
            move *= max(gap + BUMP, 0.0) / max(math.hypot(*move), 1e-9)
            heedless[i] = False
        elif left <= length:
            ways[i] = ways[i][1:]
        v_WP[i] = move / period
    return People(time, p_WP, v_WP, people.speed, standing, waited, noticed, heedless, tuple(ways))


def _step_back(p_WP: FloatArray, p_WB: FloatArray, length: float, walls: FloatArray) -> FloatArray | None:
    """Where somebody at p_WP (2,) is after a step of this length (m) away from p_WB (2,); None if there is a wall."""
    away = p_WP - p_WB
    back = p_WP + length * away / max(math.hypot(*away), 1e-9)
    room = clearance(np.append(p_WP, back)[None], walls, RADIUS + SLACK)[0]
    return np.asarray(back) if room >= RADIUS + SLACK else None


def way_between(ground: Ground, p_WP: FloatArray, place: float, p_WB: FloatArray, apart: float) -> FloatArray:
    """The places (k, 2), m in W, that a short way from p_WP (2,) leads through, to the end; none where there is no way.

    place: between 0 and 1, which of all places that is. The way leads round p_WB (2,) at a distance, m: `apart`, or
    a cell's side less than where it begins, if that is nearer.
    """
    row, column = ground.grid.cell(p_WP[None])
    begin = int(row[0] * ground.free.shape[1] + column[0])
    if not ground.free[row[0], column[0]]:
        p_PG = _centre(ground.grid, ground.places) - p_WP
        nearest = int(np.argmin(np.hypot(p_PG[:, 0], p_PG[:, 1])))
        begin = int(ground.places[nearest])
        if clearance(np.append(p_WP, p_WP + p_PG[nearest])[None], ground.walls, RADIUS)[0] == 0.0:
            # A door has shut whoever it is in.
            return np.zeros((0, 2))
    # Out of a door, a way away from p_WB may begin with a cell nearer to it.
    first = np.vstack([p_WP, _centre(ground.grid, np.array([begin]))])
    apart = min(apart, float(np.hypot(*(first - p_WB).T).min()) - CELL)
    end = int(ground.places[int(place * len(ground.places))])
    cells = _shortest_way(ground.free, begin, end, (p_WB - ground.grid.p_WG) / CELL, apart / CELL)
    points = np.vstack([p_WP, _centre(ground.grid, cells)])
    robot = np.append(p_WB, p_WB)[None]
    # Straight from each to the farthest that can be gone to straight; to the next it always can.
    kept, i, need = [], 0, RADIUS + MARGIN - SLACK
    # A person nearer to a wall than that may leave it straight.
    least = min(need, float(clearance(np.append(p_WP, p_WP)[None], ground.walls, need)[0]) - 1e-9)
    while i < len(points) - 1:
        lines = np.hstack([np.broadcast_to(points[i], (len(points) - i - 1, 2)), points[i + 1 :]])
        open_ = np.flatnonzero(
            (clearance(lines, ground.walls, need) >= (need if i else least)) & (clearance(lines, robot, apart) >= apart)
        )
        i += 1 + (int(open_[-1]) if len(open_) else 0)
        kept.append(points[i])
    return np.array(kept).reshape(-1, 2)


def _centre(grid: Grid, cells: IntArray) -> FloatArray:
    """Centres (n, 2), m in W, of cells by their flat indices (n,)."""
    row, column = np.divmod(cells, grid.shape[1])
    return np.asarray(grid.p_WG + CELL * np.column_stack([column, row]))


def _shortest_way(free: BoolArray, begin: int, end: int, robot: FloatArray, apart: float) -> IntArray:
    """Flat indices of the free cells on a shortest way from begin to end; none where there is no way.

    robot: (2,) column and row that the way keeps off, `apart` cells; begin may be nearer.
    """
    row, column = np.indices(free.shape)
    passable = free & (np.hypot(column - robot[0], row - robot[1]) >= apart)
    passable.flat[[begin, end]] = True
    # From the end, so that the way comes out from its beginning on.
    _, _, before = cheapest(passable, np.ones(free.shape), np.array([end]), np.zeros(1), np.zeros(1))
    way = [begin]
    while before.flat[way[-1]] >= 0:
        way.append(int(before.flat[way[-1]]))
    return np.array(way if way[-1] == end else [], dtype=np.int64)
