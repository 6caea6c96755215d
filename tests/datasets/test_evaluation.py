"""Errors after alignment, and landmarks that contradict their truth."""

import math

import numpy as np
import pytest

from tfg_drake.datasets.evaluation import landmark_error, relative_error, robot_error, truth_at, wall_thickness
from tfg_drake.datasets.recording import GroundTruth
from tfg_drake.geometry import se2

X_MW = np.array([3.0, -2.0, 1.1])


def truth(n=9, seed=0):
    random = np.random.default_rng(seed)
    stamps = np.arange(50) * 0.1
    X_WB = np.column_stack([stamps, np.sin(stamps), np.cos(stamps)])
    return GroundTruth(stamps, X_WB, np.arange(n) + 6, random.uniform(-8, 8, (n, 2)))


def test_a_moved_estimate_without_error_has_none():
    given = truth()
    robot = robot_error(given, given.stamps, se2.compose(X_MW, given.X_WB))
    assert robot.rmse < 1e-12
    assert robot.compared == 50
    np.testing.assert_allclose(robot.X_WM, se2.inverse(X_MW))
    landmarks = landmark_error(given, given.ids, se2.transform(X_MW, given.p_WL))
    assert landmarks.rmse < 1e-12
    assert landmarks.rmse_without == landmarks.rmse
    assert landmarks.notes == ()


def test_estimates_outside_the_truth_or_in_a_gap_of_it_do_not_count():
    given = truth()
    keep = (given.stamps < 1.0) | (given.stamps > 3.0)
    given = GroundTruth(given.stamps[keep], given.X_WB[keep], given.ids, given.p_WL)
    stamps = np.array([-1.0, 0.5, 2.0, 3.5, 9.0])
    assert robot_error(given, stamps, np.zeros((5, 3))).compared == 2
    assert np.isnan(robot_error(given, stamps[:1], np.zeros((1, 3))).rmse)


def test_exchanged_labels_are_found():
    given = truth()
    swapped = given.p_WL.copy()
    swapped[[2, 5]] = swapped[[5, 2]]
    off = np.linalg.norm(given.p_WL[2] - given.p_WL[5])
    landmarks = landmark_error(given, given.ids, se2.transform(X_MW, swapped))
    assert landmarks.misfit_ids.tolist() == [8, 11]
    assert landmarks.notes == (
        f"landmarks 8 and 11 lie {off:.1f} m from the given truth: each where the other should be",
    )
    assert landmarks.rmse > 1.0
    assert landmarks.rmse_without < 1e-9


def test_a_single_misfit_is_found():
    given = truth()
    moved = given.p_WL.copy()
    moved[4] += (3.0, 0.0)
    landmarks = landmark_error(given, given.ids, moved)
    assert landmarks.notes == ("landmark 10 lies 3.0 m from the given truth",)


def test_where_no_majority_agrees_nobody_is_blamed():
    given = truth()
    landmarks = landmark_error(given, given.ids, truth(seed=1).p_WL)
    assert landmarks.misfit_ids.tolist() == []
    assert landmarks.rmse > 1.0


def test_nothing_to_compare_is_nan():
    given = truth()
    landmarks = landmark_error(given, np.array([99]), np.zeros((1, 2)))
    assert np.isnan(landmarks.rmse)
    assert landmarks.ids.tolist() == []


def test_walls_that_are_seen_twice_are_thick():
    x = np.linspace(0.0, 5.0, 500)
    one = np.column_stack([x, np.zeros(500)])
    assert wall_thickness(one) == pytest.approx(0.0, abs=1e-9)
    assert wall_thickness(np.vstack([one, one + np.array([0.0, 0.1])])) == pytest.approx(0.05, rel=0.02)
    assert math.isnan(wall_thickness(one[::100]))


def test_relative_errors_forget_where_the_map_lies():
    X_WS = np.column_stack([np.arange(50.0), np.zeros(50), np.zeros(50)])
    moved = se2.compose(np.array([3.0, -2.0, 2.5]), X_WS)
    assert max(*relative_error(X_WS, moved)[0].values(), *relative_error(X_WS, moved)[1].values()) < 1e-9
    longer = X_WS * [1.1, 1.0, 1.0]
    translation, rotation = relative_error(X_WS, longer)
    assert 0.5 < translation["mean"] < translation["worst_tenth"] <= 2.0 + 1e-9
    assert rotation["worst_tenth"] < 1e-9


def test_the_truth_is_interpolated_over_the_cut_of_the_heading():
    X_WB = np.array([[0.0, 0.0, 3.0], [1.0, 2.0, -3.0]])
    truth = GroundTruth(np.array([0.0, 1.0]), X_WB, np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
    np.testing.assert_allclose(truth_at(truth, np.array([0.5])), [[0.5, 1.0, math.pi]])
