"""Walls in a turn's solution, in keyframes and in the map."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.arrays import frozen
from tests.slam.test_scan_lines import ANGLES, CONFIG, WALLS
from tests.walls import walls_between
from tfg_drake.config import OdometryConfig, ScanConfig, TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import WALLS_BELOW, LaserScan, Odometry
from tfg_drake.simulation.laser_scanner import along_rays, scan
from tfg_drake.slam.estimator import begin_turn, end_turn, pose_estimate, process_odometry, process_scan
from tfg_drake.slam.estimator_state import initial_state
from tfg_drake.slam.keyframe import linearised, without_tags
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.slam.noise import LOOKS, Noise, noise_by_data_sheet
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
from tfg_drake.slam.turn import TAGS, Sample, TurnFrame, no_detections, reduced, solved_chain
from tfg_drake.slam.turn import _ties as ties_of
from tfg_drake.slam.walls import (
    FLOOR,
    LEAST_LENGTH,
    LEAST_LOOKS,
    OVERLAP,
    PROVISIONAL,
    Names,
    WallSet,
    compared,
    ends_seen,
    grouped,
    identified,
    known_walls,
    least_known,
    named,
    no_lines,
    no_walls,
    same_walls,
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


def faces(ends_W):
    """The row (v,) in WALLS that each pair of ends (v, 2, 2) lies on; how far the ends are off its line, and how far
    beyond what there is of it, (v, 2) m."""
    along = WALLS[:, 2:] - WALLS[:, :2]
    length = np.hypot(*along.T)
    along /= length[:, None]
    apart = ends_W[:, None] - WALLS[None, :, None, :2]
    off = np.abs(apart[..., 0] * along[:, None, 1] - apart[..., 1] * along[:, None, 0])
    s = np.einsum("vwei,wi->vwe", apart, along)
    beyond = np.maximum(np.maximum(-s, s - length[:, None]), 0.0)
    wall = np.argmin((off + beyond).max(axis=2), axis=1)
    rows = np.arange(len(wall))
    return wall, off[rows, wall], beyond[rows, wall]


def test_a_turn_puts_its_walls_where_they_are():
    begin, frames, end = turn()
    one = reduced(NOISE, (begin, frames, end), SHEET).keyframe
    assert one.walls == len(one.ids) >= 4
    assert (one.ids < PROVISIONAL).all()
    ends = ends_seen(one, np.zeros(SHARED))
    wall, off, beyond = faces(se2.transform(START, ends.reshape(-1, 2)).reshape(-1, 2, 2))
    assert len(np.unique(wall)) >= 4
    np.testing.assert_allclose(off, 0.0, atol=1e-6)
    np.testing.assert_allclose(beyond, 0.0, atol=1e-6)
    # The anchor is on the wall, in the middle of what was seen, which the robot has on its left from the first end on.
    np.testing.assert_allclose(ends.mean(axis=1), one.anchor, atol=1e-6)
    along = ends[:, 1] - ends[:, 0]
    assert (ends[:, 0, 0] * along[:, 1] > ends[:, 0, 1] * along[:, 0]).all()
    np.testing.assert_allclose(one.given(np.zeros(SHARED))[1], [0.0, 0.0, end.X_OB[2]], atol=1e-6)


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
    border = np.append(0.01 * rng.normal(size=SHARED), looks.first(X_OB).ravel())
    frames = Sample(stamps, X_OB, X_OB, none, none, np.zeros((0, 8)), border, prior, np.eye(SHARED), looks)
    ties = ties_of(NOISE, frames)

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
        own, vector = reduced(NOISE, (begin, frames, end), loose).keyframe.alone()
        information, gradient = information + own, gradient + vector
    mean = -np.linalg.solve(information, gradient)
    if which == SCANNER_YAW:
        assert abs(mean[which]) < 1e-3  # A turn on the spot tells nothing of it.
        assert information[which, which] < 1e4
    else:
        assert mean[which] == pytest.approx(value, abs=2e-3)
    assert mean[SWEEP] == pytest.approx(0.0, abs=1e-3)


def map_of(one, covariance=None, moved=(0.0, 0.0)):
    """The map as a keyframe of walls has it, moved by so much, the robot where that began."""
    n = len(one.ids)
    p_ML, _, own = one.given(np.zeros(SHARED))
    joint = np.zeros((2 * n + 3, 2 * n + 3))
    joint[:-3, :-3] = own[:-3, :-3] if covariance is None else covariance * np.eye(2 * n)
    return replace(
        empty_map(SHEET),
        ids=one.ids,
        p_ML=p_ML,
        anchor=one.anchor + moved,
        reach=one.reach,
        local=np.arange(n),
        covariance=joint,
        landmark_covariance=np.array([joint[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(n)]),
        with_shared=np.zeros((2 * n + 3 + SHARED, SHARED)),
    )


def test_a_wall_seen_again_is_found():
    begin, frames, end = turn(np.random.default_rng(4), steps=80)
    first = reduced(NOISE, (begin, frames, end), SHEET)
    names, walls = identified(first.keyframe, first.sightings, no_walls(), empty_map(SHEET))
    assert sorted(names.ids) == list(range(WALLS_BELOW - len(names.ids), WALLS_BELOW))
    assert len(names.ids) >= 4
    one = named(first.keyframe, names)
    assert (np.diff(one.ids) > 0).all()
    estimate = map_of(one)
    begin, frames, end = turn(np.random.default_rng(5), steps=30)
    again = reduced(NOISE, (begin, frames, end), SHEET)
    names, after = identified(again.keyframe, again.sightings, walls, estimate)
    assert len(names.ids) >= 2
    assert np.isin(names.ids, one.ids).all()
    assert (after.by_floor != walls.by_floor).all()
    seen = named(again.keyframe, names)
    R = seen.given(np.zeros(SHARED))[2]
    # Both are looks at one wall of the world, and agree.
    row = np.searchsorted(one.ids, seen.ids)
    ends, known = (ends_seen(of, np.zeros(SHARED)) for of in (seen, one))
    where, of_map = (faces(se2.transform(START, pairs.reshape(-1, 2)).reshape(-1, 2, 2))[0] for pairs in (ends, known))
    np.testing.assert_array_equal(where, of_map[row])
    for k in range(len(seen.ids)):
        off = apart_at_ends(ends[k], known[row[k]])
        by = np.column_stack([-seen.reach[k], [1.0, 1.0]])
        S = R[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] + estimate.landmark_covariance[row[k]]
        assert (off**2 < 16.0 * np.diag(by @ S @ by.T) + 1e-5).all()


def apart_at_ends(ends, known):
    """How far ends (2, 2) are off the line through two others (2, 2), (2,) m, positive away from the robot."""
    along = (known[1] - known[0]) / np.hypot(*(known[1] - known[0]))
    return (ends - known[0]) @ [along[1], -along[0]]


def test_a_wall_is_told_along_its_normal_only():
    """However far the robot is moved along a wall, the cost of a keyframe that sees it is the same."""
    begin, frames, end = turn(np.random.default_rng(4))
    one = reduced(NOISE, (begin, frames, end), SHEET).keyframe
    for id_ in one.ids:
        alone = without_tags(one, one.ids[one.ids != id_])
        ((p_M, q_M),) = ends_seen(alone, np.zeros(SHARED))
        along = (q_M - p_M) / np.hypot(*(q_M - p_M))

        def cost(move, alone=alone):
            A, D = np.append(move, 0.0), alone.y_AD + np.append(move, 0.0)
            return linearised(alone, (alone.y_AL, alone.anchor), (A, D), np.zeros(SHARED))[2]

        for far in (-7.0, 0.5, 30.0):
            assert cost(far * along) == pytest.approx(cost(np.zeros(2)), abs=1e-6)
        assert cost(0.02 * np.array([along[1], -along[0]])) > cost(np.zeros(2)) + 4.0


def test_a_wall_that_is_hardly_known_spoils_nothing_of_the_others():
    """However little: rounding leaves what is known to a millimetre beside kilometres."""
    begin, frames, end = turn(np.random.default_rng(4))
    one = reduced(NOISE, (begin, frames, end), SHEET).keyframe
    R, by_shared = one.conditional()
    for share in (1e-3, 1e-7):
        unit = np.ones(len(one.information))
        unit[2:4] = share
        hardly = replace(one, information=unit[:, None] * one.information * unit)
        found, on = hardly.conditional()
        np.testing.assert_allclose(found * np.outer(unit, unit)[: len(R), : len(R)], R, rtol=1e-6, atol=1e-15)
        np.testing.assert_allclose(unit[: len(R), None] * on, by_shared, atol=1e-6 * np.abs(by_shared).max())


def test_a_name_changes_nothing_but_the_order():
    """Also where the parameters are not zero; and what has no name takes nothing from what has."""
    begin, frames, end = turn(np.random.default_rng(6))
    shared = np.zeros(SHARED)
    shared[SCANNER_YAW] = 0.1
    one = reduced(NOISE, (begin, frames, end), replace(SHEET, mean=shared)).keyframe
    ids = WALLS_BELOW - 1 - np.random.default_rng(7).permutation(one.walls)
    for some in (np.arange(one.walls), np.array([2, 0, 3])):
        seen = named(one, Names(one.ids[some], ids[some]))
        np.testing.assert_array_equal(seen.ids, np.sort(ids[some]))
        row = some[np.argsort(ids[some])]
        (y, X_AD, R), (y_1, X_AD_1, R_1) = seen.given(shared), one.given(shared)
        np.testing.assert_allclose(y, y_1[row], atol=1e-9)
        np.testing.assert_allclose(X_AD, X_AD_1, atol=1e-9)
        np.testing.assert_array_equal(seen.anchor, one.anchor[row])
        np.testing.assert_array_equal(seen.reach, one.reach[row])
        at = np.append((2 * row[:, None] + [0, 1]).ravel(), len(R_1) - np.arange(3, 0, -1))
        np.testing.assert_allclose(R, R_1[np.ix_(at, at)], rtol=1e-6, atol=1e-12)
        before, after = (keyframe.alone()[0] * np.outer(SHEET.sigma, SHEET.sigma) for keyframe in (one, seen))
        np.testing.assert_allclose(after, before, atol=1e-6)


def test_walls_are_the_same_wherever_their_anchors_are():
    """A keyframe's walls by other anchors on the same lines, or turned or moved by just more than is the same."""
    begin, frames, end = turn()
    one = reduced(NOISE, (begin, frames, end), SHEET).keyframe
    ends = ends_seen(one, np.zeros(SHARED))

    def by_others(pairs, at):
        wall, anchor, reach = walls_between(pairs, at)
        wall[:, 0] += 2.0 * np.pi * np.round((one.y_AL[:, 0] - wall[:, 0]) / (2.0 * np.pi))
        return replace(one, y_AL=wall, anchor=anchor, reach=reach)

    for at in (-1.0, 0.3):
        assert same_walls(by_others(ends, at), one)
        for k in range(len(ends)):
            along = (ends[k, 1] - ends[k, 0]) / np.hypot(*(ends[k, 1] - ends[k, 0]))
            for move, same in ((0.28, True), (0.32, False), (-0.32, False)):
                moved, turned = ends.copy(), ends.copy()
                moved[k] += move * np.array([along[1], -along[0]])
                # About the anchor's foot.
                turned[k] = one.anchor[k] + (ends[k] - one.anchor[k]) @ se2.rotation(move).T
                assert same_walls(by_others(moved, at), one) == same
                assert same_walls(by_others(turned, 0.5), one) == same


