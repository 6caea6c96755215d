"""Walls in a turn's solution, in keyframes and in the map."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.slam.test_scan_lines import ANGLES, CONFIG, WALLS
from tfg_drake.config import OdometryConfig, ScanConfig, TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import WALLS_BELOW, LaserScan, Odometry, is_tag
from tfg_drake.simulation.laser_scanner import scan
from tfg_drake.slam.estimator import begin_turn, end_turn, pose_estimate, process_odometry, process_scan
from tfg_drake.slam.estimator_state import initial_state
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.slam.noise import Noise
from tfg_drake.slam.odometry_model import random_walks
from tfg_drake.slam.scan_lines import scan_lines
from tfg_drake.slam.shared import (
    RANGE_SCALE,
    SCANNER_CLOCK,
    SCANNER_X,
    SCANNER_Y,
    SCANNER_YAW,
    SHARED,
    SWEEP,
    Shared,
    by_data_sheet,
)
from tfg_drake.slam.turn import TAGS, TurnFrame, no_detections, reduced, solved_chain
from tfg_drake.slam.turn import _ties as ties_of
from tfg_drake.slam.walls import (
    PROVISIONAL,
    Names,
    Walls,
    floor_of_points,
    grouped,
    identified,
    known_walls,
    least_known,
    named,
    no_lines,
    no_walls,
)

NOISE = Noise(random_walks(OdometryConfig()))
SHEET = by_data_sheet(OdometryConfig(), TagSensorConfig())
START = np.array([-1.0, -1.0, 0.3])

# A tag, in every frame of the first second.
SEEN = {"ids": 7, "range": 2.0, "bearing": 0.2, "sigma_range": 0.02, "sigma_bearing": 0.01}


def turn(rng=None, rate=0.6, steps=30, scanner=(0.0, 0.0, 0.0), clock=0.0):
    """begin, frames and end of a robot that stands for a second and then turns on the spot, among WALLS. Its scanner is
    at a pose in the body, its scans show what there was `clock` s before."""
    frames = []
    for i in range(steps + 1):
        stamp = 0.1 * i
        X_WB = np.array([*START[:2], START[2] + rate * max(stamp - clock - 1.0, 0.0)])
        X_WS = se2.compose(X_WB, np.array(scanner))
        normal = np.zeros(len(ANGLES)) if rng is None else rng.normal(size=len(ANGLES))
        lines = scan_lines(scan(WALLS, X_WS, stamp, ANGLES, normal, CONFIG))
        X_OB = np.array([0.0, 0.0, rate * max(stamp - 1.0, 0.0)])
        frames.append(TurnFrame(stamp, stamp, X_OB, no_detections(stamp), 0.0, lines, True))
    bare = [TurnFrame(one.stamp, one.clock, one.X_OB, one.detections) for one in (frames[0], frames[-1])]
    return bare[0], tuple(frames[1:-1]), bare[1]


def distances(p_W):
    """How far points (k, 2) are from the nearest line of WALLS, (k,) m."""
    normal = np.column_stack([WALLS[:, 3] - WALLS[:, 1], WALLS[:, 0] - WALLS[:, 2]])
    normal /= np.hypot(*normal.T)[:, None]
    return np.abs(np.einsum("kwi,wi->kw", p_W[:, None] - WALLS[None, :, :2], normal)).min(axis=1)


def test_a_turn_puts_its_walls_where_they_are():
    begin, frames, end = turn()
    solution = reduced(NOISE, begin, frames, end, SHEET)
    p_AL, X_AD, _ = solution.keyframe.given(np.zeros(SHARED))
    assert len(p_AL) >= 8
    assert (solution.keyframe.ids < PROVISIONAL).all()
    np.testing.assert_allclose(distances(se2.transform(START, p_AL)), 0.0, atol=1e-6)
    np.testing.assert_allclose(X_AD, [0.0, 0.0, end.X_OB[2]], atol=1e-6)


def test_normal_equations_are_those_of_numerical_differences():
    """The kernel's information, with the scanner's parameters and twist, beside that of all residuals differentiated
    numerically, the poses between eliminated."""
    rng = np.random.default_rng(2)
    begin, frames, end = turn(rng, steps=4)
    stamps = 0.1 * np.arange(5)
    X_OB = np.array([one.X_OB for one in (begin, *frames, end)])
    lines = np.concatenate([one.lines for one in frames])
    node = np.repeat([1, 2, 3], [len(one.lines) for one in frames])
    twist = np.tile([0.2, 0.6], (len(lines), 1))
    looks = grouped(node, lines, twist, X_OB)
    none = np.zeros(0, dtype=np.int64)
    prior = np.zeros(SHARED)
    ties = ties_of(NOISE, stamps, X_OB, prior, np.eye(SHARED), none, none, np.zeros((0, 8)), looks)
    border = np.append(0.01 * rng.normal(size=SHARED), looks.first(X_OB).ravel())

    def residuals(x):
        X, parameters = np.vstack([np.zeros(3), x[:12].reshape(-1, 3)]), x[12 : 12 + SHARED]
        yaw, ahead, left, clock, sweep = parameters[8:13]
        found = []
        for i, w, seen in zip(looks.node, looks.wall, looks.seen, strict=True):
            normal, m_x, m_y = seen[:3]
            sigma_angle, sigma, speed, rate = seen[7:]
            angle, distance = x[12 + SHARED + 2 * w :][:2]
            bearing = math.atan2(m_y, m_x)
            then = clock + sweep * bearing
            swept = rate * seen[3:5] + speed * math.cos(angle - X[i, 2]) * seen[5:7]
            lever = np.array([ahead - then * speed, left])
            m = se2.transform(np.array([0.0, 0.0, yaw - then * rate]), np.array([[m_x, m_y]]))[0] + lever
            p = se2.transform(X[i], m[None])[0] - looks.anchor[w]
            found.append((angle - X[i, 2] - yaw + clock * rate + sweep * swept[0] - normal) / sigma_angle)
            off = math.cos(angle) * p[0] + math.sin(angle) * p[1] - distance
            found.append((off - sweep * swept[1]) / sigma)
        return np.array(found)

    X, there = X_OB.copy(), border.copy()
    information, gradient, squared = solved_chain(ties, X, there, math.inf)
    assert len(squared) == len(looks.node)
    x = np.append(X[1:].ravel(), there)
    J = np.column_stack([(residuals(x + h) - residuals(x - h)) / 2e-6 for h in 1e-6 * np.eye(len(x))])
    np.testing.assert_allclose(np.square(residuals(x)).reshape(-1, 2).sum(axis=1), squared, rtol=1e-6, atol=1e-9)
    # Walls have nothing but looks: their block, the poses between held, is that of the residuals.
    of_walls = J[:, 12 + SHARED :]
    assert np.linalg.eigvalsh(of_walls.T @ of_walls - information[TAGS:, TAGS:]).min() > -1e-6 * np.trace(information)
    # At the solution nothing pulls at them.
    np.testing.assert_allclose(gradient[TAGS:], 0.0, atol=1e-3)
    np.testing.assert_allclose(J.T[12 + SHARED :] @ residuals(x), 0.0, atol=1e-3)
    # And the scanner's parameters are drawn as the residuals are.
    drawn = J.T[12 + 8 : 12 + 13] @ residuals(x) + there[8:13]
    np.testing.assert_allclose(drawn, 0.0, atol=1e-3)


@pytest.mark.parametrize(
    ("scanner", "clock", "which", "value"),
    [
        ((0.0, 0.0, 0.02), 0.0, SCANNER_YAW, 0.02),
        ((0.02, 0.0, 0.0), 0.0, SCANNER_X, 0.02),
        ((0.0, -0.015, 0.0), 0.0, SCANNER_Y, -0.015),
        ((0.0, 0.0, 0.0), 0.03, SCANNER_CLOCK, 0.03),
    ],
)
def test_turns_tell_how_the_scanner_is_mounted(scanner, clock, which, value):
    """Two turns, to the left and to the right; the yaw is told by driving alone, where heading is known otherwise."""
    loose = Shared(np.zeros(SHARED), np.diag(np.where(np.arange(SHARED) == which, 0.1, 1e-5) ** 2))
    mean, information = np.zeros(SHARED), np.linalg.inv(loose.covariance)
    gradient = np.zeros(SHARED)
    for rate in (0.6, -0.6):
        begin, frames, end = turn(rate=rate, steps=60, scanner=scanner, clock=clock)
        own, vector = reduced(NOISE, begin, frames, end, loose).keyframe.alone()
        information, gradient = information + own, gradient + vector
    mean = -np.linalg.solve(information, gradient)
    if which == SCANNER_YAW:
        assert abs(mean[which]) < 1e-3  # A turn on the spot tells nothing of it.
        assert information[which, which] < 1e4
    else:
        assert mean[which] == pytest.approx(value, abs=2e-3)
    assert mean[SWEEP] == pytest.approx(0.0, abs=1e-3)


def test_a_wall_seen_again_is_found_and_told_along_its_normal_only():
    begin, frames, end = turn(np.random.default_rng(4), steps=80)
    first = reduced(NOISE, begin, frames, end, SHEET)
    nothing = empty_map(SHEET)
    names, walls = identified(first.keyframe, first.sightings, no_walls(), nothing)
    assert names.is_new.all()
    assert len(walls.first) >= 4
    assert (walls.first < WALLS_BELOW).all()
    one = named(first.keyframe, names, np.zeros(SHARED))
    assert (np.diff(one.ids) > 0).all()
    # The map as that keyframe has it, the robot where it began.
    n = len(one.ids)
    covariance = np.zeros((2 * n + 3, 2 * n + 3))
    covariance[:-3, :-3] = one.given(np.zeros(SHARED))[2][:-3, :-3]
    p_ML = one.given(np.zeros(SHARED))[0]
    estimate = replace(
        nothing,
        ids=one.ids,
        p_ML=p_ML,
        local=np.arange(n),
        covariance=covariance,
        landmark_covariance=np.zeros((n, 2, 2)),
        with_shared=np.zeros((2 * n + 3 + SHARED, SHARED)),
    )
    begin, frames, end = turn(np.random.default_rng(5), steps=30)
    again = reduced(NOISE, begin, frames, end, SHEET)
    names, after = identified(again.keyframe, again.sightings, walls, estimate)
    assert not names.is_new.any()
    assert len(names.first) >= 2
    np.testing.assert_array_equal(after.first, walls.first)
    seen = named(again.keyframe, names, np.zeros(SHARED))
    assert np.isin(seen.ids, one.ids).all()
    p_AL, _, R = seen.given(np.zeros(SHARED))
    for k in range(0, len(p_AL), 2):
        along = p_AL[k + 1] - p_AL[k]
        along /= np.hypot(*along)
        normal, own = np.array([along[1], -along[0]]), R[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        assert along @ own @ along > 100.0
        known = p_ML[np.searchsorted(one.ids, seen.ids[k])]
        off = normal @ (p_AL[k] - known)
        assert off**2 < 16.0 * (normal @ own @ normal + normal @ covariance[:2, :2] @ normal + 1e-5)


def test_a_name_tells_nothing_of_the_parameters():
    """The points named lie on the walls seen, a metre along them, where the parameters are those linearised at."""
    begin, frames, end = turn()
    shared = np.zeros(SHARED)
    shared[SCANNER_YAW] = 0.1
    one = reduced(NOISE, begin, frames, end, replace(SHEET, mean=shared)).keyframe
    p_AL = one.given(shared)[0].reshape(-1, 2, 2)
    along = p_AL[:, 1] - p_AL[:, 0]
    along /= np.hypot(*along.T)[:, None]
    none = np.zeros(len(p_AL), dtype=bool)
    names = Names(one.ids[::2], WALLS_BELOW - 2 - 2 * np.arange(len(p_AL)), p_AL + along[:, None], none)
    seen = named(one, names, shared)
    order = np.argsort(names.first)
    off = seen.given(shared)[0].reshape(-1, 2, 2) - p_AL[order]
    normal = np.column_stack([along[:, 1], -along[:, 0]])[order]
    np.testing.assert_allclose(np.einsum("wpi,wi->wp", off, normal), 0.0, atol=1e-6)
    np.testing.assert_allclose(np.einsum("wpi,wi->wp", off, along[order]), 1.0, atol=0.02)
    before, after = (keyframe.alone()[0] / np.outer(1.0 / SHEET.sigma, 1.0 / SHEET.sigma) for keyframe in (one, seen))
    np.testing.assert_allclose(after, before, atol=1e-3)


def test_what_is_free_along_walls_spoils_nothing_across_them(monkeypatch):
    """However free: rounding leaves what is known to a millimetre beside kilometres."""
    begin, frames, end = turn(np.random.default_rng(4))
    one = reduced(NOISE, begin, frames, end, SHEET).keyframe
    p_AL = one.given(np.zeros(SHARED))[0].reshape(-1, 2, 2)
    names = Names(one.ids[::2], WALLS_BELOW - 2 - 2 * np.arange(len(p_AL)), p_AL, np.zeros(len(p_AL), dtype=bool))
    least = []
    for free in (1.0, 3000.0):
        monkeypatch.setattr("tfg_drake.slam.walls.FREE", free)
        least.append(np.linalg.eigvalsh(named(one, names, np.zeros(SHARED)).conditional()[0])[:3])
    np.testing.assert_allclose(least[1], least[0], rtol=0.01)


def test_walls_have_the_length_that_the_scanner_says_whatever_the_scale_of_the_tags_ranges():
    begin, frames, end = turn()
    tag = replace(no_detections(0.0), **{name: np.array([value]) for name, value in SEEN.items()})
    frames = tuple(
        replace(one, detections=replace(tag, stamp=one.stamp)) if i < 8 else one for i, one in enumerate(frames)
    )
    shared = np.zeros(SHARED)
    shared[RANGE_SCALE] = 0.02
    by_sheet = reduced(NOISE, begin, frames, end, SHEET).keyframe
    other = reduced(NOISE, begin, frames, end, replace(SHEET, mean=shared)).keyframe
    walls = ~is_tag(by_sheet.ids)
    assert not walls.all()
    np.testing.assert_allclose(other.given(shared)[0][walls], by_sheet.given(np.zeros(SHARED))[0][walls], atol=1e-5)
    # And the tag is nearer, by the longer ranges.
    r, nearer = (np.hypot(*one.given(at)[0][~walls].T) for one, at in ((by_sheet, np.zeros(SHARED)), (other, shared)))
    assert r / nearer == pytest.approx(1.02, abs=1e-3)


def test_a_wall_beside_a_known_one_waits():
    """Not far enough to be another, too far to be the same: it gets no name."""
    begin, frames, end = turn()
    solution = reduced(NOISE, begin, frames, end, SHEET)
    names, walls = identified(solution.keyframe, solution.sightings, no_walls(), empty_map(SHEET))
    one = named(solution.keyframe, names, np.zeros(SHARED))
    n = len(one.ids)
    moved = one.given(np.zeros(SHARED))[0] + [0.15, 0.15]
    estimate = replace(
        empty_map(SHEET),
        ids=one.ids,
        p_ML=moved,
        local=np.arange(n),
        covariance=1e-8 * np.eye(2 * n + 3),
        landmark_covariance=np.zeros((n, 2, 2)),
        with_shared=np.zeros((2 * n + 3 + SHARED, SHARED)),
    )
    names, after = identified(solution.keyframe, solution.sightings, walls, estimate)
    assert not len(names.first)
    assert len(after.first) == len(walls.first)


def drive(state, seed, noise, legs, spoil=lambda scanned: scanned):
    """The state after legs (speed, rate, seconds, whether it is a turn) from START among WALLS; X_MB in the end."""
    rng, X_WB, X_OB, stamp = np.random.default_rng(seed), START.copy(), np.zeros(3), 0.0
    state = process_odometry(state, Odometry(0.0, X_OB, np.zeros(2)))
    for speed, rate, seconds, is_turn in legs:
        state = begin_turn(state, stamp) if is_turn else state
        for _ in range(round(seconds / 0.05)):
            stamp = round(stamp + 0.05, 6)
            X_WB = se2.compose(X_WB, np.array([0.05 * speed, 0.0, 0.05 * rate]))
            slip = noise * rng.normal(size=2) * [0.02 * math.sqrt(0.05 * abs(speed)), 0.005 * math.sqrt(0.05)]
            moved = np.array([0.05 * speed * (1.0 + 0.02 * noise) + slip[0], 0.0, 0.05 * rate + slip[1]])
            X_OB = se2.compose(X_OB, moved)
            scanned: LaserScan = scan(WALLS, X_WB, stamp, ANGLES, noise * rng.normal(size=len(ANGLES)), CONFIG)
            state = process_scan(state, spoil(scanned))
            state = process_odometry(state, Odometry(stamp, X_OB, np.array([speed, rate])))
        state = end_turn(state, stamp) if is_turn else state
    return state, se2.between(START, X_WB)


ROUND = [(0.0, 0.6, 10.5, True)] + 6 * [(0.3, 0.4, 4.0, False), (0.0, 0.6, 4.0, True)]


def test_a_robot_without_tags_knows_where_it_is():
    sheet = by_data_sheet(OdometryConfig(), TagSensorConfig(), ScanConfig())
    walls, X_MB = drive(initial_state(OdometryConfig(), 1.0, sheet), 1, 1.0, ROUND)
    alone, _ = drive(initial_state(OdometryConfig(), 1.0, sheet, landmarks="tags"), 1, 1.0, ROUND)
    assert alone.map is not None
    assert not len(alone.map.ids)
    assert not len(alone.walls.first)
    assert walls.published is not None
    assert not len(walls.published.ids)
    by_walls, by_wheels = pose_estimate(walls), pose_estimate(alone)
    off = np.append(by_walls.X_MB[:2] - X_MB[:2], se2.wrap_angle(by_walls.X_MB[2] - X_MB[2]))
    assert np.hypot(*off[:2]) < 0.02
    assert abs(off[2]) < 0.005
    assert off @ np.linalg.solve(by_walls.covariance, off) < 16.3
    assert np.hypot(*(by_wheels.X_MB[:2] - X_MB[:2])) > 3.0 * np.hypot(*off[:2])
    assert np.sqrt(np.trace(by_walls.covariance[:2, :2])) < 0.3 * np.sqrt(np.trace(by_wheels.covariance[:2, :2]))


def test_between_views_the_pose_is_told_by_walls():
    """A way of two metres after the last turn: odometry alone is 2 % off."""
    sheet = by_data_sheet(OdometryConfig(), TagSensorConfig(), ScanConfig())
    legs = [*ROUND[:3], (0.3, -0.2, 6.0, False)]
    state, X_MB = drive(initial_state(OdometryConfig(), 0.0, sheet), 3, 1.0, legs)
    by_walls = pose_estimate(state)
    off = np.append(by_walls.X_MB[:2] - X_MB[:2], se2.wrap_angle(by_walls.X_MB[2] - X_MB[2]))
    assert np.hypot(*off[:2]) < 0.015
    assert off @ np.linalg.solve(by_walls.covariance, off) < 16.3
    assert np.sqrt(np.trace(by_walls.covariance[:2, :2])) < 0.02


@pytest.mark.parametrize("level", [0.5, 1.0, 4.0])
def test_the_floor_is_found_by_walls_seen_again(level):
    """Walls, each off by errors of the floor beside others; whatever the floor is taken to be meanwhile."""
    rng, floor = np.random.default_rng(3), floor_of_points(np.array([[0.0, 0.0], [2.0, 0.0]]))[1::2, 1::2]
    walls, others = no_walls(), np.array([[1e-6, 5e-7], [5e-7, 1e-6]])
    for _ in range(60):
        off = rng.multivariate_normal(np.zeros(2), others + level**2 * floor)
        walls = walls.seen_again(off, others + 0.5**2 * floor, floor, 0.5)
    assert walls.floor == pytest.approx(level, rel=0.3)


def test_the_scanners_clock_is_no_excuse_for_the_noise_of_odometry():
    """A twist of a single step would have that step's noise in it: a late clock explained it, 18 deviations off."""
    sheet, found = by_data_sheet(OdometryConfig(), TagSensorConfig(), ScanConfig()), []
    for seed in range(3):
        state, _ = drive(initial_state(OdometryConfig(), 1.0, sheet), seed, 1.0, ROUND[:7])
        shared = state.graph.shared
        found.append((shared.mean / shared.sigma)[[SCANNER_YAW, SCANNER_X, SCANNER_Y, SCANNER_CLOCK, SWEEP]])
    assert np.abs(found).max() < 3.5


