"""The camera's yaw and clock: in one turn, and as a drive tells them."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.slam.test_robustness import Tour
from tfg_drake.config import TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import replace
from tfg_drake.slam.camera_model import camera_model
from tfg_drake.slam.estimator import begin_turn, end_turn, finished_map, pose_estimate, process_odometry
from tfg_drake.slam.estimator_state import initial_state, known_camera
from tfg_drake.slam.odometry_model import arc, odometry_model, predict_increment
from tfg_drake.slam.turn import solve_turn

YAW, OFFSET = 0.015, -0.06


def by_least_squares(model, camera, begin, frames, end):
    """Camera (2,), tags and last pose of a piece of the way, and their covariance, by a general solver."""
    ids = np.unique(np.concatenate([frame.detections.ids for frame in frames]))
    instants = [begin, *frames, end]
    increments = [arc(a.X_OB, b.X_OB) for a, b in itertools.pairwise(instants)]
    dt = [b.clock - a.clock for a, b in itertools.pairwise(instants)]
    t, root = len(instants), np.linalg.cholesky(np.linalg.inv(model.calibration_covariance)).T
    root_camera = np.linalg.cholesky(np.linalg.inv(camera.covariance)).T

    def residuals(x):
        calibration, (yaw, offset), p_AL = x[:3], x[3:5], x[5 : 5 + 2 * len(ids)].reshape(-1, 2)
        X_AB = np.vstack([np.zeros(3), x[5 + 2 * len(ids) :].reshape(-1, 3)])
        rows = [root @ (calibration - model.calibration), root_camera @ (x[3:5] - camera.mean)]
        for i in range(t - 1):
            moved, _, _ = predict_increment(increments[i], dt[i], calibration, model.noise)
            Q = predict_increment(increments[i], dt[i], np.zeros(3), model.noise)[2]
            moved = np.append(se2.rotation(-yaw) @ moved[:2], moved[2])
            error = se2.between(X_AB[i], X_AB[i + 1]) - moved
            rows.append(np.linalg.solve(np.linalg.cholesky(Q), error))
        for X, frame in zip(X_AB[1:-1], frames, strict=True):
            seen, late = frame.detections, offset - frame.offset
            ahead = np.array([np.cos(X[2]), np.sin(X[2])])
            then = np.append(X[:2] - late * frame.twist[0] * ahead, X[2] - late * frame.twist[1])
            p_BL = se2.transform(se2.inverse(then), p_AL[np.searchsorted(ids, seen.ids)])
            bearing = se2.wrap_angle(np.arctan2(p_BL[:, 1], p_BL[:, 0]) - seen.bearing)
            rows += [bearing / seen.sigma_bearing, (np.hypot(*p_BL.T) - seen.range) / seen.sigma_range]
        return np.concatenate(rows)

    X_AB = np.array([se2.between(begin.X_OB, one.X_OB) for one in instants])
    first = {}
    for X, frame in zip(X_AB[1:-1], frames, strict=True):
        seen = frame.detections
        for tag, r, b in zip(seen.ids.tolist(), seen.range, seen.bearing, strict=True):
            first.setdefault(tag, se2.transform(X, r * np.array([np.cos(b), np.sin(b)])))
    x = np.concatenate([model.calibration, camera.mean, *(first[tag] for tag in ids.tolist()), X_AB[1:].ravel()])
    found = least_squares(residuals, x, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return found.x, np.linalg.inv(found.jac.T @ found.jac)


def test_the_camera_is_an_unknown_of_a_turn(drive):
    robot = drive(np.random.default_rng(4).uniform(-6.0, 6.0, (9, 2)), 4, 1.0)
    camera = replace(camera_model(TagSensorConfig()), mean=np.array([0.01, 0.02]))
    begin, twist = robot.instant(), np.array([0.3, 0.4])
    frames = tuple(replace(one, twist=twist, offset=0.03) for one in robot.frames(*twist, 16)[1:])
    model, end = odometry_model(robot.config), robot.instant()
    solution = solve_turn(model, begin, frames, end, camera)
    assert solution.dropped == 0
    x, covariance = by_least_squares(model, camera, begin, frames, end)
    n = len(solution.observation.ids)
    np.testing.assert_allclose(solution.camera.mean, x[3:5], atol=1e-6)
    np.testing.assert_allclose(solution.camera.covariance, covariance[3:5, 3:5], rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(solution.observation.p_AL.ravel(), x[5 : 5 + 2 * n], atol=1e-5)
    # Given the yaw, and with what it changes.
    at = np.append(5 + np.arange(2 * n), len(x) - 3 + np.arange(3))
    on_yaw = covariance[at, 3] / covariance[3, 3]
    np.testing.assert_allclose(solution.observation.on_yaw, on_yaw, rtol=1e-2, atol=1e-3)
    given = covariance[np.ix_(at, at)] - covariance[3, 3] * np.outer(on_yaw, on_yaw)
    deviation = np.sqrt(np.diag(given))
    error = (solution.observation.covariance - given) / np.outer(deviation, deviation)
    assert np.abs(error).max() < 1e-2


@pytest.mark.parametrize(("yaw", "offset"), [(0.0, 0.0), (YAW, OFFSET)])
def test_a_drive_tells_yaw_and_clock(drive, yaw, offset):
    def otherwise(detections, _rng):
        return dataclasses.replace(detections, stamp=detections.stamp + offset, bearing=detections.bearing - yaw)

    tour = Tour(drive, 3, period=2.0, spoil=otherwise)
    start = initial_state(tour.robot.config, 2.0, camera_model(TagSensorConfig()))
    tour.state = process_odometry(start, tour.robot.odometry())
    # A base has to speed up: between a frame's own instant and its stamp the twist hardly changes.
    rates = np.concatenate(
        [np.zeros(20), np.linspace(0.0, 1.0, 16), np.ones(85), np.linspace(1.0, 0.0, 16), np.zeros(8)]
    )
    for _ in range(5):
        tour.state = begin_turn(tour.state, tour.robot.time)
        for rate in rates:
            tour.move(0.0, rate, 1)
        tour.state = end_turn(tour.state, tour.robot.time)
        tour.leg()
    camera = known_camera(finished_map(tour.state))
    assert camera.sigma[0] < 0.01
    assert camera.sigma[1] < 0.01
    assert (np.abs(camera.mean - [yaw, offset]) < 3.5 * camera.sigma).all()


def test_the_published_heading_is_as_uncertain_as_the_camera_s_yaw_makes_it(drive):
    """With yaws drawn from the data sheet. M's x axis is where the camera looked, so a yaw that is not known yet is an
    error of the body's heading in M."""
    sheet, squared = TagSensorConfig(), []

    def judge(tour, yaw):
        pose = pose_estimate(tour.state)
        error = se2.wrap_angle(pose.X_MB[2] - (tour.robot.X_MB[2] - yaw))
        squared.append(error**2 / pose.covariance[2, 2])

    for seed in range(20):
        yaw = np.random.default_rng(seed).normal(0.0, sheet.yaw_deviation)

        def seen_by_the_camera(seen, _rng, yaw=yaw):
            return dataclasses.replace(seen, bearing=seen.bearing - yaw)

        tour = Tour(drive, seed, spoil=seen_by_the_camera)
        start = initial_state(tour.robot.config, 0.0, camera_model(sheet))
        tour.state = process_odometry(start, tour.robot.odometry())
        tour.turn_round()
        judge(tour, yaw)  # nothing has told the yaw yet
        tour.leg()
        tour.turn_round()
        judge(tour, yaw)
    first, second = np.mean(squared[::2]), np.mean(squared[1::2])
    # A mean of 20 has a standard deviation of 0.32. Without the yaw's variance the first is 27.
    assert 0.3 < first < 2.0
    assert 0.3 < second < 2.0
