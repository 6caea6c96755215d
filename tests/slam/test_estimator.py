import copy

import numpy as np
import pytest

from tfg_drake.config import OdometryConfig, TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.messages import Odometry, replace
from tfg_drake.slam import estimator, map_solver, map_update
from tfg_drake.slam.estimator import (
    begin_turn,
    end_turn,
    finished_map,
    pose_estimate,
    process_detections,
    process_odometry,
)
from tfg_drake.slam.estimator_state import initial_state
from tfg_drake.slam.shared import CLOCK, SHARED, Shared, by_data_sheet

TURN = 201


def feed(state, message):
    return (process_odometry if isinstance(message, Odometry) else process_detections)(state, message)


def explore(drive, seed, noise, views=8, tags=80, check=None, order=lambda messages: messages, solver="dissection"):
    """Turns at places on a ring in a 20 x 20 m room; returns the robot and the estimator after the last."""
    points = np.random.default_rng(1000 + seed).uniform(-10.0, 10.0, (tags, 2))
    robot = drive(points, seed, noise, start=(6.0, 0.0, 0.5 * np.pi))
    state = process_odometry(initial_state(robot.config, solver=solver), robot.odometry())

    def move(state, speed, turn_rate, steps):
        for _ in range(steps):
            for message in order(robot.step(speed, turn_rate)):
                state = feed(state, message)
            if check is not None:
                check(robot, state)
        return state

    for view in range(views):
        if view > 0:
            state = move(state, 0.5, 0.5 / 6.0, int(6.0 * 2.0 * np.pi / 8.0 / 0.5 * 32.0))
        state = move(begin_turn(state, robot.time), 0.0, 1.0, TURN)
        state = end_turn(state, robot.time)
    return robot, state


def test_exact_without_noise(drive):
    def check(robot, state):
        error = pose_estimate(state).X_MB - robot.X_MB
        error[2] = se2.wrap_angle(error[2])
        assert np.abs(error).max() < 1e-6

    robot, state = explore(drive, 1, 0.0, views=2, tags=120, check=check)
    estimate = state.map
    assert estimate.stage == 2
    assert len(estimate.ids) > 60
    np.testing.assert_allclose(estimate.p_ML, robot.p_ML(estimate.ids), atol=1e-6)
    np.testing.assert_allclose(estimate.X_MD, robot.X_MB, atol=1e-6)
    assert estimate.observation.X_AB.shape[0] > 60


def test_gtsam_alone_comes_to_the_same_map(drive):
    expected, found = (
        finished_map(explore(drive, 3, 1.0, views=2, solver=solver)[1]) for solver in ("dissection", "gtsam")
    )
    assert (expected.graph.solver, found.graph.solver) == ("dissection", "gtsam")
    np.testing.assert_array_equal(found.map.ids, expected.map.ids)
    np.testing.assert_allclose(found.map.p_ML, expected.map.p_ML, atol=1e-6)
    np.testing.assert_allclose(found.map.X_MA, expected.map.X_MA, atol=1e-6)
    np.testing.assert_allclose(found.graph.shared.mean, expected.graph.shared.mean, atol=1e-6)
    deviation = np.sqrt(np.diag(expected.map.covariance))
    assert np.abs((found.map.covariance - expected.map.covariance) / np.outer(deviation, deviation)).max() < 1e-5


@pytest.mark.parametrize("spread", [25, None], ids=["some", "as many as there are"])
def test_once_all_is_explored_landmarks_all_over_a_large_map_are_known_jointly(drive, monkeypatch, spread):
    if spread is not None:
        monkeypatch.setattr(estimator, "SPREAD", spread)
    monkeypatch.setattr(estimator, "JOINT", 30)
    monkeypatch.setattr(map_update, "NEAREST", 20)
    monkeypatch.setitem(map_solver.solve.__kwdefaults__, "joint", 30)
    robot, state = explore(drive, 2, 1.0, views=3)
    state = begin_turn(state, robot.time)
    for _ in range(TURN):
        for message in robot.step(0.0, 1.0):
            state = feed(state, message)
    near, all_over = (end_turn(state, robot.time, explored=explored).map for explored in (False, True))
    assert len(near.local) < 55 <= len(all_over.local) <= len(all_over.ids)
    assert spread is not None or all_over.is_joint


@pytest.mark.parametrize(("seeds", "views"), [(2, 3), pytest.param(6, 5, marks=pytest.mark.slow)])
def test_consistent_with_the_systematic_errors_of_a_run(drive, nees, caplog, seeds, views):
    landmarks, poses, online = [], [], []

    def check(robot, state):
        if round(robot.time * 32.0) % 16 == 0:
            estimate = pose_estimate(state)
            error = estimate.X_MB - robot.X_MB
            error[2] = se2.wrap_angle(error[2])
            online.append(nees(error, estimate.covariance))

    for seed in range(seeds):
        robot, state = explore(drive, seed, 1.0, views=views, check=check)
        estimate = state.map
        assert "left out of the map" not in caplog.text
        landmarks.append(nees((estimate.p_ML - robot.p_ML(estimate.ids)).ravel(), estimate.covariance[:-3, :-3]))
        error = estimate.X_MD - robot.X_MB
        error[2] = se2.wrap_angle(error[2])
        poses.append(nees(error, estimate.covariance[-3:, -3:]))
        assert np.sqrt(np.mean((estimate.p_ML - robot.p_ML(estimate.ids)) ** 2)) < 0.05
    assert 0.8 < np.mean(landmarks) < 1.2
    # Three deviations of a mean of three squares a seed.
    assert np.mean(poses) < 1.0 + 3.0 * np.sqrt(2.0 / (3.0 * seeds))
    assert 0.3 < np.mean(online) < 1.6