def test_nothing_seen_is_no_wall():
    assert no_lines().shape == (0, 11)
    assert isinstance(no_walls(), Walls)
    begin, frames, end = turn(steps=3)
    blind = tuple(TurnFrame(one.stamp, one.clock, one.X_OB, one.detections) for one in frames)
    assert not len(reduced(NOISE, begin, blind, end, SHEET).keyframe.ids)


def test_a_mirrored_scan_is_no_witness():
    """The first look tells it; then nothing but tags is a landmark."""
    sheet = by_data_sheet(OdometryConfig(), TagSensorConfig(), ScanConfig())

    def mirrored(scanned):
        return replace(scanned, ranges=scanned.ranges[::-1].copy())

    state, _ = drive(initial_state(OdometryConfig(), 1.0, sheet), 2, 1.0, ROUND[:3], spoil=mirrored)
    assert state.landmarks == "tags"
    assert not len(state.walls.first)
    assert state.map is not None
    assert not len(state.map.ids)


def test_of_a_walls_points_the_deviation_normal_to_it_counts():
    """Whatever they are said to be along it, and whichever way it runs."""
    rng = np.random.default_rng(4)
    ids = WALLS_BELOW + np.array([-6, -5, -2, -1, 0, 1])  # two walls and two tags
    p_ML = rng.normal(size=(6, 2))
    covariance = np.array([one @ one.T for one in rng.normal(size=(6, 2, 2))])
    known = SimpleNamespace(ids=ids, p_ML=p_ML, landmark_covariance=covariance)
    first, points, deviation = known_walls(known)
    np.testing.assert_array_equal(first, ids[[0, 2]])
    np.testing.assert_array_equal(points.reshape(-1, 2), p_ML[:4])
    for k, row in np.ndindex(2, 2):
        # As far as samples of the point are off its line.
        some = rng.multivariate_normal(points[k, row], covariance[2 * k + row], size=20000)
        turn = math.atan2(*(points[k, 1] - points[k, 0])[::-1])
        off = (some - points[k, 0]) @ [-math.sin(turn), math.cos(turn)]
        assert deviation[k, row] == pytest.approx(off.std(), rel=0.03)
    assert [
        len(some)
        for some in known_walls(SimpleNamespace(ids=ids[4:], p_ML=p_ML[4:], landmark_covariance=covariance[4:]))
    ] == [0, 0, 0]


def test_the_least_known_place_is_of_a_tag_or_normal_to_a_wall():
    """A wall along x, known to 4 cm at one point, to 2 m along itself, and a tag known to 3 cm at best."""
    known = SimpleNamespace(
        ids=np.array([WALLS_BELOW - 2, WALLS_BELOW - 1, 7]),
        p_ML=np.array([[0.0, 1.0], [3.0, 1.0], [2.0, 2.0]]),
        landmark_covariance=np.array([np.diag([4.0, 0.01**2]), np.diag([4.0, 0.04**2]), np.diag([0.03**2, 0.01**2])]),
    )
    deviation, place = least_known(known)
    assert deviation == pytest.approx(0.04)
    assert place == pytest.approx([3.0, 1.0])
    known.landmark_covariance[2] *= 4.0
    assert least_known(known)[0] == pytest.approx(0.06)
    nothing = SimpleNamespace(ids=known.ids[:0], p_ML=known.p_ML[:0], landmark_covariance=known.landmark_covariance[:0])
    assert least_known(nothing) is None
