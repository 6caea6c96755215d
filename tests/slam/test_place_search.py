"""A robot finds itself among the surfaces of the map, and does not where another place looks the same."""

import numpy as np
import pytest

from tfg_drake.geometry import se2
from tfg_drake.slam import place_search
from tfg_drake.slam.keyframe import moved_points
from tfg_drake.slam.place_search import BLUR, SAME, STEP, find_place, peaks, tells_place
from tfg_drake.slam.surface_fit import points_along

# Faces seen from their left: a room of 6 by 4 m with a niche, and beside it one of 5 by 3 m.
ROOM = [[0.0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 2, 4], [2, 4, 2, 3], [2, 3, 0, 3], [0, 3, 0, 0]]
OTHER = [[0.0, 0, 5, 0], [5, 0, 5, 3], [5, 3, 0, 3], [0, 3, 0, 0]]
TURNED = np.array([9.0, 1.0, 0.3])
HERE, AWAY = np.array([2.0, 1.5, 0.7]), np.array([8.0, 0.0, 1.2])


def surfaces(room, at=(0.0, 0.0, 0.0)):
    """Points with normals (p, 4) of a room."""
    return moved_points(np.array(at), points_along(np.array(room).reshape(-1, 2, 2)))


def seen(room, pose, noise=0.01, seed=0):
    """The same as seen from a pose, but for where walls end."""
    ends = np.array(room).reshape(-1, 2, 2)
    middle = ends.mean(axis=1, keepdims=True)
    points = moved_points(se2.inverse(pose), points_along(middle + 0.8 * (ends - middle)))
    points[:, :2] += np.random.default_rng(seed).normal(0.0, noise, (len(points), 2))
    return points


def both():
    return np.concatenate([surfaces(ROOM), surfaces(OTHER, TURNED)])


def off(X, pose):
    return np.abs(se2.between(pose, X))


@pytest.mark.parametrize("pose", [HERE, np.array([4.0, 2.0, -2.5]), np.array([0.5, 0.5, 3.0])])
def test_it_is_found_wherever_it_is(pose):
    found, here = find_place(both(), seen(ROOM, pose), AWAY)
    assert found is not None
    assert np.all(off(found, pose) < [0.02, 0.02, 0.01])
    assert here < 0.6


def test_where_nothing_is_mapped_nothing_is_found():
    known = surfaces(ROOM)
    assert find_place(known, seen([*OTHER[:3], [0.0, 3, 0, 2], [0, 2, 1, 2], [1, 2, 1, 0]], HERE), AWAY)[0] is None
    assert find_place(known[:0], seen(ROOM, HERE), AWAY) == (None, 0.0)
    assert find_place(known, np.zeros((0, 4)), AWAY) == (None, 0.0)


def test_of_two_equal_rooms_neither_is_believed():
    known = np.concatenate([surfaces(ROOM), surfaces(ROOM, TURNED)])
    assert find_place(known, seen(ROOM, HERE), AWAY)[0] is None


def test_a_room_that_looks_the_same_turned_round_is_not_believed():
    assert find_place(surfaces(OTHER), seen(OTHER, HERE), AWAY)[0] is None


def test_what_few_points_tell_is_not_believed_and_one_wall_tells_nothing():
    query = seen(ROOM, HERE)
    assert tells_place(query)
    assert not tells_place(query[::5])
    assert not tells_place(np.tile(seen(ROOM[:1], HERE), (3, 1)))
    assert find_place(both(), seen(ROOM[:2], HERE), AWAY)[0] is None  # A corner is anywhere.


def test_what_fits_the_expected_pose_is_told():
    """All of it, as far off as the pose may be; of a room of which half is mapped, so much."""
    known, query = surfaces(ROOM), seen(ROOM, HERE)
    for aside in (0.0, 0.9 * SAME[0]):
        assert find_place(known, query, HERE + np.array([aside, 0.0, 0.0]))[1] > 0.95
    found, half = find_place(surfaces(ROOM[:3]), query, HERE)
    length = np.hypot(*np.diff(np.array(ROOM).reshape(-1, 2, 2), axis=1)[:, 0].T)
    assert found is None
    assert half == pytest.approx(length[:3].sum() / length.sum(), abs=0.05)


def test_of_two_equal_rooms_the_one_is_believed_where_the_robot_may_have_drifted_to():
    known = np.concatenate([surfaces(ROOM), surfaces(ROOM, TURNED)])
    found, _ = find_place(known, seen(ROOM, HERE), HERE + np.array([0.7, -0.5, 0.1]))
    assert found is not None
    assert np.all(off(found, HERE) < [0.02, 0.02, 0.01])


def test_nobody_has_carried_it_through_the_whole_building():
    far = np.array([30.0, 0.0, 0.0])
    assert find_place(surfaces(ROOM), seen(ROOM, HERE), far)[0] is None
    assert find_place(surfaces(ROOM), seen(ROOM, HERE), far, anywhere=True)[0] is not None


def test_the_field_and_its_scores_are_those_of_the_nearest_points():
    rng = np.random.default_rng(0)
    points, query = rng.uniform(0.5, 3.5, (12, 2)), rng.uniform(0.5, 3.5, (7, 2))
    low, cells, side, turn = np.zeros(2), np.array([40, 40]), 0.1, 0.03
    field = place_search._field(points, low, cells, side)
    at = (np.arange(40) + 0.5) * side
    apart = np.hypot(at[None, :, None] - points[:, 0], at[:, None, None] - points[:, 1]).min(axis=2)
    near = apart < 2.5 * BLUR * side
    np.testing.assert_allclose(field[near], np.exp(-0.5 * (apart[near] / (BLUR * side)) ** 2))
    X = np.array([0.3, -0.2, 0.1])
    scores = place_search._scores(field, low, side, query, X, np.array([2, 1, 3]), turn)
    assert scores.shape == (7, 3, 5)
    for a, i, j in ((0, 0, 0), (3, 1, 2), (4, 2, 3)):
        p = se2.transform(X + np.array([(j - 2) * STEP * side, (i - 1) * STEP * side, (a - 3) * turn]), query)
        cell = np.floor(p / side).astype(int)
        inside = ((cell >= 0) & (cell < 40)).all(axis=1)
        assert scores[a, i, j] == pytest.approx(field[cell[inside, 1], cell[inside, 0]].sum() / len(query))


def test_peaks_are_apart_and_the_best_come_first():
    known, query = both()[:, :2], seen(ROOM, HERE)[:, :2]
    scores, poses = peaks(known, query, HERE + np.array([0.4, -0.3, 0.1]), np.array([2.0, 2.0, 0.5]))
    assert np.all(np.diff(scores) <= 0.0)
    assert scores[0] > 0.6
    assert np.all(off(poses[0], HERE) < [0.2, 0.2, 0.04])
    for k, pose in enumerate(poses):
        away = np.abs(poses[:k] - pose)
        assert np.all((away[:, :2] > 0.7).any(axis=1) | (away[:, 2] > 0.25))
