"""Which scans are believed."""

import numpy as np
import pytest

from tfg_drake.config import ScanConfig
from tfg_drake.messages import LaserScan, replace
from tfg_drake.safety.scan_watch import EMPTY, FROZEN, no_watch, watched
from tfg_drake.simulation.laser_scanner import no_scan, ray_angles, scan

SCAN = ScanConfig()
ANGLES = ray_angles(SCAN)
ROOM = np.array([[4, -3, 4, 3], [4, 3, -4, 3], [-4, 3, -4, -3], [-4, -3, 4, -3]], dtype=float)
CORRIDOR = np.array([[-30, 1, 30, 1], [-30, -1, 30, -1]], dtype=float)


def seen(walls, X_WB, stamp, random=None):
    normal = np.zeros(len(ANGLES)) if random is None else random.normal(size=len(ANGLES))
    return scan(walls, np.array(X_WB, dtype=float), stamp, ANGLES, normal, SCAN)


def watch(scans, poses, rest=False, least_range=0.0):
    """What is believed after each of the scans."""
    watches, now = [], no_watch(no_scan(SCAN))
    for one, pose in zip(scans, poses, strict=True):
        now = watched(now, one, np.array(pose, dtype=float), rest, 0.18, least_range)
        watches.append(now)
    return watches


STRAIGHT = [(0.03 * k, 0.0, 0.0) for k in range(40)]
TURN = [(0.0, 0.0, 0.12 * k) for k in range(40)]


@pytest.mark.parametrize("poses", [STRAIGHT, TURN])
@pytest.mark.parametrize("walls", [ROOM, CORRIDOR])
@pytest.mark.parametrize("noisy", [True, False])
def test_a_working_scanner_is_believed(walls, poses, noisy):
    random = np.random.default_rng(0) if noisy else None
    scans = [seen(walls, pose, 0.1 * k, random) for k, pose in enumerate(poses)]
    watches = watch(scans, poses)
    assert not any(each.doubt for each in watches)
    assert watches[-1].believed is scans[-1]


@pytest.mark.parametrize("poses", [STRAIGHT, TURN])
def test_a_frozen_scan_is_doubted_while_the_robot_moves_and_until_it_changes(poses):
    frozen = seen(ROOM, poses[0], 0.0, np.random.default_rng(0))
    scans = [replace(frozen, stamp=0.1 * k) for k in range(len(poses))]
    watches = watch(scans, poses)
    doubted = [k for k, each in enumerate(watches) if each.doubt]
    assert doubted
    assert doubted == list(range(doubted[0], len(poses)))
    assert np.hypot(*np.subtract(poses[doubted[0]], poses[0])[:2]) < 0.1
    assert watches[-1].doubt == FROZEN
    assert watches[-1].believed.stamp < 0.1 * doubted[0]
    # A robot that stands, as it does then, does not make it credible.
    still = watched(watches[-1], replace(frozen, stamp=9.0), np.array(poses[-1], dtype=float), True, 0.18, 0.0)
    assert still.doubt == FROZEN
    again = watched(still, seen(ROOM, poses[-1], 9.1), np.array(poses[-1], dtype=float), True, 0.18, 0.0)
    assert not again.doubt


def test_a_scan_without_noise_stays_the_same_while_the_robot_stands():
    """Though the gyro's heading wanders meanwhile."""
    poses = [(0.0, 0.0, 0.002 * k) for k in range(100)]
    scans = [seen(CORRIDOR, (0.0, 0.0, 0.3), 0.1 * k) for k in range(100)]
    assert not any(each.doubt for each in watch(scans, poses, rest=True))


def _nothing(ranges):
    return np.full_like(ranges, np.nan)


def _far(ranges):
    return np.full_like(ranges, np.inf)


def _thin(ranges):
    return np.where(np.arange(len(ranges)) % 100 == 50, ranges, np.nan)


@pytest.mark.parametrize("spoil", [_nothing, _far, _thin])
def test_a_scan_that_shows_nothing_any_more_is_doubted(spoil):
    scans = [seen(ROOM, pose, 0.1 * k) for k, pose in enumerate(STRAIGHT)]
    scans[20:] = [replace(one, ranges=spoil(one.ranges)) for one in scans[20:]]
    watches = watch(scans, STRAIGHT)
    assert [each.doubt for each in watches] == [""] * 20 + [EMPTY] * 20
    assert watches[-1].believed is scans[19]


def test_a_scan_without_rays_is_doubted():
    empty = LaserScan(0.1, np.zeros(0), np.zeros(0), 10.0, 0.015)
    assert watch([seen(ROOM, STRAIGHT[0], 0.0), empty], STRAIGHT[:2])[-1].doubt == EMPTY


@pytest.mark.parametrize("share", [0.2, 0.6])
def test_rays_that_are_lost_at_random_do_not_matter(share):
    random = np.random.default_rng(0)
    scans = [seen(ROOM, pose, 0.1 * k, random) for k, pose in enumerate(STRAIGHT)]
    lossy = [replace(one, ranges=np.where(random.random(249) < share, np.nan, one.ranges)) for one in scans]
    assert not any(each.doubt for each in watch(lossy, STRAIGHT))


def test_a_depth_camera_before_a_wall_sees_nothing_and_is_believed():
    wall = np.array([[2.0, -5, 2, 5]])
    camera = ScanConfig(field_of_view=1.0, least_range=0.45)
    angles = ray_angles(camera)
    poses = [(0.03 * k, 0.0, 0.0) for k in range(60)]
    scans = [scan(wall, np.array(pose), 0.1 * k, angles, np.zeros(len(angles)), camera) for k, pose in enumerate(poses)]
    assert not np.isfinite(scans[-1].ranges).any()
    assert not any(each.doubt for each in watch(scans, poses, least_range=0.45))


def test_a_robot_that_leaves_a_building_is_believed():
    poses = [(0.05 * k, 0.0, 0.0) for k in range(200)]
    gate = np.array([[3, 0.5, 3, 4], [3, -0.5, 3, -4], [3, 4, -4, 4], [-4, -4, 3, -4]], dtype=float)
    random = np.random.default_rng(0)
    scans = [seen(gate, pose, 0.1 * k, random) for k, pose in enumerate(poses)]
    assert not np.isfinite(scans[-1].ranges).any()
    assert not any(each.doubt for each in watch(scans, poses))
