"""Lines of single scans, against simulated scans of known walls."""

import dataclasses
import math

import numpy as np
import pytest

from tfg_drake.config import ScanConfig, ScanRealityConfig
from tfg_drake.geometry import se2
from tfg_drake.simulation.laser_scanner import along_rays, ray_angles, scan, spoilt
from tfg_drake.slam.scan_lines import LENGTH, on_uneven, scan_lines, surface_seen, unevenness_after

CONFIG = ScanConfig()
ANGLES = ray_angles(CONFIG)
# A room of 8 m by 6 m with a wall across and a pillar.
WALLS = np.array(
    [
        [-4.0, -3.0, 4.0, -3.0],
        [4.0, -3.0, 4.0, 3.0],
        [4.0, 3.0, -4.0, 3.0],
        [-4.0, 3.0, -4.0, -3.0],
        [1.0, -1.0, 1.0, 1.5],
        [-2.0, 1.0, -1.8, 1.0],
    ]
)


def seen(walls, X_WB, rng=None, config=CONFIG):
    normal = np.zeros(len(ANGLES)) if rng is None else rng.normal(size=len(ANGLES))
    return scan(walls, np.asarray(X_WB, dtype=float), 0.0, ANGLES, normal, config)


def errors(walls, X_WB, line):
    """The line's errors of angle and of the distance at its middle in deviations, by the wall it is nearest to; and the
    ends of what was seen of that wall, m along it, and its length."""
    angle, offset, begin, end, middle, sigma_angle, sigma = line[:7]
    n = np.array([math.cos(angle + X_WB[2]), math.sin(angle + X_WB[2])])
    along, best = np.array([-n[1], n[0]]), None
    for p, q in zip(walls[:, :2], walls[:, 2:], strict=True):
        length = np.hypot(*(q - p))
        t = (q - p) / length
        normal = np.array([t[1], -t[0]])
        normal = normal if normal @ (p - X_WB[:2]) > 0.0 else -normal
        turned = math.atan2(normal[0] * n[1] - normal[1] * n[0], normal @ n)
        off = float(normal @ (X_WB[:2] + offset * n + middle * along - p))
        reach = sorted(float(t @ (X_WB[:2] + offset * n + s * along - p)) for s in (begin, end))
        if abs(turned) < 0.3 and abs(off) < 0.2 and reach[0] < length and reach[1] > 0.0:
            best = np.array([turned / sigma_angle, off / sigma]), reach, length
    return best


def test_exact_without_noise():
    X_WB = np.array([-1.0, -0.5, 0.2])
    lines = scan_lines(seen(WALLS, X_WB))
    assert len(lines) >= 2
    for line in lines:
        off, reach, length = errors(WALLS, X_WB, line)
        np.testing.assert_allclose(off, 0.0, atol=1e-6)
        assert -1e-9 < reach[0] < reach[1] < length + 1e-9


def test_errors_are_as_large_as_stated():
    rng, found = np.random.default_rng(3), []
    for _ in range(400):
        X_WB = np.append(rng.uniform([-3.5, -2.5], [3.5, 2.5]), rng.uniform(-math.pi, math.pi))
        for line in scan_lines(seen(WALLS, X_WB, rng)):
            off, reach, length = errors(WALLS, X_WB, line)
            assert reach[0] > -0.05
            assert reach[1] < length + 0.05
            found.append(off)
    found = np.array(found)
    assert len(found) > 800
    assert np.all((found.std(axis=0) > 0.9) & (found.std(axis=0) < 1.1))
    assert np.all(np.abs(found.mean(axis=0)) < 3.0 / math.sqrt(len(found)))
    assert np.abs(found).max() < 5.5
    assert abs(np.corrcoef(found.T)[0, 1]) < 0.1


