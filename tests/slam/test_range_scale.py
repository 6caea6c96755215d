"""The range scale learnt from tags on surfaces that the scan meets."""

import itertools

import numpy as np
import pytest

from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.messages import LaserScan, TagDetections, replace
from tfg_drake.slam.range_scale import (
    SCALE_SIGMA,
    compare,
    corrected,
    correction,
    great_error,
    none_compared,
    unknown_scale,
)

FRAMES = itertools.count()
WALLS = np.array([[4.0, -6.0, 5.0, 6.0], [-6.0, 5.0, 6.0, 5.0], [-6.0, -5.0, 6.0, -5.0], [-5.0, -6.0, -5.0, 6.0]])
ANGLES = np.linspace(-1.08, 1.08, 249)
# Those of the columns of an image.
COLUMNS = np.arctan(np.linspace(np.tan(-1.08), np.tan(1.08), 249))


def inwards(walls, distance):
    """Walls moved towards the origin."""
    along = walls[:, 2:] - walls[:, :2]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
    normal *= -np.sign((normal * walls[:, :2]).sum(axis=1))[:, None]
    return walls + distance * np.hstack([normal, normal])


def frame(rng, scale, stamp=0.0, noise=1.0, stray=0, before=0.01, angles=ANGLES):
    """A frame of twelve tags that no other frame shows, before their walls, and the scan of its instant, from a random
    place."""
    origin, heading = rng.uniform(-2.0, 2.0, 2), rng.uniform(-np.pi, np.pi)
    ranges = cast_rays(WALLS, origin, angles + heading, 10.0)
    bearing = rng.uniform(-1.0, 1.0, 12)
    distance = cast_rays(inwards(WALLS, before), origin, bearing + heading, 10.0)
    distance[:stray] *= rng.uniform(0.3, 0.8, stray)
    sigma = 0.02 + 0.01 * distance
    z = scale * distance + noise * sigma * rng.normal(size=12)
    bearing = bearing + noise * 0.01 * rng.normal(size=12)
    scan = LaserScan(stamp, angles, ranges + noise * 0.015 * rng.normal(size=len(angles)), 10.0, 0.015)
    ids = 12 * next(FRAMES) + np.arange(12)
    return TagDetections(stamp, ids, z, bearing, sigma, np.full(12, 0.01)), scan


@pytest.mark.parametrize(
    ("true", "stray", "angles"),
    [(1.0, 0, ANGLES), (1.01, 0, ANGLES), (0.985, 0, ANGLES), (1.01, 3, ANGLES), (1.0, 0, COLUMNS), (1.01, 0, COLUMNS)],
)
def test_the_scale_is_found_to_two_parts_in_a_thousand(true, stray, angles):
    errors, sigmas = [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        scale, compared = unknown_scale(), none_compared()
        for _ in range(100):
            scale, compared = compare(scale, compared, *frame(rng, true, stray=stray, angles=angles))
        errors.append(scale.mean[0] - (true - 1.0))
        sigmas.append(scale.sigma)
    assert np.abs(errors).max() < 0.005
    assert np.abs(np.mean(errors)) < 0.0015
    assert max(sigmas) < 0.002


@pytest.mark.parametrize("before", [-0.02, 0.0, 0.03, 0.05])
def test_tags_before_their_surfaces_are_no_range_scale(before):
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        scale, compared = unknown_scale(), none_compared()
        for _ in range(200):
            scale, compared = compare(scale, compared, *frame(rng, 1.0, before=before))
        assert abs(scale.mean[0]) < 4.0 * scale.sigma
        found.append(scale.mean)
    r, o = np.mean(found, axis=0)
    assert abs(r) < 1e-3
    assert o == pytest.approx(before, abs=6e-3)


def test_a_corrected_range_is_the_true_one():
    rng = np.random.default_rng(1)
    scale, compared = unknown_scale(), none_compared()
    detections, _ = frame(rng, 1.01)
    assert corrected(detections, correction(scale, compared)) is detections
    for _ in range(200):
        scale, compared = compare(scale, compared, *frame(rng, 1.01))
    np.testing.assert_allclose(
        corrected(detections, correction(scale, compared)).range, detections.range / 1.01, rtol=3e-3
    )
    np.testing.assert_array_equal(corrected(detections, correction(scale, compared)).bearing, detections.bearing)


def test_a_scale_that_may_well_be_true_is_not_corrected():
    rng = np.random.default_rng(1)
    scale, compared = unknown_scale(), none_compared()
    for _ in range(100):
        scale, compared = compare(scale, compared, *frame(rng, 1.0))
    detections, _ = frame(rng, 1.0)
    assert scale.pairs > 1000
    assert corrected(detections, correction(scale, compared)) is detections


def test_what_a_few_tags_err_by_in_all_frames_alike_is_no_scale():
    for seed in range(10):
        rng = np.random.default_rng(seed)
        detections, scan = frame(rng, 1.0, noise=0.0)
        errors, scale, compared = 0.01 * rng.normal(size=12), unknown_scale(), none_compared()
        for _ in range(300):
            noisy = errors + detections.sigma_range * rng.normal(size=12)
            scale, compared = compare(scale, compared, replace(detections, range=detections.range + noisy), scan)
        assert scale.pairs > 1000
        assert corrected(detections, correction(scale, compared)) is detections


def test_without_a_pair_nothing_is_learnt():
    nothing = LaserScan(0.0, np.zeros(0), np.zeros(0), 10.0, 0.015)
    free = LaserScan(0.0, ANGLES, np.full(len(ANGLES), np.inf), 10.0, 0.015)
    detections, _ = frame(np.random.default_rng(2), 1.0)
    for scan in (nothing, free):
        scale, _ = compare(unknown_scale(), none_compared(), detections, scan)
        assert scale.pairs == 0
        assert scale.sigma == pytest.approx(SCALE_SIGMA)


@pytest.mark.parametrize("stray", [0, 3])
@pytest.mark.parametrize("exact", [1.0, 0.2])
@pytest.mark.parametrize("true", [0.05, 0.1, 0.2, 0.8, 0.9, 0.985, 1.0, 1.01, 1.1, 1.2, 5.0, 10.0, 20.0])
def test_a_setting_that_must_be_wrong_is_told_from_a_scale_that_may_be(true, exact, stray):
    """exact: what share of the usual deviations a detector has; then no pair agrees with a tenth too much."""
    rng = np.random.default_rng(1)
    scale, compared = unknown_scale(), none_compared()
    for _ in range(30):
        detections, scan = frame(rng, true, noise=exact, stray=stray)
        stated = {name: exact * getattr(detections, name) for name in ("sigma_range", "sigma_bearing")}
        scale, compared = compare(scale, compared, replace(detections, **stated), replace(scan, sigma=0.015 * exact))
    expected = true - 1.0 if abs(true - 1.0) > 0.03 else 0.0
    assert great_error(scale, compared) == pytest.approx(expected, abs=0.03 * max(1.0, true))
    assert bool(great_error(scale, compared)) == bool(expected)


def test_the_wrong_walls_are_no_wrong_size():
    """A scan that is mirrored, or of another place."""
    for other in (False, True):
        rng, scale, compared = np.random.default_rng(2), unknown_scale(), none_compared()
        for _ in range(30):
            detections, scan = frame(rng, 1.0)
            wrong = frame(rng, 1.0)[1].ranges if other else scan.ranges[::-1]
            scale, compared = compare(scale, compared, detections, replace(scan, ranges=wrong))
        assert compared.apart.sum() > 100
        assert great_error(scale, compared) == 0.0
