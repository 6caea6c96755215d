"""Who stands where free ground was seen does not enter the map; who stood there first leaves it when seen past."""

import copy

import numpy as np
import pytest

from tfg_drake.metrics import surface_coverage, surface_phantom
from tfg_drake.world.reachability import cut_walls


def somebody(x, y, radius=0.25):
    """A person's outline, walls (16, 4)."""
    angle = np.linspace(0.0, 2.0 * np.pi, 17)
    p = np.array([x, y]) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.hstack([p[:-1], p[1:]])


@pytest.fixture
def rooms(two_rooms):
    two_rooms.building = two_rooms.walls
    return two_rooms


def look(rooms, pose, *people, **options):
    rooms.walls = np.vstack([rooms.building, *people])
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
