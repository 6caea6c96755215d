"""Scan matching and odometry held against it, on simulated drives: the truth, and by hand what is wrong."""

import dataclasses
import functools
import math
from pathlib import Path

import numpy as np
import pytest

from tfg_drake.geometry import se2
from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.messages import LaserScan, Odometry, replace
from tfg_drake.slam.scan_matching import (
    EVERY,
    LONG,
    Verdict,
    Watch,
    bridged,
    compare,
    corrected,
    judged,
    match,
    watched,
)


def box(x0, y0, x1, y1):
    return [[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]]


# Two rooms with a doorway between, furniture in both.
ROOMS = np.array(
    [*box(0, 0, 9, 5), [5, 0, 5, 1.8], [5, 3.0, 5, 5], *box(1.5, 4.2, 2.6, 4.8), *box(7.2, 0.6, 8.0, 1.3)], float
)
CORRIDOR = np.array([[-50.0, -0.9, 50.0, -0.9], [-50.0, 0.9, 50.0, 0.9]])
RINGS = np.linspace(0.0, 2.0 * np.pi, 721)
ROUND = 3.0 * np.column_stack([np.cos(RINGS[:-1]), np.sin(RINGS[:-1]), np.cos(RINGS[1:]), np.sin(RINGS[1:])])
NOISE = 0.015


def fan(degrees=270.0, rays=360):
    return np.deg2rad(np.linspace(-0.5 * degrees, 0.5 * degrees, rays, endpoint=degrees < 360.0))


def scan(walls, X_WS, rng, stamp=0.0, angles=None, flip=False, range_max=10.0):
    angles = fan() if angles is None else angles
    ranges = cast_rays(walls, X_WS[:2], np.ascontiguousarray(X_WS[2] + (-angles if flip else angles)), range_max)
    return LaserScan(stamp, angles, ranges + NOISE * rng.normal(size=len(angles)), range_max, NOISE)


STOP, DT = 3.0, 0.05
# Turn rate, speed, for how long: two rooms, through the doorway and back.
LEGS = [
    (0.0, 0.0, STOP),
    (0.6, 0.0, 0.8),
    (0.0, 0.5, 4.0),
    (-0.6, 0.3, 1.6),
    (0.0, 0.5, 5.0),
    (0.9, 0.0, np.pi / 0.9),
    (0.0, 0.5, 6.0),
    (0.5, 0.2, 3.0),
    (0.0, 0.0, 1.0),
    (-0.9, 0.0, (1.5 + np.pi - 0.48) / 0.9),
]


@functools.cache
def way():
    """t (n,), X_WB (n, 3), V_B (n, 2)."""
    rows, X, t = [], np.array([1.5, 1.6, 0.0]), 0.0
    for w, v, duration in LEGS:
        for _ in range(round(duration / DT)):
            rows.append([t, *X, v, w])
            half = 0.5 * w * DT
            X = se2.compose(X, [v * DT * np.sinc(half / np.pi) * math.cos(half), v * DT * math.sin(half), w * DT])
            t += DT
    rows = np.array(rows)
    return rows[:, 0], rows[:, 1:4], rows[:, 4:]


def pose(t):
    stamps, X, _ = way()
    return np.array(
        [np.interp(t, stamps, X[:, 0]), np.interp(t, stamps, X[:, 1]), np.interp(t, stamps, np.unwrap(X[:, 2]))]
    )


@functools.cache
def drive(seed=0, turn=1.0, travel=1.0, lag=0.0, yaw=0.0, lever=(0.0, 0.0), flip=False, degrees=270.0):
    """Odometry and scans. turn, travel: how much less the odometry says than there is."""
    rng = np.random.default_rng(seed)
    stamps, X, V = way()
    odometry = [Odometry(0.0, np.zeros(3), np.zeros(2), True)]
    for before, after, v in zip(X[:-1], X[1:], V[:-1], strict=True):
        step = se2.between(before, after)
        length, angle = np.hypot(step[0], step[1]) * (1.01 + 0.02 * rng.normal()) / travel, step[2] * 1.005 / turn
        angle += 0.001 * rng.normal() if v.any() else 0.0
        step = np.array([length * math.cos(0.5 * angle), length * math.sin(0.5 * angle), angle])
        stamp = odometry[-1].stamp + DT
        odometry.append(
            Odometry(stamp, se2.compose(odometry[-1].X_OB, step), np.array([length, angle]) / DT, not v.any())
        )
    mount = np.array([*lever, yaw])
    scans = [
        scan(ROOMS, se2.compose(pose(t), mount), rng, t + lag, fan(degrees), flip)
        for t in np.arange(0.02, stamps[-1], 0.12)
    ]
    return tuple(odometry), tuple(scans)


