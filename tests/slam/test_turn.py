"""One turn or piece reduced to a keyframe."""

import dataclasses
import math

import numpy as np
import pytest

from tests.slam.oracle import NOISE, PRIOR, SIGMA, Drive, dense
from tfg_drake.config import OdometryConfig, TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import TagDetections
from tfg_drake.simulation.tag_sensor import correlated
from tfg_drake.slam.keyframe import moved_points
from tfg_drake.slam.odometry_model import REST_SHARE
from tfg_drake.slam.shared import (
    CLOCK,
    DISTANCE_SCALE,
    GYRO_BIAS,
    GYRO_SCALE,
    LEVER_X,
    LEVER_Y,
    RANGE_SCALE,
    SCANNER_YAW,
    SHARED,
    SWEEP,
    by_data_sheet,
    exactly_known,
)
from tfg_drake.slam.turn import in_body, reduced

STEPS = 201
KNOWN = exactly_known()
# What the data sheets of `RingDrive` say; its camera is exact.
EXACT = TagSensorConfig(yaw_deviation=0.0, clock_deviation=0.0, mount_deviation=0.0, range_scale_deviation=0.0)
SHEET = by_data_sheet(OdometryConfig(), EXACT)


def simulate(drive, seed, noise, tags=35):
    points = np.random.default_rng(seed).uniform(-8.0, 8.0, (tags, 2))
    robot = drive(points, seed, noise)
    begin = robot.instant()
    frames = robot.frames(0.0, 1.0, STEPS)
    return robot, (NOISE, (begin, frames, robot.instant()), SHEET)


def posterior(one, prior=SHEET):
    """p_AL (n, 2), X_AD (3,) and the parameters (8,) by a keyframe and what is known of the parameters, and the
    covariance of all these."""
    m = len(one.information) - SHARED
    H, g = one.information.copy(), np.zeros(m + SHARED)
    inverse = np.linalg.inv(prior.covariance)
    H[m:, m:] += inverse
    g[m:] = one.vector - inverse @ prior.mean
    x = np.append(one.y_AL, one.y_AD)
    step = np.linalg.solve(H, -g)
    x, shared = x + step[:m], step[m:]
    # From the keyframe's unit to metres.
    scale = 1.0 + shared[one.unit]
    J = np.eye(m + SHARED)
    J[: m - 1, : m - 1] /= scale
    J[: m - 1, m + one.unit] = -x[:-1] / scale**2
    x[:-1] /= scale
    return x[:-3].reshape(-1, 2), x[-3:], shared, J @ np.linalg.inv(H) @ J.T


def error(robot, one):
    """Of tags and heading of D: D's position is exact in this simulator, whose wheels never slip on the spot."""
    p_AL, X_AD, _, covariance = posterior(one)
    heading = se2.wrap_angle(X_AD[2] - robot.X_MB[2])
    rows = np.append(np.arange(p_AL.size), p_AL.size + 2)
    return np.append((p_AL - robot.p_ML(one.ids)).ravel(), heading), covariance[np.ix_(rows, rows)]


def left_out(frames, solution):
    """Number of the frames' detections that are behind none of the solution's tags."""
    return sum(len(frame.detections.ids) for frame in frames) - solution.sightings[solution.keyframe.walls :].sum()


def test_exact_without_noise(drive):
    robot, arguments = simulate(drive, 1, 0.0)
    solution = reduced(*arguments)
    one = solution.keyframe
    assert left_out(arguments[1][1], solution) == 0
    assert len(one.ids) > 25
    p_AL, X_AD, shared, _ = posterior(one)
    np.testing.assert_allclose(p_AL, robot.p_ML(one.ids), atol=1e-6)
    np.testing.assert_allclose(X_AD, robot.X_MB, atol=1e-6)
    np.testing.assert_allclose(shared, 0.0, atol=1e-7)
    assert solution.X_AB.shape == (len(solution.stamps), 3)
    np.testing.assert_allclose(solution.X_AB[:, 2], se2.wrap_angle(solution.stamps), atol=1e-6)
    assert np.all(np.diff(solution.stamps) > 0.0)
    assert solution.sightings.sum() == sum(len(frame.detections.ids) for frame in arguments[1][1])


