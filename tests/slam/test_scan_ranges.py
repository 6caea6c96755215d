"""Tags' ranges and the camera's mount learnt from a scan of the surfaces that tags stand on."""

import numpy as np
import pytest

from tests.arrays import frozen
from tfg_drake.geometry import se2
from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.messages import LaserScan, TagDetections, replace
from tfg_drake.slam.scan_ranges import (
    BEFORE_SURFACE,
    TAG_SIGMA,
    compared,
    great_error,
    none_compared,
    scan_information,
    surface,
)
from tfg_drake.slam.shared import (
    CAMERA_YAW,
    LEVER_X,
    LEVER_Y,
    RANGE_SCALE,
    SCANNER_X,
    SCANNER_Y,
    SCANNER_YAW,
    SHARED,
    Shared,
)

CORNERS = np.array([[4.0, -6.0], [5.0, 6.0], [-6.0, 5.0], [-5.0, -5.5]])
WALLS = np.hstack([CORNERS, np.roll(CORNERS, -1, axis=0)])
ANGLES = np.linspace(-1.08, 1.08, 249)
# Those of the columns of an image.
COLUMNS = np.arctan(np.linspace(np.tan(-1.08), np.tan(1.08), 249))
SIGMA = np.zeros(SHARED)
SIGMA[[CAMERA_YAW, LEVER_X, LEVER_Y, RANGE_SCALE]] = 0.0175, 0.005, 0.005, 0.01
SCANNER = np.array([0.01, 0.005, 0.005])
SIGMA[[SCANNER_YAW, SCANNER_X, SCANNER_Y]] = SCANNER
PRIOR = Shared(np.zeros(SHARED), np.diag(np.maximum(SIGMA, 1e-6) ** 2))
AT = [RANGE_SCALE, CAMERA_YAW, LEVER_X, LEVER_Y]


class World:
    """A room of n tags so far, m, before its walls, a camera with parameters (8,), a scanner with a yaw (rad) and a
    lever arm of its own, m, and each tag's error of range, m."""

    def __init__(self, seed, shared=None, scanner=(0.0, 0.0, 0.0), before=0.01, errors=0.0, tags=60):
        self.rng = np.random.default_rng(seed)
        self.shared = np.zeros(SHARED) if shared is None else shared
        self.scanner = np.array(scanner)
        wall, along = self.rng.integers(0, 4, tags), self.rng.uniform(0.1, 0.9, tags)
        way = WALLS[wall, 2:] - WALLS[wall, :2]
        # The room is to the left of its walls.
        inwards = np.column_stack([-way[:, 1], way[:, 0]]) / np.hypot(*way.T)[:, None]
        self.points = WALLS[wall, :2] + along[:, None] * way + before * inwards
        self.errors = errors * self.rng.normal(size=tags)

    def frame(self, stamp=0.0, noise=1.0, stray=0, angles=ANGLES, exact=1.0):
        """A frame of tags and the scan of its instant, from a random place; `stray` tags have something before them.
        exact: what share of the usual deviations the sensors have, and state."""
        rng = self.rng
        X_WB = np.append(rng.uniform(-2.0, 2.0, 2), rng.uniform(-np.pi, np.pi))
        yaw, x, y = self.scanner
        X_WS = se2.compose(X_WB, np.array([x, y, yaw]))
        ranges = cast_rays(WALLS, X_WS[:2], angles + X_WS[2], 12.0)
        camera = self.shared[[LEVER_X, LEVER_Y, CAMERA_YAW]]
        p_CL = se2.transform(se2.inverse(se2.compose(X_WB, camera)), self.points)
        r, b = np.hypot(*p_CL.T), np.arctan2(p_CL[:, 1], p_CL[:, 0])
        seen = np.flatnonzero((np.abs(b) < 1.0) & (r < 10.0))
        r, b = r[seen] + self.errors[seen], b[seen]
        r[:stray] *= rng.uniform(0.3, 0.8, len(r[:stray]))
        sigma = exact * (0.02 + 0.01 * r)
        z = (1.0 + self.shared[RANGE_SCALE]) * r + noise * sigma * rng.normal(size=len(r))
        b = b + noise * exact * 0.01 * rng.normal(size=len(r))
        ranges = ranges + noise * exact * 0.015 * rng.normal(size=len(angles))
        scan = LaserScan(stamp, angles, ranges, 12.0, 0.015 * exact)
        return TagDetections(stamp, seen, z, b, sigma, np.full(len(r), 0.01 * exact)), scan

    def told(self, frames, prior=PRIOR, **how):
        """All pairs of so many frames, and the posterior of the parameters."""
        ranges = none_compared()
        for _ in range(frames):
            ranges = compared(ranges, *self.frame(**how), prior)
        return ranges, posterior(ranges, prior)