def error(X, truth):
    off = X - truth
    return np.array([off[0], off[1], se2.wrap_angle(off[2])])


@pytest.mark.parametrize(
    ("degrees", "rays", "moved"),
    [
        (180, 180, [0.3, 0.05, 0.5]),
        (240, 682, [0.0, 0.0, -0.9]),
        (270, 1081, [-0.2, 0.0, 0.1]),
        (360, 360, [0.0, 0.0, 0.0]),
        (360, 360, [0.3, 0.05, 0.5]),
    ],
)
def test_a_match_is_the_motion_within_its_deviations(degrees, rays, moved):
    rng, squares = np.random.default_rng(1), []
    for x in (1.5, 2.5, 3.2, 6.0, 6.7):
        begin = np.array([x, 2.2, 0.3 * x])
        scans = [scan(ROOMS, X, rng, angles=fan(degrees, rays)) for X in (begin, se2.compose(begin, np.array(moved)))]
        found = match(*scans)
        off = error(found.X, moved)
        assert (np.abs(off) < [0.02, 0.02, 0.01]).all()
        assert found.share > 0.7
        squares.append(off @ np.linalg.solve(found.covariance, off))
    # Of three numbers each.
    assert np.mean(squares) < 5.0


def test_rays_that_are_lost_or_told_as_nothing_do_no_harm():
    rng = np.random.default_rng(2)
    begin, moved = np.array([2.0, 2.0, 0.4]), np.array([0.2, 0.0, 0.2])
    scans = [scan(ROOMS, X, rng) for X in (begin, se2.compose(begin, moved))]
    spoilt = []
    for one in scans:
        ranges, lost = one.ranges.copy(), rng.random(len(one.ranges))
        ranges[lost < 0.15], ranges[(lost > 0.15) & (lost < 0.3)], ranges[lost > 0.97] = np.nan, np.inf, 0.0
        kept = (lost < 0.5) | (lost > 0.55)
        spoilt.append(LaserScan(0.0, one.angles[kept], ranges[kept], 10.0, NOISE))
    assert np.abs(error(match(*spoilt).X, moved)).max() < 0.02


def test_a_guess_may_be_off_by_a_radian():
    rng = np.random.default_rng(3)
    begin, moved = np.array([2.0, 2.0, 0.4]), np.array([0.2, 0.05, 0.9])
    scans = [scan(ROOMS, X, rng) for X in (begin, se2.compose(begin, moved))]
    for guess in ([0.0, 0.0, 0.0], [0.5, 0.2, 1.7], [0.1, -0.2, 0.2]):
        assert np.abs(error(match(*scans, np.array(guess)).X, moved)).max() < 0.02


def test_scans_that_show_too_little_or_other_places_do_not_match():
    rng = np.random.default_rng(4)
    seen = scan(ROOMS, np.array([2.0, 2.0, 0.0]), rng)
    nothing = replace(seen, ranges=np.full(len(seen.ranges), np.inf))
    empty = LaserScan(0.0, np.zeros(0), np.zeros(0), 10.0, NOISE)
    noise = replace(seen, ranges=rng.uniform(0.5, 9.0, len(seen.ranges)))
    for other in (nothing, empty, noise):
        assert match(seen, other) is None
        assert match(other, seen) is None


def test_a_corridor_does_not_tell_how_far_along():
    rng = np.random.default_rng(5)
    for heading in (0.0, 0.7, 2.0):
        scans = [scan(CORRIDOR, np.array([x, 0.1, heading]), rng, angles=fan(360)) for x in (0.0, 0.3)]
        found = match(*scans)
        along, across = (
            np.array([math.cos(heading), -math.sin(heading)]),
            np.array([math.sin(heading), math.cos(heading)]),
        )
        assert math.sqrt(along @ found.covariance[:2, :2] @ along) > 0.3
        assert math.sqrt(across @ found.covariance[:2, :2] @ across) < 0.02
        assert abs(across @ found.X[:2]) < 0.01
        assert abs(found.X[2]) < 0.005