def test_exact_without_noise_where_all_parameters_are_off():
    """Known beforehand: each has the sign and the place that it has in the simulation."""
    truth = SIGMA * np.random.default_rng(1).normal(size=SHARED)
    robot = Drive(np.random.default_rng(1).uniform(-8.0, 8.0, (20, 2)), truth, 0, noise=0.0)
    known = dataclasses.replace(KNOWN, mean=truth)
    solution = reduced(NOISE, robot.piece(0.4, 0.3, 10.0), known)
    p_AL, X_AD, _ = solution.keyframe.given(truth)
    # But for products of two of them: the lever arm is in the unit of ranges.
    np.testing.assert_allclose(p_AL, robot.p_ML(solution.keyframe.ids), atol=5e-4)
    np.testing.assert_allclose(X_AD, robot.X_MB, atol=5e-4)


PIECES = {"turn": (0.0, 0.6, 10.5), "back": (0.0, -0.6, 8.0), "curve": (0.4, 0.3, 5.0), "straight": (0.4, 0.0, 3.0)}


@pytest.mark.parametrize("piece", PIECES.values(), ids=PIECES)
def test_it_is_the_least_squares_of_all_its_frames(piece):
    """Tags, D and all parameters, and their covariance; without the outliers there are none."""
    rng = np.random.default_rng(5)
    robot = Drive(rng.uniform(-8.0, 8.0, (25, 2)), SIGMA * rng.normal(size=SHARED), 5)
    seen = robot.piece(*piece)
    solution, expected = reduced(NOISE, seen, PRIOR), dense([seen])
    assert left_out(seen[1], solution) == 0
    np.testing.assert_array_equal(solution.keyframe.ids, expected.ids)
    p_AL, X_AD, shared, found = posterior(solution.keyframe, PRIOR)
    off, covariance = expected.off(p_AL, X_AD, shared)
    deviation = np.sqrt(np.diag(covariance))
    assert np.abs(off / deviation).max() < 0.02
    assert np.abs((found - covariance) / np.outer(deviation, deviation)).max() < 0.02


def test_what_a_turn_tells_and_what_a_piece_without_tags_does_not():
    robot = Drive(np.random.default_rng(2).uniform(-8.0, 8.0, (25, 2)), np.zeros(SHARED), 2)
    turn = reduced(NOISE, robot.piece(0.0, 0.6, 10.5), PRIOR).keyframe
    told = np.diag(turn.alone()[0]) * SIGMA**2
    assert (told[[GYRO_SCALE, LEVER_X, LEVER_Y]] > 1.0).all()
    # What no length is compared with has no scale.
    assert turn.unit == RANGE_SCALE
    assert told[RANGE_SCALE] < 1e-3
    robot.tags = np.zeros((0, 2))
    blind = reduced(NOISE, robot.piece(0.4, 0.1, 5.0), PRIOR).keyframe
    assert blind.unit == DISTANCE_SCALE
    information, gradient = blind.alone()
    assert np.abs(SIGMA[:, None] * information * SIGMA).max() < 1e-6
    assert np.abs(SIGMA * gradient).max() < 1e-6
    # Only bias and scale of the gyro bend it.
    _, by_shared = blind.conditional()
    np.testing.assert_allclose(np.delete(by_shared, [GYRO_BIAS, GYRO_SCALE], axis=1), 0.0, atol=1e-9)
    assert (np.abs(by_shared[2, [GYRO_BIAS, GYRO_SCALE]]) > 0.4).all()
    assert np.linalg.matrix_rank(blind.information, tol=1e-3) == 3


