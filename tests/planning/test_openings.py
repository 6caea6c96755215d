"""Openings of a free space drawn by hand: where each is, how wide, and what keeps the robot from it."""

import numpy as np
import pytest

from tfg_drake.config import RobotConfig, TagSensorConfig
from tfg_drake.messages import Roadmap, replace
from tfg_drake.planning.openings import (
    BEHIND_DOOR,
    CELL,
    IN_VAIN,
    KEPT_OUT,
    NOT_WORTH,
    REACH,
    TOO_NARROW,
    TOO_UNCERTAIN,
    find_openings,
    with_seen_before,
)
from tfg_drake.tfg.graph import empty_map

HERE = np.array([2.0, 1.5])
RADIUS = RobotConfig().radius


def room(gap, *walls, **fields):
    """A room of 4 x 3 m, seen as a whole, with a gap (m) in the middle of the wall at x = 4, and as much of a corridor
    behind it as is seen through: 0.5 m."""
    low, high = 1.5 - 0.5 * gap, 1.5 + 0.5 * gap
    segments = [(0, 0, 4, 0), (4, 0, 4, low), (4, high, 4, 3), (4, 3, 0, 3), (0, 3, 0, 0)]
    segments += [(4, low, 4.5, low), (4, high, 4.5, high), *walls]
    star = [(0, 0), (4, 0), (4, low), (4.5, low), (4.5, high), (4, high), (4, 3), (0, 3)]
    tfg = replace(
        empty_map(),
        segments=np.array(segments, dtype=float),
        star_offsets=np.array([0, len(star)]),
        star_vertices=np.array(star, dtype=float),
        star_centers=HERE[None],
    )
    return replace(tfg, **fields)


def found(tfg, sigma_need=0.23, **masks):
    points = np.array([[2.0, 1.5], [4.25, 1.5]])
    all_of, none = np.ones(2, dtype=bool), np.zeros(2)
    edges = np.zeros((0, 2), dtype=np.int64)
    need = np.full(2, sigma_need)
    roadmap = Roadmap(1, points, edges, all_of, all_of, np.arange(2), none, none, need=need)
    return find_openings(tfg, replace(roadmap, **masks), HERE, RobotConfig(), TagSensorConfig())


def test_a_room_without_a_gap_has_no_opening():
    assert len(found(room(0.0)).p) == 0


def test_an_opening_has_its_place_and_width():
    openings = found(room(1.0))
    np.testing.assert_allclose(openings.p, [[4.5, 1.5]], atol=2 * CELL)
    np.testing.assert_allclose(openings.width, [1.0], atol=2 * CELL)
    assert openings.why.tolist() == [NOT_WORTH]
    assert openings.missing.tolist() == [0.0]


def test_what_an_earlier_session_has_seen_is_not_open():
    """A closet behind the corridor, with a post where the newer session has seen free space."""
    closet = np.array([[4.4, 0.5], [6.0, 0.5], [6.0, 2.5], [4.4, 2.5]])
    sides = np.vstack([np.hstack([closet[:-1], closet[1:]]), [[4.4, 0.5, 4.4, 1.0], [4.4, 2.0, 4.4, 2.5]]])
    post = np.array([[1.0, 1.0, 1.2, 1.0]])
    before = room(0.0, star_offsets=np.array([0, 4]), star_vertices=closet, segments=np.vstack([sides, post]))
    kinds = {"segment_kind": np.zeros(6, dtype=np.int64), "segment_ids": np.zeros((6, 2), dtype=np.int64)}
    both = with_seen_before(room(1.0), replace(before, **kinds))
    assert len(found(both).p) == 0
    assert not (both.segments == post).all(axis=1).any()
    assert len(both.segments) == len(room(1.0).segments) + len(sides)


@pytest.mark.parametrize("gap", [0.25, 0.3, 0.4])
def test_what_is_too_narrow_lacks_the_room_between_its_sides(gap):
    openings = found(room(gap))
    assert openings.why.tolist() == [TOO_NARROW]
    np.testing.assert_allclose(openings.missing, [0.23 - 0.5 * gap], atol=0.03)


def test_a_robot_that_knows_its_place_badly_lacks_more():
    assert found(room(0.54), 0.26).why.tolist() == [NOT_WORTH]
    openings = found(room(0.54), 0.30)
    assert openings.why.tolist() == [TOO_UNCERTAIN]
    np.testing.assert_allclose(openings.missing, [0.30 - 0.27], atol=0.03)


def test_what_is_narrow_on_the_way_counts_however_wide_the_opening():
    posts = [(3.0, 0.0, 3.0, 1.3), (3.0, 1.7, 3.0, 3.0)]
    openings = found(room(1.0, *posts))
    assert openings.why.tolist() == [TOO_NARROW]
    np.testing.assert_allclose(openings.missing, [0.23 - 0.2], atol=0.03)


def test_an_area_that_must_not_be_entered_is_told_from_a_narrow_place():
    area = np.array([[3.0, 0.0, 3.0, 3.0]])
    assert found(room(1.0, keep_out=area)).why.tolist() == [KEPT_OUT]
    assert found(room(0.3, keep_out=area)).why.tolist() == [TOO_NARROW]


def test_what_was_tried_in_vain_is_told():
    given_up = {"given_up": np.array([[4.8, 1.5]]), "given_up_length": np.ones(1), "given_up_normal": np.eye(2)[:1]}
    assert found(room(1.0, **given_up)).why.tolist() == [IN_VAIN]
    elsewhere = given_up | {"given_up": np.array([[1.0, 1.5]])}
    assert found(room(1.0, **elsewhere)).why.tolist() == [NOT_WORTH]


def test_behind_a_door_that_shut():
    frontier = {
        "frontiers": np.array([[4.8, 1.5]]),
        "frontier_length": np.ones(1),
        "frontier_normal": np.array([[-1.0, 0.0]]),
    }
    door = (3.0, 0.0, 3.0, 3.0)
    masks = {"reachable": np.array([True, False]), "enterable": np.array([True, False])}
    shut = found(room(1.0, door, **frontier), once_open=np.array([True, True]), **masks)
    assert shut.why.tolist() == [BEHIND_DOOR]
    assert found(room(1.0, door, **frontier), **masks).why.tolist() == [TOO_NARROW]


@pytest.mark.parametrize(("depth", "area"), [(2.0, 4.0), (1.0, 2.0), (0.3, 0.0)])
def test_the_unknown_behind_ends_at_known_walls(depth, area):
    """A closet 2 m wide behind the corridor, of which the three other walls are known."""
    x = 4.5 + depth
    closet = [(4.5, 0.5, x, 0.5), (x, 0.5, x, 2.5), (x, 2.5, 4.5, 2.5), (4.5, 0.5, 4.5, 1.0), (4.5, 2.0, 4.5, 2.5)]
    unknown = found(room(1.0, *closet)).unknown
    # A disc leaves the corners out.
    np.testing.assert_allclose(unknown, [area], atol=0.25 * area + 1e-9)


def test_the_unknown_is_looked_at_within_reach_only():
    unknown = found(room(1.0)).unknown[0]
    assert 0.4 * (2 * REACH) ** 2 < unknown < (2 * REACH + 0.5) ** 2
