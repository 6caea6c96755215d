"""Who stands where free ground was seen does not enter the map, but what stays does; who was there first leaves it when
seen past."""

import copy

import numpy as np
import pytest

from tfg_drake.comparison.metrics import surface_coverage, surface_phantom
from tfg_drake.geometry.star import inside_any
from tfg_drake.tfg.passing import STAYS
from tfg_drake.world.reachability import cut_walls


def somebody(x, y, radius=0.25):
    """A person's outline, walls (16, 4)."""
    angle = np.linspace(0.0, 2.0 * np.pi, 17)
    p = np.array([x, y]) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.hstack([p[:-1], p[1:]])


@pytest.fixture(params=["tags", "walls"])
def rooms(two_rooms, request):
    """Known by the tags in it, or by its outer walls alone."""
    two_rooms.building = two_rooms.walls
    if request.param == "walls":
        two_rooms.landmarks = two_rooms.walls[:4]
        two_rooms.p_WT, two_rooms.normal = np.zeros((2, 0, 2))
    return two_rooms


def look(rooms, pose, *people, stamp=0.0, **options):
    rooms.walls, rooms.stamp = np.vstack([rooms.building, *people]), stamp
    return rooms.observe(np.array(pose), **options)


def test_who_comes_after_a_place_was_seen_is_not_mapped_and_hides_nothing(rooms):
    look(rooms, [1.5, 3.0, 0.0])
    alone = look(copy.deepcopy(rooms), [2.5, 3.0, 0.5], glance=True)
    among = look(rooms, [2.5, 3.0, 0.5], somebody(4.0, 3.2), somebody(3.0, 1.5), glance=True)
    assert surface_phantom(among.segments, rooms.building) == 0.0
    assert among.frontier_length.sum() < alone.frontier_length.sum() + 0.2
    # What they hide was mapped before, and stays.
    assert surface_coverage(cut_walls(alone.segments)[0], among.segments) > 0.99


def test_who_was_there_first_is_mapped_until_seen_past(rooms):
    first = look(rooms, [1.5, 3.0, 0.0], somebody(4.0, 3.2))
    assert surface_phantom(first.segments, rooms.building) > 0.3
    second = look(rooms, [2.5, 2.0, 0.5])
    assert surface_phantom(second.segments, rooms.building) == 0.0


def test_what_is_beyond_somebody_is_still_to_be_seen(rooms):
    first = look(rooms, [1.5, 3.0, 0.0], somebody(2.2, 3.0))
    assert np.hypot(*(first.frontiers - [4.0, 3.0]).T).min() < 1.5


def test_a_wall_is_no_passer_by_however_often_it_is_seen(rooms):
    for pose in ([1.5, 3.0, 0.0], [5.0, 3.0, 0.0], [7.5, 3.0, 1.0], [10.5, 3.0, 2.0], [7.0, 1.0, 0.0]):
        found = look(rooms, pose)
        assert surface_phantom(found.segments, rooms.building) == 0.0
    # The pillar in the right room is all there.
    pillar = np.array([[8.5, 2.5], [9.5, 2.5], [9.5, 3.5], [8.5, 3.5]])
    for corner in pillar:
        ends = found.segments.reshape(-1, 2)
        assert np.hypot(*(ends - corner).T).min() < 0.1


def test_a_post_that_was_too_thin_to_be_seen_from_afar_is_mapped(rooms):
    look(rooms, [1.0, 3.0, 0.0])
    near = look(rooms, [4.0, 3.0, 0.0], somebody(5.0, 3.0, radius=0.04))
    assert surface_phantom(near.segments, rooms.building) > 0.05


def test_a_thin_wall_that_was_seen_edge_on_is_mapped(rooms):
    rooms.building = np.vstack([rooms.building, [[3.0, 3.001, 4.0, 3.001]]])
    look(rooms, [1.0, 3.0, 0.0])
    found = look(rooms, [2.5, 1.5, 1.0])
    assert surface_coverage(cut_walls(np.array([[3.0, 3.0, 4.0, 3.0]]))[0], found.segments) > 0.9


def box(x, y, side=0.45):
    """A chair's outline, walls (4, 4)."""
    corners = np.array([x, y]) + side * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    return np.hstack([corners, np.roll(corners, -1, axis=0)])


def test_furniture_put_down_where_ground_was_free_is_mapped_when_it_is_seen_there_again(rooms):
    look(rooms, [1.5, 3.0, 0.0])
    chair = box(3.5, 3.0)
    assert surface_phantom(look(rooms, [2.0, 2.5, 0.5], chair, stamp=5.0).segments, rooms.building) == 0.0
    soon = look(rooms, [2.0, 2.8, 0.5], chair, stamp=5.0 + 0.9 * STAYS)
    assert surface_phantom(soon.segments, rooms.building) == 0.0
    look(rooms, [2.0, 2.6, 0.5], chair, stamp=5.0 + 1.1 * STAYS)
    # From the other side it is nothing that passes by, either.
    found = look(rooms, [5.0, 4.5, 0.5], chair, stamp=6.0 + 1.1 * STAYS)
    assert surface_coverage(cut_walls(chair)[0], found.segments) > 0.9
    assert surface_phantom(found.segments, np.vstack([rooms.building, chair])) == 0.0
    # As seen from where there was nothing: it does not count as drifted there.
    found = look(rooms, [1.5, 3.0, 0.0], chair, stamp=7.0 + 1.1 * STAYS)
    assert surface_coverage(cut_walls(chair)[0], found.segments) > 0.9
    assert not inside_any(np.array([[3.7, 3.2]]), found.star_offsets, found.star_vertices)[0]
    # ... and it falls when it has been carried away again.
    found = look(rooms, [2.0, 2.6, 0.5], stamp=60.0)
    found = look(rooms, [5.0, 4.5, 0.5], stamp=62.0)
    assert surface_phantom(found.segments, rooms.building) == 0.0


def test_who_stands_where_another_stood_before_he_was_seen_past_is_not_furniture(rooms):
    look(rooms, [1.5, 3.0, 0.0])
    for stamp, people in ((5.0, [somebody(3.5, 3.0)]), (15.0, []), (30.0, [somebody(3.5, 3.0)])):
        found = look(rooms, [2.0, 2.5, 0.5], *people, stamp=stamp)
    assert surface_phantom(found.segments, rooms.building) == 0.0


def test_a_door_that_was_shut_is_mapped(rooms):
    look(rooms, [4.0, 3.0, 0.0])
    door = np.array([[6.0, 2.5, 6.0, 3.5]])
    look(rooms, [4.5, 3.0, 0.5], door, stamp=5.0)
    found = look(rooms, [4.2, 3.2, 0.5], door, stamp=30.0)
    assert surface_coverage(cut_walls(door)[0], found.segments) > 0.9
