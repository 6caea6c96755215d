"""A robot finds itself among the surfaces of the map, and does not where another place looks the same."""

import numpy as np
import pytest

from tfg_drake.geometry import se2
from tfg_drake.slam import place_search
from tfg_drake.slam.keyframe import moved_points
from tfg_drake.slam.place_search import (
    BLUR,
    LONG,
    SHORT,
    STEP,
    WRONG,
    Places,
    Prior,
    find_places,
    fits_near,
    is_straight,
    log_odds,
    no_places,
    nothing_seen,
    peaks,
    seen_from,
    tells_place,
)
from tfg_drake.slam.surface_fit import points_along, thinned

# Faces seen from their left: a room of 6 by 4 m with a niche, and beside it one of 5 by 3 m.
ROOM = [[0.0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 2, 4], [2, 4, 2, 3], [2, 3, 0, 3], [0, 3, 0, 0]]
OTHER = [[0.0, 0, 5, 0], [5, 0, 5, 3], [5, 3, 0, 3], [0, 3, 0, 0]]
TURNED = np.array([9.0, 1.0, 0.3])
HERE, AWAY = np.array([2.0, 1.5, 0.7]), np.array([8.0, 0.0, 1.2])
# Where the rooms were mapped from.
EYES = np.array([[2.0, 1.5], [4.5, 2.0], [11.0, 3.0]])


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


def places(known, query, prior=None):
    return find_places(seen_from(EYES, known), nothing_seen().with_look(query, np.zeros(3)), prior)


@pytest.mark.parametrize("pose", [HERE, np.array([4.0, 2.0, -2.5]), np.array([0.5, 0.5, 3.0])])
def test_it_is_found_wherever_it_is(pose):
    """By one room most likely, by two surely."""
    there = places(both(), seen(ROOM, pose))
    assert there.found() is None
    assert there.near(pose) > 0.95
    assert there.near(AWAY) < 1e-3
    assert there.probability.sum() <= 1.0
    both_seen = np.vstack([seen(ROOM, pose), moved_points(se2.between(pose, TURNED), seen(OTHER, np.zeros(3)))])
    there = places(both(), both_seen)
    assert np.all(off(there.found(), pose) < [0.02, 0.02, 0.01])
    assert there.near(pose) > 1.0 - WRONG


def test_where_nothing_is_mapped_nothing_is_found():
    known = surfaces(ROOM)
    assert places(known, seen([*OTHER[:3], [0.0, 3, 0, 2], [0, 2, 1, 2], [1, 2, 1, 0]], HERE)).found() is None
    assert not len(places(known[:0], seen(ROOM, HERE)).X)
    assert not len(places(known, np.zeros((0, 4))).X)


def test_two_equal_rooms_are_as_likely():
    known = np.concatenate([surfaces(ROOM), surfaces(ROOM, TURNED)])
    there = places(known, seen(ROOM, HERE))
    assert there.found() is None
    np.testing.assert_allclose(there.probability[:2], 0.5, atol=0.2)
    assert there.near(HERE) + there.near(se2.compose(TURNED, HERE)) > 0.97


def test_a_room_that_looks_the_same_turned_round_is_not_believed():
    assert places(surfaces(OTHER), seen(OTHER, HERE)).found() is None


def test_what_few_points_tell_is_not_believed_and_one_wall_tells_nothing():
    query = seen(ROOM, HERE)
    assert tells_place(query)
    assert not tells_place(query[::5])
    assert not tells_place(np.tile(seen(ROOM[:1], HERE), (3, 1)))
    assert places(both(), seen(ROOM[:2], HERE)).found() is None  # A corner is anywhere.


def test_what_is_looked_through_speaks_against_a_place():
    """A room of which one wall is not where the map has it, but farther off; or before it."""
    longer = [[0.0, 0, 8, 0], [8, 0, 8, 4], [8, 4, 2, 4], *ROOM[3:]]
    for there, here in ((ROOM, longer), (longer, ROOM)):
        assert places(surfaces(there), seen(here, HERE)).near(HERE) < 0.7
        assert places(surfaces(here), seen(here, HERE)).near(HERE) > 0.95


def test_where_the_map_ends_what_is_seen_beyond_hardly_matters():
    """It bears little on which place it is, and nothing on whether one is contradicted."""
    known = seen_from(EYES, both())
    beyond = surfaces([[20.0 + 4.0 * k, 30, 23 + 4.0 * k, 30] for k in range(30)])
    seen_now = seen_from(EYES, np.vstack([known.points, beyond]))
    assert log_odds(known, seen_now) == pytest.approx(log_odds(known, known))
    for most, is_growing in ((place_search.MOST_BEYOND, False), (place_search.GROWING, True)):
        assert place_search._beyond(np.array([0.0, 90.0]), is_growing=is_growing).tolist() == [0.0, most]


