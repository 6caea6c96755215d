import numpy as np
import pytest

from tfg_drake.comparison.curves import Curve, averaged, band, coverage_curve, error_curves


def test_errors_of_a_trajectory_made_by_hand():
    true_stamps, truth = np.array([0.0, 2.0]), np.array([[0.0, 0.0, 3.1], [2.0, 0.0, -3.1]])
    stamps, estimate = np.array([0.0, 1.0]), np.array([[0.0, 0.5, 3.0], [1.3, 0.4, np.pi]])
    position, heading = error_curves(stamps, estimate, true_stamps, truth)
    np.testing.assert_allclose(position.y, [0.5, 0.5])
    np.testing.assert_allclose(heading.y, [0.1, 0.0], atol=1e-12)  # across the seam at pi


def line(n=41):
    return np.column_stack([np.linspace(0.0, 4.0, n), np.zeros(n), np.zeros(n)])


def test_what_is_ahead_and_within_range_is_seen():
    cells = np.array([[1.0, 0.0], [4.6, 0.0], [-1.0, 0.0], [9.0, 0.0], [2.0, 3.0]])
    curve = coverage_curve(line(), cells, np.zeros((0, 4)), 2.0, np.pi / 2)
    assert curve.x[[0, -1]] == pytest.approx([0.0, 4.0])
    assert curve.y[[0, -1]] == pytest.approx([0.2, 0.4])
    assert np.all(np.diff(curve.y) >= 0.0)
    first = curve.x[np.argmax(curve.y > 0.3)]
    assert 2.6 <= first <= 2.6 + 0.3


def test_walls_hide_until_they_are_passed():
    cells, wall = np.array([[1.0, 1.0]]), np.array([[-1.0, 0.5, 3.0, 0.5]])
    assert coverage_curve(line(), cells, wall, 5.0, 2 * np.pi).y[-1] == 0.0
    assert coverage_curve(line(), cells, wall[:, [0, 1, 0, 3]], 5.0, 2 * np.pi).y[-1] == 1.0


def test_a_turn_in_place_sees_all_round():
    turn = np.column_stack([np.zeros((80, 2)), np.linspace(0.0, 2 * np.pi, 80)])
    cells = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    curve = coverage_curve(turn, cells, np.zeros((0, 4)), 2.0, 1.0)
    assert (curve.y[0], curve.y[-1], curve.x[-1]) == (0.25, 1.0, 0.0)
    assert 20 <= len(curve.x) <= 30


def test_no_poses_or_no_cells_give_no_curve():
    assert len(coverage_curve(line()[:0], np.zeros((1, 2)), np.zeros((0, 4)), 1.0, 1.0).x) == 0
    assert len(coverage_curve(line(), np.zeros((0, 2)), np.zeros((0, 4)), 1.0, 1.0).x) == 0


def test_stretches_are_averaged():
    curve = averaged(Curve(np.array([0.0, 1.0, 2.0, 6.0]), np.array([1.0, 3.0, 5.0, 7.0])), 2.0)
    np.testing.assert_array_equal(curve.x, [1.0, 3.0, 7.0])
    np.testing.assert_array_equal(curve.y, [2.0, 5.0, 7.0])


def test_a_band_is_mean_and_range_of_the_runs_still_going():
    short, long = Curve(np.array([0.0, 2.0]), np.array([1.0, 1.0])), Curve(np.array([0.0, 4.0]), np.array([3.0, 7.0]))
    found = band([short, long], 1.0)
    np.testing.assert_allclose(found.x, [0, 1, 2, 3, 4])
    np.testing.assert_allclose(found.mean, [2, 2.5, 3, 6, 7])
    np.testing.assert_allclose(found.low, [1, 1, 1, 6, 7])
    np.testing.assert_allclose(found.high, [3, 4, 5, 6, 7])
    assert found.common == 2.0
    np.testing.assert_allclose(band([short, long], 1.0, hold=True).low, 1.0)
    assert band([Curve(np.zeros(0), np.zeros(0))], 1.0) is None
