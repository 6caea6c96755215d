"""Corners refined by a tag's cells, on tags that OpenCV's warps render."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.cameras import pinhole
from tests.vision.rendering import corners_of, cv2, projected, render
from tfg_drake.vision.tag_corners import refined

CAMERA = pinhole(640, 480, 520.0)
# Of corners_of, in the order of the detector: from the upper right counter-clockwise.
ORDER = [1, 0, 3, 2]


def drawn(distance, incidence, blur, tag=7, seed=0):
    """An image, blurred by so many pixels to the side and half of that upward, and the exact corners in it."""
    facing = Rotation.from_euler("ZYX", [0.1, incidence, 0.0]).as_matrix()
    p_CT = np.array([0.03, -0.02, distance])
    image = render([(tag, facing, p_CT, 0.16)], CAMERA, noise=0.0)
    image = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigmaX=blur, sigmaY=0.5 * blur)
    image += np.random.default_rng(seed).normal(scale=2.0, size=image.shape)
    exact = projected(corners_of(facing, p_CT, 0.16), CAMERA)[ORDER]
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), exact


@pytest.mark.parametrize("blur", [0.1, 0.5, 1.5])
@pytest.mark.parametrize(("distance", "incidence"), [(1.0, 0.2), (2.0, 0.7), (3.3, -0.2)])
def test_corners_are_exact_however_blurred_the_image_is(distance, incidence, blur):
    found = []
    for seed in range(4):
        image, exact = drawn(distance, incidence, blur, seed=seed)
        near = exact + np.random.default_rng(seed).uniform(-0.4, 0.4, (4, 2))
        corners, likeness = refined(image, near, 7, "tag36h11")
        assert likeness > 0.97
        found.append(corners - exact)
    outward = exact - exact.mean(axis=0)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    assert abs(np.mean(np.sum(found * outward, axis=2))) < 0.05
    assert np.sqrt(np.mean(np.square(found))) < 0.1


def test_corners_of_something_else_stay_as_they_were():
    image, exact = drawn(2.0, 0.2, 0.5)
    for corners, tag, picture in (
        (exact + 12.0, 7, image),  # beside the tag
        (exact, 7, np.full_like(image, 90)),  # nothing there
        (exact - [300.0, 0.0], 7, image),  # at the image's edge
        (np.zeros((4, 2)), 7, image),
    ):
        found, likeness = refined(picture, corners, tag, "tag36h11")
        np.testing.assert_array_equal(found, corners)
        assert likeness == 0.0


def test_a_large_tag_is_left_as_it_is():
    image, exact = drawn(0.4, 0.2, 0.5)
    np.testing.assert_array_equal(refined(image, exact + 0.3, 7, "tag36h11")[0], exact + 0.3)


def test_the_other_family_too():
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_16h5)
    image = np.full((100, 100), 255, np.uint8)
    image[20:68, 30:78] = cv2.aruco.generateImageMarker(dictionary, 3, 48)
    exact = np.array([[77.5, 19.5], [29.5, 19.5], [29.5, 67.5], [77.5, 67.5]])
    np.testing.assert_allclose(refined(image, exact + 0.4, 3, "tag16h5")[0], exact, atol=0.05)
