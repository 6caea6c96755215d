"""An emulated TurtleBot: what arrives agrees with the simulation, and every fault stops the wheels."""

import math
import time

import numpy as np
import pytest

from tfg_drake.config import TagSensorConfig
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.geometry import se2
from tfg_drake.messages import Hazards, LaserScan, Odometry, TagDetections
from tfg_drake.simulation.tag_sensor import NOISE_PER_TAG, detect

# The robot is told to stop within 0.6 s, which test_watchdog.py tests on a clock of its own; this is for a loaded
# machine.
LOADED = 5.0
# What may lock a robot on a loaded machine.
SILENT = "no odometry for more than 0.5 s"


@pytest.fixture(scope="module", params=["ros2", "rosbridge"])
def transport(request):
    return request.getfixturevalue(request.param)


def true_pose(transport, stamp):
    """X_WB of the robot at a stamp."""
    poses = transport.order("report")["poses"]
    return min(poses, key=lambda pose: abs(pose[0] - stamp))[1]


def test_it_stands_until_it_is_enabled(transport):
    with transport.connect() as device:
        assert device.locked == "not enabled yet"
        began = time.monotonic()
        transport.drive(device, 0.5, 0.3, 0.0)
        assert transport.last_motion_told() < began


def test_what_the_robot_sees(device, source, transport):
    """It stands: odometry is where it is; every ray ends on a wall; the tags are those of the sensor's model."""
    transport.wait_for(lambda: device.newest(Odometry) and source.newest(LaserScan) and source.newest(TagDetections))
    transport.wait_for(lambda: device.newest(Odometry).at_rest)
    odometry, scan, tags = device.newest(Odometry), source.newest(LaserScan), source.newest(TagDetections)
    assert [device.newest(kind) for kind in (Hazards, LaserScan, TagDetections)] == [None] * 3
    assert source.newest(Odometry) is None
    X_WB = true_pose(transport, odometry.stamp)
    np.testing.assert_allclose(odometry.X_OB, se2.between(transport.order("report")["poses"][0][1], X_WB), atol=1e-9)
    for message in (odometry, scan, tags):
        assert abs(time.monotonic() - message.stamp) < 10.0
    world = MakeWorld(LoadScenario("house").world)
    hit = np.isfinite(scan.ranges)
    assert hit.sum() > 300
    assert (np.diff(scan.angles) > 0.0).all()
    points = scan.ranges[hit, None] * np.stack([np.cos(scan.angles[hit]), np.sin(scan.angles[hit])], axis=1)
    points = X_WB[:2] + points @ se2.rotation(X_WB[2]).T
    assert max(distance_to_walls(world.walls, point) for point in points) < 1e-4
    zeros = np.zeros((len(world.tag_ids), NOISE_PER_TAG))
    expected = detect(world, X_WB, 0.0, zeros, TagSensorConfig(range=5.0))
    assert tags.ids.tolist() == expected.ids.tolist()
    for name in ("range", "bearing", "sigma_range", "sigma_bearing"):
        np.testing.assert_allclose(getattr(tags, name), getattr(expected, name), atol=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        scan.ranges[0] = 0.0


def test_messages_wait_until_they_are_taken(device, transport):
    """None is lost while nobody reads, none comes before its time, none twice."""
    transport.wait_for(lambda: device.newest(Odometry))
    first = device.take(Odometry, math.inf)[-1].stamp
    arrived = set()

    def goes_on():
        arrived.add(device.newest(Odometry).stamp)
        return max(arrived) > first + 1.2

    transport.wait_for(goes_on)
    middle = first + 0.9
    early, late = device.take(Odometry, middle), device.take(Odometry, math.inf)
    stamps = [one.stamp for one in (*early, *late)]
    assert all(first < stamp <= middle for stamp in stamps[: len(early)])
    assert all(stamp > middle for stamp in stamps[len(early) :])
    assert (np.diff(stamps) > 0.0).all()
    assert arrived - {first} <= set(stamps)
    assert early
    assert late


def distance_to_walls(walls, point):
    along = walls[:, 2:] - walls[:, :2]
    share = np.clip(((point - walls[:, :2]) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
    return np.hypot(*(point - walls[:, :2] - share[:, None] * along).T).min()


def test_commands_move_it(driving, transport):
    """Odometry at a stamp is the true pose at that stamp; the limits hold."""
    before = len(transport.order("report")["commands"])

    def commands_since():
        return np.array(transport.order("report")["commands"][before:])

    def turns():
        transport.drive(driving, 0.5, 9.0, 9.0)
        return commands_since()[-1, 2] > 1.4 and driving.newest(Odometry).V_B[1] > 1.0

    transport.wait_for(turns)
    commands = commands_since()
    assert commands[:, 1].max() <= 0.3 + 1e-12
    assert commands[:, 2].max() <= 1.5 + 1e-12
    odometry = driving.newest(Odometry)
    X_WB, start = true_pose(transport, odometry.stamp), transport.order("report")["poses"][0][1]
    expected = se2.between(start, X_WB)
    assert np.hypot(*(odometry.X_OB[:2] - expected[:2])) < 0.05
    assert abs(se2.wrap_angle(odometry.X_OB[2] - expected[2])) < 0.2


def test_odometry_that_falls_silent(driving, transport):
    silent = transport.order("silent", ["odometry"])
    transport.drive(driving, 1.0, 0.0, 0.8)
    stopped = transport.stop_after(silent)
    transport.order("silent", [])
    assert stopped < LOADED
    assert driving.locked == SILENT
    transport.wait_for(lambda: transport.fresh(driving))
    back = time.monotonic()
    transport.drive(driving, 0.3, 0.0, 0.8)
    assert transport.last_motion_told() < back
    transport.go(driving)


def test_a_scan_that_falls_silent(driving, source, transport):
    """No message is made up meanwhile; the robot goes on, for the explorer's safety filter is what minds."""
    transport.order("silent", ["scan", "detections"])
    # The last ones may be on their way.
    transport.wait_for(lambda: time.monotonic() - source.newest(LaserScan).stamp > 1.0)
    silent = source.newest(LaserScan).stamp
    transport.drive(driving, 0.7, 0.0, 0.8)
    assert source.newest(LaserScan).stamp == silent
    assert driving.locked in (None, SILENT)
    transport.wait_for(lambda: transport.fresh(driving))
    transport.order("silent", [])
    transport.wait_for(lambda: source.newest(LaserScan).stamp > silent + 0.7)
    source.take(LaserScan, silent)
    assert source.take(LaserScan, math.inf)[0].stamp > silent + 0.7


def test_a_clock_that_jumps(driving, transport):
    jumped = transport.order("jump", -5.0)
    transport.drive(driving, 1.0, 0.0, 0.8)
    assert transport.stop_after(jumped) < LOADED
    transport.wait_for(lambda: "has jumped" in (driving.locked or ""))
    transport.wait_for(lambda: transport.fresh(driving))
    transport.go(driving)
    transport.order("jump", 5.0)