def test_a_round_room_does_not_tell_how_far_it_turned():
    rng = np.random.default_rng(6)
    scans = [scan(ROUND, np.array([0.0, 0.0, turn]), rng, angles=fan(360)) for turn in (0.0, 0.3)]
    found = match(*scans)
    assert math.sqrt(found.covariance[2, 2]) > 0.3
    assert np.hypot(*found.X[:2]) < 0.02


@pytest.mark.parametrize("mount_known", [True, False])
@pytest.mark.parametrize("degrees", [180.0, 360.0])
def test_a_good_drive_is_left_as_it_is(mount_known, degrees):
    odometry, scans = drive(degrees=degrees)
    found = compare(odometry, scans, mount_known)
    verdict = judged(found)
    assert vars(verdict) == vars(Verdict())
    assert (found.turn, found.travel) == (pytest.approx(1 / 1.005, abs=0.01), pytest.approx(1 / 1.01, abs=0.02))
    assert not len(found.contradicts)
    # The same messages.
    after = corrected(odometry, scans, verdict)
    assert all(one is other for one, other in zip(after[0] + after[1], odometry + scans, strict=True))


WRONG = [
    pytest.param({"turn": 0.4}, True, marks=pytest.mark.slow),
    pytest.param({"travel": 4.0}, True, marks=pytest.mark.slow),
    ({"lag": 0.06}, True),
    pytest.param({"lag": -0.9}, True, marks=pytest.mark.slow),
    ({"yaw": 0.5 * math.pi, "lever": (0.1, -0.1)}, False),
    ({"yaw": -0.3}, True),
    ({"turn": 1.5, "travel": 0.5, "lag": 0.4, "yaw": 2.0}, False),
]


@pytest.mark.parametrize(("wrong", "mount_known"), WRONG)
def test_what_is_wrong_all_along_is_found_and_corrected(wrong, mount_known):
    odometry, scans = drive(seed=7, **wrong)
    verdict = judged(compare(odometry, scans, mount_known))
    assert verdict.refusal == ""
    said = {"turn": 1.0, "travel": 1.0, "lag": 0.0, "yaw": 0.0} | {key: wrong[key] for key in wrong if key != "lever"}
    assert verdict.turn == pytest.approx(said["turn"], rel=0.02)
    assert verdict.travel == pytest.approx(said["travel"], rel=0.03)
    assert verdict.lag == pytest.approx(said["lag"], abs=0.02)
    assert se2.wrap_angle(verdict.yaw - said["yaw"]) == pytest.approx(0.0, abs=0.02)
    kinds = {"turn": "turn_scale", "travel": "travel_scale", "lag": "lag", "yaw": "mount_yaw"}
    assert [note.kind for note in verdict.notes] == [kinds[key] for key in kinds if key in wrong]
    # After that nothing is wrong, and the odometry is near the truth.
    odometry, scans = corrected(odometry, scans, verdict)
    assert all((np.diff(one.angles) > 0.0).all() and abs(one.angles).max() <= np.pi for one in scans)
    assert vars(judged(compare(odometry, scans, mount_known))) == vars(Verdict())
    stamps, _, V = way()
    moved = se2.between(pose(stamps[0]), pose(stamps[-1]))
    assert np.hypot(*(odometry[-1].X_OB - moved)[:2]) < 0.6
    driving = [one.V_B for one, v in zip(odometry[1:], V, strict=False) if v[0] == 0.5]
    assert np.mean(driving, axis=0) == pytest.approx([0.505, 0.0], abs=0.02)


@pytest.mark.parametrize("wrong", [{"turn": -1.0}, {"flip": True}])
def test_scans_that_turn_against_the_odometry_are_refused(wrong):
    verdict = judged(compare(*drive(**wrong), mount_known=True))
    assert verdict.against
    assert verdict.refusal.startswith("scans turn against the odometry (-")
    assert "--set hardware.scanner.flip=true" in verdict.refusal


def still(odometry):
    return [replace(one, X_OB=np.zeros(3), V_B=np.zeros(2)) for one in odometry]


