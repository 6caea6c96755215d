"""Why a mission ends: what is left, and what of it keeps a mission from being complete."""

import numpy as np

from tfg_drake.config import TagSensorConfig
from tfg_drake.messages import Roadmap, replace
from tfg_drake.planning.mission_end import frontier_left, given_up_open, why_end
from tfg_drake.tfg.graph import empty_map


def lengths(not_worth=0.0, too_uncertain=0.0, shut=0.0, too_narrow=0.0, kept_out=0.0):
    return np.array([not_worth, too_uncertain, shut, too_narrow, kept_out])


def end(candidates=True, narrow=0.0, given_up=0.0, **left):
    return why_end(candidates, narrow, given_up, lengths(**left), 20.0)


def test_nothing_left_is_complete():
    assert end() == ("complete", "No place promises more than 20 nats.")
    assert end(candidates=False)[0] == "complete"


def test_gain_behind_a_passage_too_narrow_for_the_uncertainty_is_stuck():
    assert end(too_narrow=3.25, narrow=19.0)[0] == "complete"
    reason = "30.2 nats lie behind a passage too narrow for the uncertainty of the map."
    assert end(too_narrow=3.25, narrow=30.25) == ("stuck", reason)


def test_an_open_frontier_that_was_given_up_is_stuck():
    assert end(given_up=0.8) == ("stuck", "0.8 m of open frontier were tried again and again in vain.")


def test_how_much_is_left_of_what_does_not_matter_is_not_told_beside_the_openings():
    assert end(too_narrow=33.21, too_uncertain=1.2, shut=0.6, not_worth=7.1) == end()


def test_more_than_two_metres_behind_what_has_or_had_room_are_stuck():
    reason = "Frontier is left behind passages too narrow for the uncertainty of the map."
    assert end(too_uncertain=1.1, shut=1.0) == ("stuck", reason)
    assert end(too_uncertain=1.0, shut=1.1) == ("stuck", "Frontier is left behind a door that shut.")
    assert end(too_uncertain=2.1)[0] == end(shut=2.1)[0] == "stuck"
    assert end(too_uncertain=1.0, shut=1.0, too_narrow=50.0, not_worth=50.0)[0] == "complete"


def test_nowhere_to_go_is_stuck_where_much_is_left():
    reason = "The robot cannot reach any other place, and frontier is left."
    assert end(candidates=False, too_narrow=2.1) == ("stuck", reason)
    assert end(candidates=False, too_narrow=1.9)[0] == "complete"


ROOMS = 4  # A row of cells of 4 m, one node in each, a frontier of another length in front of each node.


def frontiers_seen(reachable, enterable, once_open, distance=4.0, seen=0.5, keep_out=None):
    """The frontier left in cells divided by walls, each with a node that is reachable, enterable or was once open.

    seen: how far (m) from each node free space was seen, sideways.
    """
    middles = distance * np.arange(ROOMS)
    walls = np.array([[x - distance / 2, -3.0, x - distance / 2, 3.0] for x in middles[1:]])
    frontiers = np.stack([middles, np.ones(ROOMS)], axis=1)
    tfg = replace(
        empty_map(),
        segments=walls,
        frontiers=frontiers,
        frontier_length=2.0 ** np.arange(ROOMS),
        frontier_normal=np.tile([0.0, -1.0], (ROOMS, 1)),
    )
    points = np.stack([middles, np.full(ROOMS, -0.5)], axis=1)
    corners = np.array([[-seen, -0.5], [seen, -0.5], [seen, 0.5], [-seen, 0.5]])
    tfg = replace(
        tfg,
        star_offsets=4 * np.arange(ROOMS + 1),
        star_vertices=(points[:, None] + corners).reshape(-1, 2),
        star_centers=points,
        keep_out=np.zeros((0, 4)) if keep_out is None else keep_out,
    )
    kinds = (np.array(kind, dtype=bool) for kind in (reachable, enterable, once_open))
    is_reachable, is_enterable, was_open = kinds
    none = np.zeros(ROOMS)
    edges, entry = np.zeros((0, 2), dtype=np.int64), np.arange(ROOMS)
    roadmap = Roadmap(1, points, edges, is_reachable, is_enterable, entry, none, none, once_open=was_open)
    return frontier_left(tfg, roadmap, TagSensorConfig(), radius=0.18)


def test_a_frontier_counts_by_the_place_that_sees_it():
    left = frontiers_seen([1, 0, 0, 0], [1, 1, 0, 0], [1, 1, 1, 0])
    np.testing.assert_array_equal(left, lengths(not_worth=1.0, too_uncertain=2.0, shut=4.0, too_narrow=8.0))


def test_behind_a_wall_that_may_have_been_mapped_twice_there_is_no_door():
    left = frontiers_seen([1, 0, 0, 0], [1, 0, 0, 0], [1, 1, 1, 0], distance=1.2)
    np.testing.assert_array_equal(left, lengths(not_worth=1.0, shut=4.0, too_narrow=10.0))


def test_a_beam_through_a_wall_that_is_narrower_than_the_robot_is_no_door():
    left = frontiers_seen([1, 0, 0, 0], [1, 0, 0, 0], [1, 1, 1, 0], seen=0.17)
    np.testing.assert_array_equal(left, lengths(not_worth=1.0, too_narrow=14.0))


def test_where_nothing_was_once_open_no_door_has_shut():
    np.testing.assert_array_equal(frontiers_seen([1, 0, 0, 0], [1, 1, 0, 0], []), lengths(1.0, 2.0, 0.0, 12.0))


NEED = 0.23


def given_up_behind(width: float, *walls: tuple[float, float, float, float]) -> float:
    """Length (m) that counts of a frontier given up, 0.35 m behind a gap of this width (m) in the line y = 0."""
    half = 0.5 * width
    tfg = replace(
        empty_map(),
        segments=np.array([[-3.0, 0.0, -half, 0.0], [half, 0.0, 3.0, 0.0], *walls]),
        given_up=np.array([[0.0, 0.35]]),
        given_up_length=np.array([0.6]),
        given_up_normal=np.array([[0.0, -1.0]]),
    )
    both = np.array([True, True])
    places = np.array([[0.2, -0.8], [2.0, -0.8]])
    roadmap = Roadmap(1, places, np.zeros((0, 2), dtype=np.int64), both, both, np.arange(2), np.zeros(2), np.zeros(2))
    return given_up_open(tfg, roadmap, NEED)


def test_a_frontier_given_up_counts_where_the_robot_fits_through():
    assert given_up_behind(1.0) == 0.6
    assert given_up_behind(0.4) == 0.0


def test_a_frontier_given_up_inside_a_hollow_obstacle_does_not_count():
    assert given_up_behind(1.0, (-0.5, 0.5, 0.5, 0.5)) == 0.0


def test_a_frontier_given_up_behind_a_wall_does_not_count():
    assert given_up_behind(1.0, (-3.0, -0.4, 3.0, -0.4)) == 0.0


def test_what_an_area_not_to_be_entered_keeps_the_robot_from_is_named_and_no_hindrance():
    masks = [1, 0, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]
    np.testing.assert_array_equal(frontiers_seen(*masks), lengths(not_worth=1.0, too_narrow=14.0))
    left = frontiers_seen(*masks, keep_out=np.array([[2.0, -3.0, 2.0, 3.0]]))
    np.testing.assert_array_equal(left, lengths(not_worth=1.0, kept_out=14.0))
    assert end(kept_out=14.0, not_worth=1.0)[0] == "complete"
