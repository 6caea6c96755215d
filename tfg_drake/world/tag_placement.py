"""Placing tags along the surfaces that a robot's free space touches."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.config import NODE_MARGIN
from tfg_drake.geometry.distance import point_distance
from tfg_drake.geometry.visibility import line_of_sight
from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.world.reachability import CELL, make_grid, reachable_cells
from tfg_drake.world.world import WorldError, bare_world

# Distance of a tag's centre from its wall, m, so that the wall does not hide it.
TAG_OFFSET = 0.01
# Free space that a tag needs in front of it, m, which excludes sharp corners.
_TAG_SPACE = 0.05
# Places where a tag is tried in its piece of wall, in lengths of the piece from its middle.
_SHIFTS = (0.0, 0.15, -0.15, 0.3, -0.3)


def place_tags(
    walls: FloatArray, start: FloatArray, spacing: float, robot_radius: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Tags about `spacing` apart along every surface touched by the free space that the robot can reach from start.

    walls: (m, 4), m. start: (3,) X_WS. spacing, robot_radius: m. Returns ids (n,) = 0..n-1 in the order of the walls,
    p_WT (n, 2) in m, TAG_OFFSET in front of the surface, and the outward normals' headings (n,) in rad. Each face of
    a wall is cut into equal stretches of about `spacing` with a tag in the middle of each; pieces shorter than half
    a stretch (curves, posts) get a tag only where none is near. Raises WorldError for a spacing that is not positive.
    """
    if not (np.isfinite(spacing) and spacing > 0.0):
        raise WorldError(f"tag spacing: must be a positive number of metres, is {spacing:g}")
    world = bare_world(walls, start)
    grid = make_grid(world)
    reachable = grid.centers(reachable_cells(grid, world, robot_radius))
    if not len(walls) or not len(reachable):
        return world.tag_ids, world.p_WT, world.tag_facing
    tree = cKDTree(reachable)
    length = np.hypot(walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1])
    is_short = length < 0.5 * spacing
    # Wall, face and stretch of each tag, which are the order of the ids; where it is and the normal there.
    keys: list[tuple[int, int, int]] = []
    tags = np.zeros((0, 2, 2))
    for wall in np.argsort(is_short, kind="stable"):
        d = walls[wall, 2:] - walls[wall, :2]
        count = max(1, round(length[wall] / spacing))
        apart = spacing if is_short[wall] else 0.5 * spacing
        for side, normal in enumerate((np.array([-d[1], d[0]]), np.array([d[1], -d[0]]))):
            normal = normal / length[wall]
            for stretch in range(count):
                for shift in _SHIFTS:
                    p = walls[wall, :2] + (stretch + 0.5 + shift) / count * d + TAG_OFFSET * normal
                    if not _crowds(p, normal, tags, apart) and _touched(p, normal, walls, tree, robot_radius):
                        keys.append((int(wall), side, stretch))
                        tags = np.append(tags, [[p, normal]], axis=0)
                        break
    order = sorted(range(len(keys)), key=keys.__getitem__)
    p_WT, normals = tags[order, 0], tags[order, 1]
    return np.arange(len(order)), p_WT, np.arctan2(normals[:, 1], normals[:, 0])


def _crowds(p: FloatArray, normal: FloatArray, tags: FloatArray, apart: float) -> bool:
    """Whether a tag (n, 2, 2), its place and its normal, nearer than apart faces about the same way: the far face of a
    wall is another surface."""
    return bool(((np.hypot(*(p - tags[:, 0]).T) < apart) & (tags[:, 1] @ normal > -0.5)).any())


def _touched(p: FloatArray, normal: FloatArray, walls: FloatArray, reachable: cKDTree, robot_radius: float) -> bool:
    """Whether the robot can come right in front of the surface point p, and p is not in the crotch of two walls."""
    if point_distance((p + _TAG_SPACE * normal)[None], walls)[0] < 0.99 * _TAG_SPACE:
        return False
    near = reachable.data[reachable.query_ball_point(p, np.sqrt(2.0) * (robot_radius + NODE_MARGIN) + CELL)]
    in_front = (near - p) @ normal > 0.5 * np.linalg.norm(near - p, axis=1)
    near = np.ascontiguousarray(near[in_front])
    return len(near) > 0 and bool(line_of_sight(walls, p, near).any())