def test_a_person_and_a_pillar_are_no_line():
    rng, round_one = np.random.default_rng(1), np.linspace(0.0, 2.0 * math.pi, 41)
    ring = 0.25 * np.column_stack([np.cos(round_one), np.sin(round_one)]) + [2.0, 0.0]
    person = np.column_stack([ring[:-1], ring[1:]])
    for x in np.linspace(-1.0, 1.0, 20):
        assert not len(scan_lines(seen(person, [x, 0.0, 0.0], rng)))
    short = np.array([[2.0, -0.2, 2.0, 0.2]])
    assert LENGTH > 0.4
    assert not len(scan_lines(seen(short, [0.0, 0.0, 0.0], rng)))


def test_a_lost_ray_parts_no_wall():
    whole = seen(WALLS[1:2], [0.0, 0.0, 0.0], np.random.default_rng(2))
    ranges = whole.ranges.copy()
    ranges[[100, 130]] = np.nan
    (one,) = scan_lines(dataclasses.replace(whole, ranges=ranges))
    (all_rays,) = scan_lines(whole)
    np.testing.assert_allclose(one[:4], all_rays[:4], atol=2e-3)


def test_a_noisier_scanner_than_told_says_so():
    loud, rng, found = dataclasses.replace(CONFIG, noise=0.03), np.random.default_rng(5), []
    for _ in range(100):
        X_WB = np.append(rng.uniform([-3.5, -2.5], [0.5, 2.5]), rng.uniform(-math.pi, math.pi))
        told = dataclasses.replace(seen(WALLS, X_WB, rng, loud), sigma=CONFIG.noise)
        found += [errors(WALLS, X_WB, line)[0] for line in scan_lines(told)]
    assert len(found) > 150
    assert np.all(np.std(found, axis=0) < 1.3)


@pytest.mark.parametrize("turned", [0.0, 1.0, 3.0])
def test_a_corner_has_two_walls_that_meet_at_a_right_angle(turned):
    X_WB = np.array([2.5, 1.5, 0.8 + turned])
    corner = se2.transform(se2.inverse(np.array([0.0, 0.0, turned])), WALLS[1:3].reshape(-1, 2)).reshape(-1, 4)
    X_WB[:2] = se2.transform(se2.inverse(np.array([0.0, 0.0, turned])), X_WB[None, :2])[0]
    X_WB[2] -= 2.0 * turned
    lines = scan_lines(seen(corner, X_WB, np.random.default_rng(7)))
    assert len(lines) == 2
    assert abs(abs(se2.wrap_angle(lines[1, 0] - lines[0, 0])) - 0.5 * math.pi) < 0.03


def unevenness_told(noise, correlation, missing, unevenness, scans):
    """The unevenness that so many scans of WALLS tell, from one on, and the last of them: their rays' errors are so
    correlated, and such a share meets nothing."""
    rng, reality = np.random.default_rng(8), ScanRealityConfig(dropout_probability=missing)
    for _ in range(scans):
        X_WB = np.append(rng.uniform([-3.5, -2.5], [0.5, 2.5]), rng.uniform(-math.pi, math.pi))
        normal = rng.normal(size=len(ANGLES))
        normal = along_rays(normal, ANGLES, correlation) if correlation else normal
        one = scan(WALLS, X_WB, 0.0, ANGLES, normal, dataclasses.replace(CONFIG, noise=noise))
        one = spoilt(one, rng.uniform(size=len(ANGLES)), reality) if missing else one
        unevenness = unevenness_after(one, scan_lines(one), unevenness)
    return unevenness, one


@pytest.mark.parametrize(
    ("noise", "correlation", "told"), [(0.015, 0.0, 0.0), (0.02, 0.05, 0.017), (0.01, 0.02, 0.009)]
)
def test_errors_that_rays_have_in_common_are_told_by_the_scans(noise, correlation, told):
    """White noise is none, and of others it is most of their deviation: where they are great there is no line."""
    unevenness, one = unevenness_told(noise, correlation, 0.0, 0.05, 300)
    assert abs(unevenness - told) < 0.004
    nothing = dataclasses.replace(one, ranges=np.full(len(ANGLES), np.inf))
    assert unevenness_after(nothing, scan_lines(nothing), 0.01) == 0.01


