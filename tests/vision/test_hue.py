"""Brightness drawn as hue: equally bright for a renderer, and what it was for the camera."""

import numpy as np

from tfg_drake.vision.hue import hue_of, photographed


def test_hues_are_equally_bright():
    luminance = hue_of(np.arange(256)) @ [0.299, 0.587, 0.114]
    assert np.ptp(luminance) < 1.0


def test_a_photograph_shows_the_grey_levels_that_were_drawn():
    levels = np.kron(np.array([[0, 90], [170, 255]], np.uint8), np.ones((8, 8), np.uint8))
    for light in (1.0, 0.6):
        drawn = np.rint(light * hue_of(levels)).astype(np.uint8)
        seen = photographed(np.dstack([drawn, np.full((16, 16), 255, np.uint8)]))
        assert seen.shape == (16, 16)
        np.testing.assert_allclose(seen[[4, 4, 12, 12], [4, 12, 4, 12]], light * np.array([0, 90, 170, 255]), atol=1.5)


def test_an_edge_stays_in_its_place_and_is_not_quite_sharp():
    levels = np.zeros((16, 16), np.uint8)
    levels[:, 8:] = 200
    row = photographed(hue_of(levels))[8].astype(int)
    assert row[7] + row[8] == 200
    assert 8 < row[7] < 40
    assert row[6] == 0
    assert row[9] == 200
