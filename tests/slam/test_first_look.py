"""The first look held against odometry: turns of a simulated robot, by sensors that are mounted or stamped wrong."""

import re

import numpy as np
import pytest

from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.messages import LaserScan, Odometry, TagDetections
from tfg_drake.slam.first_look import (
    agreement,
    held_against_odometry,
    off_by_way,
    remedies,
    turns_of_tags,
)
from tfg_drake.slam.scan_matching import Verdict, compare, judged

# A room that looks another from each side, and tags in it.
WALLS = np.array([[4.0, -3.0, 4.0, 5.0], [4.0, 5.0, -6.0, 5.0], [-6.0, 5.0, -6.0, -3.0], [-6.0, -3.0, 4.0, -3.0]])
TAGS = np.array([[3.9, 0.5], [3.9, 4.0], [-2.0, 4.9], [-5.9, 1.0], [-1.0, -2.9], [2.0, -2.9]])
NARROW, ALL_ROUND = np.deg2rad(np.arange(-62.0, 62.1, 0.5)), np.deg2rad(np.arange(-180.0, 180.0, 0.5))
# It stands until then, turns round twice with the usual rates and stands again, s, rad/s, rad/s^2.
BEGIN, END, RATE, ACCELERATION = 4.0, 4.0 + 4.0 * np.pi / 1.2, 1.2, 3.5


FINE = np.arange(0.0, 20.0, 0.001)
HEADING = 0.001 * np.cumsum(np.clip(ACCELERATION * np.minimum(FINE - BEGIN, END - FINE), 0.0, RATE))


def heading(t):
    """rad, of the robot at times (n,), s."""
    return np.interp(t, FINE, HEADING)


def scan(t, angles, rng, flip=False):
    ranges = cast_rays(WALLS, np.zeros(2), (-angles if flip else angles) + float(heading(t)), 8.0)
    return LaserScan(t, angles, ranges + 0.015 * rng.normal(size=len(angles)), 8.0, 0.015)


def frame(t, rng, mirrored=False):
    r = np.hypot(*TAGS.T)
    bearing = np.arctan2(TAGS[:, 1], TAGS[:, 0]) - heading(t) + 0.01 * rng.normal(size=len(r))
    bearing = np.pi - np.mod(np.pi - bearing, 2.0 * np.pi)
    seen = np.flatnonzero(np.abs(bearing) < 1.08)
    bearing = -bearing[seen] if mirrored else bearing[seen]
    return TagDetections(t, seen, r[seen], bearing, np.full(len(seen), 0.05), np.full(len(seen), 0.01))


def messages(seed=0, angles=NARROW, flip=False, mirrored=False, scan_ahead=0.0, tags_ahead=0.0, turned=1.0):
    """All of a first look. ahead: clocks, s. turned: the odometry's turn as a share of the true one."""
    rng = np.random.default_rng(seed)
    result = [
        Odometry(t, np.array([0.0, 0.0, np.angle(np.exp(1j * turned * heading(t)))]), np.zeros(2))
        for t in np.arange(0.0, 17.0, 1 / 16)
    ]
    for t in np.arange(0.03, 17.0, 0.1):
        seen = scan(t, angles, rng, flip), frame(t, rng, mirrored)
        result += [
            LaserScan(t + scan_ahead, angles, seen[0].ranges, 8.0, 0.015),
            TagDetections(t + tags_ahead, *(getattr(seen[1], name) for name in list(vars(seen[1]))[1:])),
        ]
    return result


def test_the_turn_between_two_frames_is_that_of_most_tags():
    bearings = np.array([0.1, 3.1, -0.5, 0.7])
    after = bearings - 0.2
    after[0] = 1.0
    one, other = np.full(4, 1.0), np.full(4, 0.1)
    frames = [TagDetections(float(t), np.arange(4), one, b, other, other) for t, b in ((1, bearings), (2, after))]
    np.testing.assert_allclose(turns_of_tags(frames), [[1.0, 2.0, 0.2]])
    none = np.zeros(0)
    frames.insert(1, TagDetections(1.5, none.astype(int), none, none, none, none))
    np.testing.assert_allclose(turns_of_tags(frames), [[1.0, 2.0, 0.2]])
    assert turns_of_tags(frames[:1]).shape == (0, 3)


@pytest.mark.parametrize(
    ("angles", "flip", "mirrored"),
    [(NARROW, False, False), (NARROW, True, True), (ALL_ROUND, False, True), (ALL_ROUND, True, False)],
)
def test_a_sensor_that_is_upside_down_turns_against_the_robot(angles, flip, mirrored):
    tags, scan = held_against_odometry(messages(0, angles, flip, mirrored))
    assert (tags.against, tags.lag) == (mirrored, 0.0)
    assert (scan.against, len(scan.lines)) == (flip, int(flip))
    # It is no scanner that is upside down where it is the odometry that turns the other way.
    other = held_against_odometry(messages(3, angles, flip, mirrored, turned=-1.0))
    assert [one.against for one in other] == [not mirrored, not flip]


@pytest.mark.parametrize("ahead", [0.3, -0.2, 0.5, -0.7])
def test_a_wrong_clock_is_found(ahead):
    tags, scans = held_against_odometry(messages(0, tags_ahead=ahead))
    assert (tags.lag, scans.lines) == (pytest.approx(ahead, abs=0.03), [])
    tags, scans = held_against_odometry(messages(1, scan_ahead=ahead))
    assert (tags.lag, scans.lag) == (0.0, pytest.approx(ahead, abs=0.03))
    assert [note.kind for note in scans.notes] == ["lag"]


