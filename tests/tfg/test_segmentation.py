"""Surfaces and corners of known rooms."""

from itertools import pairwise

import numpy as np
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tfg_drake.tfg.panorama import Panorama
from tfg_drake.tfg.segmentation import find_corners, panorama_links, segment

SQUARE = [[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 4.0], [4.0, 4.0, 0.0, 4.0], [0.0, 4.0, 0.0, 0.0]]


def _segment(panorama: Panorama) -> list[np.ndarray]:
    """The polylines of the surfaces of a panorama."""
    components = segment(panorama, panorama_links(panorama))
    return np.split(components.vertices, components.offsets[1:-1])


def test_a_closed_room_is_one_closed_surface_with_four_corners(simulate) -> None:
    panorama = simulate(SQUARE).panorama(np.array([1.5, 2.0, 0.0]))
    assert segment(panorama, panorama_links(panorama)).closed
    (polyline,) = _segment(panorama)
    np.testing.assert_array_equal(polyline[0], polyline[-1])
    assert len(polyline) <= 7
    corners = np.array([[x, y] for x in (0.0, 4.0) for y in (0.0, 4.0)]) - [1.5, 2.0]
    assert np.hypot(*(corners[:, None] - polyline[None]).transpose(2, 0, 1)).min(axis=1).max() < 0.08


def test_surfaces_run_counter_clockwise_round_the_robot(two_rooms) -> None:
    components = _segment(two_rooms.panorama(np.array([2.0, 3.0, 0.3])))
    assert len(components) >= 2
    for component in components:
        a, b = component[:-1], component[1:]
        assert (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > -1e-9).all()


def test_a_door_breaks_a_wall(two_rooms) -> None:
    X_WA = np.array([3.0, 3.0, 0.0])
    for component in _segment(two_rooms.panorama(X_WA)):
        line = shapely.LineString(component + X_WA[:2])
        assert line.intersection(shapely.LineString([[6.0, 2.6], [6.0, 3.4]])).is_empty


def test_a_wall_seen_at_grazing_incidence_stays_one_surface(simulate) -> None:
    panorama = simulate([[-1.0, 0.0, 6.0, 0.0]], noise=0.005).panorama(np.array([0.0, 0.6, 0.0]))
    components = _segment(panorama)
    assert len(components) == 1
    assert components[0][:, 0].max() > 5.3


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10_000), st.integers(0, 60))
def test_corners_stay_within_tolerance_of_every_point(seed: int, count: int) -> None:
    points = np.cumsum(np.random.default_rng(seed).uniform(-0.3, 0.5, (count, 2)), axis=0)
    keep = find_corners(points, 0.2)
    if count < 2:
        assert keep.all()
        return
    assert keep[0]
    assert keep[-1]
    kept = np.flatnonzero(keep)
    for a, b in pairwise(kept):
        chord = shapely.LineString([points[a], points[b]])
        assert shapely.distance(chord, shapely.points(points[a : b + 1])).max() <= 0.2 + 1e-9


def test_a_near_wall_is_not_joined_to_the_one_behind_it(simulate) -> None:
    """The end of one wall hides another half a metre behind."""
    panorama = simulate([[-3.0, 5.0, 0.0, 5.0], [-3.0, 5.5, 3.0, 5.5]]).panorama(np.array([0.0, 0.0, 0.0]))
    components = _segment(panorama)
    assert len(components) == 2
    assert all(np.ptp(c[:, 1]) < 0.1 for c in components)