def test_in_an_unfinished_map_a_place_does_not_win_by_being_mapped_better():
    """A room that is mapped for the most part beside an equal one that is mapped whole."""
    most = moved_points(TURNED, points_along(np.array(ROOM).reshape(-1, 2, 2)[:4]))
    known, here = seen_from(EYES, np.vstack([surfaces(ROOM), most])), se2.compose(TURNED, HERE)
    look = nothing_seen().with_look(seen(ROOM, HERE), np.zeros(3))
    finished, growing = (find_places(known, look, None, here[None], is_growing=one) for one in (False, True))
    assert growing.near(here) > 2.0 * finished.near(here)
    assert growing.probability.sum() <= 1.0


def test_what_either_has_looked_through_speaks_against_a_place_if_it_is_straight():
    """A wall across the room, seen by one of the two, and posts as wide together, which may be people."""
    across = surfaces([[3.0, 3.5, 3.0, 0.5]])
    posts = np.vstack([surfaces([[3.0, 0.5 + y, 3.0, 0.2 + y]]) for y in (0.0, 0.8, 1.6, 2.4)])
    room, eye = surfaces(ROOM), np.array([[4.5, 2.0]])
    bare = seen_from(eye, room)
    agrees = log_odds(bare, bare)
    for more, least, most in ((across, 3.0, 8.0), (posts, -0.1, 1.0)):
        with_more = seen_from(eye, np.vstack([room, more]))
        for known, seen_now in ((bare, with_more), (with_more, bare)):
            assert least < agrees - log_odds(known, seen_now) < most


def test_what_others_of_its_own_eyes_have_looked_through_does_not_stay():
    """Somebody stood in the room when it was seen first."""
    room, somebody = surfaces(ROOM), surfaces([[3.0, 2.0, 3.0, 1.4]])
    first = nothing_seen().with_look(np.vstack([room, somebody]) - [4.5, 2.0, 0.0, 0.0], np.array([4.5, 2.0, 0.0]))
    both_looks = first.with_look(room - [4.5, 1.7, 0.0, 0.0], np.array([4.5, 1.7, 0.0]))
    at_somebody = [np.count_nonzero(np.abs(look.staying()[:, 0] - 3.0) < 0.05) for look in (first, both_looks)]
    assert at_somebody[0] >= 3
    assert at_somebody[1] <= 1  # An edge, perhaps.
    np.testing.assert_array_equal(both_looks.depth, [first.depth[0], place_search.nearest(both_looks.eyes[1], room)])


@pytest.mark.parametrize(
    ("moved", "fits"), [((0.3, 0.4, 0.1), True), ((0.0, 0.0, 1.57), False), ((0.0, 2.0, 0.0), False)]
)
def test_a_corridor_tells_whether_the_robot_may_have_drifted(moved, fits):
    """Its walls do not tell a place, but that a robot turned by 90 degrees, or that stands in its wall, was carried."""
    corridor, here = [[0.0, 0.0, 12.0, 0.0], [12.0, 2.0, 0.0, 2.0]], np.array([6.0, 1.0, 0.0])
    known = seen_from(np.array([[3.0, 1.0], [9.0, 1.0]]), surfaces(corridor))
    walls = nothing_seen().with_look(seen([[3.0, 0.0, 9.0, 0.0], [9.0, 2.0, 3.0, 2.0]], here), np.zeros(3))
    assert not tells_place(walls.points)
    assert fits_near(known, walls, here + np.array(moved), np.array([1.5, 1.5, 0.5])) == fits
    assert not fits_near(nothing_seen(), walls, here, np.array([1.5, 1.5, 0.5]))


@pytest.mark.parametrize("least", [SHORT, LONG])
def test_straight_is_what_goes_on_in_line(least):
    angle = np.arange(0.0, 2.0 * np.pi, 0.2)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.cos(angle), np.sin(angle)]) * [0.3, 0.3, 1.0, 1.0]
    wall, leg = thinned(surfaces([[0.0, 0.0, 3.0, 0.0]])), thinned(ring)
    assert is_straight(wall, least).all()
    assert is_straight(thinned(surfaces([[0.0, 0.0, least + 0.3, 0.0]])), least).any()
    assert not is_straight(leg, least).any()
    assert not is_straight(thinned(surfaces([[0.0, 0.0, least - 0.3, 0.0]])), least).any()
    assert is_straight(np.zeros((0, 4)), least).shape == (0,)