@pytest.mark.parametrize(("correlation", "told"), [(0.0, 0.0), (0.05, 0.017)])
@pytest.mark.parametrize("missing", [0.1, 0.2])
def test_rays_that_meet_nothing_hide_no_errors_in_common(missing, correlation, told):
    assert abs(unevenness_told(0.02, correlation, missing, 0.0, 200)[0] - told) < 0.004


def test_uneven_walls_are_known_no_better_than_their_stretches():
    scan = seen(WALLS, np.array([0.3, -0.2, 0.4]))
    even, uneven = scan_lines(scan), on_uneven(scan_lines(scan), 0.03)
    same = [0, 1, 2, 3, 4, 7, 8, 9, 10]
    np.testing.assert_allclose(uneven[:, same], even[:, same], rtol=1e-9, atol=1e-12)
    stretches = np.maximum((even[:, 3] - even[:, 2]) / 0.5, 1.0)
    np.testing.assert_allclose(uneven[:, 6] ** 2 - even[:, 6] ** 2, 0.03**2 / stretches)
    assert (uneven[:, 5] > even[:, 5]).all()


def arc(radius, begin, end, centre=(0.0, 0.0), pieces=400):
    """Walls (pieces, 4) along an arc."""
    angle = np.linspace(begin, end, pieces + 1)
    points = np.column_stack([np.cos(angle), np.sin(angle)]) * radius + np.asarray(centre)
    return np.hstack([points[:-1], points[1:]])


@pytest.mark.parametrize("radius", [1.0, 2.5, 4.0, 8.0])
def test_a_curve_has_no_straight_piece(radius):
    """A chord of it lies otherwise when it is seen from elsewhere: it would turn the robot."""
    rng, found = np.random.default_rng(11), 0
    for _ in range(100):
        X_WB = np.append(0.6 * radius * rng.uniform(-0.7, 0.7, 2), rng.uniform(-math.pi, math.pi))
        found += len(scan_lines(seen(arc(radius, -math.pi, math.pi), X_WB, rng)))
    assert found < 80


def test_straight_walls_beside_a_curve_are_lines_nevertheless():
    """A nave with walls of 6 m that end in half a circle."""
    nave = np.array([[-6.0, -2.5, 0.0, -2.5], [0.0, 2.5, -6.0, 2.5]])
    walls = np.vstack([nave, arc(2.5, -0.5 * math.pi, 0.5 * math.pi)])
    rng, lines = np.random.default_rng(12), []
    for _ in range(50):
        X_WB = np.append(rng.uniform([-5.0, -1.0], [-3.0, 1.0]), rng.uniform(-0.2, 0.2))
        lines.append([errors(nave, X_WB, line) for line in scan_lines(seen(walls, X_WB, rng))])
    assert np.mean([len(of_scan) for of_scan in lines]) > 1.8
    off = np.array([one[0] for of_scan in lines for one in of_scan if one is not None])
    assert len(off) > 90
    assert (off.std(axis=0) < 2.0).all()


@pytest.mark.parametrize(("length", "corner"), [(1.0, 40.0), (3.0, 40.0), (3.0, 90.0)])
def test_a_wall_between_corners_is_no_chord(length, corner):
    rng, y = np.random.default_rng(13), 0.5 * length
    x, aside = 2.0 - 2.0 * math.sin(math.radians(corner)), 2.0 * math.cos(math.radians(corner))
    walls = np.array([[x, -y - aside, 2.0, -y], [2.0, -y, 2.0, y], [2.0, y, x, y + aside]])
    for _ in range(40):
        lines = scan_lines(seen(walls, [0.0, rng.uniform(-0.2, 0.2), 0.0], rng))
        assert np.any(np.abs(lines[:, 0]) < 0.1)


def test_the_surface_seen_is_as_long_as_it_is_straight_or_not():
    rng = np.random.default_rng(14)
    for walls, length in ((WALLS[1:2], 6.0), (arc(3.0, -1.0, 1.0), 6.0)):
        assert surface_seen(seen(walls, [0.0, 0.0, 0.0], rng)) == pytest.approx(length, rel=0.05)
    assert surface_seen(seen(WALLS[1:2], [-8.0, 0.0, 0.0], rng)) == 0.0
