import math

import numpy as np
import pytest

from tests.diagrams.rooms import room
from tests.walls import no_walls
from tfg_drake.diagrams.missions.errors import driven, landmark_figures, online_pose_anees, path_length
from tfg_drake.diagrams.missions.mission import Mission, MissionRequest
from tfg_drake.geometry.se2 import rotation
from tfg_drake.messages import replace
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.world.world import World

WORLD = World(
    walls=np.zeros((0, 4)),
    tag_ids=np.array([4, 7, 9]),
    p_WT=np.array([[1.0, 0.0], [3.0, 0.0], [3.0, 2.0]]),
    tag_facing=np.full(3, np.pi / 2),
    start=np.zeros(3),
)


def figures(doubtful):
    estimate = replace(
        empty_map(),
        ids=np.array([4, 7, 8, 9]),
        p_ML=np.array([[1.0, 0.01], [8.0, 0.0], [0.0, 0.0], [3.0, 2.0]]),
        **no_walls(4),
        local=np.arange(4),
        covariance=0.01**2 * np.eye(11),
        landmark_covariance=np.tile(0.01**2 * np.eye(2), (4, 1, 1)),
        doubtful=np.array(doubtful, dtype=np.int64),
    )
    return landmark_figures(WORLD, np.ones(3, dtype=bool), estimate, True, np.zeros(3))


def test_the_errors_are_those_of_landmarks_that_are_not_doubtful():
    sure, named = figures([]), figures([1, 7, 8])
    assert sure["landmarks_mapped"] == 3
    assert sure["landmarks_extra"] == 1
    assert sure["landmark_rmse_m"] > 2.0
    assert sure["landmark_error_max_m"] == 5.0
    assert named["landmarks_mapped"] == 2
    assert named["landmarks_extra"] == 0
    np.testing.assert_allclose(named["landmark_rmse_m"], 0.01 / np.sqrt(2.0))
    np.testing.assert_allclose(named["landmark_anees"], 0.25)
    np.testing.assert_allclose(named["landmark_nees"], 0.25)


def test_where_the_estimate_jumps_nothing_is_driven():
    stamps = np.arange(5) / 16.0
    X_WB = np.array([[0.0, 0, 0], [0.03, 0, 0], [6.2, 1, 0], [6.2, 1.03, 1], [6.2, 1.06, 1]])
    np.testing.assert_allclose(driven(stamps, X_WB), 0.09)
    np.testing.assert_allclose(driven(2.5 * np.arange(5), X_WB), path_length(X_WB))  # There was time for it.


def test_before_the_first_view_there_is_nothing():
    assert landmark_figures(WORLD, np.ones(3, dtype=bool), None, True, np.zeros(3))["landmarks_mapped"] == 0


def test_the_online_poses_are_judged_by_what_was_said_then():
    """Against the definition, pose by pose: a place in the true M is one seen from where the robot started."""
    rng, n, X_WS = np.random.default_rng(3), 40, np.array([2.0, -1.0, 2.5])
    X_WB, error = rng.uniform(-3.0, 3.0, (n, 3)), rng.normal(size=(n, 3)) * [0.03, 0.05, 0.02]
    roots = rng.normal(size=(n, 3, 3)) * 0.05
    covariance = roots @ roots.transpose(0, 2, 1)
    X_MB, expected = np.empty((n, 3)), []
    for i in range(n):
        p_MB = rotation(X_WS[2]).T @ (X_WB[i, :2] - X_WS[:2])
        X_MB[i] = np.append(p_MB, X_WB[i, 2] - X_WS[2]) + error[i]
        expected.append(error[i] @ np.linalg.inv(covariance[i]) @ error[i] / 3.0)
    X_MB[::2, 2] += 2.0 * np.pi
    assert online_pose_anees(X_MB, covariance, X_WB, X_WS) == pytest.approx(np.mean(expected))
    # At the start the pose is known exactly: there is nothing to judge.
    X_MB[0], covariance[0] = np.zeros(3), np.zeros((3, 3))
    assert online_pose_anees(X_MB, covariance, X_WB, X_WS) == pytest.approx(np.mean(expected[1:]))
    assert math.isnan(online_pose_anees(X_MB[:1], covariance[:1], X_WB[:1], X_WS))


def test_poses_are_logged_with_their_covariance_once_a_second():
    mission, seen = Mission(MissionRequest(room())), []
    mission.begin()
    while mission.time < 8.0:
        seen.append(mission.pose)
        mission.advance(mission.time + 1.0)
    stamps, X_MB, covariance = mission.published_poses()
    seen = [pose for i, pose in enumerate(seen) if i == 0 or pose.stamp > seen[i - 1].stamp]
    assert len(stamps) == len(seen) + 1  # the one at the end was not looked at
    for i, pose in enumerate(seen):
        np.testing.assert_array_equal(np.append(stamps[i], X_MB[i]), np.append(pose.stamp, pose.X_MB))
        np.testing.assert_array_equal(covariance[i], pose.covariance)
    assert np.diff(stamps).max() < 1.1
