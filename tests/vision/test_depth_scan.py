"""Depth images of planes and boxes, made by exact geometry, to scans: exact ranges, limits, the blind zone."""

import numpy as np
import pytest

from tests.cameras import pinhole
from tfg_drake.vision.depth_scan import DepthScanConfig, depth_rays, depth_scan
from tfg_drake.vision.mount import CameraMount

CAMERA = pinhole(64, 48, 50.0)
LEVEL = CameraMount(z=0.3)
CONFIG = DepthScanConfig(low=0.05, high=0.5, least_depth=0.45, most_depth=5.0, range_max=5.0)


def directions(camera, mount):
    """(h, w, 3) of the pixels in the body frame, for a depth of 1 m."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    K = camera.matrix
    return np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1) @ mount.R_BC.T


def room(camera, mount, wall=3.0, box=None):
    """(h, w) depth of a floor and a wall x = wall in B, and a box (x, y0, y1, z0, z1) with its face at x; m."""
    d = directions(camera, mount)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(d[..., 2] < 0.0, -mount.z / d[..., 2], np.inf)
        ahead = np.where(d[..., 0] > 0.0, (wall - mount.x) / d[..., 0], np.inf)
        depth = np.minimum(depth, ahead)
        if box is not None:
            x, y0, y1, z0, z1 = box
            face = (x - mount.x) / d[..., 0]
            y, z = mount.y + face * d[..., 1], mount.z + face * d[..., 2]
            on = (face > 0) & (y >= y0) & (y <= y1) & (z >= z0) & (z <= z1)
            depth = np.where(on, np.minimum(face, depth), depth)
    return depth


def scanned(depth, mount=LEVEL, camera=CAMERA, config=CONFIG):
    return depth_scan(depth, depth_rays(camera, mount, config), 2.0, config)


def test_a_wall_ahead_is_exact():
    scan = scanned(room(CAMERA, LEVEL))
    columns = np.sort(np.arctan2(-(np.arange(64) - 31.5), 50.0))
    assert scan.stamp == 2.0
    assert scan.range_max == 5.0
    np.testing.assert_allclose(scan.angles, columns, atol=1e-12)
    np.testing.assert_allclose(scan.ranges, 3.0 / np.cos(columns), atol=1e-12)


@pytest.mark.parametrize(
    "mount",
    [
        CameraMount(z=0.3, pitch=0.2),
        CameraMount(0.1, -0.05, 0.3, yaw=0.4, pitch=-0.1),
        CameraMount(0.1, 0.0, 0.4, roll=0.1),
    ],
)
def test_a_tilted_camera_sees_the_same_wall(mount):
    """Every range is that of a point on the wall, in its direction to within one column."""
    camera = pinhole(320, 240, 250.0)
    scan = scanned(room(camera, mount), mount, camera)
    hit = np.isfinite(scan.ranges)
    assert np.count_nonzero(hit) > 250
    x = scan.ranges[hit] * np.cos(scan.angles[hit])
    np.testing.assert_allclose(x, 3.0, atol=0.012)
    assert (np.diff(scan.angles) > 0.0).all()


def test_the_camera_s_place_is_taken_into_account():
    mount = CameraMount(0.2, 0.1, 0.3, yaw=np.pi / 2)
    depth = np.full((48, 64), 2.0)
    scan = scanned(depth, mount)
    x, y = scan.ranges * np.cos(scan.angles), scan.ranges * np.sin(scan.angles)
    np.testing.assert_allclose(y, 2.1, atol=1e-12)
    np.testing.assert_allclose(np.sort(x), 0.2 + 2.0 * np.sort((np.arange(64) - 31.5) / 50.0), atol=1e-12)


def test_only_the_band_counts():
    """A box within the band is seen, a shelf above it is not, nor is the floor."""
    low, shelf = (1.5, -0.2, 0.2, 0.0, 0.4), (1.5, -0.2, 0.2, 0.6, 0.9)
    scan, clear, above = (scanned(room(CAMERA, LEVEL, box=box)) for box in (low, None, shelf))
    wide = np.abs(1.5 * np.tan(scan.angles)) <= 0.2
    np.testing.assert_allclose(scan.ranges[wide], 1.5 / np.cos(scan.angles[wide]), atol=1e-12)
    np.testing.assert_array_equal(scan.ranges[~wide], clear.ranges[~wide])
    np.testing.assert_array_equal(above.ranges, clear.ranges)


def test_nothing_within_range_is_infinite():
    far = scanned(room(CAMERA, LEVEL, wall=20.0))
    assert np.isposinf(far.ranges).all()
    empty = scanned(np.where(np.isfinite(room(CAMERA, LEVEL, wall=20.0)), np.inf, np.inf))
    assert np.isposinf(empty.ranges).all()
    short = scanned(room(CAMERA, LEVEL), config=DepthScanConfig(range_max=3.1))
    beyond = 3.0 / np.cos(short.angles) > 3.1
    assert np.isposinf(short.ranges[beyond]).all()
    assert np.isfinite(short.ranges[~beyond]).all()


@pytest.mark.parametrize("answer", [0.0, np.nan, 0.3, -1.0, -np.inf])
def test_without_an_answer_nothing_is_known(answer):
    depth = room(CAMERA, LEVEL)
    depth[:, :20] = answer
    scan = scanned(depth)
    assert np.isnan(scan.ranges[-20:]).all()  # the image's left is the last
    assert np.isfinite(scan.ranges[:-20]).all()


def test_something_in_the_blind_zone_hides_the_wall_behind_it_but_a_speckle_does_not():
    clear, near = room(CAMERA, LEVEL), room(CAMERA, LEVEL)
    near[20:40, 30] = 0.0
    speckled = clear.copy()
    speckled[23, 30] = 0.0
    column = 63 - 30
    assert np.isnan(scanned(near).ranges[column])
    np.testing.assert_array_equal(scanned(speckled).ranges, scanned(clear).ranges)


def test_a_camera_that_sees_the_floor_only_knows_nothing():
    mount = CameraMount(z=1.0, pitch=1.2)
    assert np.isnan(scanned(room(CAMERA, mount), mount).ranges).all()


def test_against_brute_force_on_random_depths():
    rng, mount = np.random.default_rng(0), CameraMount(0.0, 0.0, 0.3)
    depth = rng.uniform(0.5, 6.0, (48, 64))
    d = directions(CAMERA, mount)
    height, reach = mount.z + depth * d[..., 2], depth * np.hypot(d[..., 0], d[..., 1])
    end = mount.z + np.minimum(5.0, 5.0 / np.hypot(d[..., 0], d[..., 1])) * d[..., 2]
    expected = []
    for j in range(64):
        hits = [reach[i, j] for i in range(48) if 0.05 <= height[i, j] <= 0.5 and depth[i, j] <= 5 and reach[i, j] <= 5]
        free = any(0.05 <= end[i, j] <= 0.5 and (depth[i, j] > 5.0 or reach[i, j] > 5.0) for i in range(48))
        expected.append(min(hits) if hits else np.inf if free else np.nan)
    np.testing.assert_allclose(scanned(depth).ranges, expected[::-1], atol=1e-12)


def test_limits_and_sizes_that_are_none():
    with pytest.raises(ValueError, match=r"^heights 0.6 to 0.5 m, depths .* must be increasing and above 0$"):
        DepthScanConfig(low=0.6)
    with pytest.raises(ValueError, match=r"^a depth image of shape \(4, 4\), the calibration is of \(48, 64\);"):
        scanned(np.ones((4, 4)))