def test_the_cameras_clock_is_counted_from_the_offset_that_stamps_were_taken_with():
    """Frames whose stamps an estimator has set back already by what it believed."""
    truth = np.zeros(SHARED)
    truth[CLOCK] = 0.02
    robot = Drive(np.random.default_rng(3).uniform(-8.0, 8.0, (25, 2)), truth, 3, noise=0.0)
    # What the clock does to bearings has the sign of the turn.
    (begin, there, _), (_, back, end) = robot.piece(0.0, 0.6, 8.0), robot.piece(0.0, -0.6, 8.0)
    frames = tuple(dataclasses.replace(frame, offset=0.03) for frame in (*there, *back))
    clock = dataclasses.replace(PRIOR, mean=0.04 * np.eye(SHARED)[CLOCK])
    _, _, shared, _ = posterior(reduced(NOISE, (begin, frames, end), clock).keyframe, clock)
    assert shared[CLOCK] == pytest.approx(0.05, abs=2e-3)


def test_where_noise_is_correlated_frames_count_for_less():
    robot = Drive(np.random.default_rng(4).uniform(-8.0, 8.0, (25, 2)), np.zeros(SHARED), 4)
    seen, correlated = robot.piece(0.0, 0.6, 10.5), dataclasses.replace(NOISE, correlation=0.8)
    independent, solution = reduced(NOISE, seen, KNOWN), reduced(correlated, seen, KNOWN)
    sure, less = (np.sqrt(np.diag(one.keyframe.given(np.zeros(SHARED))[2]))[:-3] for one in (independent, solution))
    assert 1.5 < np.median(less / sure) < correlated.frame_worth**-0.5


@pytest.mark.parametrize("gaps", [0.0, 0.1])
def test_a_turn_of_correlated_frames_is_as_sure_as_it_may_be(drive, nees, gaps):
    """The robot stands and looks at the same tags for twenty seconds, of which now and then one is not seen."""
    values, noise = [], dataclasses.replace(NOISE, correlation=math.exp(-0.1))
    for seed in range(12):
        robot = drive(np.random.default_rng(seed).uniform(-8.0, 8.0, (60, 2)), seed, 0.0)
        rng, begin = np.random.default_rng(seed), robot.instant()
        frames, normal = [], rng.normal(size=(60, 2))
        for frame in robot.frames(0.0, 0.0, 200):
            seen = frame.detections
            normal = correlated(normal, rng.normal(size=(60, 2)), 0.1, 1.0)
            own, kept = normal[seen.ids - 100], rng.random(len(seen.ids)) >= gaps
            seen = TagDetections(
                seen.stamp,
                seen.ids[kept],
                (seen.range + own[:, 1] * seen.sigma_range)[kept],
                (seen.bearing + own[:, 0] * seen.sigma_bearing)[kept],
                seen.sigma_range[kept],
                seen.sigma_bearing[kept],
            )
            frames.append(dataclasses.replace(frame, detections=seen))
        solution = reduced(noise, (begin, tuple(frames), robot.instant()), KNOWN)
        p_AL, _, covariance = solution.keyframe.given(KNOWN.mean)
        values.append(nees((p_AL - robot.p_ML(solution.keyframe.ids)).ravel(), covariance[:-3, :-3]))
    assert 0.75 < np.mean(values) < 1.25


def test_consistent(drive, nees):
    values = []
    for seed in range(15):
        robot, arguments = simulate(drive, seed, 1.0)
        values.append(nees(*error(robot, reduced(*arguments).keyframe)))
    assert 0.85 < np.mean(values) < 1.15


def test_outliers_are_dropped_and_counted(drive):
    robot, (noise, (begin, frames, end), sheet) = simulate(drive, 3, 1.0)
    bad = [10, 30, 50]
    spoilt = list(frames)
    for i in bad:
        detections = frames[i].detections
        distance = detections.range.copy()
        distance[0] += 4.0
        spoilt[i] = dataclasses.replace(frames[i], detections=dataclasses.replace(detections, range=distance))
    clean = reduced(noise, (begin, frames, end), sheet)
    solution = reduced(noise, (begin, tuple(spoilt), end), sheet)
    assert left_out(frames, clean) == 0
    assert left_out(spoilt, solution) == len(bad)
    np.testing.assert_allclose(posterior(solution.keyframe)[1], posterior(clean.keyframe)[1], atol=5e-3)
    assert np.abs(error(robot, solution.keyframe)[0]).max() < 0.3


