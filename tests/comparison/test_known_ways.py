import math

import numpy as np
import pytest

from tfg_drake.comparison.known_ways import known_ways
from tfg_drake.geometry.distance import clearance

WALL = np.array([[0.0, -1.0, 0.0, 1.0]])


def test_the_way_round_a_wall_is_the_taut_string():
    ways = known_ways(WALL, np.array([[-1.0, 0.0], [1.0, 0.0], [1.0, 2.0]]), 0.3)
    # A tangent, an arc round the wall's end, and a tangent.
    far, room = math.sqrt(2.0), 0.3
    on_arc = 2.0 * math.pi - 0.5 * math.pi - 2.0 * math.acos(room / far)
    exact = 2.0 * math.sqrt(far**2 - room**2) + room * on_arc
    assert exact <= ways.length[0, 1] <= 1.01 * exact
    assert ways.length[1, 2] == pytest.approx(2.0)
    np.testing.assert_allclose(ways.length, ways.length.T)


def test_a_way_keeps_its_room_and_is_as_long_as_it_says():
    rng = np.random.default_rng(0)
    walls = np.hstack([p := rng.uniform(0.0, 6.0, (8, 2)), p + rng.uniform(-1.0, 1.0, (8, 2))])
    places = rng.uniform(0.0, 6.0, (30, 2))
    places = places[clearance(np.hstack([places, places]), walls, 1.0) >= 0.25]
    ways = known_ways(walls, places, 0.25)
    assert np.isfinite(ways.length).all()
    for i in range(len(places)):
        way = ways.way(0, i)
        assert way[0].tolist() == places[0].tolist()
        assert way[-1].tolist() == places[i].tolist()
        assert np.hypot(*np.diff(way, axis=0).T).sum() == pytest.approx(ways.length[0, i], abs=1e-6)
        if i:
            assert clearance(np.hstack([way[:-1], way[1:]]), walls, 1.0).min() >= 0.25 - 1e-5


def test_a_closed_room_is_not_reached_and_a_start_near_a_wall_is():
    square = np.array([[-1.0, -1, 1, -1], [1, -1, 1, 1], [1, 1, -1, 1], [-1, 1, -1, -1]])
    ways = known_ways(square, np.array([[0.0, 0.0], [3.0, 0.0], [0.9, 0.0]]), 0.2)
    assert np.isinf(ways.length[0, 1])
    assert ways.length[0, 2] == pytest.approx(0.9)
