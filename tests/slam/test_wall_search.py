"""A robot finds itself among the walls of the map, and does not where another place looks the same."""

import numpy as np
import pytest

from tfg_drake.geometry import se2
from tfg_drake.slam.wall_search import SAME, find_place, refined

# Faces seen from their left: a room of 6 by 4 m with a niche, and beside it one of 5 by 3 m.
ROOM = [[0.0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 2, 4], [2, 4, 2, 3], [2, 3, 0, 3], [0, 3, 0, 0]]
OTHER = [[0.0, 0, 5, 0], [5, 0, 5, 3], [5, 3, 0, 3], [0, 3, 0, 0]]
TURNED = np.array([9.0, 1.0, 0.3])
HERE, AWAY = np.array([2.0, 1.5, 0.7]), np.array([8.0, 0.0, 1.2])


def walls(room, at=(0.0, 0.0, 0.0)):
    return se2.transform(np.array(at), np.array(room).reshape(-1, 2)).reshape(-1, 2, 2)


def seen(of, pose):
    """Walls (n, 2, 2) as they are seen from a pose, each but for its ends."""
    middle = of.mean(axis=1, keepdims=True)
    part = middle + 0.8 * (of - middle)
    return se2.transform(se2.inverse(pose), part.reshape(-1, 2)).reshape(-1, 2, 2)


def both():
    return np.concatenate([walls(ROOM), walls(OTHER, TURNED)])


@pytest.mark.parametrize("pose", [HERE, np.array([4.0, 2.0, -2.5]), np.array([0.5, 0.5, 3.0])])
def test_exact_without_noise(pose):
    found, here = find_place(seen(walls(ROOM), pose), both(), AWAY)
    assert found is not None
    np.testing.assert_allclose(se2.between(pose, found), 0.0, atol=1e-9)
    assert here < 0.3


def test_noise_moves_the_pose_by_as_much():
    rng = np.random.default_rng(0)
    noisy = seen(walls(ROOM), HERE) + rng.normal(0.0, 0.01, (6, 2, 2))
    found, _ = find_place(noisy, both(), AWAY)
    assert found is not None
    assert np.abs(se2.between(HERE, found)).max() < 0.02


def test_where_nothing_is_mapped_nothing_is_found():
    known = walls(ROOM)
    assert find_place(seen(walls(OTHER), HERE), known, AWAY)[0] is None
    assert find_place(seen(known, HERE), known[:0], AWAY) == (None, 0.0)
    assert find_place(np.zeros((0, 2, 2)), known, AWAY) == (None, 0.0)


def test_of_two_equal_rooms_neither_is_believed():
    known = np.concatenate([walls(ROOM), walls(ROOM, TURNED)])
    assert find_place(seen(walls(ROOM), HERE), known, AWAY)[0] is None


def test_a_room_that_looks_the_same_turned_round_is_not_believed():
    known = walls(OTHER)
    assert find_place(seen(known, HERE), known, AWAY)[0] is None


def test_what_few_walls_tell_is_not_believed():
    """A corner is anywhere."""
    assert find_place(seen(walls(ROOM)[:2], HERE), both(), AWAY)[0] is None


def test_what_fits_the_expected_pose_is_told():
    """All of it, as far off as the pose may be; of a room of which half is mapped, so much."""
    known = walls(ROOM)
    of = seen(known, HERE)
    length = np.hypot(*(of[:, 1] - of[:, 0]).T)
    for aside in (0.0, 0.9 * SAME[0]):
        assert find_place(of, known, HERE + np.array([aside, 0.0, 0.0]))[1] == pytest.approx(1.0)
    found, half = find_place(of, known[:3], HERE)
    assert found is None
    assert half == pytest.approx(length[:3].sum() / length.sum())


def test_of_two_equal_rooms_the_one_is_believed_where_the_robot_may_have_drifted_to():
    known = np.concatenate([walls(ROOM), walls(ROOM, TURNED)])
    drifted = HERE + np.array([0.7, -0.5, 0.1])
    found, here = find_place(seen(walls(ROOM), HERE), known, drifted)
    assert found is not None
    np.testing.assert_allclose(se2.between(HERE, found), 0.0, atol=1e-9)
    assert here < 0.5


def test_nobody_has_carried_it_through_the_whole_building():
    far = np.array([30.0, 0.0, 0.0])
    assert find_place(seen(walls(ROOM), HERE), walls(ROOM), far)[0] is None


def test_a_rough_pose_is_refined_by_all_walls():
    known = both()
    found = refined(HERE + 0.02, seen(known, HERE), known)
    np.testing.assert_allclose(found, HERE, atol=1e-9)
