"""Lens and tag positions against OpenCV's forward models, and their covariance against noise drawn at random."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.cameras import pinhole
from tests.vision.rendering import corners_of, projected
from tfg_drake.vision.calibration import CameraCalibration
from tfg_drake.vision.lens import on_pixels, undistorted
from tfg_drake.vision.tag_position import tag_positions

K = np.array([[520.5, 0.0, 321.25], [0.0, 519.0, 239.5], [0.0, 0.0, 1.0]])
LENSES = {
    "ideal": CameraCalibration(640, 480, K, "plumb_bob", np.zeros(0)),
    "brown": CameraCalibration(640, 480, K, "plumb_bob", np.array([-0.1, 0.02, 0.001, -0.0005, 0.003])),
    "rational": CameraCalibration(
        640, 480, K, "plumb_bob", np.array([0.2, 0.05, 0.001, -0.0005, 0.003, 0.3, 0.1, 0.01])
    ),
    "fisheye": CameraCalibration(640, 480, 0.5 * K + 0.5 * np.diag([0, 0, 1]), "equidistant", np.full(4, -0.01)),
}


@pytest.mark.parametrize("lens", LENSES)
def test_a_lens_is_undone(lens):
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2))
    pixels = projected(np.column_stack([points, np.ones(50)]), LENSES[lens])
    np.testing.assert_allclose(undistorted(pixels, LENSES[lens]), points, atol=1e-7)
    slopes = on_pixels(pixels, LENSES[lens])
    step = np.array([0.3, -0.2])
    ahead = undistorted(pixels + step, LENSES[lens]) - undistorted(pixels - step, LENSES[lens])
    np.testing.assert_allclose(2.0 * slopes @ step, ahead, atol=1e-6)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("reverse", [False, True])
def test_a_tag_is_where_its_exact_corners_say(lens, reverse):
    rng = np.random.default_rng(1)
    for _ in range(20):
        R_CT = Rotation.from_euler("ZYX", rng.uniform(-1.0, 1.0, 3)).as_matrix()
        p_CT = np.append(rng.uniform(-0.3, 0.3, 2), 1.0) * rng.uniform(0.5, 6.0)
        corners = projected(corners_of(R_CT, p_CT, 0.16), LENSES[lens])
        corners = np.roll(corners[::-1] if reverse else corners, rng.integers(4), axis=0)
        found, _ = tag_positions(corners[None], np.array([0.16]), LENSES[lens])
        np.testing.assert_allclose(found[0], p_CT, atol=2e-5)


# Each lens at each distance and incidence once; all of them together are slow.
INCIDENCES, DISTANCES = [0.0, 0.6, 1.1], [0.7, 2.0, 4.0]
ONCE = [("brown", 0), ("fisheye", 1)]


@pytest.mark.parametrize(
    ("lens", "distance", "incidence"),
    [
        pytest.param(lens, d, a, marks=() if (i + shift - k) % 3 == 0 else pytest.mark.slow)
        for lens, shift in ONCE
        for k, d in enumerate(DISTANCES)
        for i, a in enumerate(INCIDENCES)
    ],
)
def test_covariance_is_that_of_noise(lens, distance, incidence):
    """A tenth is what 2000 draws leave open and more; of small squares, whose tilt is lost in noise, yet more."""
    rng, sigma = np.random.default_rng(2), 0.05
    R_CT, p_CT = Rotation.from_euler("y", incidence).as_matrix(), np.array([0.1, -0.05, distance])
    exact = projected(corners_of(R_CT, p_CT, 0.16), LENSES[lens])
    noisy = exact + sigma * rng.normal(size=(2000, 4, 2))
    found, _ = tag_positions(noisy, np.full(2000, 0.16), LENSES[lens])
    _, unit = tag_positions(exact[None], np.array([0.16]), LENSES[lens])
    spread, stated = np.cov(found.T), sigma**2 * unit[0]
    tolerance = 0.1 if 0.16 * LENSES[lens].focal / distance > 40.0 else 0.25
    np.testing.assert_allclose(np.sqrt(np.diag(spread)), np.sqrt(np.diag(stated)), rtol=tolerance)


def test_deviations_grow_with_range_and_lateral_ones_stay_those_of_a_direction():
    camera = pinhole(640, 480, 500.0)
    corners = np.array([projected(corners_of(np.eye(3), [0.0, 0.0, z], 0.16), camera) for z in (1.0, 2.0, 4.0)])
    _, unit = tag_positions(corners, np.full(3, 0.16), camera)
    along, across = np.sqrt(unit[:, 2, 2]), np.sqrt(unit[:, 0, 0])
    np.testing.assert_allclose(along[1:] / along[:-1], 4.0, rtol=0.05)  # as the square of the range
    np.testing.assert_allclose(across[1:] / across[:-1], 2.0, rtol=0.05)


@pytest.mark.parametrize(
    "corners",
    [np.zeros((4, 2)), np.full((4, 2), np.nan), [[0, 0], [1, 1], [2, 2], [3, 3]], [[0, 0], [9, 9], [9, 0], [0, 9]]],
    ids=["point", "nan", "line", "bow tie"],
)
def test_what_is_no_square_is_nowhere(corners):
    found, unit = tag_positions(np.array([corners], dtype=float), np.array([0.16]), LENSES["brown"])
    assert np.isnan(found).all()
    assert np.isnan(unit).all()


def test_no_tags():
    found, unit = tag_positions(np.zeros((0, 4, 2)), np.zeros(0), LENSES["brown"])
    assert found.shape == (0, 3)
    assert unit.shape == (0, 3, 3)
