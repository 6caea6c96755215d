import numpy as np

from tfg_drake.diagrams.errors import _landmarks
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
        local=np.arange(4),
        covariance=0.01**2 * np.eye(11),
        landmark_covariance=np.tile(0.01**2 * np.eye(2), (4, 1, 1)),
        doubtful=np.array(doubtful, dtype=np.int64),
    )
    return _landmarks(WORLD, np.ones(3, dtype=bool), estimate, True)


def test_the_errors_are_those_of_landmarks_that_are_not_doubtful():
    sure, named = figures([]), figures([1, 7, 8])
    assert sure["landmarks_mapped"] == 3
    assert sure["landmarks_extra"] == 1
    assert sure["landmark_rmse_m"] > 2.0
    assert named["landmarks_mapped"] == 2
    assert named["landmarks_extra"] == 0
    np.testing.assert_allclose(named["landmark_rmse_m"], 0.01 / np.sqrt(2.0))
    np.testing.assert_allclose(named["landmark_anees"], 0.25)
    np.testing.assert_allclose(named["landmark_nees"], 0.25)


def test_before_the_first_goal_there_is_nothing():
    assert _landmarks(WORLD, np.ones(3, dtype=bool), None, True)["landmarks_mapped"] == 0
