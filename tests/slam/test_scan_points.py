"""Points and normals of single scans, against the rule by brute force and against worlds whose normals are known."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tfg_drake.messages import LaserScan
from tfg_drake.slam.scan_points import (
    BESIDE,
    CURVATURE,
    LENGTH,
    MOST,
    SLANT,
    STRAIGHT,
    WORST,
    scan_points,
)

ROUND = np.arange(-180, 180) * math.radians(1.0)
HALF = np.arange(-180, 181) * math.radians(0.5)
ROOM = [(-3.0, -2.0, 4.0, -2.0), (4.0, -2.0, 4.0, 2.5), (4.0, 2.5, -3.0, 2.5), (-3.0, 2.5, -3.0, -2.0)]


def seen(walls=(), columns=(), angles=ROUND, range_max=20.0):
    """Ranges (m,), normals towards the scanner (m, 2) and surfaces (m,) that rays from the origin meet."""
    along = np.column_stack([np.cos(angles), np.sin(angles)])
    ranges, normals, surface = np.full(len(angles), np.inf), np.zeros((len(angles), 2)), np.full(len(angles), -1)
    with np.errstate(all="ignore"):
        for k, (x, y, u, v) in enumerate(walls):
            normal = np.array([v - y, x - u]) / math.hypot(u - x, v - y)
            r = normal @ [x, y] / (along @ normal)
            share = (r[:, None] * along - [x, y]) @ [u - x, v - y] / ((u - x) ** 2 + (v - y) ** 2)
            met = (r > 0.0) & (share >= 0.0) & (share <= 1.0) & (r < ranges)
            ranges[met], surface[met] = r[met], k
            normals[met] = -normal * np.sign(along[met] @ normal)[:, None]
        for k, (x, y, radius) in enumerate(columns):
            middle = along @ [x, y]
            r = middle - np.sqrt(middle**2 - x * x - y * y + radius**2)
            met = (r > 0.0) & (r < ranges)
            ranges[met], surface[met] = r[met], len(walls) + k
            normals[met] = (r[met, None] * along[met] - [x, y]) / radius
    ranges[ranges >= range_max] = np.inf
    return ranges, normals, surface


def scan_of(ranges, angles=ROUND, sigma=0.01, range_max=20.0):
    return LaserScan(0.0, np.array(angles), np.array(ranges), range_max, sigma)


def by_ray(points, angles=ROUND):
    """Normals (m, 2) by ray, nan where a ray is left out."""
    normals = np.full((len(angles), 2), np.nan)
    bearings = np.arctan2(points[:, 1], points[:, 0])
    off = np.abs(np.angle(np.exp(1j * (bearings[:, None] - angles))))
    assert len(points) == 0 or off.min(axis=1).max() < 1e-9
    normals[off.argmin(axis=1)] = points[:, 2:] if len(points) else 0.0
    return normals


def turned(normals, truth):
    """Signed angles, degrees, from true normals."""
    across = truth[:, 0] * normals[:, 1] - truth[:, 1] * normals[:, 0]
    return np.degrees(np.arctan2(across, (truth * normals).sum(axis=1)))


def inner(surface, rays):
    """Which rays are at least so many rays from the next surface."""
    return np.all([np.roll(surface, k) == surface for k in range(-rays, rays + 1)], axis=0)


def brute_force(angles, ranges, range_max, sigma, around):
    """Normals (m, 2) by every choice of rays, each solved anew; (0, 0) for none."""
    met = [k for k in range(len(ranges)) if 0.0 < ranges[k] < range_max - 3.0 * sigma]
    n, best = len(met), dict.fromkeys(met, (WORST**2, None))
    for first in range(n):
        for count in (3, 5, 7, 9, 17, 25, 33):
            if count > min(n, MOST) or not (around or first + count <= n):
                continue
            at = np.arange(first, first + count)
            rays = np.take(met, at % n) + at // n * len(ranges)
            r, a = ranges[rays % len(ranges)], np.take(angles, rays % len(ranges)) + rays // len(ranges) * 2.0 * math.pi
            step = np.minimum(r[1:], r[:-1]) * np.diff(a)
            if np.any(np.diff(rays) > BESIDE) or np.any(np.abs(np.diff(r)) > step / SLANT + 4.0 * sigma):
                continue
            p = np.column_stack([r * np.cos(a), r * np.sin(a)])
            if math.hypot(*(p[-1] - p[0])) > LENGTH:
                continue
            centred = p - p.mean(axis=0)
            _, values, axes = np.linalg.svd(centred)
            off, freedoms = centred @ axes[1], count - 2
            parabola = np.linalg.qr(np.vander(np.arange(count), 3, increasing=True))[0][:, 2]
            if values[1] ** 2 > sigma**2 * (freedoms + STRAIGHT * math.sqrt(2 * freedoms)):
                continue
            if abs(parabola @ off) > STRAIGHT * sigma:
                continue
            of_line = (sigma**2 + values[1] ** 2 / freedoms) / values[0] ** 2
            variance = of_line + (CURVATURE * (centred @ axes[0])) ** 2
            for k in np.flatnonzero(np.abs(off) < STRAIGHT * sigma):
                ray = rays[k] % len(ranges)
                if variance[k] < best[ray][0]:
                    best[ray] = variance[k], axes[1]
    normals = np.zeros((len(ranges), 2))
    for k, (_, normal) in best.items():
        if normal is not None:
            cosine = normal @ [math.cos(angles[k]), math.sin(angles[k])]
            normals[k] = -normal * np.sign(cosine) if abs(cosine) >= SLANT else 0.0
    return normals


@pytest.mark.parametrize(("angles", "around"), [(ROUND[::2], True), (HALF[::2], False)])
@pytest.mark.parametrize("sigma", [0.005, 0.03])
def test_normals_are_those_of_the_best_choice_of_rays(angles, around, sigma):
    rng = np.random.default_rng(2)
    columns = [(1.5, 1.0, 0.5), (-1.5, 0.5, 0.03), (0.5, -1.4, 0.25)]
    ranges = seen(ROOM, columns, angles)[0] + rng.normal(scale=sigma, size=len(angles))
    ranges[rng.random(len(angles)) < 0.05] = np.inf
    # More than the scan itself says, which the oracle would have to find, too.
    stated = 2.0 * sigma
    found = np.nan_to_num(by_ray(scan_points(scan_of(ranges, angles, stated)), angles))
    expected = brute_force(angles, ranges, 20.0, stated, around)
    assert (expected != 0.0).any(axis=1).mean() > 0.6
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_exact_without_noise():
    # Two walls side by side, of which no corner is seen.
    ranges, truth, _ = seen([(-9.0, -2.0, 9.0, -2.0), (-9.0, 2.5, 9.0, 2.5)], range_max=6.0)
    points = scan_points(scan_of(ranges, range_max=6.0))
    # Where what is seen of a wall ends far away, rays are too far apart to know.
    measured = np.isfinite(by_ray(points)).all(axis=1)
    assert measured[inner(np.isfinite(ranges), 1) & np.isfinite(ranges)].all()
    np.testing.assert_allclose(by_ray(points)[measured], truth[measured], atol=1e-9)
    np.testing.assert_allclose(np.hypot(points[:, 2], points[:, 3]), 1.0, atol=1e-12)
    assert np.all((points[:, :2] * points[:, 2:]).sum(axis=1) < 0.0)
    # All rays, in their order, where they were measured.
    along = np.column_stack([np.cos(ROUND), np.sin(ROUND)])
    np.testing.assert_allclose(points[:, :2], ranges[measured, None] * along[measured], atol=1e-12)


@pytest.mark.parametrize(("sigma", "share", "most"), [(0.005, 0.99, 2.0), (0.015, 0.98, 4.0), (0.03, 0.95, 7.0)])
@pytest.mark.parametrize("angles", [ROUND, HALF])
def test_walls_have_normals_that_no_corner_turns(angles, sigma, share, most):
    """Of rays three or more from a corner, by noise as stated: most is what 95 of 100 are off, degrees."""
    rng, off, having = np.random.default_rng(1), [], []
    for _ in range(60):
        turn, offset = rng.uniform(-math.pi, math.pi), rng.uniform(-1.0, 1.0, 2)
        c, s = math.cos(turn), math.sin(turn)
        ends = (np.reshape(ROOM, (-1, 2)) + offset) @ np.array([[c, s], [-s, c]])
        ranges, truth, surface = seen(ends.reshape(-1, 4), angles=angles)
        normals = by_ray(
            scan_points(scan_of(ranges + rng.normal(scale=sigma, size=len(ranges)), angles, sigma)), angles
        )
        rays = np.flatnonzero(inner(surface, 3))[3:-3]
        having.append(np.nan_to_num(normals[rays]).any(axis=1))
        off.append(turned(normals[rays], truth[rays])[having[-1]])
    having, off = np.concatenate(having), np.concatenate(off)
    assert having.mean() > share
    assert np.percentile(np.abs(off), 95.0) < most
    # A tenth would be off by more than five times that, did a wall's rays take the normal of the next.
    assert (np.abs(off) > 20.0).mean() < 0.005
    assert abs(off.mean()) < 0.2


@pytest.mark.parametrize(("radius", "most"), [(0.2, 25.0), (0.5, 16.0), (1.5, 8.0), (3.0, 6.0)])
def test_curves_have_normals_without_bias(radius, most):
    rng, off, having = np.random.default_rng(4), [], []
    for _ in range(60):
        at = np.array([np.cos(a := rng.uniform(-1.2, 1.2)), np.sin(a)]) * (radius + rng.uniform(1.0, 2.5))
        ranges, truth, surface = seen([(-9.0, -9.0, -9.0, 9.0)], [(*at, radius)], HALF)
        normals = by_ray(scan_points(scan_of(ranges + rng.normal(scale=0.01, size=len(ranges)), HALF)), HALF)
        facing = (surface == 1) & (-(truth * np.column_stack([np.cos(HALF), np.sin(HALF)])).sum(axis=1) > 0.4)
        having.append(np.nan_to_num(normals[facing]).any(axis=1))
        # Towards the column's rim.
        side = np.sign(HALF[facing] - math.atan2(at[1], at[0]))
        off.append((side * turned(normals[facing], truth[facing]))[having[-1]])
    having, off = np.concatenate(having), np.concatenate(off)
    assert having.mean() > 0.95
    assert np.percentile(np.abs(off), 95.0) < most
    assert abs(off.mean()) < 0.15 * most


def test_a_scanner_noisier_than_its_data_sheet_has_normals_as_well():
    ranges, truth, surface = seen(ROOM)
    noisy = ranges + np.random.default_rng(0).normal(scale=0.03, size=len(ranges))
    normals, rays = by_ray(scan_points(scan_of(noisy, sigma=0.002))), inner(surface, 3)
    assert np.nan_to_num(normals[rays]).any(axis=1).mean() > 0.9
    assert np.nanpercentile(np.abs(turned(normals[rays], truth[rays])), 95.0) < 8.0


@pytest.mark.parametrize("sigma", [0.005, 0.03])
def test_legs_are_edges(sigma):
    rng = np.random.default_rng(5)
    for _ in range(40):
        bearings = np.arange(-150, 180, 30) + rng.uniform(-8.0, 8.0, 11)
        legs = [(1.4 * math.cos(b), 1.4 * math.sin(b), rng.uniform(0.013, 0.025)) for b in np.radians(bearings)]
        ranges, _, surface = seen(ROOM, legs)
        normals = by_ray(scan_points(scan_of(ranges + rng.normal(scale=sigma, size=len(ranges)), sigma=sigma)))
        for leg in range(len(legs)):
            rays = np.flatnonzero(surface == len(ROOM) + leg)
            assert len(rays)
            assert (normals[rays] == 0.0).all(axis=1).any()


def edges_of(ranges, angles=ROUND, **scan):
    return np.flatnonzero((by_ray(scan_points(scan_of(ranges, angles, **scan)), angles) == 0.0).all(axis=1))


def test_walls_seen_aslant_are_no_edges():
    # Neighbouring rays of a corridor's walls are up to 5 m apart.
    ranges, truth, _ = seen([(-30.0, -1.0, 30.0, -1.0), (-30.0, 1.5, 30.0, 1.5)], range_max=25.0)
    ranges += np.random.default_rng(1).normal(scale=0.01, size=len(ranges))
    slant = np.abs((truth * np.column_stack([np.cos(ROUND), np.sin(ROUND)])).sum(axis=1)) < 0.8 * SLANT
    aslant = np.flatnonzero(slant & np.isfinite(ranges))
    steps = np.abs(np.diff(ranges[aslant]))
    assert (steps > 2.0).sum() > 5
    assert len(edges_of(ranges, range_max=25.0)) == 0
    assert np.isnan(by_ray(scan_points(scan_of(ranges, range_max=25.0)))[aslant]).all()


def test_the_last_ray_before_the_end_of_a_wall_seen_aslant_is_no_edge():
    # A corridor with a door 4 m ahead, and what is behind it: there neighbouring rays meet the wall .3 m apart.
    doors = [(-3.0, -1.0, 4.0, -1.0), (5.2, -1.0, 9.0, -1.0), (5.2, -4.0, 5.2, -1.0), (-3.0, 1.2, 9.0, 1.2)]
    end = math.degrees(math.atan2(-1.0, 4.0))
    for turned in np.radians(np.linspace(0.0, 1.0, 11)):
        angles = ROUND + turned
        ranges, _, surface = seen(doors, angles=angles)
        last = np.flatnonzero((surface == 0) & (np.degrees(angles) < end))[-1]
        assert surface[last + 1] == 2
        assert ranges[last] < ranges[last + 1] - 0.2
        assert last not in edges_of(ranges, angles)
    # A post there, of a ray or two, is where it is seen.
    ranges, _, surface = seen(doors, [(4.0, -0.9, 0.06)])
    assert np.intersect1d(edges_of(ranges), np.flatnonzero(surface == len(doors))).size


def test_the_nearer_side_alone_is_an_edge_and_neither_end_of_a_scan():
    angles = np.radians(np.arange(-40.0, 41.0))
    ranges = np.full(len(angles), 3.0) / np.cos(angles)
    ranges[[0, 20, 21, 60, -1]] = [1.0, 1.0, 1.05, 2.7, 1.0]
    assert edges_of(ranges, angles).tolist() == [20, 21, 60]
    # Not by less than 0.2 m, nor on the way between a near surface and a far one, nor before what was not measured.
    none = np.nan
    for beside, range_m in (
        ({}, 3.05),
        ({59: 1.0}, 2.5),
        ({58: 1.0, 59: 1.0, 61: none, 62: np.inf, 63: 0.0}, 1.0),
        ({57: none, 58: np.inf, 59: 0.0}, 1.0),
    ):
        ranges = np.full(len(angles), 3.0) / np.cos(angles)
        ranges[60] = range_m
        ranges[list(beside)] = list(beside.values())
        assert 60 not in edges_of(ranges, angles)


def test_rays_over_the_cut_are_neighbours_where_the_scanner_sees_all_round():
    ranges, _, _ = seen(ROOM, [(-1.5, 0.0, 0.4), (1.0, 1.5, 0.02)])
    ranges += np.random.default_rng(3).normal(scale=0.01, size=len(ranges))
    # More noise than the scan itself says, which is of other rays where it begins elsewhere.
    expected = by_ray(scan_points(scan_of(ranges, sigma=0.02)))
    assert np.isfinite(expected).all(axis=1)[[0, 1, -2, -1]].all()
    # The same rays, of a scanner that is mounted another way round.
    for first in (97, 180, 301):
        back = by_ray(scan_points(scan_of(np.roll(ranges, -first), sigma=0.02)))
        angle = ROUND[0] - ROUND[first]
        c, s = math.cos(angle), math.sin(angle)
        np.testing.assert_allclose(np.roll(back, first, axis=0), expected @ np.array([[c, s], [-s, c]]), atol=1e-7)
    # A leg in the cut.
    leg = np.full(len(ROUND), 2.0)
    leg[0] = 1.0
    assert edges_of(leg).tolist() == [0]
    assert edges_of(leg[:-5], ROUND[:-5]).tolist() == []


def test_what_drowns_in_noise_and_lone_rays_have_no_normal():
    # A plate of 6 cm, of five rays.
    rng = np.random.default_rng(6)
    ranges, _, surface = seen([(1.5, -0.03, 1.5, 0.03), (4.0, -9.0, 4.0, 9.0)], angles=HALF)
    for _ in range(40):
        noisy = ranges + rng.normal(scale=0.03, size=len(ranges))
        normals = by_ray(scan_points(scan_of(noisy, HALF, 0.03)), HALF)
        assert not np.nan_to_num(normals[surface == 0]).any()
    # Two rays of a wall, and three that are not measured, in turns; and two of each.
    ranges = seen([(2.0, -9.0, 2.0, 9.0)], angles=HALF)[0]
    for missing, has in ((3, False), (2, True)):
        gaps = np.where(np.arange(len(HALF)) % (2 + missing) < 2, ranges, np.nan)
        points = scan_points(scan_of(gaps, HALF))
        assert (len(points) > 20) == has
        assert has or len(points) == 0


def test_degenerate_scans():
    few = np.array([-0.1, 0.0, 0.1])
    for angles, ranges in (
        ([], []),
        (few[:2], [1.0, 1.0]),
        (few, [1.0, np.nan, 1.0]),
        (ROUND, np.full(360, np.inf)),
        (ROUND, np.full(360, np.nan)),
        (ROUND, np.zeros(360)),
        (ROUND, np.full(360, 19.98)),
        # A wall that goes through the scanner, as seen by a ray that hardly turns.
        (1e-12 * np.arange(20), np.linspace(1.0, 1.5, 20)),
        (1e-12 * np.arange(20), np.full(20, 1.0)),
    ):
        points = scan_points(scan_of(np.array(ranges, dtype=float), np.array(angles, dtype=float)))
        assert points.shape == (0, 4)
    # Three rays of a wall, without bound of the range.
    points = scan_points(scan_of(1.0 / np.cos(few), few, range_max=math.inf))
    np.testing.assert_allclose(points, np.column_stack([np.ones(3), np.tan(few), -np.ones(3), np.zeros(3)]), atol=1e-9)


def test_what_was_not_measured_is_left_out():
    ranges, truth, _ = seen(ROOM)
    for value in (0.0, np.inf, -np.inf, np.nan, 19.99, 1e300):
        gaps = ranges.copy()
        gaps[::3] = value
        normals = by_ray(scan_points(scan_of(gaps)))
        assert np.isnan(normals[::3]).all()
        assert (np.abs(turned(normals, truth)[1::3]) < 1.0).mean() > 0.9


@settings(deadline=None, max_examples=40)
@given(st.floats(-math.pi, math.pi), st.integers(0, 2**32 - 1), st.sampled_from([0.003, 0.03]), st.booleans())
def test_points_turn_with_the_scanner(turn, seed, sigma, mirrored):
    rng = np.random.default_rng(seed)
    columns = [(*rng.uniform(-2.0, 2.0, 2), r) for r in (0.03, 0.02, 0.4)]
    ranges = seen(ROOM, [c for c in columns if math.hypot(c[0], c[1]) > c[2] + 0.2])[0]
    ranges += rng.normal(scale=sigma, size=len(ranges))
    ranges[rng.random(len(ranges)) < 0.1] = np.inf
    points = scan_points(scan_of(ranges, sigma=sigma))
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, s], [-s, c]])
    other = scan_points(scan_of(ranges, ROUND + turn, sigma))
    np.testing.assert_allclose(other, np.hstack([points[:, :2] @ rotation, points[:, 2:] @ rotation]), atol=1e-6)
    if mirrored:
        other = scan_points(scan_of(ranges[::-1], -ROUND[::-1], sigma))[::-1]
        np.testing.assert_allclose(other, points * [1.0, -1.0, 1.0, -1.0], atol=1e-6)