def test_what_is_known_of_a_wall_is_compared_with_what_is_seen_of_it():
    """The squared error beside numerical differences; how far off and how much of it was seen, by the ends."""
    rng = np.random.default_rng(12)
    X_MD = np.array([0.7, -0.4, 2.6])
    ends_M = np.array([[[3.0, -2.0], [3.0, 3.0]], [[3.0, 2.0], [-2.0, 2.0]], [[-2.0, 0.3], [-2.1, -2.2]]])
    known, p_MC, reach = walls_between(ends_M)
    ends_D = se2.transform(se2.inverse(X_MD), ends_M.reshape(-1, 2)).reshape(-1, 2, 2)
    part = (
        ends_D[:, :1] + np.array([[0.2], [0.7]]) * (ends_D[:, 1:] - ends_D[:, :1]) + 0.02 * rng.normal(size=(3, 2, 2))
    )
    seen, p_AC, seen_reach = walls_between(part)
    root, own = 0.01 * rng.normal(size=(11, 11)), 0.01 * rng.normal(size=(6, 6))
    P, R, entry = root @ root.T, own @ own.T, np.array([2, 0, 3])
    one, other = WallSet(seen, frozen(p_AC), frozen(seen_reach)), WallSet(known, p_MC, reach)
    squared, far, overlap = compared(one, R, other, entry, frozen(X_MD), frozen(P))

    def error(x, k):
        """Angle and distance of wall k, x: (5,) its own and the pose, by the anchor seen, less those that are seen."""
        anchor, normal = se2.transform(x[2:], p_AC[k][None])[0], np.array([math.cos(x[0]), math.sin(x[0])])
        turned = se2.wrap_angle(x[0] - x[4] - seen[k, 0])
        return np.array([turned, normal @ (p_MC[k] + x[1] * normal - anchor) - seen[k, 1]])

    for k in range(3):
        x = np.append(known[k], X_MD)
        J = np.column_stack([(error(x + h, k) - error(x - h, k)) / 2e-6 for h in 1e-6 * np.eye(5)])
        at = np.append(2 * entry[k] + np.arange(2), np.arange(8, 11))
        S = J @ P[np.ix_(at, at)] @ J.T + R[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        assert squared[k, k] == pytest.approx(error(x, k) @ np.linalg.solve(S, error(x, k)), rel=1e-6)
        in_M = se2.transform(X_MD, part[k])
        assert far[k, k] == pytest.approx(np.abs(apart_at_ends(in_M, ends_M[k])).max(), rel=0.03)
        assert overlap[k, k] == pytest.approx(np.hypot(*(part[k, 1] - part[k, 0])), rel=0.01)
    others = ~np.eye(3, dtype=bool)
    assert np.isinf(squared[others]).all()
    assert np.isinf(far[others]).all()


@pytest.mark.parametrize("shift", [-3.0, -1.0, 0.0, 1.0, 2.4, 3.15, 3.25, 5.0])
def test_what_hardly_overlaps_is_not_compared(shift):
    """A wall of 5 m, and 2.5 m of its line, seen from 1 m on: anchors and poses tell no more than where both are."""
    X_MD, piece = np.array([0.7, -0.4, 2.6]), np.array([1.0, 3.5])
    known, p_MC, reach = walls_between([[[3.0, -2.0], [3.0, 3.0]]])
    ends_M = np.array([[3.0, -2.0], [3.0, -2.0]]) + np.outer(piece + shift, [0.0, 1.0])
    seen, p_AC, seen_reach = walls_between(se2.transform(se2.inverse(X_MD), ends_M), 0.8)
    P, R, entry = 1e-4 * np.eye(5), 1e-4 * np.eye(2), np.array([0])
    one, other = WallSet(seen, frozen(p_AC), frozen(seen_reach)), WallSet(known, p_MC, reach)
    squared, far, overlap = compared(one, R, other, entry, frozen(X_MD), frozen(P))
    expected = min(5.0, 3.5 + shift) - max(0.0, 1.0 + shift)
    assert overlap[0, 0] == pytest.approx(expected)
    assert np.isfinite(squared[0, 0]) == np.isfinite(far[0, 0]) == (expected > OVERLAP)


def test_walls_have_the_length_that_the_scanner_says_whatever_the_scale_of_the_tags_ranges():
    begin, frames, end = turn()
    tag = replace(no_detections(0.0), **{name: np.array([value]) for name, value in SEEN.items()})
    frames = tuple(
        replace(one, detections=replace(tag, stamp=one.stamp)) if i < 8 else one for i, one in enumerate(frames)
    )
    shared = np.zeros(SHARED)
    shared[RANGE_SCALE] = 0.02
    by_sheet = reduced(NOISE, (begin, frames, end), SHEET).keyframe
    other = reduced(NOISE, (begin, frames, end), replace(SHEET, mean=shared)).keyframe
    assert other.walls == by_sheet.walls == len(by_sheet.ids) - 1
    np.testing.assert_allclose(ends_seen(other, shared), ends_seen(by_sheet, np.zeros(SHARED)), atol=1e-5)
    # And the tag is nearer, by the longer ranges.
    r, nearer = (np.hypot(*one.given(at)[0][-1]) for one, at in ((by_sheet, np.zeros(SHARED)), (other, shared)))
    assert r / nearer == pytest.approx(1.02, abs=1e-3)


def test_a_wall_beside_a_known_one_waits():
    """Not far enough to be another, too far to be the same: it gets no name."""
    begin, frames, end = turn()
    solution = reduced(NOISE, (begin, frames, end), SHEET)
    names, walls = identified(solution.keyframe, solution.sightings, no_walls(), empty_map(SHEET))
    one = named(solution.keyframe, names)
    estimate = map_of(one, covariance=1e-8, moved=(0.15, 0.15))
    names, after = identified(solution.keyframe, solution.sightings, walls, estimate)
    assert not len(names.ids)
    np.testing.assert_array_equal(after.by_floor, walls.by_floor)
    # Where it is, it is found; and farther off, it is another.
    for moved, found in (((0.0, 0.0), True), ((0.7, 0.7), False)):
        names, _ = identified(solution.keyframe, solution.sightings, walls, map_of(one, covariance=1e-8, moved=moved))
        assert len(names.ids)
        assert np.isin(names.ids, one.ids).all() == found


def test_what_may_be_either_of_two_walls_is_neither():
    """But of two that lie within a hand of each other it is one, whichever."""
    begin, frames, end = turn()
    solution = reduced(NOISE, (begin, frames, end), SHEET)
    names, walls = identified(solution.keyframe, solution.sightings, no_walls(), empty_map(SHEET))
    once = map_of(named(solution.keyframe, names), covariance=0.05**2)
    n = len(once.ids)
    for apart, found in ((0.03, True), (0.15, False)):
        twice = replace(
            once,
            ids=np.append(once.ids - n, once.ids),
            p_ML=np.vstack([once.p_ML + np.array([0.0, apart]), once.p_ML]),
            anchor=np.tile(once.anchor, (2, 1)),
            reach=np.tile(once.reach, (2, 1)),
            local=np.arange(2 * n),
            covariance=np.diag(np.append(np.full(4 * n, 0.05**2), np.zeros(3))),
            landmark_covariance=np.tile(once.landmark_covariance, (2, 1, 1)),
            with_shared=np.zeros((4 * n + 3 + SHARED, SHARED)),
        )
        names, _ = identified(solution.keyframe, solution.sightings, walls, twice)
        assert bool(len(names.ids)) == found
        assert np.isin(names.ids, twice.ids).all()


def test_a_new_wall_is_long_and_has_been_looked_at_often():
    begin, frames, end = turn()
    solution = reduced(NOISE, (begin, frames, end), SHEET)
    one, looks = solution.keyframe, solution.sightings
    all_of_them = set(identified(one, looks, no_walls(), empty_map(SHEET))[0].provisional)
    assert all_of_them == set(one.ids)
    for k in (0, one.walls - 1):
        for few, enough in ((LEAST_LOOKS - 1, False), (LEAST_LOOKS, True)):
            counts = np.where(np.arange(one.walls) == k, few, looks)
            new = identified(one, counts, no_walls(), empty_map(SHEET))[0].provisional
            assert set(new) == all_of_them - (set() if enough else {one.ids[k]})
        for length, enough in ((0.9 * LEAST_LENGTH, False), (1.1 * LEAST_LENGTH, True)):
            reach = one.reach.copy()
            reach[k] = [-0.5 * length, 0.5 * length]
            new = identified(replace(one, reach=reach), looks, no_walls(), empty_map(SHEET))[0].provisional
            assert set(new) == all_of_them - (set() if enough else {one.ids[k]})


def test_a_wall_seen_again_after_a_turn_round_is_one_landmark():
    """By odometry, which turns two per cent too far, it stands elsewhere by then."""
    counts = []
    for share in (1.0, 1.02):
        begin, frames, end = turn(steps=135)
        frames = tuple(replace(one, X_OB=share * one.X_OB) for one in frames)
        one = reduced(NOISE, (begin, frames, replace(end, X_OB=share * end.X_OB)), SHEET).keyframe
        assert end.X_OB[2] > 2.0 * np.pi + 1.0
        assert one.y_AD[2] == pytest.approx(se2.wrap_angle(end.X_OB[2]), abs=5e-3)
        counts.append(one.walls)
    assert counts[0] == counts[1]


@pytest.mark.parametrize(
    ("sides", "landmarks", "advice"), [(4, "both", []), (60, "both", ["; hang tags"]), (60, "walls", [""])]
)
def test_where_hardly_anything_is_straight_the_operator_is_told_once(sides, landmarks, advice, caplog):
    """In a room as good as round; a square one is as good as any. Tags that are not looked for are no advice."""
    a = 2.0 * np.pi * np.arange(sides + 1) / sides
    corners = 3.0 * np.column_stack([np.cos(a), np.sin(a)])
    room, rng = np.hstack([corners[:-1], corners[1:]]), np.random.default_rng(5)
    state = initial_state(OdometryConfig(), landmarks=landmarks)
    state = begin_turn(process_odometry(state, Odometry(0.0, np.zeros(3), np.zeros(2))), 0.0)
    for i in range(1, 401):
        stamp, X = 0.1 * i, np.array([0.0, 0.0, 0.06 * i])
        state = process_scan(state, scan(room, X, stamp, ANGLES, rng.normal(size=len(ANGLES)), CONFIG))
        state = process_odometry(state, Odometry(stamp, X, np.array([0.0, 0.6])))
        state = end_turn(state, stamp) if i == 120 else state
    told = [record.note.text for record in caplog.records if hasattr(record, "note")]
    assert told == [
        f"less than 40% of the surfaces in view are straight; deviations may not hold{one}" for one in advice
    ]


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


def test_a_first_turn_is_as_uncertain_as_its_scans_have_told_by_its_end():
    """Errors that rays have in common are not known yet when the first of them are seen."""
    begun, deviations = initial_state(OdometryConfig()), []
    for told in (0.0, 0.016):
        normal = np.random.default_rng(3)

        def common(scanned, normal=normal):
            errors = along_rays(normal.normal(size=len(ANGLES)), ANGLES, 0.05)
            return replace(scanned, ranges=scanned.ranges + 0.02 * errors)

        knows = replace(begun, graph=replace(begun.graph, unevenness=told))
        turned, _ = drive(knows, 1, 0.0, [(0.0, 0.6, 4.0, True)], common)
        deviations.append(math.sqrt(turned.map.covariance[-1, -1]))
    assert deviations[0] > 0.9 * deviations[1]


def test_a_robot_without_tags_knows_where_it_is():
    sheet = by_data_sheet(OdometryConfig(), TagSensorConfig(), ScanConfig())
    walls, X_MB = drive(initial_state(OdometryConfig(), 1.0, sheet), 1, 1.0, ROUND)
    alone, _ = drive(initial_state(OdometryConfig(), 1.0, sheet, landmarks="tags"), 1, 1.0, ROUND)
    assert alone.map is not None
    assert not len(alone.map.ids)
    assert walls.map is not None
    assert not len(walls.map.of_tags.ids)
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


@pytest.mark.parametrize("level", [0.5, 1.0, 4.0, 16.0])
def test_the_floor_is_found_by_walls_seen_again(level):
    """Walls, each off by errors of the floor beside others; whatever the floor is taken to be meanwhile."""
    rng, floor = np.random.default_rng(3), np.diag(np.square(FLOOR))
    walls, others = no_walls(), np.array([[3e-7, 2e-7], [2e-7, 1e-6]])
    for _ in range(30):
        two, of_floor = np.kron(np.eye(2), others), np.kron(np.eye(2), floor)
        off = rng.multivariate_normal(np.zeros(4), two + level**2 * of_floor)
        walls = walls.seen_again(off, two + 0.5**2 * of_floor, 0.5)
    assert walls.floor == pytest.approx(level, rel=0.3)


@pytest.mark.parametrize("factor", [1.0, pytest.param(3.0, marks=pytest.mark.slow), 8.0])
def test_the_noise_of_looks_is_learnt_from_how_they_agree_in_a_turn(factor):
    """Looks that are off by so many times what their rays tell: outliers at first, all of them believed at last."""
    rng, known = np.random.default_rng(7), noise_by_data_sheet(NOISE.walks)
    for _ in range(12):
        begin, frames, end = turn()
        off = []
        for frame in frames:
            lines = frame.lines.copy()
            by_angle, by_distance = factor * lines[:, 5:7].T * rng.normal(size=(2, len(lines)))
            lines[:, 0] += by_angle
            lines[:, 1] += by_distance + by_angle * lines[:, 4]
            off.append(replace(frame, lines=lines))
        known = known.with_sample(reduced(known.now, (begin, tuple(off), end), SHEET).sample)
        known = replace(known, samples=known.samples[-4:], due=known.seen).learnt()
    assert known.now.looks == pytest.approx(factor, rel=0.1)
    assert known.sigma[LOOKS] < 0.05


@pytest.mark.parametrize("seeds", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_the_scanners_clock_is_no_excuse_for_the_noise_of_odometry(seeds):
    """A twist of a single step would have that step's noise in it: a late clock explained it, 18 deviations off."""
    sheet, found = by_data_sheet(OdometryConfig(), TagSensorConfig(), ScanConfig()), []
    for seed in range(seeds):
        state, _ = drive(initial_state(OdometryConfig(), 1.0, sheet), seed, 1.0, ROUND[:7])
        shared = state.graph.shared
        found.append((shared.mean / shared.sigma)[[SCANNER_YAW, SCANNER_X, SCANNER_Y, SCANNER_CLOCK, SWEEP]])
    assert np.abs(found).max() < 3.5


def test_nothing_seen_is_no_wall():
    assert no_lines().shape == (0, 11)
    begin, frames, end = turn(steps=3)
    blind = tuple(TurnFrame(one.stamp, one.clock, one.X_OB, one.detections) for one in frames)
    assert not len(reduced(NOISE, (begin, blind, end), SHEET).keyframe.ids)


def test_a_mirrored_scan_is_no_witness():
    """The first look tells it; then nothing but tags is a landmark."""
    sheet = by_data_sheet(OdometryConfig(), TagSensorConfig(), ScanConfig())

    def mirrored(scanned):
        return replace(scanned, ranges=scanned.ranges[::-1].copy())

    state, _ = drive(initial_state(OdometryConfig(), 1.0, sheet), 2, 1.0, ROUND[:3], spoil=mirrored)
    assert state.landmarks == "tags"
    assert state.map is not None
    assert not len(state.map.ids)


def test_of_a_walls_ends_the_deviation_normal_to_it_counts():
    """Whichever way it runs, wherever its anchor is."""
    rng = np.random.default_rng(4)
    ids = WALLS_BELOW + np.array([-2, -1, 0, 1])  # two walls and two tags
    ends = np.array([[[1.0, 2.0], [3.0, -1.0]], [[-2.0, 0.5], [-1.5, 2.5]]])
    columns = [np.vstack([of_walls, rng.normal(size=(2, 2))]) for of_walls in walls_between(ends)]
    covariance = 1e-4 * np.array([one @ one.T for one in rng.normal(size=(4, 2, 2))])

    def known(rows):
        p_ML, anchor, reach = (column[rows] for column in columns)
        return SimpleNamespace(
            ids=ids[rows], p_ML=p_ML, anchor=anchor, reach=reach, landmark_covariance=covariance[rows]
        )

    of, found, deviation = known_walls(known(slice(None)))
    np.testing.assert_array_equal(of, ids[:2])
    np.testing.assert_allclose(found, ends, atol=1e-12)
    p_ML, anchor, _ = columns
    for k, end in np.ndindex(2, 2):
        # As far as the lines of samples are off the end.
        angle, distance = rng.multivariate_normal(p_ML[k], covariance[k], size=20000).T
        off = distance - np.column_stack([np.cos(angle), np.sin(angle)]) @ (ends[k, end] - anchor[k])
        assert deviation[k, end] == pytest.approx(off.std(), rel=0.03)
    assert [len(some) for some in known_walls(known(slice(2, 4)))] == [0, 0, 0]


def test_the_least_known_place_is_of_a_tag_or_normal_to_a_wall():
    """A wall along x, known to 1 cm at one end and 4 cm at the other, and a tag known to 3 cm at best."""
    wall, anchor, reach = walls_between([[[0.0, 1.0], [3.0, 1.0]]])
    across = np.linalg.inv(np.column_stack([-reach[0], [1.0, 1.0]]))
    of_wall = across @ np.diag([0.01**2, 0.04**2]) @ across.T
    known = SimpleNamespace(
        ids=np.array([WALLS_BELOW - 1, 7]),
        p_ML=np.vstack([wall, [[2.0, 2.0]]]),
        anchor=np.vstack([anchor, np.zeros((1, 2))]),
        reach=np.vstack([reach, np.zeros((1, 2))]),
        landmark_covariance=np.array([of_wall, np.diag([0.03**2, 0.01**2])]),
    )
    deviation, place = least_known(known)
    assert deviation == pytest.approx(0.04)
    assert place == pytest.approx([3.0, 1.0])
    known.landmark_covariance[1] *= 4.0
    deviation, place = least_known(known)
    assert deviation == pytest.approx(0.06)
    assert place == pytest.approx([2.0, 2.0])
    none = np.empty((0, 2))
    nothing = SimpleNamespace(
        ids=known.ids[:0], p_ML=none, anchor=none, reach=none, landmark_covariance=known.landmark_covariance[:0]
    )
    assert least_known(nothing) is None
