"""Poses by surfaces of the map: what is seen from a place lies on them."""

import math

import numpy as np
import pytest

from tests.slam.test_loop_search import driven, surfaces, true_way
from tfg_drake.geometry import se2
from tfg_drake.messages import LaserScan, replace
from tfg_drake.slam.keyframe import moved_points
from tfg_drake.slam.surface_fit import GATES, Surfaces, poses_by_surfaces

LOOSE = np.diag(np.array([0.1, 0.1, 0.03]) ** -2.0)
WHERE = np.array([-9.0, -5.0, 0.3])


def seen_from(X, noise=0.0):
    """Points with normals within 4 m of a pose, in its frame."""
    seen = surfaces()
    query = moved_points(se2.inverse(X), seen[np.hypot(*(seen[:, :2] - X[:2]).T) < 4.0])
    return query + np.random.default_rng(2).normal(0.0, [noise, noise, 0.0, 0.0], query.shape)


@pytest.mark.parametrize("off", [[0.15, -0.1, 0.06], [-0.1, 0.12, -0.04], [0.0, 0.0, 0.0]])
def test_a_query_is_fitted_to_surfaces_and_lies_on_them(off):
    found, _, share = Surfaces(surfaces()).fitted(seen_from(WHERE, 0.01), WHERE + off, 0.01 * LOOSE, 2 * GATES)
    np.testing.assert_allclose(found, WHERE, atol=5e-3)
    assert share > 0.9


def test_along_a_bare_wall_and_where_nothing_is_what_was_known_before_stays():
    x = np.arange(-3.0, 3.0, 0.02)
    wall = np.column_stack([x, np.full(len(x), 1.0), 0.0 * x, np.full(len(x), -1.0)])
    start = np.array([0.07, 0.05, 0.02])
    found, *_ = Surfaces(wall).fitted(wall[np.abs(wall[:, 0]) < 2.0], start, LOOSE, 2 * GATES)
    np.testing.assert_allclose(found, [0.07, 0.0, 0.0], atol=2e-3)
    for known, seen in ((np.empty((0, 4)), wall), (wall, np.empty((0, 4)))):
        nothing, _, share = Surfaces(known).fitted(seen, start, LOOSE, GATES)
        assert np.array_equal(nothing, start)
        assert share == 0.0


def test_what_looks_the_other_way_is_another_surface():
    """The two faces of a thin wall are not taken for each other."""
    x = np.arange(-3.0, 3.0, 0.02)
    face = np.column_stack([x, np.full(len(x), 1.0), 0.0 * x, np.full(len(x), 1.0)])
    seen = face * [1.0, 0.0, 1.0, -1.0] + [0.0, 0.9, 0.0, 0.0]
    start = np.array([0.0, 0.05, 0.0])
    assert np.array_equal(Surfaces(face).fitted(seen, start, LOOSE, GATES)[0], start)


def scan_from(X_WS):
    """A scan all round from a pose, by the surfaces' points in the directions of its rays."""
    angles, ranges = np.linspace(-math.pi, math.pi, 360, endpoint=False), np.full(360, np.inf)
    p = seen_from(X_WS)
    bearing, distance = np.arctan2(p[:, 1], p[:, 0]), np.hypot(p[:, 0], p[:, 1])
    ray = np.round((bearing + math.pi) / math.radians(1.0)).astype(int) % 360
    facing = np.sum(p[:, :2] * p[:, 2:], axis=1) < 0.0
    np.minimum.at(ranges, ray[facing], distance[facing])
    return LaserScan(stamp=0.0, angles=angles, ranges=ranges, range_max=10.0, sigma=0.01)


def test_poses_of_scans_are_better_than_those_between_keyframes():
    graph, truth = driven(20, drift=0.0)
    graph = replace(graph, X_MN=truth)
    off = np.random.default_rng(3).normal(0.0, [0.03, 0.03, 0.01], (5, 3))
    true = truth[2:12:2]
    scans = [scan_from(se2.compose(true_way(1)[0], X)) for X in true]
    found, covariance = poses_by_surfaces(graph, scans, true + off)
    error = np.abs(found - true)
    assert np.all(error.mean(axis=0) < 0.4 * np.abs(off).mean(axis=0))
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    assert np.all(variance < [9e-4, 9e-4, 1e-4])
    assert np.all(np.mean(error**2 / variance, axis=0) < 4.0)
