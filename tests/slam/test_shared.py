"""The parameters that keyframes share: by data sheets, and as a drive tells them."""

import numpy as np
import pytest

from tests.slam.oracle import measured
from tests.slam.test_robustness import Tour
from tfg_drake.config import OdometryConfig, TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.geometry.visibility import cast_rays
from tfg_drake.messages import LaserScan, Odometry, TagDetections, replace
from tfg_drake.slam.estimator import (
    begin_turn,
    end_turn,
    finished_map,
    pose_estimate,
    process_detections,
    process_odometry,
    process_scan,
)
from tfg_drake.slam.estimator_state import initial_state
from tfg_drake.slam.scan_ranges import scan_information
from tfg_drake.slam.shared import (
    CAMERA_YAW,
    CLOCK,
    DISTANCE_SCALE,
    GYRO_BIAS,
    GYRO_SCALE,
    LEAST_SIGMA,
    LEVER_X,
    LEVER_Y,
    RANGE_SCALE,
    SHARED,
    Shared,
    by_data_sheet,
    exactly_known,
    seen_from_body,
)

SHEET = by_data_sheet(OdometryConfig(), TagSensorConfig())


def test_the_prior_is_what_the_data_sheets_say():
    odometry = OdometryConfig(distance_scale=0.1, gyro_bias=0.2, gyro_scale=0.3)
    sensor = TagSensorConfig(yaw_deviation=0.4, mount_deviation=0.5, clock_deviation=0.6, range_scale_deviation=0.7)
    prior = by_data_sheet(odometry, sensor)
    at = [DISTANCE_SCALE, GYRO_BIAS, GYRO_SCALE, CAMERA_YAW, LEVER_X, LEVER_Y, CLOCK, RANGE_SCALE]
    np.testing.assert_allclose(prior.sigma[at], [0.1, 0.2, 0.3, 0.4, 0.5, 0.5, 0.6, 0.7])
    assert not prior.mean.any()
    np.testing.assert_allclose(exactly_known().sigma, LEAST_SIGMA)
    np.testing.assert_allclose(exactly_known(np.eye(SHARED)[CLOCK]).sigma[CLOCK], 1.0)


def test_what_is_seen_from_the_body_lacks_scale_and_yaw():
    shared = np.zeros(SHARED)
    shared[[CAMERA_YAW, RANGE_SCALE]] = 0.1, 0.02
    point = np.array([[3.0, 1.0]])
    r, b = measured(np.zeros((1, 3)), point, shared, np.zeros((1, 2))).T
    one = np.ones(1)
    seen = seen_from_body(TagDetections(0.0, np.array([5]), r, b, one, one), Shared(shared, np.eye(SHARED)))
    np.testing.assert_allclose([seen.range[0], seen.bearing[0]], [np.hypot(3.0, 1.0), np.arctan2(1.0, 3.0)])


# A base has to speed up: between a frame's own instant and its stamp the twist hardly changes.
RATES = np.concatenate([np.zeros(20), np.linspace(0.0, 1.0, 16), np.ones(85), np.linspace(1.0, 0.0, 16), np.zeros(8)])


def camera(shared):
    """Detections by a camera with these parameters (13,), from those of an exact one; the lever arm is small."""

    def spoil(detections, _rng):
        ahead = np.column_stack([np.cos(detections.bearing), np.sin(detections.bearing)])
        p_CL = detections.range[:, None] * ahead - shared[[LEVER_X, LEVER_Y]]
        return replace(
            detections,
            stamp=detections.stamp + shared[CLOCK],
            range=(1.0 + shared[RANGE_SCALE]) * np.hypot(*p_CL.T),
            bearing=np.arctan2(p_CL[:, 1], p_CL[:, 0]) - shared[CAMERA_YAW],
        )

    return spoil


def drive_with(drive, seed, shared, prior=SHEET, turns=5):
    """The estimator after turns and legs of a robot with such a camera."""
    tour = Tour(drive, seed, period=2.0, spoil=camera(shared))
    tour.state = process_odometry(initial_state(tour.robot.config, 2.0, prior), tour.robot.odometry())
    for _ in range(turns):
        tour.state = begin_turn(tour.state, tour.robot.time)
        for rate in RATES:
            tour.move(0.0, rate, 1)
        tour.state = end_turn(tour.state, tour.robot.time)
        tour.leg()
    return tour, finished_map(tour.state)


@pytest.mark.parametrize(
    "sign", [pytest.param(0.0, marks=pytest.mark.slow), 1.0, pytest.param(-1.0, marks=pytest.mark.slow)]
)
def test_a_drive_tells_the_parameters(drive, sign):
    truth = np.zeros(SHARED)
    truth[CAMERA_YAW : CLOCK + 1] = sign * np.array([0.015, 0.006, -0.004, -0.06])
    tour, state = drive_with(drive, 3, truth)
    found = state.graph.shared
    truth[:3] = tour.robot.errors
    assert (found.sigma[[GYRO_BIAS, GYRO_SCALE, CAMERA_YAW, CLOCK]] < [8e-4, 3e-3, 0.01, 0.01]).all()
    assert (found.sigma[[LEVER_X, LEVER_Y]] < 0.0045).all()
    assert (np.abs(found.mean - truth) < 3.5 * found.sigma).all()


