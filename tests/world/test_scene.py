"""The mesh of a building against the world that it is made of."""

import cv2
import numpy as np
import pytest

from tfg_drake.world.scene import SceneConfig, make_scene
from tfg_drake.world.world import World, WorldError

WORLD = World(
    walls=np.array([[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 3.0]]),
    tag_ids=np.array([7, 300]),
    p_WT=np.array([[1.0, 0.01], [3.99, 2.0]]),
    tag_facing=np.array([np.pi / 2, np.pi]),
    start=np.array([1.0, 1.0, 0.0]),
)
FLOOR, WALLS, TAGS = 0, slice(1, 3), slice(3, 5)


def quads_of(scene):
    """Corners (n, 4, 3), texture coordinates (n, 4, 2) and normals (n, 3) of an OBJ text."""
    rows = {"v": [], "vt": [], "vn": []}
    for line in scene.obj.splitlines():
        kind, *numbers = line.split()
        if kind in rows:
            rows[kind].append([float(x) for x in numbers])
    return np.array(rows["v"]).reshape(-1, 4, 3), np.array(rows["vt"]).reshape(-1, 4, 2), np.array(rows["vn"])


def test_tags_hang_where_the_world_has_them():
    corners, _, normals = quads_of(make_scene(WORLD, SceneConfig(tag_size=0.16, tag_height=0.4)))
    centres = corners[TAGS].mean(axis=1)
    np.testing.assert_allclose(centres[:, :2], WORLD.p_WT, atol=0.0011)
    np.testing.assert_allclose(centres[:, 2], 0.4, atol=1e-6)
    facing = np.stack([np.cos(WORLD.tag_facing), np.sin(WORLD.tag_facing), np.zeros(2)], axis=1)
    np.testing.assert_allclose(normals[TAGS], facing, atol=1e-6)
    # The black square and a border one cell wide.
    np.testing.assert_allclose(np.linalg.norm(corners[TAGS, 1] - corners[TAGS, 0], axis=1), 0.2, atol=1e-5)


def test_walls_stand_on_the_floor():
    corners, _, normals = quads_of(make_scene(WORLD, SceneConfig(wall_height=2.0)))
    np.testing.assert_allclose(corners[WALLS, 0, :2], WORLD.walls[:, :2])
    np.testing.assert_allclose(corners[WALLS, 1, :2], WORLD.walls[:, 2:])
    np.testing.assert_allclose(corners[WALLS, :, 2], [[0.0, 0.0, 2.0, 2.0]] * 2)
    np.testing.assert_allclose(normals[FLOOR], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(corners[FLOOR, :, 2], 0.0)


def test_each_tag_has_its_own_picture():
    scene = make_scene(WORLD)
    _, uv, _ = quads_of(scene)
    picture = cv2.imdecode(np.frombuffer(scene.png, np.uint8), cv2.IMREAD_COLOR)
    h, w = picture.shape[:2]
    texture = np.where(picture[..., 2] > 127, 0, 255)  # black is drawn as red
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for tag, corners in zip(WORLD.tag_ids.tolist(), uv[TAGS], strict=True):
        columns = np.round(corners[[0, 1], 0] * w).astype(int)
        rows = np.round((1.0 - corners[[2, 1], 1]) * h).astype(int)
        tile = texture[slice(*rows), slice(*columns)]
        assert (tile[:3] == 255).all()
        np.testing.assert_array_equal(tile[3:-3, 3:-3], cv2.aruco.generateImageMarker(dictionary, tag, 24))


def test_an_id_that_no_tag_has_is_told():
    world = World(WORLD.walls, np.array([587]), WORLD.p_WT[:1], WORLD.tag_facing[:1], WORLD.start)
    with pytest.raises(WorldError) as error:
        make_scene(world)
    assert str(error.value) == "world.tags: id 587 cannot be drawn; tag36h11 has the ids 0 to 586"
