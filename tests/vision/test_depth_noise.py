"""The noise of depth images, and scans of them that have no bias by it."""

import dataclasses

import numpy as np
import pytest

from tests.cameras import pinhole
from tests.vision.test_depth_scan import CONFIG, LEVEL, room, scanned
from tfg_drake.vision.depth_scan import with_noise

CAMERA = pinhole(320, 240, 250.0)


def test_it_grows_with_the_square_of_the_depth_and_leaves_what_is_no_depth():
    depth = np.repeat(np.array([0.0, 1.0, 3.0, np.inf], dtype=np.float32), 300)[None].repeat(203, axis=0)
    seen = with_noise(depth, 0.003, 1)
    assert seen.dtype == np.float32
    np.testing.assert_array_equal(seen[:, depth[0] == 0.0], 0.0)
    assert np.isinf(seen[:, np.isinf(depth[0])]).all()
    for d in (1.0, 3.0):
        error = seen[:, depth[0] == d] - d
        assert error.std() == pytest.approx(0.003 * d**2, rel=0.1)
        assert abs(error.mean()) < 0.0005 * d**2
    np.testing.assert_array_equal(seen, with_noise(depth, 0.003, 1))
    assert (seen != with_noise(depth, 0.003, 2)).any()
    assert with_noise(depth, 0.0, 1) is depth


@pytest.mark.parametrize("wall", [1.0, 2.0, 4.0])
def test_a_noisy_wall_is_where_it_is(wall):
    config = dataclasses.replace(CONFIG, noise=0.003)
    depth = room(CAMERA, LEVEL, wall).astype(np.float32)
    exact = scanned(depth, camera=CAMERA).ranges
    errors = [scanned(with_noise(depth, 0.003, k), camera=CAMERA, config=config).ranges - exact for k in range(10)]
    assert abs(np.mean(errors)) < 0.15 * 0.003 * wall**2
    assert np.std(errors) < 0.5 * 0.003 * wall**2


def test_the_nearest_thing_counts_not_what_stands_behind_it():
    config = dataclasses.replace(CONFIG, noise=0.003)
    depth = room(CAMERA, LEVEL, 3.0, box=(2.0, -0.3, 0.3, 0.05, 0.2)).astype(np.float32)
    for image in (depth, with_noise(depth, 0.003, 1)):
        ahead = scanned(image, camera=CAMERA, config=config).ranges[158:162]
        np.testing.assert_allclose(ahead, 2.0, atol=0.02)