@pytest.mark.parametrize("steps", [0, STEPS])
def test_without_tags_odometry_remains(drive, steps):
    robot = drive(np.empty((0, 2)), 4, 0.0)
    begin, frames = robot.instant(), robot.frames(0.0, 1.0, steps)
    one = reduced(NOISE, (begin, frames, robot.instant()), SHEET).keyframe
    _, X_AD, _, covariance = posterior(one)
    assert len(one.ids) == 0
    np.testing.assert_allclose(X_AD, robot.X_MB, atol=1e-9)
    # A gyro scale error of 1 percent over a whole turn.
    assert steps == 0 or np.sqrt(covariance[2, 2]) == pytest.approx(0.0648, abs=2e-3)


def test_a_slip_during_the_turn_is_told_by_the_tags(drive):
    robot, (noise, (begin, frames, end), sheet) = simulate(drive, 5, 1.0)
    # From the middle on the robot slides half a metre to where it looked first, and the wheels know nothing of it.
    slide = 0.5 * np.clip(np.linspace(-2.0, 3.0, len(frames)), 0.0, 1.0)
    slid = []
    for frame, x in zip(frames, slide, strict=True):
        seen, theta = frame.detections, frame.stamp - begin.stamp
        d = seen.range[:, None] * np.stack([np.cos(seen.bearing), np.sin(seen.bearing)], axis=1)
        d = d - x * np.array([np.cos(theta), -np.sin(theta)])
        seen = dataclasses.replace(seen, range=np.hypot(*d.T), bearing=np.arctan2(d[:, 1], d[:, 0]))
        slid.append(dataclasses.replace(frame, detections=seen))
    solution = reduced(noise, (begin, tuple(slid), end), sheet)
    assert left_out(slid, solution) <= 2
    np.testing.assert_allclose(posterior(solution.keyframe)[1][:2] - robot.X_MB[:2], [0.5, 0.0], atol=0.05)
    assert np.abs(error(robot, solution.keyframe)[0]).max() < 0.3


def test_a_push_at_rest_is_told_by_the_tags(drive):
    robot = drive(np.random.default_rng(6).uniform(-8.0, 8.0, (60, 2)), 6, 1.0)
    begin, frames = robot.instant(), robot.frames(0.0, 0.0, 80)
    end = robot.instant()
    pushed = []
    for frame, x in zip(frames, 1.0 * np.clip(np.linspace(-2.0, 3.0, len(frames)), 0.0, 1.0), strict=True):
        seen = frame.detections
        d = seen.range[:, None] * np.stack([np.cos(seen.bearing), np.sin(seen.bearing)], axis=1) - [x, 0.0]
        seen = dataclasses.replace(seen, range=np.hypot(*d.T), bearing=np.arctan2(d[:, 1], d[:, 0]))
        # Standing, by its wheels: no time in which errors accrue, and no motion.
        clock = begin.clock + 1e-3 * (frame.stamp - begin.stamp)
        pushed.append(dataclasses.replace(frame, clock=clock, X_OB=begin.X_OB, detections=seen))
    end = dataclasses.replace(end, clock=begin.clock + 1e-3 * (end.stamp - begin.stamp), X_OB=begin.X_OB)
    solution = reduced(NOISE, (begin, tuple(pushed), end), SHEET)
    np.testing.assert_allclose(posterior(solution.keyframe)[1][:2], [1.0, 0.0], atol=0.05)


