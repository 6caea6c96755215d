import dataclasses

import gtsam
import numpy as np
import pytest
import scipy.linalg
from gtsam.symbol_shorthand import B, C, L

from tfg_drake.geometry import se2
from tfg_drake.slam.odometry_model import REST_SHARE, arc, odometry_model, predict_increment
from tfg_drake.slam.turn import solve_turn

STEPS = 201


def simulate(drive, seed, noise, tags=35):
    points = np.random.default_rng(seed).uniform(-8.0, 8.0, (tags, 2))
    robot = drive(points, seed, noise)
    begin = robot.instant()
    frames = robot.frames(0.0, 1.0, STEPS)
    return robot, (odometry_model(robot.config), begin, frames, robot.instant())


def error(robot, observation):
    """Of tags and heading of D: D's position is exact in this simulator, whose wheels never slip on the spot."""
    heading = se2.wrap_angle(observation.X_AD[2] - robot.X_MB[2])
    return np.append((observation.p_AL - robot.p_ML(observation.ids)).ravel(), heading)


def test_exact_without_noise(drive):
    robot, arguments = simulate(drive, 1, 0.0)
    solution = solve_turn(*arguments)
    observation = solution.observation
    assert solution.dropped == 0
    assert len(observation.ids) > 25
    np.testing.assert_allclose(observation.p_AL, robot.p_ML(observation.ids), atol=1e-6)
    np.testing.assert_allclose(observation.X_AD, robot.X_MB, atol=1e-6)
    assert observation.X_AB.shape == (len(observation.stamps), 3)
    np.testing.assert_allclose(observation.X_AB[:, 2], se2.wrap_angle(observation.stamps), atol=1e-6)
    assert np.all(np.diff(observation.stamps) > 0.0)


def odometry_factor(before, after, X_OB0, X_OB1, dt, noise):
    """An odometry increment on two Pose2 and the calibration C(0), as a GTSAM factor in Python."""
    increment = arc(X_OB0, X_OB1)
    W = np.linalg.inv(np.linalg.cholesky(predict_increment(increment, dt, np.zeros(3), noise)[2]))

    def error(_, values, jacobians):
        X = values.atPose2(before).between(values.atPose2(after))
        predicted, on_calibration, _ = predict_increment(increment, dt, values.atVector(C(0)), noise)
        if jacobians is not None:
            # GTSAM's poses move in their own frame.
            jacobians[0] = W @ np.array([[-1.0, 0.0, X.y()], [0.0, -1.0, -X.x()], [0.0, 0.0, -1.0]])
            jacobians[1] = W @ scipy.linalg.block_diag(X.rotation().matrix(), 1.0)
            jacobians[2] = -W @ on_calibration
        return W @ [X.x() - predicted[0], X.y() - predicted[1], se2.wrap_angle(X.theta() - predicted[2])]

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(3), [before, after, C(0)], error)


