import math

import numpy as np
import pytest

from tfg_drake.config import ExplorerConfig, GridConfig, OdometryConfig, RobotConfig, ScanConfig
from tfg_drake.grid.frontier import FREE, OCCUPIED, UNKNOWN
from tfg_drake.grid.frontier_goal import no_tries
from tfg_drake.grid.weighted_goal import _look_round, choose, grid_gain, log_variance, pose_gain, predicted_covariance
from tfg_drake.messages import GridMap, PoseEstimate


def pose_of(covariance, x=2.0, y=2.5):
    X_MB = np.array([x, y, 0.0])
    return PoseEstimate(0.0, X_MB, covariance, np.zeros(2), 1, np.zeros(0, dtype=np.int64), np.zeros((0, 2)))


def test_the_unknown_in_view_of_a_lone_robot_is_a_disc():
    cells = np.full((81, 81), UNKNOWN, dtype=np.uint8)
    area, information = _look_round(cells, np.zeros((2, 81, 81)), np.array([[40.5, 40.5]]), 30.0, 180)
    assert area[0] == pytest.approx(math.pi * 30.0**2, rel=0.01)
    assert (information == 0.0).all()
    np.testing.assert_allclose(grid_gain(np.array([2.0])), 2.0 * math.log(2.0))


def test_a_wall_hides_what_is_behind_it_and_says_how_far_it_is():
    cells = np.full((81, 81), FREE, dtype=np.uint8)
    cells[:, 60:] = UNKNOWN
    cells[:, 60] = OCCUPIED
    slope = np.zeros((2, 81, 81))
    slope[1] = 1.0
    area, information = _look_round(cells, slope, np.array([[40.5, 40.5]]), 30.0, 360)
    assert area[0] == 0.0
    # A plane wall ahead tells x and, by the incidence, the heading, but nothing along itself.
    assert information[0, 0, 0] > 0.0
    assert information[0, 1, 1] == 0.0
    assert information[0, 2, 2] > 0.0
    assert abs(information[0, 0, 2]) < 0.1 * math.sqrt(information[0, 0, 0] * information[0, 2, 2])


def test_information_about_the_pose_is_that_of_gaussians():
    prior, known = np.diag([4.0, 1.0, 0.25])[None], np.diag([0.75, 3.0, 0.0])[None]
    # Variances 4, 1, 1/4 become 1, 1/4, 1/4.
    assert log_variance(prior, known)[0] == pytest.approx(math.log(1.0 / 16.0), abs=1e-5)
    before = log_variance(prior, np.zeros((1, 3, 3)))
    assert pose_gain(before, log_variance(prior, known))[0] == pytest.approx(math.log(4.0), abs=1e-6)
    assert pose_gain(log_variance(prior, known), before)[0] == 0.0


def test_an_uncertain_heading_spreads_sideways_on_the_way():
    still = OdometryConfig(distance_noise=0.0, distance_scale=0.0, gyro_noise=0.0, gyro_bias=0.0)
    pose = pose_of(np.diag([0.0, 0.0, 0.01]))
    (covariance,) = predicted_covariance(pose, pose.X_MB[None, :2] + [5.0, 0.0], np.array([5.0]), 0.5, still)
    np.testing.assert_allclose(covariance, [[0, 0, 0], [0, 0.25, 0.05], [0, 0.05, 0.01]], atol=1e-12)


def world():
    """A room of 12 m by 3 m; at its right end a wide door to the unknown, at its left a narrow one."""
    probability = np.full((100, 280), 0.5, dtype=np.float32)
    probability[20:80, 20:260] = 0.9
    probability[22:78, 22:258] = 0.1
    probability[30:70, 258:260] = 0.1
    probability[45:56, 20:22] = 0.1
    return GridMap(4, 0.0, 0.05, np.zeros(2), probability)


def chosen(weights, pose, tried=None, grid=None):
    everything = OdometryConfig(), ScanConfig(), RobotConfig(), ExplorerConfig(), weights
    return choose(grid or world(), pose, no_tries() if tried is None else tried, *everything)


def test_the_weights_decide_between_map_and_pose():
    pose = pose_of(np.diag([0.1, 0.1, 0.01]), 7.0, 2.5)
    choice, _ = chosen(GridConfig(weight_map=1.0, weight_pose=0.0), pose)
    assert choice.verdict == "goal"
    assert (choice.exploitation == 0.0).all()
    np.testing.assert_allclose(choice.gain, choice.exploration)
    choice, _ = chosen(GridConfig(weight_map=0.0, weight_pose=1.0), pose)
    assert (choice.exploration == 0.0).all()
    assert choice.value.max() > 0.0
    np.testing.assert_allclose(choice.gain, choice.exploitation)


def test_as_printed_the_largest_sum_is_the_goal_however_far():
    pose = pose_of(np.diag([0.1, 0.1, 0.01]), 2.0, 2.5)
    soon, _ = chosen(GridConfig(), pose)
    printed, _ = chosen(GridConfig(per_time=False), pose)
    np.testing.assert_array_equal(printed.value, printed.gain)
    assert printed.value.max() == soon.gain.max()
    assert np.hypot(*(printed.p_MG - pose.X_MB[:2])) > np.hypot(*(soon.p_MG - pose.X_MB[:2]))


def test_the_same_stop_rule():
    closed = world().probability.copy()
    closed[20:80, 258:260] = closed[20:80, 20:22] = 0.9
    choice, _ = chosen(GridConfig(), pose_of(np.eye(3)), grid=GridMap(4, 0.0, 0.05, np.zeros(2), closed))
    assert (choice.verdict, choice.reason) == ("complete", "No frontier is left.")


def test_even_for_the_pose_alone_it_comes_to_an_end():
    tried, places = no_tries(), 0
    while places < 200:
        choice, tried = chosen(GridConfig(weight_map=0.0), pose_of(np.eye(3)), tried)
        if choice.verdict != "goal":
            break
        places += 1
    assert choice.verdict == "stuck"
