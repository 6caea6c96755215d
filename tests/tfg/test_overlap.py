"""Which of two drifted surfaces stands is told by what ties them to the newest goal."""

import numpy as np
import pytest

from tfg_drake.messages import replace
from tfg_drake.slam.goal_graph import empty_map
from tfg_drake.tfg.overlap import distance_along_map

# Goals on the corners of a square of 4 m and a fifth beyond the first; landmarks in the middle and beside the fifth.
X_MA = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 4.0, 0.0], [0.0, 4.0, 0.0], [0.0, -1.0, 0.0]])
MAP = replace(empty_map(), X_MA=X_MA, ids=np.array([3, 7]), p_ML=np.array([[2.0, 2.0], [0.0, -2.0]]))
HALF = 2.0 * np.sqrt(2.0)


@pytest.mark.parametrize(
    ("seen", "goals", "expected"),
    [
        ([], [0, 1, 2, 3], [12.0, 8.0, 4.0, 0.0, np.inf]),
        ([(0, 3), (3, 3), (0, 3)], [0, 1, 2, 3], [2 * HALF, 8.0, 4.0, 0.0, np.inf]),
        ([(0, 3), (3, 3)], [0, 3], [2 * HALF, np.inf, np.inf, 0.0, np.inf]),
        ([(0, 7), (4, 7)], [0, 1, 2, 3, 4], [3.0, 7.0, 9.0, 5.0, 0.0]),
    ],
    ids=["one after the other", "across the square", "not one after the other", "round and across"],
)
def test_goals_are_as_far_as_what_ties_them_is_long(seen, goals, expected):
    goal, ids = np.array(seen, dtype=np.int64).reshape(-1, 2).T
    np.testing.assert_allclose(distance_along_map(goal, ids, np.array(goals), MAP), expected, rtol=1e-12)


def test_a_goal_where_another_ended_is_tied_to_it():
    twice = replace(MAP, X_MA=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [3.0, 0.0, 0.0]]))
    none = np.zeros(0, dtype=np.int64)
    np.testing.assert_allclose(distance_along_map(none, none, np.arange(3), twice), [3.0, 3.0, 0.0], atol=1e-8)
