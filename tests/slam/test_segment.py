import itertools

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, C, L

from tfg_drake.geometry import se2
from tfg_drake.slam import segment as segment_module
from tfg_drake.slam.odometry_factor import odometry_factor
from tfg_drake.slam.odometry_model import arc, odometry_model
from tfg_drake.slam.segment import segment_factor, start_segment, step_segment


def simulate(drive, seed, noise, steps=400, tags=60):
    points = np.random.default_rng(seed).uniform([-5.0, -8.0], [15.0, 8.0], (tags, 2))
    robot = drive(points, seed, noise)
    frames = (robot.instant(), *robot.frames(0.5, 0.3, steps // 2), *robot.frames(0.5, -0.3, steps // 2))
    return robot, (*frames, robot.instant())


def run(model, frames):
    segment = start_segment(model)
    for last, frame in itertools.pairwise(frames):
        increment = arc(last.X_OB, frame.X_OB)
        segment = step_segment(segment, model, increment, frame.stamp - last.stamp, frame.detections)
    return segment_factor(segment)


def test_exact_without_noise(drive):
    robot, frames = simulate(drive, 1, 0.0)
    X_DA, _ = run(odometry_model(robot.config), frames)
    np.testing.assert_allclose(X_DA, robot.X_MB, atol=1e-6)


def test_against_a_batch_with_flat_landmarks(drive, monkeypatch):
    monkeypatch.setattr(segment_module, "MEMORY", 1e9)
    robot, frames = simulate(drive, 2, 0.3, steps=128)
    model = odometry_model(robot.config)
    X_DA, covariance = run(model, frames)

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose2(B(0), gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-7)))
    calibration = gtsam.noiseModel.Diagonal.Sigmas(model.calibration_sigma.copy())
    graph.add(gtsam.PriorFactorVector(C(0), np.zeros(3), calibration))
    values.insert(C(0), np.zeros(3))
    for i, frame in enumerate(frames):
        values.insert(B(i), gtsam.Pose2(*se2.between(frames[0].X_OB, frame.X_OB)))
        detections = frame.detections
        if i > 0:
            dt = max(frame.stamp - frames[i - 1].stamp, 1e-9)
            increment = arc(frames[i - 1].X_OB, frame.X_OB)
            graph.add(odometry_factor(B(i - 1), B(i), C(0), increment, dt, model.noise))
        for j, tag in enumerate(detections.ids):
            noise = gtsam.noiseModel.Diagonal.Sigmas([detections.sigma_bearing[j], detections.sigma_range[j]])
            bearing = gtsam.Rot2.fromAngle(detections.bearing[j])
            graph.add(gtsam.BearingRangeFactor2D(B(i), L(int(tag)), bearing, detections.range[j], noise))
            if not values.exists(L(int(tag))):
                values.insert(L(int(tag)), robot.tags[tag - 100])
    values = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    last = len(frames) - 1
    pose = values.atPose2(B(last))
    R = np.eye(3)
    R[:2, :2] = se2.rotation(pose.theta())
    expected = R @ gtsam.Marginals(graph, values).marginalCovariance(B(last)) @ R.T
    sigma = np.sqrt(np.diag(expected))
    assert np.all(np.abs(X_DA - [pose.x(), pose.y(), pose.theta()]) < 0.1 * sigma)
    np.testing.assert_allclose(
        np.sqrt(np.linalg.eigvalsh(covariance)), np.sqrt(np.linalg.eigvalsh(expected)), rtol=0.05
    )


def test_consistent(drive, nees):
    values = []
    for seed in range(30):
        robot, frames = simulate(drive, seed, 1.0)
        X_DA, covariance = run(odometry_model(robot.config), frames)
        error = X_DA - robot.X_MB
        error[2] = se2.wrap_angle(error[2])
        values.append(nees(error, covariance))
    assert 0.65 < np.mean(values) < 1.4


def test_without_tags_odometry_remains(drive):
    robot, frames = simulate(drive, 3, 0.0, tags=0)
    X_DA, covariance = run(odometry_model(robot.config), frames)
    np.testing.assert_allclose(X_DA, robot.X_MB, atol=1e-9)
    assert np.sqrt(covariance[0, 0]) > 0.015 * robot.X_MB[0]