def posterior(ranges, prior=PRIOR):
    information, gradient = scan_information(ranges, 1.0)
    inverse = np.linalg.inv(prior.covariance)
    covariance = np.linalg.inv(inverse + information)
    return Shared(covariance @ (inverse @ prior.mean - gradient), covariance)


def off(**parameters):
    shared = np.zeros(SHARED)
    for name, value in parameters.items():
        shared[{"scale": RANGE_SCALE, "yaw": CAMERA_YAW, "ahead": LEVER_X, "aside": LEVER_Y}[name]] = value
    return shared


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("name", "value", "at"),
    [("scale", 0.015, RANGE_SCALE), ("yaw", 0.04, CAMERA_YAW), ("ahead", 0.04, LEVER_X), ("aside", 0.04, LEVER_Y)],
)
def test_each_parameter_is_found_with_its_sign(name, value, at, sign):
    """As far as the scanner's own mount lets it be told."""
    wide = np.maximum(SIGMA, 1e-6)
    wide[at] = 10.0 * value
    world = World(1, off(**{name: sign * value}))
    _, found = world.told(100, Shared(np.zeros(SHARED), np.diag(wide**2)))
    assert found.mean[at] == pytest.approx(sign * value, abs=3.0 * found.sigma[at])
    assert found.sigma[at] < 0.4 * value
    others = [other for other in AT if other != at]
    assert (np.abs(found.mean[others]) < 3.0 * found.sigma[others]).all()


def test_what_is_told_is_not_counted_from_what_was_believed():
    """A scan is read where the camera is believed to look, and tells where it looks."""
    wide = np.maximum(SIGMA, 1e-6)
    wide[CAMERA_YAW] = 0.1
    for believed in (0.0, 0.08):
        prior = Shared(off(yaw=believed), np.diag(wide**2))
        _, found = World(3, off(yaw=0.08)).told(100, prior)
        assert found.mean[CAMERA_YAW] == pytest.approx(0.08, abs=3.0 * found.sigma[CAMERA_YAW])
        assert found.sigma[CAMERA_YAW] < 0.012


def test_the_camera_is_measured_against_the_scanner():
    """Mounted alike, the two differ by nothing; a scanner that is off by itself makes the camera seem off."""
    exact = np.maximum(SIGMA, 1e-6)
    exact[[CAMERA_YAW, LEVER_X, LEVER_Y]] = 0.1
    prior = Shared(np.zeros(SHARED), np.diag(exact**2))
    both = World(2, off(yaw=0.03, ahead=0.02, aside=-0.02), (0.03, 0.02, -0.02)).told(150, prior)[1]
    scanner = World(2, None, (0.03, 0.02, -0.02)).told(150, prior)[1]
    for found, truth in ((both, off()), (scanner, off(yaw=-0.03, ahead=-0.02, aside=0.02))):
        assert (np.abs(found.mean - truth)[AT] < 3.0 * found.sigma[AT]).all()


@pytest.mark.parametrize("exact", [1.0, 0.1])
def test_its_covariance_is_honest(exact):
    """Over worlds whose parameters, scanner, tags and distance before the walls are drawn from what is believed."""
    squared, of_each = [], []
    for seed in range(200):
        rng = np.random.default_rng(1000 + seed)
        truth = SIGMA * rng.normal(size=SHARED)
        nuisance = np.append(SCANNER, BEFORE_SURFACE) * rng.normal(size=4)
        world = World(seed, truth, nuisance[:3], before=nuisance[3], errors=TAG_SIGMA, tags=30)
        _, found = world.told(12, exact=exact)
        error = (found.mean - truth)[AT]
        squared.append(error @ np.linalg.solve(found.covariance[np.ix_(AT, AT)], error) / 4.0)
        of_each.append(np.square(error / found.sigma[AT]))
    assert 0.8 < np.mean(squared) < 1.25
    assert (np.mean(of_each, axis=0) > 0.65).all()
    assert (np.mean(of_each, axis=0) < 1.45).all()


@pytest.mark.parametrize("yaw", [-0.02, 0.02])
def test_a_scanner_that_looks_aside_is_no_scale(yaw):
    found = [World(seed, None, (yaw, 0.0, 0.0)).told(150)[1] for seed in range(6)]
    assert np.abs([one.mean[RANGE_SCALE] / one.sigma[RANGE_SCALE] for one in found]).max() < 3.0
    assert abs(np.mean([one.mean[RANGE_SCALE] for one in found])) < 1.5e-3


@pytest.mark.parametrize("before", [-0.02, 0.0, 0.03, 0.05])
def test_tags_before_their_surfaces_are_no_scale(before):
    found = [World(seed, before=before).told(150)[1] for seed in range(6)]
    assert np.abs([one.mean[RANGE_SCALE] / one.sigma[RANGE_SCALE] for one in found]).max() < 3.0
    assert abs(np.mean([one.mean[RANGE_SCALE] for one in found])) < 1.5e-3


