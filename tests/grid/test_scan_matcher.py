"""Matching against a map that is known, and the proposal drawn from it."""

import math

import numpy as np

from tfg_drake.config import ScanConfig
from tfg_drake.grid import scan_matcher
from tfg_drake.grid.occupancy import empty_maps, insert_scan
from tfg_drake.grid.scan_matcher import end_points, propose
from tfg_drake.messages import LaserScan
from tfg_drake.simulation.laser_scanner import ray_angles, scan

# An L-shaped room, so that no turn maps it onto itself.
ROOM = np.array(
    [[-3, -2, 4, -2], [4, -2, 4, 1], [4, 1, 1, 1], [1, 1, 1, 3], [1, 3, -3, 3], [-3, 3, -3, -2]], dtype=float
)
TRUE = np.array([0.3, -0.2, 0.4])


def view(X_WB, noise=0.0, seed=0):
    config = ScanConfig(noise=noise)
    angles = ray_angles(config)
    return scan(ROOM, np.asarray(X_WB), 0.0, angles, np.random.default_rng(seed).standard_normal(len(angles)), config)


def room_map(particles=1, noise=0.0):
    maps = empty_maps(particles, 0.05)
    for k, theta in enumerate(np.arange(0.0, 2 * math.pi, 0.5)):
        X = np.tile([0.0, 0.0, theta], (particles, 1))
        maps = insert_scan(maps, np.arange(particles), X, view(X[0], noise, k))
    return maps


def test_the_likelihood_peaks_at_the_true_pose():
    maps, p_BP = room_map(), end_points(view(TRUE), 0.05)
    field = np.empty((14 * scan_matcher.TILE, 14 * scan_matcher.TILE), dtype=np.float32)
    splat = scan_matcher._splat_table(maps.resolution)
    field = scan_matcher._fill(field, maps, 0, splat, TRUE)
    for axis, step in ((0, 0.02), (1, 0.02), (2, 0.005)):
        poses = np.tile(TRUE, (41, 1))
        poses[:, axis] += step * np.arange(-20, 21)
        values = np.array([scan_matcher._score(field, p_BP, pose) for pose in poses])
        assert abs(int(np.argmax(values)) - 20) <= 1
        assert values.max() > values[[0, 40]].max() + 10.0


def test_end_points_are_the_returns_a_spacing_apart():
    angles = np.array([-0.2, -0.1, 0.0, 0.001, 0.1, 0.2, 0.3])
    one = LaserScan(0.0, angles, np.array([np.nan, np.inf, 2.0, 2.0, 2.0, 12.0, 0.0]), 10.0, 0.01)
    np.testing.assert_allclose(end_points(one, 0.05), [[2.0, 0.0], [2.0 * math.cos(0.1), 2.0 * math.sin(0.1)]])


def test_a_wrong_prediction_is_corrected_in_every_particle():
    n = 20
    maps, rng = room_map(n, 0.015), np.random.default_rng(3)
    sigma = np.array([0.05, 0.05, 0.02])
    prior = TRUE + sigma * rng.standard_normal((n, 3))
    covariance = np.tile(np.diag(sigma**2), (n, 1, 1))
    points = end_points(view(TRUE, 0.015, 99), 0.05)
    drawn, log_weight = propose(maps, prior, covariance, points, rng.standard_normal((n, 3)))
    error = np.abs(drawn - TRUE)
    assert error[:, :2].mean() < 0.02
    assert error[:, :2].max() < 0.06
    assert error[:, 2].mean() < 0.008
    assert np.isfinite(log_weight).all()


def test_without_anything_to_match_the_motion_model_is_drawn_from():
    n, rng = 4000, np.random.default_rng(4)
    covariance = np.array([[0.04, 0.01, 0.002], [0.01, 0.02, 0.0], [0.002, 0.0, 0.003]])
    for points in (np.zeros((0, 2)), end_points(view(TRUE), 0.05)):
        drawn, log_weight = propose(
            empty_maps(n, 0.05), np.tile(TRUE, (n, 1)), np.tile(covariance, (n, 1, 1)), points, rng.normal(size=(n, 3))
        )
        np.testing.assert_allclose(np.cov((drawn - TRUE).T), covariance, atol=0.004)
        np.testing.assert_allclose(log_weight, log_weight[0])


def test_the_particle_whose_map_the_scan_fits_gains_weight():
    fits, empty = room_map(), empty_maps(1, 0.05)
    points, covariance = end_points(view(TRUE), 0.05), np.diag([0.01, 0.01, 0.002])[None] ** 2
    good, bad = (propose(maps, TRUE[None], covariance, points, np.zeros((1, 3)))[1][0] for maps in (fits, empty))
    assert good > bad + 5.0