def test_a_person_who_shuffles_is_not_straight_however_often_it_is_seen():
    """Half a metre of body, seen twelve times, each time two centimetres farther."""
    body = surfaces([[0.0, 0.0, 0.0, 0.5]])
    often = np.vstack([thinned(body + np.array([0.015 * k, 0.02 * k, 0.0, 0.0])) for k in range(12)])
    assert not is_straight(often, LONG).any()
    once = thinned(surfaces([[0.0, 0.0, 0.0, 1.5]]))
    np.testing.assert_array_equal(is_straight(np.vstack([once, once]), LONG)[: len(once)], is_straight(once, LONG))


def test_of_two_equal_rooms_the_one_is_believed_where_the_robot_is_thought_to_be():
    known = np.concatenate([surfaces(ROOM), surfaces(ROOM, TURNED)])
    prior = Prior(HERE + np.array([0.7, -0.5, 0.1]), np.array([0.5, 0.5, 0.2]), -12.0)
    there = places(known, seen(ROOM, HERE), prior)
    assert np.all(off(there.X[0], HERE) < [0.02, 0.02, 0.01])
    assert there.near(HERE) > 0.95
    # But not where what is seen contradicts it.
    elsewhere = places(surfaces(ROOM), seen(ROOM, HERE), prior._replace(X=AWAY, elsewhere=-1.0))
    assert np.all(off(elsewhere.X[0], HERE) < [0.02, 0.02, 0.01])


def test_it_has_rather_not_been_carried_far():
    """A metre farther is less likely, in a frame in which the robot is not at the origin, too."""
    far = np.array([30.0, 0.0, 0.0])
    known, query = surfaces(ROOM), nothing_seen().with_look(seen(ROOM, HERE), np.zeros(3))
    mapped = seen_from(EYES, known)
    told, none = (find_places(mapped, query, Prior(far, np.zeros(3), 0.0, a_metre)).near(HERE) for a_metre in (0, -1))
    assert told > 0.9
    assert none < 1e-6
    at = np.array([1.0, -2.0, 0.5])
    prior = Prior(far, np.array([0.5, 0.5, 0.2]), -1.0, -0.3, at)
    X = np.array([HERE, se2.compose(far, se2.inverse(at))])
    apart = np.hypot(*(se2.compose(HERE, at) - far)[:2])
    np.testing.assert_allclose(prior.log(X), [-1.0 - 0.3 * apart, 0.0], atol=1e-9)
    np.testing.assert_allclose(prior.of_frame, X[1], atol=1e-9)


def test_what_is_nearest_by_bearing_is_that_of_every_point():
    rng = np.random.default_rng(1)
    points = surfaces(ROOM)
    eye = np.array([2.0, 1.5])
    found = place_search.nearest(eye, points)
    # A ray from inside meets the room there; of one cell of bearing the nearest counts.
    for bearing in rng.uniform(-np.pi, np.pi, 50):
        k = int((bearing + np.pi) / (2.0 * np.pi) * place_search.BEARINGS)
        off_points = points[:, :2] - eye
        angle = np.arctan2(off_points[:, 1], off_points[:, 0])
        apart = np.abs(se2.wrap_angle(angle - (k + 0.5) * 2.0 * np.pi / place_search.BEARINGS + np.pi))
        near = np.hypot(*off_points[apart < 0.05].T)
        assert near.min() - 0.1 < found[k] < near.max() + 0.1


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


@pytest.mark.parametrize(
    ("probability", "may_be"), [([0.497, 0.497], True), ([0.7, 0.3], False), ([0.35, 0.25], True), ([0.0, 1.0], True)]
)
def test_it_may_be_where_no_other_place_is_twice_as_probable(probability, may_be):
    """Of a corridor's two places, alike, either may be the right one."""
    X = np.array([[1.0, 0.0, 0.0], [2.2, 0.0, np.pi]])
    found = Places(X, np.array(probability), np.ones(2, dtype=bool))
    assert found.may_be(np.array([2.21, 0.01, -np.pi + 0.01]), np.array([0.05, 0.05, 0.02])) is may_be
    assert not found.may_be(np.array([1.6, 0.0, 0.0]), np.array([0.05, 0.05, 0.02]))
    assert not no_places().may_be(np.zeros(3), np.ones(3))


def test_peaks_are_apart_and_the_best_come_first():
    known, query = both()[:, :2], seen(ROOM, HERE)[:, :2]
    scores, poses = peaks(known, query, HERE + np.array([0.4, -0.3, 0.1]), np.array([2.0, 2.0, 0.5]))
    assert np.all(np.diff(scores) <= 0.0)
    assert scores[0] > 0.6
    assert np.all(off(poses[0], HERE) < [0.2, 0.2, 0.04])
    for k, pose in enumerate(poses):
        away = np.abs(poses[:k] - pose)
        assert np.all((away[:, :2] > 0.7).any(axis=1) | (away[:, 2] > 0.25))
