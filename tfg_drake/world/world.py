"""The true world: what is simulated, what metrics compare with, never what the explorer knows."""

from __future__ import annotations

import numpy as np

from tfg_drake.bad_input import not_radians
from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.messages import FloatArray, IntArray, message


class WorldError(ValueError):
    """A world that cannot be used; the message is one line: where, what is wrong, how to mend it."""


@message
class World:
    """Walls, tags and the robot's start, in the world frame W.

    walls: (m, 4) opaque segments x0, y0, x1, y1, m. tag_ids: (n,). p_WT: (n, 2) tag centres on the walls' surfaces,
    m. tag_facing: (n,) heading of each tag's outward normal, rad. start: (3,) X_WS, where the robot begins.
    """

    walls: FloatArray
    tag_ids: IntArray
    p_WT: FloatArray
    tag_facing: FloatArray
    start: FloatArray


def bare_world(walls: FloatArray, start: FloatArray) -> World:
    """A world without tags."""
    return World(walls, np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0), start)


# Greatest length, m, and area, m^2, of a building, ten times the largest known map; its cells take a gigabyte while
# tags are placed.
LONGEST = 1000.0
LARGEST = 5e4
# Greatest coordinate, m, at which a float64 separates the sides of a thin wall; UTM's are within.
FARTHEST = 1e8
# Greatest distance of a start outside the walls, m.
OUTSIDE = 10.0
# Greatest distance of a tag from its wall, m; within the second one it may be on either side of the wall, m.
_HANGS, _ON_IT = 0.1, 1e-6
# A free place is searched on a lattice with step _STEP, m, up to _STEPS in x and y. One is enclosed, as in a sofa, if
# it sees less than _SHUT_IN, m^2, within _SIGHT, m.
_STEP, _STEPS, _SHUT_IN, _SIGHT = 0.1, 20, 2.5, 3.0
_ALL_ROUND = np.linspace(-np.pi, np.pi, 60, endpoint=False)


def wall_distance(p_WP: FloatArray, walls: FloatArray) -> FloatArray:
    """Distance (m,) from the point p_WP (2,) to each wall (m, 4), m."""
    a, d = walls[:, :2], walls[:, 2:] - walls[:, :2]
    length_squared = np.maximum(np.sum(d * d, axis=1), np.finfo(float).tiny)
    t = np.clip(np.sum((p_WP - a) * d, axis=1) / length_squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(a + t[:, None] * d - p_WP, axis=1))


def check_extent(walls: FloatArray) -> None:
    """Raises WorldError where walls (m, 4), m, reach farther than a building: a wrong unit, or one stray number."""
    if not len(walls):
        return
    corners = walls.reshape(-1, 2)
    x, y = corners[np.argmax(np.abs(corners).max(axis=1))]
    if not max(abs(x), abs(y)) <= FARTHEST:
        raise WorldError(f"a wall ends at ({x:g}, {y:g}), too far from the origin; check its unit and that number")
    width, height = np.ptp(corners, axis=0)
    if max(width, height) > LONGEST or width * height > LARGEST:
        x, y = corners[np.argmax(np.abs(corners - np.median(corners, axis=0)).max(axis=1))]
        where = f"{width:.0f} x {height:.0f} m, the farthest to ({x:g}, {y:g})"
        raise WorldError(f"the walls extend over {where}; check their unit or resolution, or that number")


