"""Blur, brightness and noise of an image against their definitions."""

import numpy as np
import pytest

from tfg_drake.config import CameraRealityConfig
from tfg_drake.vision.exposure import exposed


def edge():
    """(8, 40): black to the left of column 20, 200 to the right."""
    image = np.zeros((8, 40), np.uint8)
    image[:, 20:] = 200
    return image


def test_a_perfect_exposure_changes_nothing():
    np.testing.assert_array_equal(exposed(edge(), 0.0, CameraRealityConfig(noise=0.0), 1), edge())


@pytest.mark.parametrize("blur", [1.0, 2.5, 4.0, 7.3])
def test_blur_spreads_an_edge_over_as_many_pixels(blur):
    seen = exposed(edge(), -blur, CameraRealityConfig(noise=0.0), 1)[4].astype(float)
    assert seen[5] == 0.0
    assert seen[35] == 200.0
    # What a row holds stays, and so does where its edge is; a ramp of so many pixels has the spread of a box.
    slope = np.diff(seen) / 200.0
    at = np.arange(39)
    middle = np.sum(slope * at)
    assert middle == pytest.approx(19.0, abs=0.02)
    assert np.sqrt(np.sum(slope * (at - middle) ** 2)) == pytest.approx(blur / np.sqrt(12.0), abs=0.3)


def test_light_and_noise():
    level = np.full((200, 200), 100, np.uint8)
    assert (exposed(level, 0.0, CameraRealityConfig(brightness=0.2, noise=0.0), 1) == 20).all()
    assert (exposed(level, 0.0, CameraRealityConfig(brightness=3.0, noise=0.0), 1) == 255).all()
    noisy = exposed(level, 0.0, CameraRealityConfig(noise=3.0), 1)
    assert noisy.std() == pytest.approx(3.0, rel=0.03)
    assert noisy.mean() == pytest.approx(100.0, abs=0.05)
    np.testing.assert_array_equal(noisy, exposed(level, 0.0, CameraRealityConfig(noise=3.0), 1))
    assert (noisy != exposed(level, 0.0, CameraRealityConfig(noise=3.0), 2)).any()