def test_without_a_scan_nothing_tells_the_scale_of_ranges(drive):
    """But distances, as well as odometry knows these: the map is as much too large as the ranges are too long."""
    truth = 0.02 * np.eye(SHARED)[RANGE_SCALE]
    _, state = drive_with(drive, 4, truth, turns=2)
    found = state.graph.shared
    assert found.sigma[RANGE_SCALE] > 0.6 * SHEET.sigma[RANGE_SCALE]
    assert abs(found.mean[RANGE_SCALE] - 0.02) < 3.0 * found.sigma[RANGE_SCALE]


def test_keyframes_are_reduced_where_the_parameters_have_been_found(drive):
    """They were first where these were believed to be, two deviations and a half from there."""
    truth = np.zeros(SHARED)
    truth[CAMERA_YAW:CLOCK] = 2.5 * SHEET.sigma[CAMERA_YAW:CLOCK] * [1, 1, -1]
    tour = Tour(drive, 5, spoil=camera(truth))
    tour.state = process_odometry(initial_state(tour.robot.config, 0.0, SHEET), tour.robot.odometry())
    for _ in range(2):
        tour.turn_round()
        tour.leg()
    state = tour.state
    assert abs(state.graph.shared.mean[CAMERA_YAW]) > SHEET.sigma[CAMERA_YAW]
    assert len(state.sources) == 3
    for source in state.sources:
        assert (np.abs(state.graph.shared.mean - source.shared.mean) < 0.7 * source.shared.sigma).all()


# A room of 12 m, with the robot in its middle.
SIDE = 6.0
WALLS = SIDE * np.array([[1, -1, 1, 1], [1, 1, -1, 1], [-1, 1, -1, -1], [-1, -1, 1, -1]], dtype=float)


def test_a_scan_tells_the_scale_of_ranges_and_each_pair_counts_once(drive):
    """Tags a centimetre before the walls, seen 1.5 percent too far away."""
    rng, truth = np.random.default_rng(1), 0.015 * np.eye(SHARED)[RANGE_SCALE]
    wall, along = rng.integers(0, 4, 40), rng.uniform(0.05, 0.95, 40)
    points = (WALLS[wall, :2] + along[:, None] * (WALLS[wall, 2:] - WALLS[wall, :2])) * (1.0 - 0.01 / SIDE)
    robot, spoil, angles = drive(points, 2, 1.0), camera(truth), np.linspace(-1.08, 1.08, 249)
    state = process_odometry(initial_state(robot.config, 0.0, SHEET), robot.odometry())
    for _ in range(2):
        state = begin_turn(state, robot.time)
        for speed, rate, steps in ((0.0, 1.0, 201), (0.4, 0.1, 80)):
            for _ in range(steps):
                for message in robot.step(speed, rate):
                    if isinstance(message, Odometry):
                        state = process_odometry(state, message)
                        continue
                    X = se2.compose(robot.X_WB, np.array([0.0, 0.0, rate * (message.stamp - robot.time)]))
                    ranges = cast_rays(WALLS, X[:2], angles + X[2], 12.0) + 0.015 * rng.normal(size=len(angles))
                    state = process_scan(state, LaserScan(message.stamp, angles, ranges, 12.0, 0.015))
                    state = process_detections(state, spoil(message, rng))
            if speed == 0.0:
                state = end_turn(state, robot.time)
                compared = state.ranges
    found = state.graph.shared
    assert state.ranges.pairs > 300
    assert found.sigma[RANGE_SCALE] < 0.005
    assert found.mean[RANGE_SCALE] == pytest.approx(0.015, abs=3.0 * found.sigma[RANGE_SCALE])
    told = np.linalg.inv(state.graph.prior.covariance) - np.linalg.inv(state.sheet.covariance)
    information, _ = scan_information(compared, state.noise.now.worth)
    np.testing.assert_allclose(told, information, atol=1e-6 * np.abs(information).max())


@pytest.mark.parametrize("seeds", [3, pytest.param(10, marks=pytest.mark.slow)])
def test_the_published_pose_is_as_uncertain_as_the_parameters_make_it(drive, seeds):
    """With cameras drawn from the data sheet, after one turn and a leg, and after another."""
    squared = []

    def judge(tour):
        pose = pose_estimate(tour.state)
        error = pose.X_MB - tour.robot.X_MB
        error[2] = se2.wrap_angle(error[2])
        squared.append(error @ np.linalg.solve(pose.covariance, error) / 3.0)

    for seed in range(seeds):
        shared = SHEET.sigma * np.random.default_rng(seed).normal(size=SHARED) * (np.arange(SHARED) != CLOCK)
        tour = Tour(drive, seed, spoil=camera(shared))
        tour.state = process_odometry(initial_state(tour.robot.config, 0.0, SHEET), tour.robot.odometry())
        for _ in range(2):
            tour.turn_round()
            tour.leg()
            judge(tour)
    # A mean of 10 times three squares has a standard deviation of 0.26, of three times 0.47.
    assert 0.4 < np.mean(squared[::2]) < 1.8
    assert 0.4 < np.mean(squared[1::2]) < 1.8