def check_world(world: World, robot_radius: float) -> None:
    """Raises WorldError for what no simulation could use: see the messages below. An empty world is valid."""
    for i, wall in enumerate(world.walls):
        if not np.isfinite(wall).all():
            raise WorldError(f"world.walls[{i}]: a coordinate is not a finite number; write [x0, y0, x1, y1] in metres")
        if wall[0] == wall[2] and wall[1] == wall[3]:
            raise WorldError(f"world.walls[{i}]: zero length at ({wall[0]:g}, {wall[1]:g}); remove the wall")
    first: dict[int, int] = {}
    for i, (tag, p, facing) in enumerate(zip(world.tag_ids.tolist(), world.p_WT, world.tag_facing, strict=True)):
        if not (np.isfinite(p).all() and np.isfinite(facing)):
            raise WorldError(f"world.tags[{i}]: position or facing is not a finite number; write metres and radians")
        if tag in first:
            raise WorldError(f"world.tags[{i}].id: {tag} is taken by world.tags[{first[tag]}]; give each tag an id")
        first[tag] = i
    check_extent(world.walls)
    if not np.isfinite(world.start).all():
        raise WorldError("world.start: not a finite number; write [x, y, yaw] in metres and radians")
    angles = {"world.start": world.start[2], **{f"world.tags[{i}].facing": a for i, a in enumerate(world.tag_facing)}}
    for place, angle in angles.items():
        if told := not_radians(angle):
            raise WorldError(f"{place}: {told}")
    if len(world.walls):
        corners = world.walls.reshape(-1, 2)
        low, high = corners.min(axis=0), corners.max(axis=0)
        if (np.maximum(low - world.start[:2], world.start[:2] - high) > OUTSIDE).any():
            raise WorldError(
                f"world.start: ({world.start[0]:g}, {world.start[1]:g}) is far from the walls, which reach from"
                f" ({low[0]:g}, {low[1]:g}) to ({high[0]:g}, {high[1]:g}); start between them"
            )
        distance = wall_distance(world.start[:2], world.walls)
        nearest = int(np.argmin(distance))
        if distance[nearest] < robot_radius:
            (x, y, _), (x0, y0, x1, y1) = world.start, world.walls[nearest]
            free = _nearest_free(world.start[:2], world.walls, robot_radius)
            mend = "farther away" if free is None else f"at ({free[0]:g}, {free[1]:g}), the nearest free place"
            wall = f"the wall from ({x0:g}, {y0:g}) to ({x1:g}, {y1:g})"
            raise WorldError(
                f"world.start: ({x:g}, {y:g}) is too near to {wall}: {distance[nearest]:.3f} m,"
                f" the robot's radius is {robot_radius:g} m; start {mend}"
            )


def _nearest_free(p_WS: FloatArray, walls: FloatArray, robot_radius: float) -> FloatArray | None:
    """The place (2,) on whole steps of a lattice, m, that is nearest to p_WS (2,), and where the robot stands free with
    a step to spare; shut in, beyond the nearest of walls (m, 4) or outside the building only if there is no other, and
    None where none is near."""
    around = np.indices((2 * _STEPS + 1, 2 * _STEPS + 1)).reshape(2, -1).T - _STEPS
    places = (_STEP * (np.round(p_WS / _STEP) + around)).round(2) + 0.0  # no -0
    a, b = walls[np.argmin(wall_distance(p_WS, walls))].reshape(2, 2)
    normal = np.array([a[1] - b[1], b[0] - a[0]])
    beyond = ((places - a) @ normal) * ((p_WS - a) @ normal) < 0.0
    low, high = walls.reshape(-1, 2).min(axis=0), walls.reshape(-1, 2).max(axis=0)
    outside = ((places < low) | (places > high)).any(axis=1)
    order = np.lexsort((np.hypot(*(places - p_WS).T), outside, beyond))
    free = [p for p in places[order] if wall_distance(p, walls).min() >= robot_radius + _STEP]
    return next((p for p in free if _seen_area(p, walls) > _SHUT_IN), next(iter(free), None))


def _seen_area(p_WS: FloatArray, walls: FloatArray) -> float:
    """Area, m^2, in sight of a place (2,) between walls (m, 4), as far as _SIGHT."""
    ranges = np.minimum(cast_rays(walls, p_WS, _ALL_ROUND, _SIGHT), _SIGHT)
    return float(np.pi * np.mean(ranges**2))


def odd_tags(world: World) -> tuple[str, ...]:
    """A line for each thing that is odd about tags, with their ids: they hang on no wall, or face into theirs."""
    on_no_wall, into_wall = [], []
    if not len(world.walls):
        return ()
    for tag, p, facing in zip(world.tag_ids.tolist(), world.p_WT, world.tag_facing, strict=True):
        distance = wall_distance(p, world.walls)
        nearest = int(np.argmin(distance))
        normal = np.array([[0.0, -1.0], [1.0, 0.0]]) @ (world.walls[nearest, 2:] - world.walls[nearest, :2])
        side = normal @ (p - world.walls[nearest, :2])
        if distance[nearest] > _HANGS:
            on_no_wall.append(tag)
        elif distance[nearest] > _ON_IT and side * (normal @ [np.cos(facing), np.sin(facing)]) < 0.0:
            into_wall.append(tag)
    told = {"hang on no wall": on_no_wall, "face into their wall, where nobody sees them": into_wall}
    return tuple(f"tags that {what}: {', '.join(map(str, ids))}; is this meant?" for what, ids in told.items() if ids)