@pytest.mark.parametrize("ahead", [0.0, 0.05, -0.08])
def test_what_is_learnt_with_the_map_is_no_fault(ahead):
    tags, scans = held_against_odometry(messages(1, tags_ahead=ahead, scan_ahead=ahead))
    assert (tags.lag, scans.lines) == (0.0, [])


@pytest.mark.parametrize("turned", [0.5, 2.0])
def test_odometry_that_turns_by_another_measure_is_told(turned):
    _, scans = held_against_odometry(messages(2, turned=turned))
    assert scans.turn == pytest.approx(1.0 / turned, rel=0.02)
    (line,) = scans.lines
    assert line.startswith(f"scans turn {scans.turn:.3g} times as far as the odometry")


def test_odometry_that_does_not_turn_with_the_scans_is_told():
    _, scans = held_against_odometry(messages(turned=0.0))
    assert scans.refusal.startswith("the odometry stands while the scans move")


def test_somebody_who_walks_by_is_no_fault_of_the_odometry():
    """In a corridor nothing but people tells how far the robot travels: of scans that turn with it, it does not."""
    rng, corridor = np.random.default_rng(4), np.array([[-30.0, 1.0, 30.0, 1.0], [30.0, -1.0, -30.0, -1.0]])
    seen = [one for one in messages() if isinstance(one, Odometry)]
    for t in np.arange(0.03, 17.0, 0.1):
        people = []
        for x, y in ((-4.0, 0.5), (-1.0, -0.4), (3.0, 0.3), (-7.0, -0.2)):
            ring = np.linspace(0.0, 2.0 * np.pi, 13)
            p = np.column_stack([(x + 0.5 * t + 9.0) % 18.0 - 9.0 + 0.25 * np.cos(ring), y + 0.25 * np.sin(ring)])
            people.append(np.hstack([p[:-1], p[1:]]))
        ranges = cast_rays(np.vstack([corridor, *people]), np.zeros(2), NARROW + float(heading(t)), 10.0)
        seen.append(LaserScan(t, NARROW, ranges + 0.015 * rng.normal(size=len(NARROW)), 10.0, 0.015))
    found = compare(
        [one for one in seen if isinstance(one, Odometry)], [one for one in seen if isinstance(one, LaserScan)], True
    )
    assert judged(found, 0.05).refusal.startswith("scans and odometry contradict each other")
    assert held_against_odometry(seen)[1].refusal == ""


def drive(yaw, walls=WALLS, seed=0):
    """3 m ahead at 0.3 m/s; yaw: where the scanner looks, farther to the left than was said."""
    rng, stamps = np.random.default_rng(seed), np.arange(0.0, 10.0, 1 / 16)
    seen = [Odometry(t, np.array([0.3 * t, 0.0, 0.0]), np.array([0.3, 0.0])) for t in stamps]
    for t in np.arange(0.03, 9.9, 0.1):
        ranges = cast_rays(walls, np.array([0.3 * t - 1.0, 0.0]), ALL_ROUND + yaw, 8.0)
        seen.append(LaserScan(t, ALL_ROUND, ranges + 0.015 * rng.normal(size=len(ranges)), 8.0, 0.015))
    return seen


@pytest.mark.parametrize("yaw", [np.pi, 0.5 * np.pi, -0.3])
def test_a_drive_tells_where_the_scanner_looks(yaw):
    (line,) = off_by_way(drive(yaw))
    if yaw > 3.0:
        assert line.startswith("scans travel backwards")
    else:
        assert float(re.search("looks (.*) degrees farther", line)[1]) == pytest.approx(np.degrees(yaw), abs=1.0)


@pytest.mark.parametrize("seed", range(5))
def test_a_drive_of_a_scanner_that_looks_ahead_tells_nothing(seed):
    assert off_by_way(drive(0.0, seed=seed)) == []
    corridor = np.array([[-30.0, 1.0, 30.0, 1.0], [30.0, -1.0, -30.0, -1.0]])
    assert off_by_way(drive(np.pi, corridor, seed)) is None


def test_where_nothing_is_told_nothing_is_wrong():
    stands = [one for one in messages() if one.stamp < BEGIN]
    for seen in (stands, [one for one in messages() if isinstance(one, Odometry)], []):
        tags, scans = held_against_odometry(seen)
        assert vars(tags) == vars(scans) == vars(Verdict())
    # Turns that no clock explains.
    rng = np.random.default_rng(0)
    stamps = np.arange(0.0, 17.0, 0.1)
    seen = np.column_stack([stamps[:-1], stamps[1:], rng.uniform(-0.3, 0.3, len(stamps) - 1)])
    told = agreement([one for one in messages() if isinstance(one, Odometry)], seen)
    assert (told.against, told.lag) == (False, 0.0)


def test_each_finding_is_a_line_with_the_key_to_set():
    right, against = Verdict(), Verdict(against=True)
    agrees, flipped = Verdict(), Verdict(refusal="scans turn against the odometry", against=True)
    assert remedies(right, agrees) == []
    assert remedies(right, flipped) == ["scans turn against the odometry"]
    (line,) = remedies(against, agrees)
    assert line.startswith("the tags turn against the robot")
    (line,) = remedies(against, flipped)
    assert "its odometry counts turns to the right" in line
    camera, scanner = remedies(Verdict(lag=0.3), flipped)
    assert "0.30 s ahead of the base's" in camera
    assert scanner == flipped.refusal