def test_the_order_of_arrival_does_not_matter(drive):
    _, one = explore(drive, 2, 1.0, views=2)
    _, other = explore(drive, 2, 1.0, views=2, order=lambda messages: messages[::-1])
    np.testing.assert_array_equal(one.map.p_ML, other.map.p_ML)
    np.testing.assert_array_equal(one.map.covariance, other.map.covariance)


def test_old_messages_change_nothing_and_the_state_copies_for_free(drive):
    robot, state = explore(drive, 3, 1.0, views=1)
    assert process_odometry(state, Odometry(robot.time, np.ones(3), np.zeros(2))) is state
    frame = robot._frame(robot.X_WB, robot.time - 1.0)
    assert process_detections(state, frame) is state
    assert copy.deepcopy(state) is state


def test_odometry_alone_keeps_the_buffers_short(drive):
    robot = drive(np.empty((0, 2)), 5, 0.0)
    state = process_odometry(initial_state(robot.config), robot.odometry())
    for _ in range(200):
        state = process_odometry(state, robot.step(0.4, 0.2)[-1])
    assert len(state.odometry) < 12
    np.testing.assert_allclose(pose_estimate(state).X_MB, robot.X_MB, atol=1e-9)
    assert pose_estimate(state).stage == 0


def test_before_and_out_of_turn():
    state = initial_state(OdometryConfig())
    assert state.map is None
    np.testing.assert_array_equal(pose_estimate(state).X_MB, np.zeros(3))
    with pytest.raises(ValueError, match="before the first odometry message"):
        begin_turn(state, 0.0)
    with pytest.raises(ValueError, match="No turn is open"):
        end_turn(state, 0.0)
    state = begin_turn(process_odometry(state, Odometry(0.0, np.zeros(3), np.zeros(2))), 0.0)
    with pytest.raises(ValueError, match="A turn is open already"):
        begin_turn(state, 0.0)


def test_turns_with_tags_teach_the_gyro_for_turns_without(drive):
    robot, state = explore(drive, 3, 1.0, views=3)
    robot.tags = np.zeros((0, 2))
    before = pose_estimate(state)
    for _ in range(TURN):
        for message in robot.step(0.0, 1.0):
            state = feed(state, message)
    estimate = pose_estimate(state)
    # The prior alone leaves 0.06 rad a turn; the gyro's random walk 0.013 rad.
    assert robot.config.gyro_scale * 2.0 * np.pi > 0.06
    assert np.sqrt(estimate.covariance[2, 2] - before.covariance[2, 2]) < 0.02
    assert abs(se2.wrap_angle(estimate.X_MB[2] - robot.X_MB[2])) < 0.04


def first_look(drive, ahead, expected):
    """The estimator after a robot stood, turned round and stood again, seen by a camera whose clock is ahead, s; by
    so much it is expected to be."""
    points = np.random.default_rng(7).uniform(-8.0, 8.0, (40, 2))
    robot = drive(points, 5, 1.0)
    start = initial_state(robot.config, prior=camera_ahead(expected))
    state = begin_turn(process_odometry(start, robot.odometry()), 0.0)
    for turn_rate, steps in ((0.0, 64), (1.0, TURN), (0.0, 64)):
        for _ in range(steps):
            for message in robot.step(0.0, turn_rate):
                is_frame = not isinstance(message, Odometry)
                state = feed(state, replace(message, stamp=message.stamp + ahead) if is_frame else message)
    return robot, end_turn(state, robot.time)


def camera_ahead(offset):
    sheet = by_data_sheet(OdometryConfig(), TagSensorConfig())
    return Shared(offset * np.eye(SHARED)[CLOCK], sheet.covariance)


@pytest.mark.parametrize("ahead", [0.3, -0.2, -0.5])
def test_a_cameras_clock_that_is_far_off_is_found_in_the_first_turn(drive, caplog, ahead):
    """Even where it has all frames arrive too late to be taken in; and the state is that of one who knew it before."""
    robot, state = first_look(drive, ahead, 0.0)
    (line,) = [record.getMessage() for record in caplog.records if record.name == "tfg_drake.slam.sensors"]
    assert f"the camera's clock is {abs(ahead):.2f} s {'ahead of' if ahead > 0.0 else 'behind'} the base's" in line
    assert state.look is None
    assert state.offset == pytest.approx(ahead, abs=0.02)
    estimate = state.map
    assert len(estimate.ids) > 30
    assert np.hypot(*(estimate.p_ML - robot.p_ML(estimate.ids)).T).mean() < 0.05
    caplog.clear()
    _, knew = first_look(drive, ahead, ahead)
    assert not caplog.records
    np.testing.assert_allclose(knew.map.p_ML, estimate.p_ML, atol=1e-9)
    assert knew.stamp == state.stamp


def test_a_clock_that_is_a_little_off_is_learnt_as_ever(drive, caplog):
    _, state = first_look(drive, 0.05, 0.0)
    assert not caplog.records
    assert state.offset == pytest.approx(0.05, abs=0.02)
