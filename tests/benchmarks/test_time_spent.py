import numpy as np
import pytest

from benchmarks.time_spent import time_spent


def test_the_parts_are_those_of_a_mission_made_by_hand():
    # Stands for 2 s, turns for 1 s, drives 1 m in 4 s, then 1 m in 2 s.
    stamps = np.array([0.0, 2.0, 3.0, 7.0, 9.0])
    X_WB = np.array([[0.0, 0, 0], [0, 0, 0], [0, 0, 1.5], [0, 1, 1.5], [0, 2, 1.5]])
    spent = time_spent(stamps, X_WB, 0.5)
    assert (spent.standing, spent.turning) == (2.0, 1.0)
    assert (spent.slower, spent.driving) == pytest.approx((2.0, 4.0))
