"""Tag centres from corners: lens models against their forward formulas, poses against projection."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tfg_drake.datasets.square_pnp import square_centers, undistort

INTRINSICS = np.array([600.0, 590.0, 640.0, 500.0])
SQUARE = np.array([[-0.5, -0.5, 0.0], [0.5, -0.5, 0.0], [0.5, 0.5, 0.0], [-0.5, 0.5, 0.0]])


def distort(points, model, k):
    x, y = points[..., 0], points[..., 1]
    r2 = x**2 + y**2
    if model == "equidistant":
        r = np.sqrt(r2)
        theta = np.arctan(r)
        scale = theta * (1 + k[0] * theta**2 + k[1] * theta**4 + k[2] * theta**6 + k[3] * theta**8) / r
        out = np.stack([scale * x, scale * y], axis=-1)
    else:
        radial = 1 + k[0] * r2 + k[1] * r2**2
        out = np.stack(
            [
                radial * x + 2 * k[2] * x * y + k[3] * (r2 + 2 * x**2),
                radial * y + k[2] * (r2 + 2 * y**2) + 2 * k[3] * x * y,
            ],
            axis=-1,
        )
    return out * INTRINSICS[:2] + INTRINSICS[2:]


@pytest.mark.parametrize(
    ("model", "k"), [("equidistant", [-0.02, 0.016, -0.0096, 0.0018]), ("radtan", [-0.1, 0.02, 0.001, -0.0005])]
)
def test_a_lens_is_undone(model, k):
    points = np.random.default_rng(0).uniform(-0.8, 0.8, (50, 2))
    np.testing.assert_allclose(undistort(distort(points, model, k), INTRINSICS, model, np.array(k)), points, atol=1e-9)


def test_the_principal_point_is_the_axis():
    assert undistort(INTRINSICS[2:], INTRINSICS, "equidistant", np.zeros(4)).tolist() == [0.0, 0.0]


def test_an_unknown_lens_is_named():
    with pytest.raises(ValueError, match="unknown lens model 'fisheye'"):
        undistort(np.zeros(2), INTRINSICS, "fisheye", np.zeros(4))


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0], [2, 3, 0, 1]])
def test_centres_come_back_from_their_projection(order):
    random = np.random.default_rng(3)
    n = 40
    sizes = random.uniform(0.1, 0.3, n)
    centers = np.column_stack([random.uniform(-1, 1, (n, 2)), random.uniform(1.0, 6.0, n)])
    R = Rotation.from_rotvec(random.uniform(-0.8, 0.8, (n, 3))).as_matrix()
    points = centers[:, None] + np.einsum("nij,nkj->nki", R, sizes[:, None, None] * SQUARE[order])
    found, _ = square_centers(points[..., :2] / points[..., 2:], sizes)
    np.testing.assert_allclose(found, centers, atol=1e-7)


def test_the_covariance_is_that_of_many_draws():
    random = np.random.default_rng(5)
    center, size, sigma = np.array([0.3, -0.2, 1.5]), 0.3, 3e-4
    R = Rotation.from_rotvec([0.5, 0.6, 0.3]).as_matrix()
    points = center + size * SQUARE @ R.T
    image = points[:, :2] / points[:, 2:]
    draws = image + sigma * random.normal(size=(4000, 4, 2))
    found, _ = square_centers(draws, np.full(4000, size))
    covariance = sigma**2 * square_centers(image[None], np.array([size]))[1][0]
    np.testing.assert_allclose(np.cov(found.T), covariance, rtol=0.15, atol=0.05 * np.abs(covariance).max())


def test_no_tags_no_centres():
    centers, covariance = square_centers(np.zeros((0, 4, 2)), np.zeros(0))
    assert centers.shape == (0, 3)
    assert covariance.shape == (0, 3, 3)
