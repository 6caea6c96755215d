"""What becomes of a world in which somebody shuts a door, moves a chair, or carries a tag elsewhere."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np

from tfg_drake.config import ChangeConfig
from tfg_drake.messages import FloatArray, message, replace
from tfg_drake.world.world import World, WorldError, check_world, wall_distance

# Least distance of a change from the robot's outline, m, twice its way to stop at full speed.
CLEAR = 0.5
# A point within this distance of a wall's line, m, is on it; shorter remains are dropped.
ON_WALL = 1e-3


@message
class WorldNow:
    """A world that changes, as it is. count: how many of the changes there have been, since: s, when the last was."""

    world: World
    count: int
    since: float


def changed(world: World, change: ChangeConfig) -> World:
    """The world after a change; raises WorldError where that opens no wall, or is of a tag that there is not."""
    walls = world.walls
    for segment in np.array(change.opened, dtype=float).reshape(-1, 4):
        walls = _opened(walls, segment)
    walls = np.vstack([walls, np.array(change.walls, dtype=float).reshape(-1, 4)])
    p_WT, facing = world.p_WT.copy(), world.tag_facing.copy()
    for tag in change.tags:
        row = _row(world, tag.id)
        p_WT[row], facing[row] = tag.position, tag.facing
    stays = np.ones(len(p_WT), dtype=np.bool_)
    stays[[_row(world, tag) for tag in change.fallen]] = False
    return replace(world, walls=walls, tag_ids=world.tag_ids[stays], p_WT=p_WT[stays], tag_facing=facing[stays])


def _row(world: World, tag: int) -> int:
    rows = np.flatnonzero(world.tag_ids == tag)
    if not len(rows):
        raise WorldError(f"there is no tag {tag} in the world then; name one of its tags")
    return int(rows[0])


def _opened(walls: FloatArray, segment: FloatArray) -> FloatArray:
    """Walls (m, 4) without what lies on a segment (4,), m; raises WorldError where nothing does."""
    start, d = walls[:, :2], walls[:, 2:] - walls[:, :2]
    length = np.hypot(*d.T)
    along = d / length[:, None]
    offset = segment.reshape(2, 1, 2) - start
    aside = np.abs(offset[..., 0] * along[:, 1] - offset[..., 1] * along[:, 0]).max(axis=0)
    at = np.sum(offset * along, axis=2)
    begin, end = np.maximum(at.min(axis=0), 0.0), np.minimum(at.max(axis=0), length)
    on = (aside <= ON_WALL) & (end - begin > ON_WALL)
    if not on.any():
        x0, y0, x1, y1 = segment
        raise WorldError(f"opened: there is no wall from ({x0:g}, {y0:g}) to ({x1:g}, {y1:g}); name a piece of one")
    before, behind = on & (begin > ON_WALL), on & (length - end > ON_WALL)
    left = np.hstack([start[before], start[before] + begin[before, None] * along[before]])
    right = np.hstack([start[behind] + end[behind, None] * along[behind], walls[behind, 2:]])
    return np.vstack([walls[~on], left, right])


def successive(world: World, changes: Sequence[ChangeConfig]) -> tuple[World, ...]:
    """The world at first and after each change in turn; raises WorldError as `changed` and check_world do."""
    worlds = [world]
    for i, change in enumerate(changes):
        try:
            worlds.append(changed(worlds[-1], change))
            # A door may shut where the robot once began.
            check_world(worlds[-1], 0.0)
        except WorldError as error:
            raise WorldError(f"reality.changes[{i}]: {error}") from None
        if change.time < changes[max(i - 1, 0)].time:
            raise WorldError(f"reality.changes[{i}].time: is before that of the one above; write them in their order")
    return tuple(worlds)


def world_at(world: World, changes: Sequence[ChangeConfig], time: float) -> World:
    """What the world is at a time, s, if no change had to wait for the robot."""
    return functools.reduce(changed, [change for change in changes if change.time <= time], world)


def is_due(change: ChangeConfig, time: float, p_WB: FloatArray, robot_radius: float) -> bool:
    """Whether the change is made at a time, s: one that puts something right beside the robot, whose centre is at p_WB
    (2,), m, waits until it has gone."""
    walls = np.array(change.walls, dtype=float).reshape(-1, 4)
    gap = wall_distance(p_WB, walls).min(initial=np.inf) - robot_radius
    return change.time <= time and bool(gap >= CLEAR)
