import numpy as np

from tfg_drake.diagrams.missions.errors import _landmarks
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


def figures(doubtful, yaw_sigma=0.0):
    estimate = replace(
        empty_map(),
        ids=np.array([4, 7, 8, 9]),
        p_ML=np.array([[1.0, 0.01], [8.0, 0.0], [0.0, 0.0], [3.0, 2.0]]),
        local=np.arange(4),
        covariance=0.01**2 * np.eye(11),
        landmark_covariance=np.tile(0.01**2 * np.eye(2), (4, 1, 1)),
        doubtful=np.array(doubtful, dtype=np.int64),
    )
    return _landmarks(WORLD, np.ones(3, dtype=bool), estimate, True, np.zeros(3), yaw_sigma)


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


def test_an_uncertain_yaw_turns_the_map():
    sure, turned = (figures([7, 8], yaw_sigma) for yaw_sigma in (0.0, 0.01))
    assert turned["landmark_nees"] < sure["landmark_nees"]
    # A metre away that is as much as the deviation of tag 4, whose error lies along the turn.
    np.testing.assert_allclose(turned["landmark_anees"], 0.125, rtol=1e-3)


def test_before_the_first_view_there_is_nothing():
    assert _landmarks(WORLD, np.ones(3, dtype=bool), None, True, np.zeros(3), 0.0)["landmarks_mapped"] == 0