def by_gtsam(model, begin, frames, end):
    """Poses (t, 3), calibration, tags (n, 2) and the covariance of (tags, last pose), all in A, by a general solver."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose2(B(0), gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-9)))
    prior = gtsam.noiseModel.Gaussian.Covariance(model.calibration_covariance)
    graph.add(gtsam.PriorFactorVector(C(0), model.calibration, prior))
    values.insert(C(0), np.zeros(3))
    values.insert(B(0), gtsam.Pose2())
    last, at = begin, 0
    for frame in (*frames, end):
        if frame.stamp > last.stamp:
            graph.add(odometry_factor(B(at), B(at + 1), last.X_OB, frame.X_OB, frame.clock - last.clock, model.noise))
            values.insert(B(at + 1), gtsam.Pose2(*se2.between(begin.X_OB, frame.X_OB)))
            last, at = frame, at + 1
        seen = frame.detections
        for tag, r, b, *sigmas in zip(
            seen.ids, seen.range, seen.bearing, seen.sigma_bearing, seen.sigma_range, strict=True
        ):
            noise = gtsam.noiseModel.Diagonal.Sigmas(np.array(sigmas))
            graph.add(gtsam.BearingRangeFactor2D(B(at), L(int(tag)), gtsam.Rot2(b), r, noise))
            if not values.exists(L(int(tag))):
                where = values.atPose2(B(at)).transformFrom(r * np.array([np.cos(b), np.sin(b)]))
                values.insert(L(int(tag)), where)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-15)
    parameters.setAbsoluteErrorTol(1e-15)
    values = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    tags = [key for key in values.keys() if gtsam.symbolChr(key) == ord("l")]  # noqa: SIM118
    poses = [values.atPose2(B(i)) for i in range(at + 1)]
    covariance = gtsam.Marginals(graph, values).jointMarginalCovariance([*tags, B(at)]).fullMatrix()
    to_A = np.eye(len(covariance))
    to_A[-3:-1, -3:-1] = poses[-1].rotation().matrix()
    X_AB = np.array([[pose.x(), pose.y(), pose.theta()] for pose in poses])
    p_AL = np.array([values.atPoint2(key) for key in tags])
    return X_AB, values.atVector(C(0)), p_AL, to_A @ covariance @ to_A.T


@pytest.mark.parametrize(("speed", "turn_rate", "steps"), [(0.0, 1.0, STEPS), (0.4, 0.2, 64), (0.0, 0.0, 10)])
def test_the_optimum_and_its_covariance_are_those_of_a_general_solver(drive, speed, turn_rate, steps):
    robot = drive(np.random.default_rng(2).uniform(-8.0, 8.0, (35, 2)), 2, 1.0)
    arguments = odometry_model(robot.config), robot.instant(), robot.frames(speed, turn_rate, steps), robot.instant()
    solution = solve_turn(*arguments)
    assert solution.dropped == 0
    X_AB, calibration, p_AL, covariance = by_gtsam(*arguments)
    np.testing.assert_allclose(solution.observation.X_AB, X_AB, atol=1e-7)
    np.testing.assert_allclose(solution.calibration, calibration, atol=1e-7)
    np.testing.assert_allclose(solution.observation.p_AL, p_AL, atol=1e-7)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(
        solution.observation.covariance / np.outer(sigma, sigma), covariance / np.outer(sigma, sigma), atol=1e-6
    )


def test_consistent(drive, nees):
    values = []
    for seed in range(15):
        robot, arguments = simulate(drive, seed, 1.0)
        observation = solve_turn(*arguments).observation
        rows = np.append(np.arange(2 * len(observation.ids)), -1)
        values.append(nees(error(robot, observation), observation.covariance[np.ix_(rows, rows)]))
    assert 0.85 < np.mean(values) < 1.15


def test_outliers_are_dropped_and_counted(drive):
    robot, (model, begin, frames, end) = simulate(drive, 3, 1.0)
    bad = [10, 30, 50]
    spoilt = list(frames)
    for i in bad:
        detections = frames[i].detections
        distance = detections.range.copy()
        distance[0] += 4.0
        spoilt[i] = dataclasses.replace(frames[i], detections=dataclasses.replace(detections, range=distance))
    clean = solve_turn(model, begin, frames, end)
    solution = solve_turn(model, begin, tuple(spoilt), end)
    assert clean.dropped == 0
    assert solution.dropped == len(bad)
    np.testing.assert_allclose(solution.observation.X_AD, clean.observation.X_AD, atol=5e-3)
    assert np.abs(error(robot, solution.observation)).max() < 0.3


@pytest.mark.parametrize("steps", [0, STEPS])
def test_without_tags_odometry_remains(drive, steps):
    robot = drive(np.empty((0, 2)), 4, 0.0)
    begin, frames = robot.instant(), robot.frames(0.0, 1.0, steps)
    observation = solve_turn(odometry_model(robot.config), begin, frames, robot.instant()).observation
    assert len(observation.ids) == 0
    np.testing.assert_allclose(observation.X_AD, robot.X_MB, atol=1e-9)
    assert observation.covariance.shape == (3, 3)
    # A gyro scale error of 1 percent over a whole turn.
    assert steps == 0 or np.sqrt(observation.covariance[2, 2]) == pytest.approx(0.0648, abs=2e-3)


def test_a_slip_during_the_turn_is_told_by_the_tags(drive):
    robot, (model, begin, frames, end) = simulate(drive, 5, 1.0)
    # From the middle on the robot slides half a metre to where it looked first, and the wheels know nothing of it.
    slide = 0.5 * np.clip(np.linspace(-2.0, 3.0, len(frames)), 0.0, 1.0)
    slid = []
    for frame, x in zip(frames, slide, strict=True):
        seen, theta = frame.detections, frame.stamp - begin.stamp
        d = seen.range[:, None] * np.stack([np.cos(seen.bearing), np.sin(seen.bearing)], axis=1)
        d = d - x * np.array([np.cos(theta), -np.sin(theta)])
        seen = dataclasses.replace(seen, range=np.hypot(*d.T), bearing=np.arctan2(d[:, 1], d[:, 0]))
        slid.append(dataclasses.replace(frame, detections=seen))
    solution = solve_turn(model, begin, tuple(slid), end)
    assert solution.dropped <= 2
    np.testing.assert_allclose(solution.observation.X_AD[:2] - robot.X_MB[:2], [0.5, 0.0], atol=0.05)
    assert np.abs(error(robot, solution.observation)).max() < 0.3


def test_a_push_at_rest_is_told_by_the_tags(drive):
    robot = drive(np.random.default_rng(6).uniform(-8.0, 8.0, (60, 2)), 6, 1.0)
    model, begin, frames = odometry_model(robot.config), robot.instant(), robot.frames(0.0, 0.0, 80)
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
    solution = solve_turn(model, begin, tuple(pushed), end)
    np.testing.assert_allclose(solution.observation.X_AD[:2], [1.0, 0.0], atol=0.05)


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
    solution = solve_turn(odometry_model(robot.config), begin, (*still, *moved[:-1]), moved[-1])
    assert solution.dropped <= 2
    n = len(solution.observation.ids)
    across = (solution.observation.p_AL[:, ::-1] * [-1.0, 1.0]).ravel()
    return 1 / np.sqrt(across @ np.linalg.solve(solution.observation.covariance[: 2 * n, : 2 * n], across))


def test_standing_tells_the_heading_that_turning_does_not(drive):
    short, long, turning = (sigma_of_heading(drive, *how) for how in ((4, 1), (16, 1), (4, 3)))
    assert long < 0.65 * short
    assert turning > 0.95 * short