def test_what_contradicts_all_along_is_refused_in_a_line():
    odometry, scans = drive()
    frozen = [replace(one, ranges=scans[40].ranges) for one in scans]
    cases = {
        "the odometry stands while the scans move": (still(odometry), scans),
        "the scans do not turn while the odometry does": (odometry, frozen),
        "scans travel backwards": drive(travel=-1.0),
        "scans travel 99 times as far as the odometry": drive(travel=100.0),
        "scans turn 10 times as far": drive(turn=10.0),
    }
    for begins, (wheels, seen) in cases.items():
        refusal = judged(compare(wheels, seen, mount_known=True)).refusal
        assert refusal.startswith(begins), refusal
        assert "\n" not in refusal
    # Scans of another time of the drive: no lag is so long.
    late = [replace(one, stamp=one.stamp - 9.0) for one in scans if one.stamp > 9.0]
    refusal = judged(compare(odometry, late, mount_known=True)).refusal
    assert refusal.startswith("scans and odometry contradict each other"), refusal


def test_where_little_is_told_nothing_is_claimed():
    odometry, scans = drive()
    stands = [one for one in scans if one.stamp < STOP]
    # A corridor without ends: how far along the robot drives no scan tells, whatever the wheels say.
    rng, stamps = np.random.default_rng(8), np.arange(0.0, 30.0, 0.1)
    along = [scan(CORRIDOR, np.array([0.3 * t, 0.0, 0.0]), rng, t) for t in stamps]
    wheels = [Odometry(t, np.array([0.9 * t, 0.0, 0.0]), np.array([0.9, 0.0])) for t in np.arange(0.0, 30.0, 0.05)]
    for told, seen in (
        (odometry, stands),
        (odometry, scans[:20]),
        (wheels, along),
        (odometry, ()),
        ((), scans),
        ((), ()),
    ):
        for mount_known in (True, False):
            found = compare(told, seen, mount_known)
            assert vars(judged(found)) == vars(Verdict())
            assert not len(found.contradicts)


@pytest.mark.parametrize("lag", [0.0, 0.4, -0.4])
def test_a_robot_that_turns_on_and_on_does_not_tell_the_clocks(lag):
    """All lags explain a constant rate; what single errors of the wheels say of the lag is no evidence."""
    for seed in range(2):
        rng, stamps = np.random.default_rng(seed), np.arange(0.0, 16.0, 0.1)
        seen = [scan(ROOMS, np.array([2.0, 2.0, 1.2 * t]), rng, t + lag) for t in stamps]
        heading = np.cumsum(1.2 * DT + 0.002 * rng.normal(size=320))
        wheels = [Odometry(k * DT, np.array([0.0, 0.0, h]), np.array([0.0, 1.2])) for k, h in enumerate(heading)]
        assert vars(judged(compare(wheels, seen, True))) == vars(Verdict())


def slipped(odometry, at, jump):
    """The wheels tell a way at once that there was not."""
    first = next(k for k, one in enumerate(odometry) if one.stamp > at)
    X, begin = odometry[first - 1].X_OB, odometry[first].X_OB
    moved = se2.compose(X, np.array(jump))
    told = [replace(one, X_OB=se2.compose(moved, se2.between(begin, one.X_OB))) for one in odometry[first:]]
    return [*odometry[:first], *told]


@pytest.mark.parametrize("jump", [[1.5, 0.0, 0.0], [-0.4, 0.0, 0.0], [0.0, 0.0, 0.5]])
@pytest.mark.parametrize("at", [6.0, 22.0])
def test_wheels_that_slip_contradict_the_scans_there_and_nowhere_else(jump, at):
    odometry, scans = drive(seed=3)
    found = compare(slipped(odometry, at, jump), scans, True)
    assert vars(judged(found)) == vars(Verdict())
    ((begin, end),) = found.contradicts
    assert begin < at + DT
    assert end > at
    assert end - begin < 1.0


def test_a_way_that_is_unknown_is_held_against_nothing():
    odometry, scans = drive(seed=3)
    told = slipped(odometry, 6.0, [1.5, 0.0, 0.0])
    first = next(k for k, one in enumerate(told) if one.stamp > 6.0)
    told[first:] = [replace(one, breaks=1) for one in told[first:]]
    assert not len(compare(told, scans, True).contradicts)