def sigma_of_heading(drive, standing, turns):
    """How well, rad, the tags tell the heading of A, from which the robot looks so long, s, before it turns."""
    robot = drive(np.random.default_rng(7).uniform(-8.0, 8.0, (30, 2)), 7, 1.0)
    begin = robot.instant()
    still = robot.frames(0.0, 0.0, 32 * standing)
    clock = [begin.clock + REST_SHARE * (frame.stamp - begin.stamp) for frame in still]
    still = tuple(dataclasses.replace(frame, clock=t, X_OB=begin.X_OB) for frame, t in zip(still, clock, strict=True))
    rest = still[-1].stamp - clock[-1]
    # From there on the clock runs, and the heading counts on from where the wheels stood.
    drift = robot.instant().X_OB[2] - begin.X_OB[2]
    moving = robot.frames(0.0, 1.0, STEPS * turns)
    moved = [*moving, robot.instant()]
    moved = [dataclasses.replace(f, clock=f.clock - rest, X_OB=f.X_OB - [0.0, 0.0, drift]) for f in moved]
    solution = reduced(NOISE, (begin, (*still, *moved[:-1]), moved[-1]), SHEET)
    assert left_out((*still, *moved), solution) <= 2
    p_AL, _, _, covariance = posterior(solution.keyframe)
    across = (p_AL[:, ::-1] * [-1.0, 1.0]).ravel()
    return 1 / np.sqrt(across @ np.linalg.solve(covariance[: p_AL.size, : p_AL.size], across))


def test_standing_tells_the_heading_that_turning_does_not(drive):
    short, long, turning = (sigma_of_heading(drive, *how) for how in ((4, 1), (16, 1), (4, 3)))
    assert long < 0.65 * short
    assert turning > 0.95 * short


def test_scans_that_see_nothing_in_common_lie_off_each_other_by_how_far_the_turn_is_known(drive):
    """Two of them, each off their mean by half of the error of the turn between them."""
    _, (noise, (begin, frames, end), _) = simulate(drive, 0, 0.0, tags=0)
    point = np.array([[1.0, 0.0, -1.0, 0.0]])
    first, last = frames[3], frames[-3]
    seen = tuple(dataclasses.replace(one, points=point) if one in (first, last) else one for one in frames)
    heading, span = np.unwrap([one.X_OB[2] for one in frames[3:-2]]), last.clock - first.clock
    turned = heading[-1] - heading[0]
    assert turned > np.pi
    found = {}
    for scale in (0.05, 1e-6):
        shared = by_data_sheet(OdometryConfig(gyro_scale=scale, gyro_bias=1e-6), EXACT)
        found[scale] = reduced(noise, (begin, seen, end), shared).keyframe
        expected = noise.walks[1] ** 2 * span + (scale * turned) ** 2
        assert found[scale].scatter[2, 2] == pytest.approx(0.25 * expected, rel=0.05)
    assert found[0.05].scatter[2, 2] > 2.0 * found[1e-6].scatter[2, 2]


def test_points_lie_where_a_scanner_that_sweeps_met_them_while_the_robot_turned():
    parameters, twist = np.zeros(SHARED), np.array([0.4, 1.2])
    parameters[SCANNER_YAW : SWEEP + 1] = yaw, ahead, left, clock, sweep = 0.1, 0.2, -0.05, 0.01, -0.016
    rng = np.random.default_rng(2)
    angle = rng.uniform(-math.pi, math.pi, 40)
    there = np.column_stack([rng.uniform(-6.0, 6.0, (40, 2)), np.cos(angle), np.sin(angle)])
    seen, bearing = there.copy(), np.zeros(40)
    for _ in range(20):
        # Where the robot was then, on its circle.
        turned = -(clock + sweep * bearing) * twist[1]
        X_BB = np.column_stack([np.sin(turned), 1.0 - np.cos(turned), turned]) * [*np.full(2, twist[0] / twist[1]), 1.0]
        back = se2.inverse(se2.compose(X_BB, np.array([ahead, left, yaw])))
        seen = moved_points(back, there)
        bearing = np.arctan2(seen[:, 1], seen[:, 0])
    found = in_body(seen, parameters, twist)
    # But for the bend of its way.
    np.testing.assert_allclose(found, there, atol=1e-3)
    at_once = moved_points(np.array([ahead, left, yaw]), seen)
    assert np.hypot(*(at_once - there)[:, :2].T).max() > 0.1
