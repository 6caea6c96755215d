"""What a building looks like: walls with height, a floor, and tags hung on the walls, as a textured mesh."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np

from tfg_drake.messages import FloatArray
from tfg_drake.vision.hue import hue_of
from tfg_drake.vision.tag_sheets import CELLS, COUNT, FAMILY, tag_cells
from tfg_drake.world.world import World, WorldError

# Cells along a tag with its white border of one cell.
_WHOLE = CELLS + 2
# Pixels of the texture along a cell's side; with more, distant tags are blurred by the renderer's mipmaps.
_CELL_PIXELS = 3
# Offset of a tag in front of its place, m, so that its wall does not hide it.
_IN_FRONT = 0.0002
# Extension of the floor beyond the walls, m.
_BESIDE = 1.0
# Grey levels of floor and walls, of 255; white paper stands out from them.
_FLOOR, _WALL = 90, 170


@dataclasses.dataclass(frozen=True)
class SceneConfig:
    """tag_size: of the tags' black squares, tag_height: of their centres above the floor, wall_height: m."""

    tag_size: float = 0.16
    tag_height: float = 0.3
    wall_height: float = 2.5


@dataclasses.dataclass(frozen=True)
class Scene:
    """A mesh of quads in W, z up from the floor, and its texture.

    obj, mtl: text of Wavefront files named scene.obj and scene.mtl. png: the texture, named scene.png, in the hues of
    tfg_drake.vision.hue.
    """

    obj: str
    mtl: str
    png: bytes


def check_drawn(world: World) -> None:
    """Raises WorldError where a tag has an id that no such tag has."""
    for tag in world.tag_ids.tolist():
        if not 0 <= tag < COUNT:
            raise WorldError(f"world.tags: id {tag} cannot be drawn; {FAMILY} has the ids 0 to {COUNT - 1}")


def make_scene(world: World, config: SceneConfig | None = None) -> Scene:
    """The building of a world. Raises WorldError where it cannot be drawn."""
    config = config or SceneConfig()
    check_drawn(world)
    texture, tags_uv, floor_uv, wall_uv = _texture(world.tag_ids.tolist())
    quads = [_floor(world)[None], _walls(world.walls, config.wall_height), _tags(world, config)]
    uv = [floor_uv[None], np.broadcast_to(wall_uv, (len(quads[1]), 4, 2)), tags_uv]
    found, png = cv2.imencode(".png", hue_of(texture)[..., ::-1])
    assert found
    mtl = "newmtl building\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nmap_Kd scene.png\n"
    return Scene(_obj(np.concatenate(quads), np.concatenate(uv)), mtl, png.tobytes())


def _texture(ids: list[int]) -> tuple[np.ndarray, FloatArray, FloatArray, FloatArray]:
    """The texture (h, w), tile by tile, and where in it (4, 2), from its lower left corner in shares of its sides, are
    the tags (n, 4, 2), the floor and the walls; corners of tags run counter-clockwise from the lower left."""
    tile = _WHOLE * _CELL_PIXELS
    across = math.ceil(math.sqrt(len(ids) + 2))
    down = math.ceil((len(ids) + 2) / across)
    texture = np.full((down * tile, across * tile), 255, dtype=np.uint8)
    corners = np.empty((len(ids) + 2, 4, 2))
    for k in range(len(ids) + 2):
        row, column = divmod(k, across)
        place = texture[row * tile : (row + 1) * tile, column * tile : (column + 1) * tile]
        if k < len(ids):
            cells = np.where(tag_cells(ids[k]), 0, 255).astype(np.uint8)
            place[_CELL_PIXELS:-_CELL_PIXELS, _CELL_PIXELS:-_CELL_PIXELS] = np.kron(
                cells, np.ones((_CELL_PIXELS, _CELL_PIXELS), dtype=np.uint8)
            )
        else:
            place[:] = (_FLOOR, _WALL)[k - len(ids)]
        x0, x1, y0, y1 = column / across, (column + 1) / across, 1.0 - (row + 1) / down, 1.0 - row / down
        corners[k] = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]
    # Surfaces of one colour take it from the middle of their tile, away from its neighbours.
    middle = corners[len(ids) :].mean(axis=1, keepdims=True) + np.zeros((2, 4, 2))
    return texture, corners[: len(ids)], middle[0], middle[1]


def _floor(world: World) -> FloatArray:
    """(4, 3) m, counter-clockwise as one looks down on it."""
    points = np.concatenate([world.walls.reshape(-1, 2), world.p_WT, world.start[None, :2]])
    (x0, y0), (x1, y1) = points.min(axis=0) - _BESIDE, points.max(axis=0) + _BESIDE
    return np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])


def _walls(walls: FloatArray, height: float) -> FloatArray:
    """(m, 4, 3) m: walls have no thickness, for tags hang close by on both sides."""
    a, b = walls[:, None, :2], walls[:, None, 2:]
    low, high = np.zeros((len(walls), 1, 1)), np.full((len(walls), 1, 1), height)
    corners = ((a, low), (b, low), (b, high), (a, high))
    return np.concatenate([np.concatenate(corner, axis=2) for corner in corners], axis=1)


def _tags(world: World, config: SceneConfig) -> FloatArray:
    """(n, 4, 3) m: counter-clockwise from the lower left as one looks at the front."""
    half = 0.5 * config.tag_size * _WHOLE / CELLS
    normal = np.stack([np.cos(world.tag_facing), np.sin(world.tag_facing)], axis=1)
    # To the right of who looks at it.
    right = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    centre = world.p_WT + _IN_FRONT * normal
    quads = np.empty((len(world.tag_ids), 4, 3))
    for k, (across, up) in enumerate(((-1, -1), (1, -1), (1, 1), (-1, 1))):
        quads[:, k, :2] = centre + across * half * right
        quads[:, k, 2] = config.tag_height + up * half
    return quads


def _obj(quads: FloatArray, uv: FloatArray) -> str:
    """Wavefront text of quads (n, 4, 3) whose fronts run counter-clockwise, and texture coordinates (n, 4, 2)."""
    normal = np.cross(quads[:, 1] - quads[:, 0], quads[:, 3] - quads[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    lines = ["mtllib scene.mtl", "usemtl building"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in quads.reshape(-1, 3).tolist()]
    lines += [f"vt {u:.8f} {v:.8f}" for u, v in uv.reshape(-1, 2).tolist()]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in normal.tolist()]
    for k in range(len(quads)):
        a, b, c, d = (f"{4 * k + i}/{4 * k + i}/{k + 1}" for i in (1, 2, 3, 4))
        lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
    return "\n".join(lines) + "\n"