@pytest.mark.parametrize(("begin", "end"), [(5.03, 7.4), (10.0, 16.01), (3.5, 3.9)])
def test_scans_bridge_a_gap(begin, end):
    _, scans = drive(seed=4)
    truth = se2.between(pose(begin), pose(end))
    stamps, X, covariance = bridged(scans, begin, end, truth + np.array([0.3, 0.0, 0.2]))
    assert stamps[0] == begin
    assert stamps[-1] == end
    assert (np.diff(stamps) > 0.0).all()
    np.testing.assert_allclose(X[0], np.zeros(3), atol=1e-12)
    off = error(X[-1], truth)
    assert (np.abs(off) < [0.04, 0.04, 0.02]).all()
    assert off @ np.linalg.solve(covariance, off) < 16.0
    for t, x in zip(stamps, X, strict=True):
        assert (np.abs(error(x, se2.between(pose(begin), pose(t)))) < [0.05, 0.05, 0.03]).all()


def test_a_scan_that_does_not_match_is_passed_over():
    """Somebody stands before the scanner: the scans before and after it match."""
    _, scans = drive(seed=4)
    truth = se2.between(pose(5.0), pose(6.5))
    amid = [k for k, one in enumerate(scans) if 5.2 < one.stamp < 6.3][3]
    hidden = [replace(one, ranges=np.full_like(one.ranges, 0.3)) if k == amid else one for k, one in enumerate(scans)]
    stamps, X, _ = bridged(hidden, 5.0, 6.5, truth)
    assert scans[amid].stamp not in stamps
    assert (np.abs(error(X[-1], truth)) < [0.04, 0.04, 0.02]).all()
    last = [replace(one, ranges=np.full_like(one.ranges, 0.3)) if one.stamp > 6.4 else one for one in scans]
    assert bridged(last, 5.0, 6.5, truth) is None


def test_what_scans_do_not_tell_is_not_bridged():
    _, scans = drive(seed=4)
    guess = np.zeros(3)
    assert bridged(scans, scans[0].stamp - 0.1, 5.0, guess) is None
    assert bridged(scans, 5.0, scans[-1].stamp + 0.1, guess) is None
    assert bridged((), 5.0, 6.0, guess) is None
    assert bridged([one for one in scans if not 6.0 < one.stamp < 9.0], 5.0, 10.0, guess) is None
    rng = np.random.default_rng(9)
    along = [scan(CORRIDOR, np.array([0.3 * t, 0.0, 0.0]), rng, t) for t in np.arange(0.0, 5.0, 0.1)]
    assert bridged(along, 1.0, 3.0, np.array([0.6, 0.0, 0.0])) is None


def watch(odometry, scans):
    """Times at which it is told."""
    state, told, k = Watch(), [], 0
    for wheels in odometry:
        while k + 1 < len(scans) and scans[k + 1].stamp <= wheels.stamp:
            k += 1
        if scans[k].stamp <= wheels.stamp:
            state, tells = watched(state, wheels, scans[k])
            told += [wheels.stamp] * tells
    return told


def test_a_robot_whose_scans_contradict_its_odometry_for_long_is_told_once():
    odometry, scans = drive()
    assert watch(odometry, scans) == []
    # One slip is not long.
    assert watch(slipped(odometry, 6.0, [1.0, 0.0, 0.0]), scans) == []
    (told,) = watch(still(odometry), scans)
    assert STOP + (LONG - 1) * EVERY < told < STOP + (LONG + 3) * EVERY
    frozen = [one if one.stamp < 12.0 else replace(one, ranges=scans[100].ranges) for one in scans]
    assert len(watch(odometry, frozen)) == 1


RECORDINGS = Path(__file__).parents[3] / "shared/data/recordings"


@pytest.mark.parametrize(
    ("name", "mount_known", "expected"),
    [
        ("0-good/good", False, {}),
        ("D-mount-untold/left_untold", False, {"yaw": 0.5 * math.pi}),
    ],
)
def test_recordings(name, mount_known, expected):
    path = RECORDINGS / f"{name}.mcap"
    if not path.exists():
        pytest.skip(f"no recordings in {RECORDINGS}")
    pytest.importorskip("mcap_ros2")
    bag = pytest.importorskip("tfg_drake.hardware.ros.bag")
    recording = bag.load_bag(path)
    found = compare(recording.odometry, recording.scans, mount_known)
    verdict = judged(found)
    assert not verdict.against
    assert verdict.yaw == pytest.approx(expected.get("yaw", 0.0), abs=0.01)
    assert dataclasses.replace(verdict, yaw=0.0, notes=(), refusal="", against=False).turn == 1.0
    assert not len(found.contradicts)
