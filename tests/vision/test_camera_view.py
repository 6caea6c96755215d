"""What cameras see together, for the planner, which thinks of one that looks ahead."""

import math

import pytest

from tests.cameras import pinhole
from tfg_drake.vision.camera_view import CameraView, camera_view, joint_view

NARROW = CameraView(1.0, 3.3)


def test_a_narrow_camera():
    """57 degrees, as of a Kinect, and a tag of 16 cm that is 24 pixels wide at its farthest."""
    view = camera_view(pinhole(640, 480, 319.5 / math.tan(math.radians(28.5))), 0.16)
    assert math.degrees(view.field_of_view) == pytest.approx(57.0)
    assert view.range == pytest.approx(0.16 * 588.4 / 24.0, rel=1e-3)


@pytest.mark.parametrize(
    ("yaws", "field_of_view"),
    [
        ([0.0], 1.0),
        ([2.0], 1.0),  # alone: what its own view is
        ([0.45, -0.45], 1.9),  # side by side
        ([-0.45, 0.45], 1.9),
        ([0.45, -0.2], 1.4),  # as much on either side
        ([0.0, 0.9, -0.9], 2.8),
        ([0.0, math.pi], 1.0),  # one looks back
        ([0.0, 1.5], 1.0),  # between them nothing is seen
        ([1.5, -1.5], 1.0),  # none looks ahead
        ([k * math.pi / 4.0 for k in range(8)], 2.0 * math.pi),
    ],
)
def test_several_cameras(yaws, field_of_view):
    view = joint_view([(yaw, NARROW) for yaw in yaws])
    assert view.field_of_view == pytest.approx(field_of_view)
    assert view.range == 3.3


def test_the_shortest_sight_holds():
    assert joint_view([(0.0, NARROW), (0.5, CameraView(1.0, 2.5))]).range == 2.5
