"""What is rendered of a world is what the pure functions say of it."""

import math

import numpy as np
import pytest

pytest.importorskip("robotpy_apriltag", reason="robotpy-apriltag is not installed: pip install 'tfg-drake[camera]'")

from tfg_drake.geometry.se2 import between
from tfg_drake.simulation.tag_sensor import visible_tags
from tfg_drake.systems.rendered_world import MakeCameraInfo, WorldView
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.sighting import TagSizes, sighted
from tfg_drake.vision.tag_detector import TagDetector
from tfg_drake.world.world import World

FIELD_OF_VIEW = math.radians(65.0)
# A room of 5 x 4 m with a thin wall in it that has tags on both faces.
WORLD = World(
    walls=np.array([[0, 0, 5, 0], [5, 0, 5, 4], [5, 4, 0, 4], [0, 4, 0, 0], [3, 0, 3, 2]], dtype=float),
    tag_ids=np.array([3, 14, 15, 92, 400]),
    p_WT=np.array([[2.99, 1.0], [3.01, 1.0], [1.5, 0.01], [1.0, 3.99], [4.99, 3.0]]),
    tag_facing=np.array([np.pi, 0.0, np.pi / 2, -np.pi / 2, np.pi]),
    start=np.array([1.0, 1.0, 0.0]),
)
MOUNT = CameraMount(x=0.05, z=0.3)


@pytest.fixture(scope="module")
def view():
    return WorldView(WORLD, MOUNT, MakeCameraInfo(640, 480, FIELD_OF_VIEW))


@pytest.mark.parametrize(
    "X_WB", [(1.0, 1.2, 0.0), (1.5, 2.0, -np.pi / 2), (4.4, 1.0, np.pi), (2.0, 2.8, 0.1), (1.2, 2.0, np.pi / 2)]
)
def test_tags_in_view_are_seen_where_they_are(view, X_WB):
    X_WB = np.array(X_WB)
    image = view.image(X_WB)
    assert image.shape == (480, 640)
    assert image.dtype == np.uint8
    seen = sighted(TagDetector().detect(image), 0.0, view.calibration, TagSizes(0.16), MOUNT).detections
    rows = visible_tags(WORLD.p_WT, WORLD.tag_facing, WORLD.walls, X_WB, 3.3, math.radians(60.0), math.radians(60.0))
    assert len(rows)
    assert set(WORLD.tag_ids[rows]) <= set(seen.ids)
    rows = np.searchsorted(WORLD.tag_ids, seen.ids)
    p_BT = between(X_WB, np.column_stack([WORLD.p_WT[rows], np.zeros(len(rows))]))[:, :2]
    np.testing.assert_allclose(seen.range, np.hypot(*p_BT.T), rtol=0.025)
    np.testing.assert_allclose(seen.bearing, np.arctan2(p_BT[:, 1], p_BT[:, 0]), atol=math.radians(0.1))


def test_depth_is_the_distance_along_the_optical_axis(view):
    depth = view.depth(np.array([1.0, 1.5, 0.0]))
    assert depth.shape == (480, 640)
    np.testing.assert_allclose(depth[240, 320], 3.0 - 1.05, atol=1e-3)
    # Straight down to the floor at the image's lower edge, and over the wall's end at (3, 2) to the room's.
    focal = view.calibration.matrix[1, 1]
    np.testing.assert_allclose(depth[479, 320], 0.3 * focal / (479 - 239), rtol=0.01)
    column = round(319.5 - focal * 1.0 / 3.0)
    np.testing.assert_allclose(depth[240, column], 5.0 - 1.05, atol=2e-3)


def test_a_picture_depends_on_the_pose_alone(view):
    first = view.image(np.array([1.0, 1.2, 0.0]))
    view.image(np.array([4.4, 1.0, np.pi]))
    np.testing.assert_array_equal(first, view.image(np.array([1.0, 1.2, 0.0])))