@pytest.mark.parametrize(("stray", "angles"), [(0, ANGLES), (2, ANGLES), (0, COLUMNS)])
def test_the_scale_is_found_to_a_few_parts_in_a_thousand(stray, angles):
    errors, sigmas = [], []
    for seed in range(8):
        _, found = World(seed, off(scale=0.01)).told(150, stray=stray, angles=angles)
        errors.append(found.mean[RANGE_SCALE] - 0.01)
        sigmas.append(found.sigma[RANGE_SCALE])
    assert np.abs(errors).max() < 0.005
    assert abs(np.mean(errors)) < 0.0015
    assert max(sigmas) < 0.0025


def test_what_a_few_tags_err_by_in_all_frames_alike_is_no_scale():
    """However often a robot that stands sees them, they are so many tags."""
    few, many = [], []
    for seed in range(10):
        world, ranges = World(seed, errors=TAG_SIGMA, tags=30), none_compared()
        detections, scan = world.frame(noise=0.0)
        for k in range(1000):
            noisy = detections.range + detections.sigma_range * world.rng.normal(size=len(detections.ids))
            ranges = compared(ranges, replace(detections, range=noisy), scan, PRIOR)
            if k == 299:
                few.append(posterior(ranges).sigma[RANGE_SCALE])
        many.append(posterior(ranges))
    scales = np.array([one.mean[RANGE_SCALE] / one.sigma[RANGE_SCALE] for one in many])
    assert np.abs(scales).max() < 3.0
    assert np.mean(scales**2) < 2.2
    assert np.mean(few) < 1.2 * np.mean([one.sigma[RANGE_SCALE] for one in many])


@pytest.mark.parametrize("slant", [0.0, 0.5, -1.2])
def test_a_straight_surface_is_read_exactly(slant):
    """A wall 3 m away along the bearing of 0.2 rad, looked at by this tangent of the incidence."""
    normal = 0.2 + np.arctan(slant)
    ranges = 3.0 * np.cos(0.2 - normal) / np.cos(ANGLES - normal)
    distance, found = surface(0.2, frozen(ANGLES), frozen(ranges), 0.015)
    assert distance == pytest.approx(3.0, abs=3e-4)
    assert found == pytest.approx(slant, abs=0.01)


def test_rays_round_a_corner_are_no_surface():
    """From the middle of a room, to its corner; to a scanner so bad that they may be straight they are one."""
    angles, ranges = frozen(ANGLES), frozen(cast_rays(WALLS, np.zeros(2), ANGLES + 0.7, 12.0))
    corner = float(angles[np.argmax(ranges)])
    assert np.isnan(surface(corner, angles, ranges, 0.015)[0])
    assert np.isfinite(surface(corner, angles, ranges, 0.5)[0])
    assert np.isfinite(surface(corner + 0.2, angles, ranges, 0.015)[0])


def test_without_a_pair_nothing_is_learnt():
    nothing = LaserScan(0.0, np.zeros(0), np.zeros(0), 10.0, 0.015)
    free = LaserScan(0.0, ANGLES, np.full(len(ANGLES), np.inf), 10.0, 0.015)
    detections, _ = World(2).frame()
    for scan in (nothing, free):
        ranges = compared(none_compared(), detections, scan, PRIOR)
        assert ranges.pairs == 0
        information, gradient = scan_information(ranges, 1.0)
        assert not information.any()
        assert not gradient.any()


@pytest.mark.parametrize("stray", [0, 2])
@pytest.mark.parametrize("exact", [1.0, 0.2])
@pytest.mark.parametrize("true", [0.05, 0.1, 0.2, 0.8, 0.9, 0.985, 1.0, 1.01, 1.1, 1.2, 5.0, 10.0, 20.0])
def test_a_setting_that_must_be_wrong_is_told_from_a_scale_that_may_be(true, exact, stray):
    """exact: what share of the usual deviations a detector has; then no pair agrees with a tenth too much."""
    world, ranges = World(1, off(scale=true - 1.0)), none_compared()
    for _ in range(30):
        ranges = compared(ranges, *world.frame(exact=exact, stray=stray), PRIOR)
    expected = true - 1.0 if abs(true - 1.0) > 0.03 else 0.0
    found = great_error(ranges, posterior(ranges))
    assert found == pytest.approx(expected, abs=0.03 * max(1.0, true))
    assert bool(found) == bool(expected)


def test_the_wrong_walls_are_no_wrong_size():
    """A scan that is mirrored, or of another place."""
    for other in (False, True):
        world, ranges = World(2), none_compared()
        for _ in range(30):
            detections, scan = world.frame()
            wrong = world.frame()[1].ranges if other else scan.ranges[::-1]
            ranges = compared(ranges, detections, replace(scan, ranges=wrong), PRIOR)
        assert ranges.apart.sum() > 100
        assert great_error(ranges, posterior(ranges)) == 0.0
